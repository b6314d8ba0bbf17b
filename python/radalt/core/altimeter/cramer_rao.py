"""Cramer-Rao bounds of the up/down beat estimate."""

import numpy as np

from ..waveform import C_M_PER_S, Waveform


def beat_crb_hz(waveform: Waveform, snr_db: np.ndarray | float) -> np.ndarray:
    """Standard deviation bound in hertz of one half sweep's beat frequency, phase and amplitude unknown.

    ``var(f) >= 6 F_s^2 / ((2 pi)^2 snr M (M^2 - 1))`` for a complex tone of ``M`` samples in white noise, with
    ``snr`` the per-sample signal-to-noise ratio before dechirping (D. C. Rife and R. R. Boorstyn, "Single-tone
    parameter estimation from discrete-time observations", IEEE Trans. Inf. Theory 20(5), 1974, eq. 17).
    """
    snr = 10.0 ** (np.asarray(snr_db, dtype=float) / 10.0)
    m = waveform.samples_per_half
    return waveform.rate_hz / (2.0 * np.pi) * np.sqrt(6.0 / (snr * m * (m * m - 1.0)))


def altitude_crb_m(waveform: Waveform, snr_db: np.ndarray | float) -> np.ndarray:
    """Altitude bound in metres: ``R = c (f_up - f_down) / 4k`` of two independent beats."""
    scale = C_M_PER_S / (4.0 * waveform.slope_hz_per_s)
    return scale * np.sqrt(2.0) * beat_crb_hz(waveform, snr_db)
