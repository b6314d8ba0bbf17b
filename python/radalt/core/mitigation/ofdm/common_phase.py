"""Common phase of each symbol."""

import numpy as np


def correct_phase(agreement: np.ndarray) -> np.ndarray:
    """(L, 1) complex64 factors that take out each symbol's common phase error.

    ``agreement`` (L, K) is received times conjugate model, weighted by the inverse noise.
    """
    total = agreement.sum(axis=1) + np.complex64(1e-20)
    return (total.conj() / np.abs(total)).astype(np.complex64)[:, None]


def axes_phases(coherence: np.ndarray) -> np.ndarray:
    """(L,) angles that blocks' coherences (L, blocks) of fourth powers have in common.

    Blocks of synchronisation signals, whose points are on the axes, have the other sign. Squares ignore it, and the
    sign of the sum decides between the two angles.
    """
    angle = np.angle((coherence * coherence / (np.abs(coherence) + np.float32(1e-9))).sum(axis=1)) / 2
    root = coherence / np.sqrt(np.abs(coherence) + np.float32(1e-9))
    return angle + np.pi * ((root * np.exp(-1j * angle)[:, None]).real.sum(axis=1) < 0)
