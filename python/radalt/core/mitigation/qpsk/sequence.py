"""QPSK under a signal narrower than its own band: decided as a sequence, not symbol by symbol."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

__all__ = ["Events", "decide_sequence", "other_decisions"]

_MEMORY = 24  # symbols from whose errors that of the next one is predicted
_SURVIVORS = 8  # of a search
_PIECES = 32  # of a sequence, searched side by side
_ROUNDS = 4
_LOADING = 1e-3  # of the errors' power
_POINTS = np.exp(0.25j * np.pi * (1 + 2 * np.arange(4)))
_SAME = 0.1  # distance of two points that are one
_LONGEST = 4  # symbols of an event
# which of its symbols an event changes; a low frequency hides errors of neighbours that are alike
_PATTERNS = np.array(
    [[1, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [1, 1, 1, 0], [1, 0, 0, 1], [1, 0, 1, 1], [1, 1, 0, 1], [1, 1, 1, 1]],
    dtype=bool,
)  # fmt: skip


def decide_sequence(outputs: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(K,) complex64 unit points of an equaliser's ``outputs`` (K,), from first decisions ``points`` (K,).

    Where another signal hides a part of the symbols' spectrum, the equaliser's errors are narrow in frequency. So each
    can be predicted from those before (P. R. Chevillat and E. Eleftheriou, IEEE Trans. Commun. 37(7), 1989). The
    sequence with the least power that was not predicted is searched among a few survivors. The predictor comes from
    the decisions of the search before.
    """
    outputs, points = outputs.astype(np.complex128), points.astype(np.complex128)
    for _ in range(_ROUNDS):
        found = _searched(outputs, points, _predictor(outputs - points))
        changed = np.abs(found - points) > _SAME
        points = found
        if not changed.any():
            break
    return points.astype(np.complex64)


@dataclass(frozen=True)
class Events:
    """Other decisions of a few neighbouring symbols, by number: each flips one rail of some of them.

    Attributes
    ----------
    begins : (E,) int
        First symbol.
    patterns : (E,) int
        Which of the symbols from there on are changed, a row of `_PATTERNS`.
    rails : (E,) int
        0 for the real part, 1 for the imaginary one.
    cost : (E,) float
        Power by which the sequence fits worse, negative where it fits better.
    """

    begins: np.ndarray
    patterns: np.ndarray
    rails: np.ndarray
    cost: np.ndarray

    def flip(self, points: np.ndarray, number: int) -> None:
        """Change (K,) ``points`` in place."""
        part = points[self.begins[number] : self.begins[number] + _LONGEST]
        on = _PATTERNS[self.patterns[number], : part.size]
        part[on] = part[on].conj() if self.rails[number] else -part[on].conj()


def other_decisions(outputs: np.ndarray, points: np.ndarray) -> Events:
    """All events of up to four symbols of a sequence decided as ``points`` (K,) from ``outputs`` (K,)."""
    error = (outputs - points).astype(np.complex128)
    whitener = np.concatenate([[1], -_predictor(error)])
    reach = whitener.size + _LONGEST - 1
    white = np.concatenate([np.convolve(error, whitener), np.zeros(_LONGEST)])
    after = np.lib.stride_tricks.sliding_window_view(white, reach)
    count = points.size - _LONGEST + 1
    numbers, cost = [], []
    for rail, away in enumerate((-2 * points.real, -2j * points.imag)):
        for number, pattern in enumerate(_PATTERNS):
            made = np.zeros((count, reach), dtype=np.complex128)
            for j in np.flatnonzero(pattern):
                made[:, j : j + whitener.size] += away[j : j + count, None] * whitener
            cost.append(
                np.square(np.abs(made)).sum(axis=1) - 2 * (made.conj() * after[:count]).real.sum(axis=1)
            )
            numbers.append((number, rail))
    patterns, rails = np.repeat(numbers, count, axis=0).T
    return Events(np.tile(np.arange(count), len(numbers)), patterns, rails, np.concatenate(cost))


def _predictor(error: np.ndarray) -> np.ndarray:
    """(_MEMORY,) weights of the last errors, the newest first, that predict the next: equations of Yule and Walker."""
    spectrum = np.fft.fft(error, 2 * error.size)
    lags = np.fft.ifft(np.square(np.abs(spectrum)))[: _MEMORY + 1] / error.size
    lags[0] = lags[0] * (1 + _LOADING) + 1e-12  # where nothing is left, nothing is predicted
    return linalg.solve_toeplitz((lags[:-1], lags[:-1].conj()), lags[1:])


def _searched(outputs: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(K,) points whose errors, less what ``weights`` predict of them, have the least power (M-algorithm).

    The pieces begin some symbols early, with the errors that the last ``points`` (K,) left before, and end some late.
    """
    size = -(-outputs.size // _PIECES)
    before = np.zeros(_MEMORY, dtype=np.complex128)
    after = np.zeros(_PIECES * size - outputs.size + _MEMORY, dtype=np.complex128)
    begins = size * np.arange(_PIECES)[:, None]
    error = np.concatenate([before, before, outputs - points, after])
    errors = error[begins + np.arange(_MEMORY - 1, -1, -1)][:, None]  # of each survivor, the newest first
    pieces = np.concatenate([before, outputs, after])[begins + np.arange(size + 2 * _MEMORY)]
    cost = np.zeros((_PIECES, 1))
    origin = np.zeros((pieces.shape[1], _PIECES, _SURVIVORS), dtype=np.intp)
    chosen = np.zeros_like(origin)
    piece = np.arange(_PIECES)[:, None]
    for step in range(pieces.shape[1]):
        error = pieces[:, step, None] - _POINTS
        new = error[:, None] - (errors @ weights)[..., None]
        total = (cost[..., None] + new.real**2 + new.imag**2).reshape(_PIECES, -1)
        kept = np.argpartition(total, min(_SURVIVORS, total.shape[1]) - 1)[:, :_SURVIVORS]
        survivor, point = np.divmod(kept, _POINTS.size)
        cost = total[piece, kept]
        errors = np.concatenate([error[piece, point][..., None], errors[piece, survivor, :-1]], axis=2)
        origin[step, :, : kept.shape[1]], chosen[step, :, : kept.shape[1]] = survivor, point
    piece, at = piece[:, 0], cost.argmin(axis=1)
    found = np.empty(pieces.shape, dtype=np.complex128)
    for step in range(pieces.shape[1] - 1, -1, -1):
        found[:, step] = _POINTS[chosen[step, piece, at]]
        at = origin[step, piece, at]
    return found[:, _MEMORY:-_MEMORY].ravel()[: outputs.size]
