"""How well elements fit the alphabets, and the factor with which they fit best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .lattice import CELL, DENSE, FEW_CELL, at_most_one, middle, nearest, power, sparse

__all__ = ["gain", "misfit", "usual_misfit"]

_GAINS = (1.025 ** np.arange(-14, 15)).astype(np.float32)
_FITS = 0.1  # mean error in cells at which no other gain is looked for
_NO_WORSE = 1.2
_SENT = 0.1  # power above which an element is not silent; the faintest points of 256QAM have less


def misfit(values: np.ndarray, asked: np.ndarray, alphabets: Sequence[int] = DENSE) -> float:
    """Mean squared distance of elements from the nearest point of QPSK or ``alphabets``, in cells, each at most 1.

    Of the ``values`` (L, n) only those ``asked`` (L, n) count, and silent ones tell nothing. Some 0.3 for elements that
    were not sent from these alphabets, or are not set upright.
    """
    errors, counts = _misfits(values, asked, alphabets)
    return float(errors.sum() / counts.sum()) if counts.any() else 1.0


def usual_misfit(values: np.ndarray, asked: np.ndarray, alphabets: Sequence[int] = DENSE) -> float:
    """The same of the median symbol: synchronisation signals fit none of these alphabets, but no frame has many."""
    errors, counts = _misfits(values, asked, alphabets)
    told = counts > 0
    return middle(errors[told] / counts[told]) if told.any() else 1.0


def _misfits(
    values: np.ndarray, asked: np.ndarray, alphabets: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of the symbols' errors, and of how many elements, (L,) and (L,)."""
    level = power(values)
    sent = level > _SENT
    sent &= asked
    least = power(values - sparse(values, level)) * (1 / FEW_CELL)
    for dense in alphabets:
        np.minimum(least, power(values - nearest(values, dense)) * (1 / CELL[dense]), out=least)
    return (at_most_one(least) * sent).sum(axis=1), np.count_nonzero(sent, axis=1)


def gain(values: np.ndarray, asked: np.ndarray, before: float) -> tuple[np.float32, float]:
    """Factor within 0.7..1.4 by which (L, n) elements fit the alphabets best, and the `misfit` that is left.

    The received power varies with what is sent, so the channel of an earlier frame is right only up to this factor.
    With a misfit no worse than ``before`` it is taken as right.
    """
    left = misfit(values, asked)
    if left < max(_FITS, _NO_WORSE * before):
        return np.float32(1), left
    return min(((factor, misfit(values * factor, asked)) for factor in _GAINS), key=lambda tried: tried[1])
