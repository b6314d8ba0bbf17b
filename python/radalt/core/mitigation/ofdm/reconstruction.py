"""Reconstruction: samples of the demodulated emitter, what a frame is without them, and blanking where that failed."""

import numpy as np
from scipy import fft

from .arrays import median, power
from .equaliser import ElementGrid
from .settings import OfdmSettings


def modulate(elements: np.ndarray, grid: ElementGrid) -> np.ndarray:
    """(N,) complex64 samples of (L, K) elements with their timing, prefixes included; 0 outside the symbols."""
    shift = (grid.numerology.useful + 1) // 2
    late = elements * grid.ramp.conj()
    first = late.shape[1] - shift
    useful = fft.ifft(np.concatenate([late[:, first:], late[:, :first]], axis=1), axis=1, norm="ortho")
    covered, places = grid.cyclic()
    out = np.zeros(grid.samples.size, np.complex64)
    out[covered] = useful.ravel().take(places)
    return out


def sent_elements(
    received: np.ndarray,
    model: np.ndarray,
    noise: np.ndarray,
    free: np.ndarray,
    used: np.ndarray,
    limit: float,
) -> np.ndarray:
    """(L, K) elements to be subtracted: everything received where no return can be, the model where one can.

    Return-free elements hold the emitter, its error vector and noise, and nothing of the return. In the mask, what
    differs from the model is the return. If it is far more than usual there, the element was decided wrongly and is
    subtracted whole. In subcarriers whose noise exceeds the usual, the return's share is kept by Wiener's weight.

    ``received``, ``model`` (L, K) complex64; ``noise`` (L, K) float32; ``free``, ``used`` (L, K) bool; ``limit``:
    times the 0.8 quantile of what is left in the mask.
    """
    rest = received - model
    masked = ~free & used
    weight = (~free & ~used).astype(np.float32)
    if masked.any():
        size = power(rest)
        own = noise[masked]
        white = np.minimum(median(own) / own, 1)
        kept = size[masked]
        high = int(0.8 * kept.size)
        weight[masked] = white * (kept < limit * np.partition(kept, high)[high])
    return received - rest * weight


def blanked(out: np.ndarray, settings: OfdmSettings) -> np.ndarray:
    """(N,) frame whose samples are 0 where they are far louder than usual."""
    level = power(out)
    return out * (level <= np.float32(settings.blank_ratio) * median(level[::4]))
