"""Common phase and timing of each symbol."""

import numpy as np

from .equaliser import ElementGrid, timing_ramp


def correct_phase(agreement: np.ndarray) -> np.ndarray:
    """(L, 1) complex64 factors that take out each symbol's common phase error.

    ``agreement`` (L, K) is received times conjugate model, weighted by the inverse noise.
    """
    total = agreement.sum(axis=1) + np.complex64(1e-20)
    return (total.conj() / np.abs(total)).astype(np.complex64)[:, None]


def timing_drift(agreement: np.ndarray, model_power: np.ndarray, grid: ElementGrid) -> np.ndarray:
    """(L,) samples by which the symbols are late, a straight line over time with mean 0.

    ``agreement`` as in `correct_phase`, phases taken out; ``model_power`` (L, K) is the weighted power of the model.
    Each symbol's slope over frequency has the noise of its data, so a line is fitted: a sample clock offset.
    """
    k = grid.numerology.subcarriers
    k = k - (model_power @ k / np.maximum(model_power.sum(axis=1), 1e-9))[:, None]
    information = (model_power * k * k).sum(axis=1) + np.float32(1e-9)
    slope = (agreement.imag * k).sum(axis=1) / information
    index = np.arange(len(slope))
    index = index - (information * index).sum() / information.sum()
    rate = (information * index * slope).sum() / (information * index * index).sum()
    return rate * index * grid.numerology.useful / (2 * np.pi)


def retimed(delay: np.ndarray, grid: ElementGrid) -> np.ndarray:
    """(L, K) factors that take out ``delay`` (L,) samples, and are kept in ``grid.ramp``."""
    factor = timing_ramp(-delay, grid.numerology)
    grid.ramp = grid.ramp * factor
    return factor


def axes_phases(coherence: np.ndarray) -> np.ndarray:
    """(L,) angles that blocks' coherences (L, blocks) of fourth powers have in common.

    Blocks of synchronisation signals, whose points are on the axes, have the other sign. Squares ignore it, and the
    sign of the sum decides between the two angles.
    """
    angle = np.angle((coherence * coherence / (np.abs(coherence) + np.float32(1e-9))).sum(axis=1)) / 2
    root = coherence / np.sqrt(np.abs(coherence) + np.float32(1e-9))
    return angle + np.pi * ((root * np.exp(-1j * angle)[:, None]).real.sum(axis=1) < 0)
