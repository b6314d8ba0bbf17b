"""Decisions and channel in turns, from symbols of known timing to a model of what was sent and heard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .acquisition import Grid
from .channel_fit import fit, sums
from .lattice import BLOCK, CELL, DENSE, SPARSE_ERROR, box, nearest, power, sparse
from .numerology import Numerology

__all__ = ["Received", "constellation", "demodulate", "gain"]

# subcarriers a channel is averaged over, and order of its course in time, turn by turn; in the end each subcarrier
# for itself
FIRST = ((15, 0), (9, 1), (5, 1), (1, 1))
AGAIN = ()
_ORDERS = 3  # 0, 1, 2: tried in the end
_HELPS = 0.95  # of the error left, for a higher order to be taken
_DOUBTFUL = 0.15  # mean error of a symbol in cells, each at most 1; a random one has 0.75
_GAINS = (1.025 ** np.arange(-14, 15)).astype(np.float32)
_STRAIGHT = 2e-4  # samples: less slope than that is none at 70 dB
_FITS = 0.1  # mean error in cells at which no other gain is looked for
_EIGHTH = np.complex64(np.exp(0.25j * np.pi))


@dataclass
class Received:
    """A frame's symbols, demodulated.

    Attributes
    ----------
    symbols, phase : (L, K) complex64
        As in `Grid`, with finer phases.
    channel : (L, K) complex64
    drift : (L, K) complex64 or None
        Change of the channel from symbol to symbol; None where it stands still.
    points : (L, K) complex64
        Decided points.
    few : (L, K) bool
        Elements whose alphabet has few points.
    error : (L, K) float32
        Squared distance from the model.
    dense : int
        Points of the square QAM: 16, 64 or 256.
    angles : (L,) float
        As in `Grid`, finer.
    weight : (L,) float
        Weight of each symbol's angle; 0 for a symbol that fits no alphabet.
    late : float
        Samples by which the symbols came late.
    """

    symbols: np.ndarray
    phase: np.ndarray
    channel: np.ndarray
    drift: np.ndarray | None
    points: np.ndarray
    few: np.ndarray
    error: np.ndarray
    dense: int
    angles: np.ndarray
    weight: np.ndarray
    late: float


def _decide(
    values: np.ndarray, dense: int, few: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, squared errors in units of the lattice and which blocks are of few points, of (L, K) elements.

    With ``few`` given the blocks' alphabets are not judged again.
    """
    level = power(values)
    points = nearest(values, dense)
    error = power(values - points)
    scanty = sparse(values, level)
    scanty_error = power(values - scanty)
    if few is None:
        few = box(scanty_error, BLOCK) < SPARSE_ERROR
        error = np.where(few, scanty_error, error)
        # the primary synchronisation signal stands on the axes
        odd = np.flatnonzero(np.minimum(error, CELL[dense]).mean(axis=1) > _DOUBTFUL * CELL[dense])
        if odd.size:
            turned = sparse(values[odd] * _EIGHTH, level[odd]) * _EIGHTH.conj()
            turned_error = power(values[odd] - turned)
            axes = (box(turned_error, BLOCK) < SPARSE_ERROR) & ~few[odd]
            scanty[odd] = np.where(axes, turned, scanty[odd])
            error[odd] = np.where(axes, turned_error, error[odd])
            few[odd] |= axes
        return np.where(few, scanty, points), error, few
    return np.where(few, scanty, points), np.where(few, scanty_error, error), few


def constellation(values: np.ndarray, clear: np.ndarray) -> int:
    """Points of the square QAM that most of the elements (L, K) agree with."""
    level = power(values)
    crowded = clear & (box(power(values - sparse(values, level)), BLOCK) > 1.5 * SPARSE_ERROR) & (level < 0.8)
    chosen = values[crowded]
    if chosen.size < 100:
        return DENSE[-1]
    return min(DENSE, key=lambda m: float(np.mean(power(chosen - nearest(chosen, m))) / CELL[m]))


def gain(values: np.ndarray, dense: int) -> np.float32:
    """Factor within 0.7..1.4 by which (n,) elements fit the alphabets best.

    The received power varies with what is sent, so the channel of an earlier frame is right only up to this factor.
    """
    level = power(values)

    def misfit(factor: np.float32) -> float:
        scaled = values * factor
        error = power(scaled - nearest(scaled, dense))
        few = power(scaled - sparse(scaled, level * factor * factor))
        return float(np.minimum(np.minimum(error, few), CELL[dense]).mean() / (factor * factor))

    if misfit(np.float32(1)) < _FITS * CELL[dense]:
        return np.float32(1)
    return min(_GAINS, key=misfit)


def _true_up(
    grid: Grid, agreement: np.ndarray, numerology: Numerology
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What sets each symbol right: (L, K) factor, (L,) angles, and (L,) slopes over the subcarriers, in samples."""
    angle = np.angle(agreement.sum(axis=1) + 1e-30)
    straight = agreement * np.exp(-1j * angle).astype(np.complex64)[:, None]
    weight = np.einsum("lk,k->l", straight.real, numerology.turn**2)
    slope = np.einsum("lk,k->l", straight.imag, numerology.turn) / np.maximum(weight, 1e-30)
    if np.abs(slope).max() < _STRAIGHT:
        return np.exp(-1j * angle).astype(np.complex64)[:, None], angle, slope
    turn = angle[:, None].astype(np.float32) + slope[:, None].astype(np.float32) * numerology.turn
    return np.exp(-1j * turn), angle, slope


def demodulate(
    grid: Grid, clear: np.ndarray, numerology: Numerology, dense: int | None, turns: Sequence[tuple[int, int]]
) -> Received:
    """Points and channel of a frame's symbols; ``clear`` (L, K) tells which elements no return can be in.

    A symbol whose elements fit no alphabet (it began or ended within its transform) has no say in the channel.
    """
    symbols, phase, angles = grid.symbols.copy(), grid.phase.copy(), grid.angles.copy()
    count = len(symbols)
    channel = grid.channel
    clear = clear & grid.used
    times = ((np.arange(count) - (count - 1) / 2) / (count / 2)).astype(np.float32)
    per_symbol = np.maximum(clear.sum(axis=1), 1)
    first = dense is None
    dense = dense or constellation(symbols * (1 / channel), clear)
    cell = CELL[dense]
    heard = np.ones((count, 1), dtype=bool)
    few, late = None, 0.0
    for number, (width, order) in enumerate((*turns, (1, -1))):
        values = symbols * (1 / channel)
        last = order < 0
        points, error, few = _decide(values, dense, few if 1 < number and not last else None)
        if number or not first:
            off = np.einsum("lk,lk->l", np.minimum(error, cell), clear) / per_symbol / cell
            heard = (off < max(_DOUBTFUL, 1.5 * np.median(off)))[:, None]
            if number == 1 or not first:
                # set upright for the next turn; what this one decided of them is wrong
                odd = _turned(values, off, dense, clear)
                symbols[odd] *= _EIGHTH
                phase[odd] *= _EIGHTH
                angles[odd] -= np.pi / 4
                heard[odd] = False
        sure = clear & heard & (error < (1.0 if number else 0.9) * 1.5 * cell)
        if first and not number:
            sure &= power(values) < 1.0  # while the gain is rough, the outer points are the uncertain ones
        model = channel * points
        agreement = symbols * model.conj()
        agreement *= sure
        if not last or not number:
            turn, angle, slope = _true_up(grid, agreement, numerology)
            late = float(np.median(slope)) if number else late
            symbols, agreement, phase = symbols * turn, agreement * turn, phase * turn
            angles = angles + angle
        weight = power(model) * sure
        if last:
            factor = _best_order(
                agreement, weight, times, float((power(symbols) * sure).sum()), int(sure.sum())
            )
        else:
            factor = fit(*sums(agreement, weight, times, order), order, width)
        drift, course = None, factor[0]
        if len(factor) > 1:
            drift = factor[1] + (2 * times[:, None] * factor[2] if len(factor) > 2 else 0)
            drift = drift * channel * np.float32(2 / count)
            for power_of_time, part in enumerate(factor[1:], 1):
                course = course + times[:, None] ** power_of_time * part
        channel = channel * course
    values = symbols * (1 / channel)
    points, error, few = _decide(values, dense)
    error = error * power(channel)
    channel = np.broadcast_to(channel, symbols.shape)
    return Received(
        symbols, phase, channel, drift, points, few, error, dense, angles, weight.sum(axis=1), late
    )


def _best_order(
    agreement: np.ndarray, weight: np.ndarray, times: np.ndarray, energy: float, elements: int
) -> np.ndarray:
    """Coefficients of the order with the least error per degree of freedom; orders rise while that helps."""
    best, least = None, np.inf
    for order in range(_ORDERS):
        right, left = sums(agreement, weight, times, order)
        factor = fit(right, left, order, 1)
        # |y - c m|^2 summed: what was received, the cross term, the model's own energy
        rest = energy - 2 * float(np.einsum("nk,nk->", factor.conj(), right).real)
        for i, one in enumerate(factor):
            for j, other in enumerate(factor):
                rest += float(np.einsum("k,k,k->", one.conj(), other, left[i + j]).real)
        rest /= max(1, elements - (order + 1) * int((left[0] > 0).sum()))
        if rest > _HELPS * least:
            break
        best, least = factor, rest
    return best


def _turned(values: np.ndarray, off: np.ndarray, dense: int, clear: np.ndarray) -> np.ndarray:
    """Numbers of the symbols that fit their alphabets better turned by an eighth.

    To the fourth power a symbol with most points on the axes (the primary synchronisation signal) looks turned so.
    ``off`` (L,) is the mean error of each as it stands, in cells.
    """
    doubtful = np.flatnonzero(off > _DOUBTFUL)
    if not doubtful.size:
        return doubtful
    error = np.minimum(_decide(values[doubtful] * _EIGHTH, dense)[1], CELL[dense])
    count = np.maximum(clear[doubtful].sum(axis=1), 1)
    turned = np.einsum("lk,lk->l", error, clear[doubtful]) / count / CELL[dense]
    return doubtful[turned < 0.8 * off[doubtful]]
