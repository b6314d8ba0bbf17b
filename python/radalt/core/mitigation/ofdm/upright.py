"""What sets a frame's symbols right in angle and delay."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .lattice import decide, middle, misread, unit
from .numerology import Numerology

__all__ = ["DOUBTFUL", "true_up", "turned"]

_STRAIGHT = 2e-4  # samples: less slope than that is none at 70 dB
_SLIGHT = 0.02  # samples of slope for which two terms of the exponential are exact to 87 dB
_FAINTER = 0.3  # of the strongest symbol's weight, from which a symbol tells how late all are
_NOTHING = 0.02  # of that weight: a symbol's few trusted elements may all be wrong, and it stays as it is
_LEAST = np.float32(1e-30)  # of a weight that divides
DOUBTFUL = 0.15  # mean error of a symbol in cells, each at most 1; a random one has 0.75
_TURNS = np.float32([-np.pi / 4, *np.arange(-0.7, 0.75, 0.1)])  # radians by which symbols may be ahead
_UPRIGHT = 0.8  # of a symbol's error, for another angle to be taken
_TOGETHER = 0.05  # samples by which symbols differ that are equally late


def true_up(
    agreement: np.ndarray, numerology: Numerology, *, upright: np.ndarray | None = None, evenly: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What sets each symbol right: (L, K) factor, (L,) angles, and (L,) slopes over the subcarriers, in samples.

    ``agreement`` (L, K) complex64 is received times conjugate model; zero where not to be used. The symbols ``upright``
    (int) are so: a channel that is still wrong would turn them. Clocks drift ``evenly``, but where echoes fade the mean
    delay has a course of its own.
    """
    moments = (agreement.view(np.float32) @ numerology.moments).view(np.complex64).T
    size = np.abs(moments[0])
    most = size.max()
    if upright is not None:
        size[upright] = 0
    if size.min() <= _NOTHING * most:
        unknown = size <= _NOTHING * most
        moments[:, unknown] = size[unknown] = 0
        most = size.max()
    mean, whole = moments[0], np.maximum(size, _LEAST)
    angle = np.arctan2(mean.imag, mean.real)
    # the elements asked are not centred: angle and slope are found together
    first, second = moments[1:] * (mean.conj() / whole)
    centre = first.real / whole
    told = np.maximum(second.real - first.real * centre, 1e-6 * whole)
    slope = first.imag / told
    # all symbols come equally late: one that seems not to was misread
    common = middle(slope[size >= _FAINTER * most])
    alone = np.abs(slope - common) > _TOGETHER
    strays = alone.any()
    if evenly:
        slope = _evenly(slope, told * ~alone if strays else told)
    elif strays:
        slope[alone] = common
    if strays and (alone := alone & (size > 0)).any():
        turn = slope[alone, None].astype(np.float32) * numerology.turn
        straight = (agreement[alone] * unit(-turn)).sum(axis=1)
        angle[alone], centre[alone] = np.angle(straight), 0
    angle = angle - slope * centre
    back = np.exp(-1j * angle)
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


def _evenly(slope: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(L,) values of the straight line through ``slope`` (L,) of those weights.

    Each symbol's own slope has the noise of its data. The channel would take that over, since the elements that are
    left out for the return are others in each symbol.
    """
    powers = _powers(len(slope))
    whole, first, second = (powers @ weight).tolist()
    value, product = (powers[:2] @ (weight * slope)).tolist()
    centre = first / whole
    drift = (product - centre * value) / max(second - centre * first, 1e-9 * whole)
    return (value / whole - drift * centre) + drift * powers[1]


@lru_cache(maxsize=16)
def _powers(count: int) -> np.ndarray:
    """(3, count) float64 powers 0, 1, 2 of the symbols' numbers, read-only."""
    powers = np.arange(float(count)) ** np.arange(3)[:, None]
    powers.setflags(write=False)
    return powers


def turned(
    symbols: np.ndarray,
    channel: np.ndarray,
    off: np.ndarray,
    clear: np.ndarray,
    halves: np.ndarray,
    kinds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the symbols that fit their alphabets better turned, and the factors (L, 1) complex64 that turn them.

    To the fourth power a symbol with most points on the axes (the primary synchronisation signal) looks turned by an
    eighth. Where the channel is wrong in some subcarriers, symbols that have most of their elements there follow it.
    ``off`` (L,) is the mean error of each as it stands, in cells; the others are as in `decide`.
    """
    doubtful = np.flatnonzero(off > DOUBTFUL)
    back = np.ones((len(off), 1), dtype=np.complex64)
    if not doubtful.size:
        return doubtful, back
    channel = channel if channel.ndim == 1 else channel[doubtful]
    # with most of them wrong, that is not the fault
    turns = unit(-_TURNS if doubtful.size < len(off) / 2 else -_TURNS[:1])
    values = turns[:, None, None] * (symbols[doubtful] * (1 / channel))
    # all turns of all symbols at once, as so many symbols
    clear, halves = (np.concatenate([part[doubtful]] * turns.size) for part in (clear, halves))
    found = decide(values.reshape(len(clear), -1), clear, halves, kinds)
    left = misread(found.capped, clear, channel).reshape(turns.size, -1)
    best = left.argmin(axis=0)
    better = left.min(axis=0) < _UPRIGHT * off[doubtful]
    back[doubtful[better], 0] = turns[best[better]]
    return np.flatnonzero(back != 1), back
