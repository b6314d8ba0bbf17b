"""What was demodulated of a frame's symbols."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

__all__ = ["ASTRAY", "Before", "Received", "astray", "likely_kind"]

_MOSTLY = 0.8  # of the elements, or an alphabet is not tried alone
ASTRAY = 0.3  # mean error of a subcarrier, each at most 1, where its channel is wrong


def astray(capped: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    """(K,) bool: subcarriers whose channel is wrong, by the errors of their ``trusted`` (L, K) elements."""
    return ((capped - np.float32(ASTRAY)) * trusted).sum(axis=0) > 0


def likely_kind(kinds: np.ndarray, capped: np.ndarray, trusted: np.ndarray) -> tuple[int, np.ndarray] | None:
    """The one of `DENSE` that most elements have, and the subcarriers that could be read; None if there are several."""
    kind = int(kinds[-1, kinds.shape[1] // 2])
    if np.count_nonzero(kinds == kind) < _MOSTLY * kinds.size:
        return None
    return kind, ~astray(capped, trusted)


@dataclass(frozen=True)
class Before:
    """What the frame before was like.

    Attributes
    ----------
    likely : (int, (K,) bool) or None
        The one of `DENSE` that most elements had, and the subcarriers that could be read.
    steady : float
        ``noise`` of `Received` where the channel stood still, 0 where it moved.
    scaled : bool
        Whether its users had amplitudes of their own.
    """

    likely: tuple[int, np.ndarray] | None
    steady: float
    scaled: bool = False


@dataclass
class Received:
    """A frame's symbols, demodulated.

    Attributes
    ----------
    symbols, phase : (L, K) complex64
        As in `Grid`, with finer phases.
    channel : (K,) or (L, K) complex64
        One for all symbols where it stands still.
    points : (L, K) complex64
        Decided points.
    kinds : (L, K) int8
        Which of `DENSE` the elements have that are not of few points.
    error : (L, K) float32
        Squared distance from the model in cells of the alphabet.
    capped : (L, K) float32
        The same, each at most 1.
    misread : (L,) float32
        Mean error of each symbol's elements without a return in cells, each at most 1; a random one has 0.75.
    noise : float
        Mean squared distance of the sure elements from the model.
    angles : (L,) float
        As in `Grid`, finer.
    weight : (L,) float
        Weight of each symbol's angle; 0 for a symbol that fits no alphabet.
    late : float
        Samples by which the symbols came late.
    amplitudes : (2, L, K) float32 or None
        As in `decide_scaled`, where users' powers differ; None where one lattice was tried. Points have them.
    few : (L, K) bool
        As in `Decisions`.
    """

    symbols: np.ndarray
    phase: np.ndarray
    channel: np.ndarray
    points: np.ndarray
    kinds: np.ndarray
    error: np.ndarray
    capped: np.ndarray
    misread: np.ndarray
    noise: float
    angles: np.ndarray
    weight: np.ndarray
    late: float
    amplitudes: np.ndarray | None
    few: np.ndarray

    @cached_property
    def mean_misread(self) -> float:
        """Mean error of all symbols in cells, each at most 1."""
        return float(self.misread.mean())

    def as_before(self, trusted: np.ndarray) -> Before:
        """What it tells of the next frame, by its ``trusted`` (L, K) elements."""
        steady = self.noise if self.channel.ndim == 1 else 0.0
        scaled = self.amplitudes is not None
        return Before(None if scaled else likely_kind(self.kinds, self.capped, trusted), steady, scaled)
