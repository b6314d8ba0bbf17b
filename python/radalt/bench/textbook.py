"""A textbook altimeter: the peak of the sum of both half sweeps' power spectra over speed hypotheses.

Whole-signal NumPy that shares no code with `core.altimeter`: dechirping at the full rate, zero-padded FFT, largest sum,
parabolic interpolation. A forced decision is the largest sum; a cell-averaging CFAR declares it by its ratio to the
mean of the band.
"""

import numpy as np

from ..core.altimeter.altimeter import AltimeterSettings
from ..core.altimeter.altimeter_settings import RESULT_DTYPE, Reason
from ..core.waveform import Waveform

# Peak over mean of the band at which it has as many false alarms in white noise as our altimeter by design, by allowed
# speed in m/s; from 60,000 frames of noise, since 3,000 give one 0.23 too low at 0 m/s.
THRESHOLD = {0.0: 6.362, 20.0: 6.755, 150.0: 7.524}
_C_M_PER_S = 299_792_458.0
_HYPOTHESIS_HZ = 500.0  # Doppler step between speed hypotheses: 17 m/s, a quarter of a resolution cell
_PADDING = 8  # FFT length over samples: the parabola's error is then below 0.5 m (tests/test_textbook.py)
_GUARD = 1.5  # resolution cells on each side of the peak that the mean of the band leaves out


def textbook_altitudes(
    frames: np.ndarray,
    *,
    bandwidth_hz: float,
    rate_hz: float,
    carrier_hz: float,
    speed_m_per_s: float,
    max_altitude_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Altitude of each frame, and the peak of the sum over the mean of the band.

    ``frames`` (n, N) complex: one sweep each, up from ``-bandwidth_hz / 2`` and down, aligned with the reference;
    ``speed_m_per_s``: largest vertical speed among the hypotheses, up and down. Returns ``altitude_m``, ``ratio``
    (n,) float.
    """
    samples = frames.shape[1] // 2
    t = np.arange(samples) / rate_hz
    slope = bandwidth_hz * rate_hz / samples
    chirp = np.exp(1j * np.pi * (slope * t**2 - bandwidth_hz * t))
    size = _PADDING * samples
    step_hz = rate_hz / size
    up = np.abs(np.fft.fft(np.conj(frames[:, :samples]) * chirp, size)) ** 2
    down = np.abs(np.fft.fft(frames[:, samples:] * chirp, size)) ** 2
    top = int(2.0 * slope * max_altitude_m / _C_M_PER_S / step_hz) + 1
    cells = np.arange(-2 * _PADDING, top + 2 * _PADDING)
    most = int(2.0 * speed_m_per_s * carrier_hz / _C_M_PER_S / _HYPOTHESIS_HZ)
    best, altitude, ratio = (np.full(len(frames), fill) for fill in (-1.0, 0.0, 0.0))
    guard = int(_GUARD * _PADDING)
    for shift in np.arange(-most, most + 1) * round(_HYPOTHESIS_HZ / step_hz):
        total = up[:, (cells + shift) % size] + down[:, (cells - shift) % size]
        for k in range(len(frames)):
            at = int(np.argmax(total[k]))
            if total[k, at] <= best[k]:
                continue
            best[k] = total[k, at]
            inside = min(max(at, 1), cells.size - 2)
            left, here, right = total[k, inside - 1 : inside + 2]
            bend = left - 2.0 * here + right
            offset = 0.5 * (left - right) / bend if bend < 0 else 0.0
            altitude[k] = (cells[inside] + np.clip(offset, -1, 1)) * step_hz * _C_M_PER_S / (2.0 * slope)
            rest = np.concatenate([total[k, : max(0, at - guard)], total[k, at + guard + 1 :]])
            ratio[k] = total[k, at] / rest.mean()
    return altitude, ratio


def textbook_results(
    frames: np.ndarray,
    waveform: Waveform,
    settings: AltimeterSettings,
    offset_s: np.ndarray,
    frame_index: np.ndarray,
) -> np.ndarray:
    """(n,) of `RESULT_DTYPE`: altitudes of frames whose timing is off by (n,) seconds, and whether they are declared.

    Raises `ValueError` for an allowed speed whose threshold is not known.
    """
    speed = settings.max_vertical_speed_m_per_s
    if speed not in THRESHOLD:
        known = ", ".join(f"{s:g}" for s in THRESHOLD)
        raise ValueError(
            f"detector: textbook allows speeds of {known} m/s, not {speed}; set altimeter to one"
        )
    assert settings.max_altitude_m is not None  # resolved
    out = np.zeros(len(frames), RESULT_DTYPE)
    altitude_m, ratio = textbook_altitudes(
        frames,
        bandwidth_hz=waveform.bandwidth_hz,
        rate_hz=waveform.rate_hz,
        carrier_hz=waveform.carrier_hz,
        speed_m_per_s=speed,
        max_altitude_m=settings.max_altitude_m,
    )
    out["frame_index"], out["valid"] = frame_index, ratio > THRESHOLD[speed]
    out["reason"] = np.where(out["valid"], Reason.OK, Reason.NO_DETECTION)
    out["altitude_m"] = out["forced_altitude_m"] = altitude_m - 0.5 * _C_M_PER_S * offset_s
    for name in ("vertical_speed_m_per_s", "peak_to_sidelobe_db", "ambiguity_db", "snr_db"):
        out[name] = np.nan
    return out
