"""What sets a frame's symbols right in angle and delay."""

from __future__ import annotations

import numpy as np

from .lattice import middle, unit
from .numerology import Numerology

__all__ = ["true_up"]

_STRAIGHT = 2e-4  # samples: less slope than that is none at 70 dB
_SLIGHT = 0.02  # samples of slope for which two terms of the exponential are exact to 87 dB
_FAINTER = 0.3  # of the strongest symbol's weight, from which a symbol tells how late all are
_TOGETHER = 0.05  # samples by which symbols differ that are equally late


def true_up(agreement: np.ndarray, numerology: Numerology) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What sets each symbol right: (L, K) factor, (L,) angles, and (L,) slopes over the subcarriers, in samples.

    ``agreement`` (L, K) complex64 is received times conjugate model; zero where not to be used.
    """
    mean, first, second = (agreement.view(np.float32) @ numerology.moments).view(np.complex64).T
    angle = np.angle(mean + 1e-30)
    back = np.exp(-1j * angle)
    # the elements asked are not centred: angle and slope are found together
    first, whole, square = first * back, np.maximum((mean * back).real, 1e-30), (second * back).real
    slope = first.imag / np.maximum(square - first.real**2 / whole, 1e-6 * square + 1e-30)
    # all symbols come equally late: one that seems not to was misread
    common = middle(slope[whole > _FAINTER * whole.max()])
    alone = np.abs(slope - common) > _TOGETHER
    if alone.any():
        slope[alone] = common
        straight = (agreement[alone] * unit(np.float32(-common) * numerology.turn)).sum(axis=1)
        angle[alone] = np.angle(straight + 1e-30)
        back[alone], first[alone] = np.exp(-1j * angle[alone]), 0
    finer = slope * first.real / whole
    angle = angle - finer
    back = back * np.exp(1j * finer)
    steepest = np.abs(slope).max()
    if steepest < _STRAIGHT:
        return back.astype(np.complex64)[:, None], angle, slope
    if steepest > _SLIGHT:
        turn = slope[:, None].astype(np.float32) * numerology.turn
        return unit(-turn - angle[:, None].astype(np.float32)), angle, slope
    terms = np.empty((len(back), 3), dtype=np.complex64)
    terms[:, 0] = back
    terms[:, 1] = back * (-1j * slope)
    terms[:, 2] = back * (-0.5 * slope * slope)
    return (terms.view(np.float32) @ numerology.moments.T).view(np.complex64), angle, slope
