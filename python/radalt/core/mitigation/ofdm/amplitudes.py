"""Users of unequal powers: the amplitude of each one's lattice, told by its own points."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .lattice import (
    BLOCK,
    DENSE,
    FAINT,
    FEW_CELL,
    Decisions,
    at_most_one,
    box,
    members,
    power,
    rounded,
    rounded_each,
    sparse,
)

__all__ = ["decide_scaled", "levelled"]

_WIDE = 13  # subcarriers that tell an amplitude; a user has at least 24
_ASIDE = (0, -6, 6)  # one of the windows so far from an element holds its user alone
_BEYOND = (-14, 14)  # the same where the channel's modulus is a mean of two users'
_NARROW = 3  # subcarriers that tell which one
_FACTORS = (1.04 ** np.arange(-3, 4)).astype(np.float32)  # some 70 points of QAM tell their amplitude to 4 %
_FLOOR = np.float32(0.3)  # amplitude below which nothing is sent
_OCCUPIED = np.float32(0.3)  # of the power around it: less is silence
_RIDGE = np.float32(0.05)  # weight of an element that the return may be in, in a block's power
_SPARSE_ERROR = np.float32(0.04)  # mean squared error below which a block is one of few points
_LONE = np.float32(0.1)  # the same of an element and its neighbours
_DOUBTFUL = 0.1  # mean error of a symbol in cells, each at most 1, that may stand on the axes
_CLEARLY = np.float32(0.8)  # of a window's error, for another one to be taken
_FAR_BETTER = np.float32(0.02)  # of the error of few points, for square QAM to be taken in their place
_EVENLY = 25  # subcarriers in most of which no user begins
_EIGHTH = np.complex64(np.exp(0.25j * np.pi))


def decide_scaled(
    values: np.ndarray, modulus: np.ndarray, trusted: np.ndarray, halves: np.ndarray
) -> tuple[Decisions, np.ndarray]:
    """`decide` of (L, K) elements whose users have amplitudes of their own, and these, (2, L, K) float32.

    The first amplitude is that of an element's square QAM, the second that of its few points; the points have them.
    ``modulus`` (K,) is the channel's, ``trusted`` (L, K) and ``halves`` (L,) are as in `decide`. A user keeps its
    amplitude and alphabet for a slot. They are those with which the elements of a window of subcarriers in a half slot
    are nearest to a lattice. An element may belong to another user than most of the window about it, so windows beside
    it and other half slots are tried, too: the one that explains the element and its neighbours best is taken,
    in the end the one that explains its subcarrier in the half slot.
    """
    level = power(values)
    found = _Scanty(values, level, trusted)
    asked = (trusted & ~found.fits).astype(np.float32)
    own, kinds, points, error = _dense(values, level, modulus, asked, halves)
    # a user's last element may be in the window of one that sends few points
    apart = [box(power(values - each), _NARROW) for each in (found.points, points)]
    found.fits &= _FAR_BETTER * apart[0] <= apart[1]
    points = np.where(found.fits, found.points, points)
    error = np.where(found.fits, found.error, error)
    amplitudes = np.stack([own[halves], found.amplitude])
    decisions = Decisions(points, error, at_most_one(error), found.fits, kinds)
    told = np.maximum(np.count_nonzero(trusted, axis=1), 1)
    odd = np.flatnonzero((decisions.capped * trusted).sum(axis=1) > _DOUBTFUL * told)
    if odd.size:  # the synchronisation signals stand on the axes
        turned = _Scanty(values[odd] * _EIGHTH, level[odd], trusted[odd])
        axes = turned.fits & ~found.fits[odd]
        points[odd] = np.where(axes, turned.points * _EIGHTH.conj(), points[odd])
        error[odd] = np.where(axes, turned.error, error[odd])
        amplitudes[1, odd] = np.where(axes, turned.amplitude, amplitudes[1, odd])
        decisions.few[odd] |= axes
        decisions.capped[odd] = at_most_one(error[odd])
    return decisions, amplitudes


def levelled(channel: np.ndarray, own: np.ndarray, told: np.ndarray) -> np.ndarray:
    """(K,) channel without the steps of users' amplitudes ``own`` (L, K), by the elements ``told`` (L, K) bool.

    What is received tells the channel's modulus times a user's amplitude. At first the steps between users are in the
    modulus, smoothed, and what is wrong there is in the amplitudes, which then are no user's. But a channel goes on
    evenly and users' amplitudes step: the median of the changes from one subcarrier to the next is the channel's.
    """
    size = np.maximum(np.abs(channel), FAINT)
    count = np.count_nonzero(told, axis=0)
    both = (np.log(own) * told).sum(axis=0) / np.maximum(count, 1) + np.log(size)
    even = np.append(0, np.cumsum(ndimage.median_filter(np.diff(both), _EVENLY)))
    some = count > 0
    even += (both - even)[some].mean() if some.any() else 0
    return np.where(some, channel * (np.exp(even) / size), channel).astype(np.complex64)


class _Scanty:
    """Blocks of silence and QPSK of any amplitude in (L, K) elements: points, errors in cells, amplitudes, and where
    they fit, all (L, K)."""

    def __init__(self, values: np.ndarray, level: np.ndarray, trusted: np.ndarray) -> None:
        heard = trusted + _RIDGE
        sent = (level > _OCCUPIED * box(level * heard, BLOCK) / box(heard, BLOCK)) * heard
        own = np.sqrt(box(level * sent, BLOCK) / np.maximum(box(sent, BLOCK), _RIDGE / BLOCK))
        np.maximum(own, _FLOOR, out=own)
        least = None
        for aside in _ASIDE:
            amplitude = _moved(own, aside)
            upright = values / amplitude
            points = sparse(upright, level / np.square(amplitude))
            error = power(upright - points)
            wrong = np.where(box(error, _NARROW) < _LONE, _moved(box(error, BLOCK), aside), np.float32(1))
            tried = points * amplitude, error * (1 / FEW_CELL), amplitude
            if least is None:
                least, kept = wrong, tried
            else:
                better = wrong < _CLEARLY * least
                least = np.where(better, wrong, least)
                kept = [np.where(better, new, old) for new, old in zip(tried, kept, strict=True)]
        self.points, self.error, self.amplitude = kept
        self.fits = least < _SPARSE_ERROR


def _dense(
    values: np.ndarray, level: np.ndarray, modulus: np.ndarray, asked: np.ndarray, halves: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes and kinds (half slots, K), points and errors in cells (L, K) of elements as square QAM."""
    within = members(halves)
    count = np.maximum(box(within @ asked, _WIDE), FAINT)
    own = np.maximum(np.sqrt(box(within @ (level * asked), _WIDE) / count), _FLOOR)
    upright = values / own[halves]
    least = np.full(own.shape, np.inf, dtype=np.float32)
    factor, kinds = np.ones_like(own), np.zeros(own.shape, dtype=np.int8)
    for kind in range(len(DENSE)):
        for tried in _FACTORS:
            error = box(within @ (at_most_one(rounded(upright * tried, kind)[1]) * asked), _WIDE)
            better = error < least
            least = np.where(better, error, least)
            factor, kinds = np.where(better, tried, factor), np.where(better, np.int8(kind), kinds)
    own /= factor
    size = own * modulus
    tried = [(_moved(own, aside), _moved(kinds, aside)) for aside in _ASIDE]
    tried += [(_moved(size, aside) / modulus, _moved(kinds, aside)) for aside in (*_ASIDE[1:], *_BEYOND)]
    number = np.arange(len(own))
    beside = [number[np.clip(number + step, 0, number[-1])] for step in (-1, 1)]
    own, kinds, points, error = _best(values, tried + [(own[at], kinds[at]) for at in beside], asked, halves)
    # finer, by least squares
    upright = points / own[halves]
    sure = asked * (error < 1)
    right = box(within @ ((values * upright.conj()).real * sure), _WIDE)
    left = box(within @ (power(upright) * sure), _WIDE)
    finer = np.where(left > 1, right / np.maximum(left, FAINT), own)
    tried = [*((_moved(finer, aside), kinds) for aside in _ASIDE), (own, kinds)]
    return _best(values, tried, asked, halves, 1)


def _best(
    values: np.ndarray,
    tried: list[tuple[np.ndarray, np.ndarray]],
    asked: np.ndarray,
    halves: np.ndarray,
    narrow: int = _NARROW,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Those of the amplitudes and kinds ``tried`` that explain ``narrow`` subcarriers about an element best; as
    `_dense`."""
    within = members(halves)
    told = np.maximum(box(within @ asked, narrow), np.float32(1 / narrow))
    least = None
    for amplitude, kinds in tried:
        here = amplitude[halves]
        points, error = rounded_each(values / here, kinds, halves)
        wrong = box(within @ (at_most_one(error) * asked), narrow) / told
        new = amplitude, kinds, points * here, error
        if least is None:
            least, kept = wrong, new
            continue
        better = wrong < _CLEARLY * least
        least = np.where(better, wrong, least)
        each = better[halves]
        kept = [np.where(b, n, o) for b, n, o in zip((better, better, each, each), new, kept, strict=True)]
    return tuple(kept)


def _moved(values: np.ndarray, aside: int) -> np.ndarray:
    """(..., K) values of so many subcarriers on, the ends repeated."""
    at = np.arange(values.shape[-1]) + aside
    return values[..., at.clip(0, at.size - 1)] if aside else values
