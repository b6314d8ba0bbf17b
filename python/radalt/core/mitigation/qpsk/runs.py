"""Which part of a frame one emitter fills, its carrier there, and its decided points."""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np

from ..ofdm.lattice import power
from .equaliser import nearest, turning

__all__ = ["MOSTLY", "Blocks", "Run", "longest_run"]

MOSTLY = 0.6  # of a frame has to be read: with less the emitter is looked for anew

_COHERENT = 0.7  # of the blocks' fourth powers: less is another carrier, or none
_WORST = 0.25  # of the points' power, of a block: the emitter begins, ends or jumps there
_OWN = 0.12  # the same where errors are to be told from those of symbols at random, some 0.35
# of a frame: where not all of it is one emitter's, one of these is
_PARTS = ((0.0, 1.0), (0.0, 0.5), (0.5, 1.0), (0.0, 0.25), (0.75, 1.0))


@dataclass(frozen=True)
class Blocks:
    """How many outputs are taken together.

    Attributes
    ----------
    size : int
        Of which phase and error are averaged.
    fine : int
        To find where another emitter begins.
    fewest : int
        In a run.
    """

    size: int
    fine: int
    fewest: int


@dataclass(frozen=True)
class Run:
    """Outputs of one emitter.

    Attributes
    ----------
    begin, end : int
        Which of the outputs.
    points, turn : (end - begin,) complex64
        Decided points, and the carrier's turn of each.
    amplitude, error : float
        Of the outputs; mean squared distance from the points, of their power.
    """

    begin: int
    end: int
    points: np.ndarray
    turn: np.ndarray
    amplitude: float
    error: float


def longest_run(
    outputs: np.ndarray, turn: np.ndarray, blocks: Blocks, limit: float, *, meets: bool = False
) -> Run | None:
    """The longest run of (K,) ``outputs`` that is QPSK of one carrier, which ``turn`` (K,) tells all but a phase and a
    little; None if there is none with errors below ``limit``.

    An emitter may begin, end or jump in a frame. So where all outputs do not agree, halves and quarters are asked for
    the phase. ``meets`` says that other outputs come before or after, so that the ends may be of both.
    """
    count, best = outputs.size, None
    for first, last in _PARTS:
        part = slice(int(first * count), int(last * count))
        aligned = _straighten(outputs, turn, blocks.size, part)
        if aligned is None:
            continue
        run, wrong = _decided(*aligned, part)
        errors = _mean_powers(wrong, blocks.size)
        if not meets and (errors < min(_WORST, 2 * limit)).all():
            return run if errors.mean() < limit else None
        own = _longest(_mean_powers(wrong, blocks.fine) < min(_OWN, 4 * limit))
        # where another part meets it, outputs may be of both
        begin = (own.start + (meets or own.start > 0)) * blocks.fine
        whole = not meets and (own.stop + 1) * blocks.fine > count
        end = count if whole else (own.stop - 1) * blocks.fine
        if end - begin < (blocks.fewest if best is None else best.points.size + 1):
            continue
        own = slice(0, end - begin)
        aligned = _straighten(outputs[begin:end], turn[begin:end], blocks.size, own)
        if aligned is None:
            continue
        run, wrong = _decided(*aligned, own, begin)
        errors = _mean_powers(wrong, blocks.size)
        if errors.mean() < limit and errors.max() < _WORST:
            best = run
    return best


def _straighten(
    outputs: np.ndarray, turn: np.ndarray, size: int, part: slice
) -> tuple[np.ndarray, np.ndarray] | None:
    """(K,) outputs without their carrier, as a ``part`` of them tells, and the carrier's turn; None where the fourth
    powers of its blocks do not agree.
    """
    straight = outputs * turn.conj()
    asked = straight[part]
    used = asked.size - asked.size % size
    if used < 2 * size:
        return None
    fourth = asked[:used] * asked[:used]
    fourth *= -fourth  # the points stand on the diagonals
    sums = np.add.reduceat(fourth, np.arange(0, used, size))
    mean = complex(sums.sum())
    if not abs(mean) > _COHERENT * np.abs(sums).sum():
        return None
    course = sums * mean.conjugate()
    course = np.arctan2(course.imag, course.real)
    weight = power(sums)  # of what is another's, little
    index = np.arange(sums.size)
    level = float(weight.sum())
    centre, angle = float(weight @ index) / level, float(weight @ course) / level
    late = index - centre
    slope = float(weight @ (late * course) / (weight @ (late * late))) / size
    first = cmath.phase(mean) + angle - slope * (part.start + (centre + 0.5) * size - 0.5)
    correction = turning(slope / (8 * np.pi), straight.size)
    correction *= np.complex64(cmath.exp(0.25j * first))
    straight *= correction.conj()
    return straight, turn * correction


def _decided(straight: np.ndarray, turn: np.ndarray, part: slice, begin: int = 0) -> tuple[Run, np.ndarray]:
    """A run of (K,) outputs without their carrier, and their (K,) distances from the points, at the amplitude that a
    ``part`` has.
    """
    points = nearest(straight)
    amplitude = float(np.vdot(points[part], straight[part]).real) / (part.stop - part.start)
    wrong = straight * np.float32(1 / amplitude)
    wrong -= points
    error = float(np.vdot(wrong, wrong).real) / wrong.size
    return Run(begin, begin + points.size, points, turn, amplitude, error), wrong


def _mean_powers(wrong: np.ndarray, size: int) -> np.ndarray:
    """(K // size,) of (K,) complex64 in blocks of so many."""
    rails = wrong[: wrong.size - wrong.size % size].view(np.float32).reshape(-1, 2 * size)
    return np.einsum("bk,bk->b", rails, rails) / size


def _longest(good: np.ndarray) -> slice:
    """The longest run of a (n,) bool array."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]])))
    runs = edges.reshape(-1, 2)
    return slice(*max(runs, key=lambda run: run[1] - run[0])) if runs.size else slice(0, 0)
