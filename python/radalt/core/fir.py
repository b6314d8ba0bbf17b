"""Window functions and the Kaiser low-pass.

`scipy.signal` gives the same numbers to the bit, but its import costs every process 40 MB and half a second.
"""

from functools import lru_cache

import numpy as np
from scipy.special import i0

_STOP_DB = 80.0  # stop-band attenuation, dB: aliases stay below the quantisation noise of 12 bits (74 dB)
WINDOWS = {  # weights of cos(k t), t = -pi..pi
    "hann": (0.5, 0.5),
    "hamming": (0.54, 1 - 0.54),
    "blackman": (0.42, 0.5, 0.08),
    "boxcar": (1.0,),
}


def cosine_window(name: str, points: int, *, periodic: bool = False) -> np.ndarray:
    """(points,) float64 window of `WINDOWS`: symmetric, or one period of a sequence, as an STFT needs it."""
    t = np.linspace(-np.pi, np.pi, points + periodic)
    return sum(weight * np.cos(k * t) for k, weight in enumerate(WINDOWS[name]))[:points]


@lru_cache(maxsize=8)
def periodic_hann(count: int) -> np.ndarray:
    """One period of a Hann window, (count,) float32, read-only."""
    window = cosine_window("hann", count, periodic=True).astype(np.float32)
    window.setflags(write=False)
    return window


def tukey_window(points: int, share: float) -> np.ndarray:
    """(points,) float64: ones, with half a cosine over ``share / 2`` of the points at either end."""
    n = np.arange(points, dtype=float)
    side = int(share * (points - 1) / 2) + 1
    window = np.ones(points)
    window[:side] = 0.5 * (1 + np.cos(np.pi * (-1 + 2 * n[:side] / share / (points - 1))))
    window[-side:] = 0.5 * (1 + np.cos(np.pi * (-2 / share + 1 + 2 * n[-side:] / share / (points - 1))))
    return window


def kaiser_window(points: int, beta: float) -> np.ndarray:
    """(points,) float64 window of J. F. Kaiser; a greater ``beta`` has lower side lobes and a wider main lobe."""
    middle = (points - 1) / 2
    return i0(beta * np.sqrt(1 - ((np.arange(points) - middle) / middle) ** 2)) / i0(beta)


def kaiser_lowpass(pass_hz: float, stop_hz: float, rate_hz: float) -> np.ndarray:
    """(odd,) float64 taps of a linear-phase low-pass of unit gain at 0 Hz.

    Kaiser's formulae for length and ``beta`` (Oppenheim and Schafer, Discrete-Time Signal Processing, sec. 7.6).

    ``pass_hz``, ``stop_hz``: edges of pass band and stop band; 80 dB of attenuation from the second on.
    """
    nyquist = rate_hz / 2
    length = (_STOP_DB - 7.95) / 2.285 / (np.pi * ((stop_hz - pass_hz) / nyquist)) + 1
    count = int(np.ceil(length)) | 1
    cutoff = 0.5 * (stop_hz + pass_hz) / nyquist
    taps = cutoff * np.sinc(cutoff * (np.arange(count) - 0.5 * (count - 1)))
    taps *= kaiser_window(count, 0.1102 * (_STOP_DB - 8.7))
    return taps / taps.sum()
