"""A frame whose channel fades or turns within it: read from its best symbols on, one symbol after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .acquisition import Grid
from .channel_fit import audible, loudest
from .demodulator import AGAIN, SURE, demodulate
from .echoes import Echoes
from .emission import PARTLY
from .lattice import amid, decide, power
from .numerology import Numerology
from .received import Received

__all__ = ["read_onward"]

_FIRST = ((15, 0, 1.0), (9, 1, 1.0), (5, 1, 1.0))  # turns: four symbols tell a straight course at most
_LONG, _APART = 4, 2  # symbols that are read by themselves, and from one such group to the next
_HOPELESS = 0.4  # mean error of the best group; random elements have 0.75
_ANGLES = 12  # in a quarter turn, tried for a new symbol: half a step keeps 64QAM in its cells
_TURNS = np.exp(-0.5j * np.pi * np.arange(_ANGLES) / _ANGLES).astype(np.complex64)[:, None]
_WEIGHT = np.float32(0.3)  # mean error around an element at which its weight is 1/e
_ENOUGH = 20.0  # elements of a symbol that tell its phase
_ON_GROUP = 2  # fits to the group before it is left
_WALKS = 4  # through a frame, at most: each from where the one before read best
_MENDS = 0.97  # of the error that was left, for one more


def read_onward(grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> Received:
    """A frame read from its best symbols on, or as ``received`` where less of that was misread.

    A first channel is a mean over symbols, and is wrong where the channel fades or turns meanwhile. Over four symbols
    it hardly does, and somewhere in the frame four can be read. A channel of echoes fitted to them tells the one of the
    next symbol on either side, all but a common angle. That angle is tried, the symbol decided, and the echoes are
    fitted again with it.
    """
    count, clear = len(grid.starts), clear & grid.used
    if count <= _LONG:
        return received
    groups = []
    for first in range(0, count - _LONG + 1, _APART):
        part = slice(first, first + _LONG)
        few = replace(
            grid, starts=grid.starts[part], symbols=grid.symbols[part], phase=grid.phase[part],
            angles=grid.angles[part], channel=grid.around(part), around=None,
        )  # fmt: skip
        alone = demodulate(few, clear[part], numerology, _FIRST)
        wrong, told = _wrong(alone.capped, alone.points, clear[part])
        groups.append((wrong.sum() / max(told.sum(), 1), part, alone))
    error, part, alone = min(groups, key=lambda group: group[0])
    if error > _HOPELESS:
        return received
    walk = _Walk(grid, clear, alone, part, numerology)
    least, best = np.inf, None
    for _ in range(_WALKS):
        walk.whole()
        error, start = walk.left()
        if error < least:
            best = walk.result()
        if error < PARTLY or error > _MENDS * least:
            break
        least = error
        walk.held = slice(start, start + _LONG)
    again = demodulate(best, clear, numerology, AGAIN)
    again.late += received.late
    return again if again.mean_misread < received.mean_misread else received


def _wrong(capped: np.ndarray, points: np.ndarray, clear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L,) errors of each symbol's ``clear`` elements, summed, and how many these are; silence is always read well."""
    told = clear & (points != 0)
    return (capped * told).sum(axis=1), told.sum(axis=1)


class _Walk:
    """The symbols ``held`` (a slice), read with one channel of echoes."""

    def __init__(
        self, grid: Grid, clear: np.ndarray, alone: Received, held: slice, numerology: Numerology
    ) -> None:
        self._grid, self._clear, self.held = grid, clear, held
        self._halves = numerology.halves(grid.starts, grid.first_long)
        self._most = loudest(grid.symbols, clear)
        self.symbols, self.phase, self.angles = grid.symbols.copy(), grid.phase.copy(), grid.angles.copy()
        self.symbols[held], self.phase[held], self.angles[held] = alone.symbols, alone.phase, alone.angles
        self.points = np.zeros_like(grid.symbols)
        self.error = np.ones(grid.symbols.shape, dtype=np.float32)
        self.points[held], self.error[held] = alone.points, alone.error
        channel = np.broadcast_to(alone.channel, alone.symbols.shape)
        self._echoes = Echoes(channel, clear[held] & (alone.error < SURE), len(grid.starts), numerology)
        self.model = np.broadcast_to(grid.channel, grid.symbols.shape)

    def whole(self) -> None:
        """Read all symbols, from those held on."""
        for _ in range(_ON_GROUP):
            self._read()
        count = len(self.symbols)
        while self.held.start > 0 or self.held.stop < count:
            self._fit()
            held = slice(max(self.held.start - 1, 0), min(self.held.stop + 1, count))
            for row in {held.start, held.stop - 1} - {self.held.start, self.held.stop - 1}:
                self._seek(row)
            self.held = held
            self._read()
        self._read()

    def left(self) -> tuple[float, int]:
        """Mean error of all elements that are not silent, each at most 1, and where the symbols with least begin."""
        wrong, told = _wrong(np.minimum(self.error, 1), self.points, self._clear)
        group = np.ones(_LONG)
        errors = np.convolve(wrong, group, "valid") / np.maximum(np.convolve(told, group, "valid"), 1)
        return float(wrong.sum() / max(told.sum(), 1)), int(errors.argmin())

    def result(self) -> Grid:
        """The grid with the channel of the echoes."""
        return replace(
            self._grid, symbols=self.symbols.copy(), phase=self.phase.copy(), channel=self.model,
            angles=self.angles.copy(),
        )  # fmt: skip

    def _fit(self) -> np.ndarray:
        """Fit the echoes to the symbols held; (L, K) weights of the elements."""
        held, weight = self.held, np.zeros(self.error.shape, dtype=np.float32)
        asked, error = self._clear[held], self.error[held]
        near = amid(np.minimum(error, 1), asked.astype(np.float32)) / _WEIGHT
        weight[held] = (asked & (error < SURE)) * np.exp(-near * near)
        model, self._echoes.likely = self._echoes.fitted(self.symbols, self.points, weight)
        self.model = audible(model, self._most)
        return weight

    def _read(self) -> None:
        """Fit the echoes, set the symbols held upright and decide them."""
        weight, held = self._fit(), self.held
        agreement = (self.symbols * (self.model * self.points).conj() * weight).sum(axis=1)
        self._turn(np.where(weight.sum(axis=1) < _ENOUGH, 0, np.angle(agreement + 1e-30)))
        halves = self._halves[held]
        found = decide(self.symbols[held] / self.model[held], self._clear[held], halves - halves[0])
        self.points[held], self.error[held] = found.points, found.error

    def _seek(self, row: int) -> None:
        """Decide a new symbol at the angle at which it fits the predicted channel best."""
        channel, clear = self.model[row], self._clear[row]
        tried = self.symbols[row] / channel * _TURNS
        found = decide(tried, np.broadcast_to(clear, tried.shape), np.arange(_ANGLES))
        best = int((found.capped @ (clear * power(channel))).argmin())
        self.points[row], self.error[row] = found.points[best], found.error[best]
        sure = clear & (found.error[best] < SURE)
        angles = np.zeros(len(self.symbols))
        angles[row] = np.angle((self.symbols[row] * (channel * self.points[row]).conj())[sure].sum() + 1e-30)
        self._turn(angles)

    def _turn(self, angles: np.ndarray) -> None:
        """Turn symbols back by ``angles`` (L,)."""
        back = np.exp(-1j * angles)[:, None].astype(np.complex64)
        self.symbols, self.phase, self.angles = self.symbols * back, self.phase * back, self.angles + angles
