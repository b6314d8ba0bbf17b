"""Measures of the path from received samples: power, clipping, lines, flatness.

Powers are relative to full scale: a complex sample of magnitude 1 is 0 dBFS. NaN stands for missing samples.
"""

import numpy as np

from ..spectral_line import noise_level
from ..waveform import Waveform

_RAIL = 0.998  # share of full scale that counts as clipped: a 12-bit converter ends at 2047 / 2048
_INNER = 0.8  # share of the band that is measured; beyond it the radios' half-band filters roll off
_PIECES = 30  # pieces of the band in which the flatness is averaged


def db(power: float) -> float:
    """Decibels of a power ratio, at least -300."""
    return float(10.0 * np.log10(max(float(power), 1e-30)))


def mean_power(samples: np.ndarray) -> float:
    """Mean power of the samples that are not missing; 0 without any."""
    there = samples[np.isfinite(samples)]
    return float(np.mean(np.abs(there) ** 2)) if there.size else 0.0


def clipped_percent(samples: np.ndarray) -> float:
    """Share of I and Q of complex64 samples at full scale, in percent."""
    rails = samples[np.isfinite(samples)].view(np.float32)
    return float(100.0 * np.mean(np.abs(rails) >= _RAIL)) if rails.size else 0.0


def strongest_lines(frames: np.ndarray, rate_hz: float) -> tuple[float, float, float]:
    """(DC in dBFS, strongest other line in dBFS, its frequency in hertz) of (k, N) frames, over the noise."""
    n = frames.shape[1]
    window = np.hanning(n)
    power = np.mean(np.abs(np.fft.fft(frames * window, axis=1) / window.sum()) ** 2, axis=0)
    power -= noise_level(power, len(frames))
    dc = power[[-1, 0, 1]].max()
    power[[-2, -1, 0, 1, 2]] = 0.0
    return db(dc), db(power.max()), float(np.fft.fftfreq(n)[power.argmax()] * rate_hz)


def ripple_db(waveform: Waveform, sweeps: np.ndarray, delay_samples: float, first: int = 0) -> float:
    """Flatness of a received sweep, peak to peak over the inner 80 % of the band, dB; NaN where samples are missing.

    The sweep's frequency is a function of time, so its power over time is the path's response. ``sweeps`` (k, N) are
    from number ``first`` on at altitude zero, each ``delay_samples`` (0..1) later than its first sample; their mean is
    taken.
    """
    rotation = np.conj(waveform.frame_rotation(np.arange(first, first + len(sweeps))))
    sweep = (sweeps * rotation[:, None]).mean(axis=0)
    if not np.isfinite(sweep).all():
        return np.nan
    w = waveform
    time_s = np.mod(w.sample_times_s - delay_samples / w.rate_hz, w.sweep_s)
    hz = w.slope_hz_per_s * np.minimum(time_s, w.sweep_s - time_s) - w.centered * w.bandwidth_hz / 2
    band = np.mod(hz / w.rate_hz + 0.5, 1.0)
    inner = np.abs(band - 0.5) < _INNER / 2
    piece = np.floor(band[inner] * _PIECES).astype(int)
    count = np.bincount(piece)
    levels = np.bincount(piece, np.abs(sweep[inner]) ** 2)[count > 0] / count[count > 0]
    return float(np.ptp(10 * np.log10(levels)))
