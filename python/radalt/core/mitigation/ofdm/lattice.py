"""Points of QPSK and square QAM at unit mean power: the nearest, and which alphabet each element has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import ndimage

__all__ = [
    "BLOCK",
    "CELL",
    "CELLS",
    "DENSE",
    "FAINT",
    "FEW_CELL",
    "SCALE",
    "SPARSE_POINTS",
    "Decisions",
    "amid",
    "at_most_one",
    "box",
    "members",
    "misread",
    "middle",
    "decide",
    "few_points",
    "nearest",
    "power",
    "rounded",
    "rounded_each",
    "sparse",
    "sparse_on_axes",
    "turn_to_axes",
    "unit",
]

DENSE = (16, 64, 256)
BLOCK = 12  # subcarriers of a resource block, of one user and one kind
_SPARSE_ERROR = 0.04  # mean squared error below which a block is one of few points; 64QAM has 0.1 from these
SCALE = {m: np.float32(np.sqrt(1.5 / (m - 1))) for m in (4, *DENSE)}  # half the distance of two neighbours
_TOP = {m: np.float32(np.sqrt(m) / 2 - 1) for m in SCALE}  # cells above the axes, less one
CELL = {
    m: np.float32(2 * (2 * SCALE[m]) ** 2 / 12) for m in DENSE
}  # squared error of a number anywhere in a cell
_STEPS = np.array([2 * SCALE[m] for m in DENSE], dtype=np.float32)
_TOPS = np.array([_TOP[m] for m in DENSE], dtype=np.float32)
CELLS = np.array([CELL[m] for m in DENSE], dtype=np.float32)
_OF_CELL = _STEPS**2 / CELLS
FEW_CELL = np.float32(0.06)  # squared error from the few points at which they are no better than any other
FAINT = np.float32(1e-30)  # beside sums that may be 0, before they divide or have a logarithm
_ROOT2 = np.float32(np.sqrt(2))
_RAIL = np.float32(np.sqrt(0.5))  # of QPSK; 3 dB up it is 1
_SIGN = np.uint32(1 << 31)  # of a float32
_ONE = np.float32(1).view(np.uint32)
_HIGHER = np.float32(1) - _RAIL
_EMPTY = np.float32(0.25)  # power below which nothing is nearer than a point of QPSK
_BOOSTED = np.float32(
    (1 + np.sqrt(2)) ** 2 / 4
)  # power above which QPSK 3 dB up (demodulation pilots) is nearer
_QPSK = np.exp(0.25j * np.pi * (1 + 2 * np.arange(4)))
# silence, QPSK, QPSK 3 dB up
SPARSE_POINTS = np.concatenate([[0], _QPSK, _ROOT2 * _QPSK]).astype(np.complex64)
_EIGHTH = np.complex64(np.exp(0.25j * np.pi))
_DOUBTFUL = 0.15  # mean error of a symbol in cells, each at most 1; a random one has 0.75
_ONE_USER = 3  # subcarriers judged together; a user has at least 24
_FRAME = np.float32(1.0)  # weight of the whole frame in a judgement, in elements
_EXPLAINED = np.float32(0.3)  # mean error of a block in a half slot, each at most 1; another alphabet has 0.7
_ELSEWHERE = 0.25  # of the blocks: where another alphabet explains more, all are judged
_GUESSED = 0.2  # mean error of all elements, up to which they may be of one kind; a fifth of others have 0.15
_SOME = 7  # one subcarrier in seven tells
_FEWEST = 8  # elements of a block that tell something; a user has a hundred
_SYMBOLS_BESIDE = 2  # before and after, whose errors tell of an element
_SUBCARRIER = np.float32(0.1)  # weight of the subcarrier's other half slots


def power(values: np.ndarray) -> np.ndarray:
    """Squared modulus, float32 for complex64."""
    return np.square(np.abs(values))


def middle(values: np.ndarray) -> float:
    """Median of a few real numbers, the upper one of two."""
    sorted_ = values.copy()
    sorted_.partition(values.size // 2)
    return float(sorted_[values.size // 2])


def unit(angle: np.ndarray) -> np.ndarray:
    """exp(j angle) of float32 angles in radians, as complex64; a complex exponential costs ten times that."""
    out = np.empty(angle.shape, dtype=np.complex64)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out


def box(
    values: np.ndarray, width: int, *, before: int | None = None, beside: float | None = None
) -> np.ndarray:
    """Running mean of (..., K) float32 over ``width`` of the last axis, of which ``before`` (or half) come before.

    Beyond the ends of the axis they are repeated, or ``beside``.
    """
    if width < 2:
        return values
    if values.ndim == 1:
        shift = 0 if before is None else width // 2 - before
        mode = "nearest" if beside is None else "constant"
        return ndimage.uniform_filter1d(values, width, mode=mode, cval=beside or 0.0, origin=shift)
    # of many rows the library's sums take half as long again
    before, size = width // 2 if before is None else before, values.shape[-1]
    # rows one after the other, summed as one: sums across two rows fall between the rows' own
    rows = np.empty((values.size // size + 1, size + width - 1), dtype=values.dtype)
    padded = rows[:-1].reshape(*values.shape[:-1], -1)
    padded[..., :before] = values[..., :1] if beside is None else beside
    padded[..., before : before + size] = values
    padded[..., before + size :] = values[..., -1:] if beside is None else beside
    rows[-1] = 0
    # sums of 1, 2, 4 ... neighbours; those in the binary form of the width are put one after the other
    out, done, ahead, count = None, 0, rows.ravel(), 1
    while True:
        if width & count:
            part = ahead[done : done + padded.size]
            out = part if out is None else out + part
            done += count
        count *= 2
        if count > width:
            out = out * np.float32(1 / width)
            return out.reshape(padded.shape)[..., :size]
        ahead = ahead[: -count // 2] + ahead[count // 2 :]


def amid(capped: np.ndarray, heard: np.ndarray) -> np.ndarray:
    """(L, K) mean error of the ``heard`` (L, K) float32 elements around each one, in cells, each at most 1."""
    number = np.arange(len(capped))
    near = (np.abs(number[:, None] - number) <= _SYMBOLS_BESIDE).astype(np.float32)
    told = near @ box(heard, BLOCK)
    return near @ box(capped * heard, BLOCK) / np.maximum(told, np.float32(1e-3))


def nearest(values: np.ndarray, points: int) -> np.ndarray:
    """Nearest of 4, 16, 64 or 256 points to each complex64 value, as complex64."""
    half = SCALE[points]
    rails = np.ascontiguousarray(values).view(np.float32) * (np.float32(0.5) / half)
    np.floor(rails, out=rails)
    top = _TOP[points]
    if rails.ndim > 1:
        np.maximum(rails, _filled(-top - 1, rails.shape), out=rails)
        np.minimum(rails, _filled(top, rails.shape), out=rails)
    else:
        np.maximum(rails, -top - 1, out=rails)
        np.minimum(rails, top, out=rails)
    rails += np.float32(0.5)
    rails *= 2 * half
    return rails.view(np.complex64)


@lru_cache(maxsize=64)
def _filled(value: float, shape: tuple[int, ...]) -> np.ndarray:
    """float32, read-only, of one value: such a limit costs a third of one given as a number."""
    filled = np.full(shape, value, dtype=np.float32)
    filled.setflags(write=False)
    return filled


def sparse(values: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Nearest of `SPARSE_POINTS`; ``level`` is the power of ``values``."""
    rail = (level > _EMPTY) * _RAIL
    rail += (level > _BOOSTED) * _HIGHER
    # 1 with the sign's bit: a fifth of copysign's time
    signs = np.ascontiguousarray(values).view(np.uint32) & _SIGN
    signs |= _ONE
    out = signs.view(np.complex64)
    out *= rail
    return out


def sparse_on_axes(values: np.ndarray, level: np.ndarray) -> np.ndarray:
    """The same for `SPARSE_POINTS` turned by an eighth."""
    return sparse(values * _EIGHTH, level) * _EIGHTH.conj()


def at_most_one(error: np.ndarray) -> np.ndarray:
    """(L, K) float32 errors, each at most 1."""
    return np.minimum(error, _filled(1.0, error.shape))


@lru_cache(maxsize=8)
def _members(halves: bytes) -> np.ndarray:
    """(half slots, L) float32, read-only: 1 where a symbol is in a half slot, whose numbers (L,) int are given."""
    number = np.frombuffer(halves, dtype=int)
    members = (number == np.arange(number[-1] + 1)[:, None]).astype(np.float32)
    members.setflags(write=False)
    return members


def members(halves: np.ndarray) -> np.ndarray:
    """(half slots, L) float32: 1 where a symbol is in a half slot, whose numbers ``halves`` (L,) int are given."""
    return _members(halves.tobytes())


@dataclass
class Decisions:
    """What was sent, as far as single elements tell.

    Attributes
    ----------
    points : (L, K) complex64
    error : (L, K) float32
        Squared distance from the point in cells of its alphabet; a random number has 1 in the mean.
    capped : (L, K) float32
        The same, each at most 1.
    few : (L, K) bool
        Silence or QPSK.
    kinds : (halves, K) int8
        Which of `DENSE` the elements of a half slot have that are not few.
    """

    points: np.ndarray
    error: np.ndarray
    capped: np.ndarray
    few: np.ndarray
    kinds: np.ndarray


def decide(
    values: np.ndarray,
    trusted: np.ndarray,
    halves: np.ndarray,
    kinds: np.ndarray | None = None,
    likely: tuple[int, np.ndarray] | None = None,
    guess: bool = False,
    heard: np.ndarray | None = None,
) -> Decisions:
    """Points of (L, K) elements; their alphabets are judged from the ``trusted`` (L, K) ones.

    A block of twelve subcarriers of a symbol is of few points (control, pilots, QPSK, silence) where these fit. All
    others have a square QAM, which a user keeps for a slot. It is the one from which the elements of one subcarrier and
    its neighbours, over the symbols of the same half slot ``halves`` (L,), are the smallest part of a cell away.
    ``kinds`` given is not judged again. ``likely`` is one of `DENSE` that may explain the whole
    frame, and the subcarriers (K,) bool that are asked; others are tried in the blocks that it does not explain. With
    ``guess`` it is sought. ``heard`` as in `turn_to_axes`.
    """
    level = power(values)
    scanty, scanty_error, few = few_points(values, level)
    asked = (trusted & ~few).astype(np.float32)
    within = members(halves)
    found = None
    if kinds is None and likely is not None:
        found = _explained(values, asked * likely[1], halves, within, likely[0])
    elif kinds is None and guess:
        kind = _guessed(values[:, ::_SOME], asked[:, ::_SOME])
        if kind is not None:
            found = *rounded(values, kind), np.full((len(within), values.shape[1]), kind, dtype=np.int8)
    chosen, error, kinds = found or _judged(values, asked, halves, within, kinds)
    np.copyto(chosen, scanty, where=few)
    np.copyto(error, scanty_error, where=few)
    capped = at_most_one(error)
    decisions = Decisions(chosen, error, capped, few, kinds)
    turn_to_axes(values, level, decisions, heard)
    return decisions


def few_points(values: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest of the few points to (L, K) elements of power ``level``, their errors in cells, and (L, K) bool: those
    in whose blocks these fit."""
    points = sparse(values, level)
    error = power(values - points)
    few = box(error, BLOCK) < _SPARSE_ERROR
    error *= 1 / FEW_CELL
    return points, error, few


def turn_to_axes(
    values: np.ndarray, level: np.ndarray, found: Decisions, heard: np.ndarray | None = None
) -> None:
    """Decide elements that stand on the axes, as the primary synchronisation signal does; ``found`` is set.

    Symbols are asked of which much was misread, or much of the elements ``heard`` (L, K) float32: a return that is
    known makes errors in the others.
    """
    if heard is None:
        wrong, count = found.capped.sum(axis=1), found.capped.shape[1]
    else:
        wrong, count = np.einsum("lk,lk->l", found.capped, heard), heard.sum(axis=1)
    odd = np.flatnonzero(wrong > _DOUBTFUL * count)
    if not odd.size:
        return
    turned = sparse_on_axes(values[odd], level[odd])
    error = power(values[odd] - turned)
    axes = (box(error, BLOCK) < _SPARSE_ERROR) & ~found.few[odd]
    found.points[odd] = np.where(axes, turned, found.points[odd])
    found.error[odd] = np.where(axes, error * (1 / FEW_CELL), found.error[odd])
    found.few[odd] |= axes
    found.capped[odd] = np.minimum(found.error[odd], 1)


def rounded(values: np.ndarray, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points of one of `DENSE`, and the squared distances from them in its cells."""
    points = nearest(values, DENSE[kind])
    error = power(values - points)
    error *= 1 / CELL[DENSE[kind]]
    return points, error


def _guessed(values: np.ndarray, asked: np.ndarray) -> int | None:
    """The one of `DENSE` that may explain all of the ``asked`` (L, K) elements; None if none does."""
    rails = np.abs(np.ascontiguousarray(values).view(np.float32)) / _STEPS[:, None, None]
    rails -= np.minimum(np.floor(rails), _TOPS[:, None, None]) + np.float32(0.5)
    rails *= rails
    error = (rails[..., ::2] + rails[..., 1::2]) * _OF_CELL[:, None, None]
    away = (np.minimum(error, 1) * asked).sum(axis=(1, 2))
    kind = int(away.argmin())
    return kind if away[kind] < _GUESSED * asked.sum() else None


def _explained(
    values: np.ndarray, asked: np.ndarray, halves: np.ndarray, within: np.ndarray, kind: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """As `_judged`, where nearly all elements may be of one kind; None if those of several blocks are not."""
    points, error = rounded(values, kind)
    blocks = np.arange(0, asked.shape[1], BLOCK)
    wrong = at_most_one(error)
    wrong -= _EXPLAINED
    wrong *= asked
    wrong = (np.add.reduceat(within @ wrong, blocks, axis=1) > _EXPLAINED * _FEWEST).any(axis=0)
    kinds = np.full((len(within), asked.shape[1]), kind, dtype=np.int8)
    if wrong.any():
        if np.count_nonzero(wrong) > _ELSEWHERE * wrong.size:
            return None
        others = np.repeat(wrong, BLOCK)[: asked.shape[1]]
        kinds[:, others] = _kinds(values[:, others], asked[:, others], within)
        points[:, others], error[:, others] = rounded_each(values[:, others], kinds[:, others], halves)
    return points, error, kinds


def _judged(
    values: np.ndarray, asked: np.ndarray, halves: np.ndarray, within: np.ndarray, kinds: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, errors and kinds of all elements as members of `DENSE`, judged from the ``asked`` (L, K) ones."""
    if kinds is None:
        kinds = _kinds(values, asked, within)
    return *rounded_each(values, kinds, halves), kinds


def _kinds(values: np.ndarray, asked: np.ndarray, within: np.ndarray) -> np.ndarray:
    """(half slots, K) int8: which of `DENSE` explains the ``asked`` (L, K) elements best."""
    rails = np.abs(np.ascontiguousarray(values).view(np.float32))  # lattices are alike on both sides
    score = np.empty((len(DENSE), len(within), values.shape[1]), dtype=np.float32)
    away, whole = np.empty_like(rails), np.empty_like(rails)
    for one, dense in zip(score, DENSE, strict=True):
        np.multiply(rails, np.float32(0.5) / SCALE[dense], out=away)
        np.floor(away, out=whole)
        np.minimum(whole, _filled(_TOP[dense], whole.shape), out=whole)
        whole += np.float32(0.5)
        away -= whole
        away *= away
        error = away[:, ::2] + away[:, 1::2]
        error *= (2 * SCALE[dense]) ** 2 / CELL[dense]
        error = at_most_one(error)
        error *= asked
        np.matmul(within, error, out=one)
    common = score.sum(axis=(1, 2)) / max(float(asked.sum()), 1.0)
    score = box(score.reshape(-1, score.shape[-1]), _ONE_USER).reshape(score.shape)
    score += _SUBCARRIER * score.sum(axis=1, keepdims=True)
    score += _FRAME * common[:, None, None]
    kinds, least = np.zeros(score.shape[1:], dtype=np.int8), score[0]
    for kind, one in enumerate(score[1:], 1):  # argmin over the first axis takes five times that
        np.putmask(kinds, one < least, kind)
        least = np.minimum(least, one)
    return kinds


def rounded_each(values: np.ndarray, kinds: np.ndarray, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `rounded`, for (L, K) values each of one of `DENSE`: the half slots' ``kinds`` (half slots, K) int."""
    rails = np.repeat(kinds, 2, axis=1)
    step, top = (each.take(rails).take(halves, axis=0) for each in (_STEPS, _TOPS))
    points = np.ascontiguousarray(values).view(np.float32) / step
    np.floor(points, out=points)
    np.minimum(points, top, out=points)
    top += 1
    np.maximum(points, np.negative(top, out=top), out=points)
    points += np.float32(0.5)
    points *= step
    points = points.view(np.complex64)
    error = power(values - points)
    error /= CELLS.take(kinds).take(halves, axis=0)
    return points, error


def misread(capped: np.ndarray, clear: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """(L,) mean error of each symbol's ``clear`` elements in cells, each at most 1, by their power."""
    level = power(channel)
    level = level if level.ndim == 1 else level.mean(axis=0)
    return (capped * clear) @ level / np.maximum(clear @ level, np.float32(1e-30))
