"""Decisions and channel in turns, from symbols of known timing to a model of what was sent and heard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from .acquisition import Grid
from .amplitudes import decide_scaled
from .channel_fit import best_order, fit, mended, standing, sums
from .lattice import (
    CELLS,
    DENSE,
    FEW_CELL,
    Decisions,
    amid,
    box,
    decide,
    middle,
    misread,
    nearest,
    power,
    sparse,
    sparse_on_axes,
)
from .numerology import Numerology
from .received import ASTRAY, Before, Received, likely_kind
from .upright import DOUBTFUL, true_up, turned

__all__ = [
    "AGAIN",
    "FINER",
    "FIRST",
    "READ",
    "SCALED",
    "SURE",
    "Begun",
    "again",
    "begin",
    "bridged",
    "demodulate",
    "once_more",
    "times_of",
    "trusted",
]

# subcarriers a channel is averaged over, order of its course in time, and share of the frame around its middle, turn by
# turn; in the end each subcarrier for itself
FIRST = ((15, 0, 1.0), (9, 1, 1.0), (5, 1, 1.0), (1, 1, 1.0))
MOVING = ((15, 0, 0.4), (9, 1, 0.5), (9, 1, 0.8), (5, 2, 1.0), (3, 2, 1.0))
MORE = ((9, 2, 1.0), (3, 2, 1.0))
SCALED = ((15, 0, 1.0), (5, 0, 1.0), (1, 0, 1.0))
AGAIN = ()
_FAIRLY_READ = 0.1  # mean error from which a channel has to be averaged over many subcarriers
_FEW = 3  # of them where that is not needed
_MOSTLY_READ = 0.05  # mean error with which an order that helps is no chance
_FAIR = 1.5  # times the median error of the symbols, up to which one tells of the carrier at first
SURE = 1.5  # error in cells, up to half a neighbour's distance
FINER = 0.01  # change of the channel for which no decision is made again
_BETTER = 0.8  # of the error, for a mended channel to be taken
READ = 0.02  # mean error of all symbols, where nothing is left to be mended
_WHOLE = 0.015  # mean error with which no run of subcarriers is wrong
_RUN = 9  # subcarriers over which their mean error is judged
_TOUCHED = 0.1  # the same beside them, where it is hardly wrong
_ON_AXES = 0.25  # of a point's power, in the product of its rails: on the axes it is 0, on the diagonals 0.5
_NEAR = np.float32(0.2)  # mean error around an element at which its weight is 1/e
_LEAST = np.float32(0.01)  # such a weight, at least: where nothing is read well, what is read counts


@dataclass(frozen=True)
class Begun:
    """The first turn of a frame's demodulation.

    Attributes
    ----------
    grid : Grid
        With a finer channel and finer phases.
    likely : (int, (K,) bool) or None
        As in `Before`.
    weight : (L,) float
        Weight of each symbol's angle; 0 for those that are misread most.
    """

    grid: Grid
    likely: tuple[int, np.ndarray] | None
    weight: np.ndarray


def begin(
    grid: Grid,
    clear: np.ndarray,
    numerology: Numerology,
    turn: tuple[int, int, float],
    before: Before | None = None,
    scaled: bool = False,
    limit: float = np.inf,
) -> Begun | None:
    """The first of the turns of `demodulate`; None if the mean errors of all symbols are above ``limit``."""
    width, order, share = turn
    clear = clear & grid.used
    values = grid.symbols * (1 / grid.channel)
    # while the gain is rough, the outer points are the uncertain ones
    trusted = clear & (power(values) < 1)
    halves = numerology.halves(grid.starts, grid.first_long)
    found, _, off = _decided(
        values, grid.channel, trusted, clear, halves, before and before.likely, scaled, guess=True
    )
    if off.min() > limit:
        return None
    times = times_of(len(values))
    sure = (found.error < 0.9 * SURE) & trusted
    if share < 1:
        sure &= np.abs(times)[:, None] <= share
    model = grid.channel * found.points
    agreement = grid.symbols * model.conj()
    agreement *= sure
    upright, angle, _ = true_up(agreement, numerology)
    agreement *= upright
    weight = power(model) * sure
    if off.mean() < _FAIRLY_READ and not scaled:
        width = _FEW
    factor = fit(*sums(agreement, weight, times, order), order, width)
    better = replace(
        grid,
        symbols=grid.symbols * upright,
        phase=grid.phase * upright,
        channel=grid.channel * _course(factor, times),
        angles=grid.angles + angle,
    )
    return Begun(
        better,
        likely_kind(found.kinds, found.capped, trusted),
        weight.sum(axis=1) * (off < _FAIR * middle(off)),
    )


def demodulate(
    grid: Grid,
    clear: np.ndarray,
    numerology: Numerology,
    turns: Sequence[tuple[int, int, float]],
    before: Before | None = None,
    scaled: bool = False,
    begun: Begun | None = None,
) -> Received:
    """Points and channel of a frame's symbols; ``clear`` (L, K) tells which elements no return can be in.

    A symbol whose elements fit no alphabet (it began or ended within its transform) has no say in the channel.
    ``before`` spares what the frame before makes unlikely. ``scaled`` lets users have amplitudes of their own, in a
    channel that stands still. ``begun`` is the first turn, if it was made.
    """
    scaled = scaled or bool(before and before.scaled)
    turns, likely = _steps(turns, scaled), before and before.likely
    first = len(turns) > 1
    if first:
        begun = begun or begin(grid, clear, numerology, turns[0], before, scaled)
        grid, likely, turns = begun.grid, begun.likely, turns[1:]
    symbols, phase, angles, channel = grid.symbols, grid.phase, grid.angles, grid.channel
    clear = clear & grid.used
    halves = numerology.halves(grid.starts, grid.first_long)
    late, times = 0.0, times_of(len(symbols))
    for width, order, share in turns:
        found, amplitudes, off = _decided(
            symbols * (1 / channel), channel, clear, clear, halves, likely, scaled
        )
        odd, back = turned(symbols, channel, off, clear, halves, found.kinds)
        if odd.size:
            symbols, phase, angles = symbols * back, phase * back, angles - np.angle(back[:, 0])
            found, amplitudes, off = _decided(
                symbols * (1 / channel), channel, clear, clear, halves, likely, scaled
            )
        last = order < 0 or off.mean() < READ
        heard = (off < max(DOUBTFUL, 1.5 * middle(off)))[:, None]
        heard[odd] = True  # a channel that they alone tell of has to follow them
        if not first and not scaled and off.mean() > _WHOLE:  # a step may be another user's
            channel, found, off = _bridged(symbols, channel, found, off, clear, heard, halves)
        sure = (found.error < SURE) & clear & heard
        if share < 1 and not last:
            sure &= np.abs(times)[:, None] <= share
        model = channel * found.points
        agreement = symbols * model.conj()
        agreement *= sure
        if order >= 0 or not first:
            turn, angle, slope = true_up(agreement, numerology, upright=odd, evenly=channel.ndim == 1)
            late = middle(slope)
            symbols, agreement, phase = symbols * turn, agreement * turn, phase * turn
            angles = angles + angle
        weight = power(model) * sure
        if last:
            steady = np.inf if scaled else before.steady if before else 0.0
            factor, noise = best_order(
                symbols, agreement, weight, times, sure, steady, read=off.mean() < _MOSTLY_READ
            )
        else:
            factor = fit(*sums(agreement, weight, times, order), order, width)
        course, averaged = _course(factor, times), channel
        channel = channel * course
        if last:
            break
        likely = likely_kind(found.kinds, found.capped, clear)
    channel, noise = standing(symbols, channel, found.points, times, sure, noise, clear)
    if first and channel.ndim == 1:
        own = channel / averaged
        symbols, phase, angles, channel = _finer(
            symbols, phase, angles, channel, agreement * own.conj(), weight * power(own), numerology
        )
    kinds = found.kinds[halves]
    if first or np.abs(angle).max() > FINER or np.abs(course - 1).sum() > FINER * course.size:
        again(found, symbols, channel, ~clear & grid.used, kinds, amplitudes)
    return Received(
        symbols, phase, channel, found.points, kinds, found.error, found.capped,
        off, noise, angles, weight.sum(axis=1), late, amplitudes, found.few,
    )  # fmt: skip


def trusted(found: Decisions, told: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """(L, K) float32 weights of the elements ``asked`` (L, K, bool) in a channel: less where those around, of which
    ``told`` (L, K) float32 says which count, were misread."""
    near = amid(found.capped, told) / _NEAR
    return (asked & (found.error < SURE)) * np.maximum(np.exp(-near * near), _LEAST)


def times_of(count: int) -> np.ndarray:
    """(count,) float32 times of a frame's symbols, -1..1."""
    return ((np.arange(count) - (count - 1) / 2) / (count / 2)).astype(np.float32)


def _course(factor: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The polynomial of coefficients (order + 1, K) at ``times`` (L,): (L, K), or (K,) of order 0."""
    return sum(times[:, None] ** n * part for n, part in enumerate(factor[1:], 1)) + factor[0]


def _steps(turns: Sequence[tuple[int, int, float]], scaled: bool) -> list[tuple[int, int, float]]:
    """The turns and the last one; with ``scaled`` the channel has no course in time."""
    return [
        (width, min(order, 0) if scaled else order, share) for width, order, share in (*turns, (1, -1, 1.0))
    ]


def once_more(
    grid: Grid,
    clear: np.ndarray,
    received: Received,
    numerology: Numerology,
    turns: Sequence[tuple[int, int, float]],
    before: Before | None = None,
) -> Received:
    """`demodulate` again, from what was ``received`` before on the same ``grid``."""
    grid = replace(
        grid, symbols=received.symbols, phase=received.phase, channel=received.channel, angles=received.angles
    )
    again = demodulate(grid, clear, numerology, turns, before, received.amplitudes is not None)
    again.late += received.late
    return again


def _decided(
    values: np.ndarray,
    channel: np.ndarray,
    trusted: np.ndarray,
    clear: np.ndarray,
    halves: np.ndarray,
    likely: tuple[int, np.ndarray] | None,
    scaled: bool,
    guess: bool = False,
) -> tuple[Decisions, np.ndarray | None, np.ndarray]:
    """`decide`, or `decide_scaled` with its amplitudes, and how much of each symbol was misread, (L,)."""
    if scaled:
        found, amplitudes = decide_scaled(values, np.abs(channel), trusted, halves)
    else:
        found, amplitudes = decide(values, trusted, halves, likely=likely, guess=guess), None
    return found, amplitudes, misread(found.capped, clear, channel)


def _finer(
    symbols: np.ndarray,
    phase: np.ndarray,
    angles: np.ndarray,
    channel: np.ndarray,
    agreement: np.ndarray,
    weight: np.ndarray,
    numerology: Numerology,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The same, set upright by each subcarrier's own ``channel`` (K,), and that channel by them: an averaged one was a
    worse measure.

    ``agreement`` (L, K) is received times conjugate model with that channel, ``weight`` (L, K) the model's power; zero
    where not to be used.
    """
    turn, angle, _ = true_up(agreement, numerology)
    factor = fit((agreement * turn).sum(axis=0)[None], weight.sum(axis=0)[None], 0, 1)[0]
    return symbols * turn, phase * turn, angles + angle, channel * factor


def _bridged(
    symbols: np.ndarray,
    channel: np.ndarray,
    found: Decisions,
    off: np.ndarray,
    clear: np.ndarray,
    heard: np.ndarray,
    halves: np.ndarray,
) -> tuple[np.ndarray, Decisions, np.ndarray]:
    """Channel, decisions and misread symbols with the channel `mended`, where that is better, or as they are."""
    other = bridged(channel, found.capped, clear & heard)
    if other is None:
        return channel, found, off
    decided = decide(symbols * (1 / other), clear, halves)
    left = misread(decided.capped, clear, other)
    return (other, decided, left) if left.mean() < _BETTER * off.mean() else (channel, found, off)


def bridged(channel: np.ndarray, capped: np.ndarray, asked: np.ndarray) -> np.ndarray | None:
    """(K,) channel `mended` over runs of subcarriers whose ``asked`` (L, K) elements are wrong; None if it has none.

    A run is found where most of its elements are wrong and ends where they are right: the channel makes its false turn
    over a dozen subcarriers, and at either end of that it is hardly wrong.
    """
    wrong = (capped * asked).sum(axis=0) / np.maximum(asked.sum(axis=0, dtype=np.float32), 1)
    wrong = box(wrong, _RUN)
    amiss = wrong > ASTRAY
    if amiss.any():
        amiss = ndimage.binary_propagation(amiss, mask=wrong > _TOUCHED)
    return mended(channel if channel.ndim == 1 else channel[len(channel) // 2], amiss)


def again(
    found: Decisions,
    symbols: np.ndarray,
    channel: np.ndarray,
    ridge: np.ndarray,
    kinds: np.ndarray,
    amplitudes: np.ndarray | None = None,
) -> None:
    """Decide the elements of the ``ridge`` (L, K) again, with a finer channel; ``found`` is set."""
    at = np.flatnonzero(ridge)
    here = channel[at % channel.size] if channel.ndim == 1 else channel.ravel()[at]
    values = symbols.ravel()[at] / here
    kinds, few = kinds.ravel()[at], found.few.ravel()[at]
    if amplitudes is not None:
        own = np.where(few, amplitudes[1].ravel()[at], amplitudes[0].ravel()[at])
        values /= own
    usual = kinds[kinds.size // 2] if kinds.size else 0
    chosen = nearest(values, DENSE[usual])
    for kind, dense in enumerate(DENSE):
        part = np.flatnonzero((kinds == kind) & ~few)
        if kind != usual and part.size:
            chosen[part] = nearest(values[part], dense)
    part = np.flatnonzero(few)
    chosen[part] = sparse(values[part], power(values[part]))
    before = found.points.ravel()[at[part]]
    axes = part[np.abs(before.real * before.imag) < _ON_AXES * power(before)]
    if axes.size:
        chosen[axes] = sparse_on_axes(values[axes], power(values[axes]))
    cells = CELLS[kinds]
    cells[part] = FEW_CELL
    np.put(found.points, at, chosen if amplitudes is None else chosen * own)
    np.put(found.error, at, power(values - chosen) / cells)
    np.minimum(found.error, 1, out=found.capped)
