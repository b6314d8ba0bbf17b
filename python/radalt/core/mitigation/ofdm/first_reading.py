"""A frame read once, with the long prefix where it leaves the fewest errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .acquisition import Grid, Prefix, acquired, retuned, transforms
from .burst import whole
from .carrier import TURNS, carrier_step, whole_subcarriers
from .demodulated import NEGLIGIBLE, Demodulated, straightened
from .demodulator import FIRST, begin, demodulate
from .emission import PARTLY
from .lattice import power
from .numerology import Numerology
from .ridge import Ridge

__all__ = ["Opened"]

_NOISE = 0.55  # error of the best symbol in the first turn; what is read in the end has 0.35, noise 0.6
_NARROWEST = 40.0  # subcarriers that share the power; a tone is one or two, the narrowest LTE 72
_BESIDE = 0.3  # of the power of elements that hold the return, in the others: a return alone has 0.15, SIR -10 dB 0.45
_SILENT = 0.1  # of the loudest symbol's power
_FEW = 0.75  # of a frame's symbols


class Opened:
    """A frame of whose prefix something is known, before it is read.

    Parameters
    ----------
    frame : (N,) complex64
    prefix : Prefix
    numerology : Numerology
    ridge : Ridge

    Attributes
    ----------
    straight : Straight
        Without the carrier that the prefix tells.
    grid : Grid
        Its symbols, with the likeliest place of the long prefix.
    clear : (L, K) bool
        Which of their elements no return can be in; those of symbols that a burst cuts are not among them.
    """

    def __init__(self, frame: np.ndarray, prefix: Prefix, numerology: Numerology, ridge: Ridge) -> None:
        self._frame, self._prefix, self.numerology, self._ridge = frame, prefix, numerology, ridge
        self.straight = straightened(frame, prefix.carrier, numerology)
        self._grids = acquired(self.straight.samples, prefix, numerology, self._clear_of)
        self.grid = next(self._grids)
        self._own = power(self.grid.symbols)
        self.clear = self._clear(self.grid)

    def _clear_of(self, starts: np.ndarray) -> np.ndarray:
        return self._ridge.clear(starts, self._prefix.carrier)

    def _clear(self, grid: Grid) -> np.ndarray:
        """(L, K) bool: elements of whole symbols that no return can be in."""
        unbroken = whole(self.straight.samples, self._own.mean(axis=1), grid.starts, self.numerology)
        return self._clear_of(grid.starts) & unbroken[:, None]

    def is_wide(self) -> bool:
        """Whether many subcarriers share the power, others than those of a return."""
        own, used = self._own, self.grid.used
        level = own.sum(axis=0)
        if level.sum() ** 2 < _NARROWEST * (level @ level):
            return False
        beside = self._clear_of(self.grid.starts) & used
        power_beside, count_beside = float((own * beside).sum()), np.count_nonzero(beside)
        power_rest = float(level @ used) - power_beside
        count_rest = len(own) * np.count_nonzero(used) - count_beside
        return power_beside / max(count_beside, 1) >= _BESIDE * power_rest / max(count_rest, 1)

    def read(self) -> Demodulated | None:
        """The frame read once; None if no symbol can be.

        A burst's few symbols do not say for certain where the long prefix is. So where much of them is misread, the
        other places that are nearly as likely are tried.
        """
        best = self._read(self.grid)
        if best is None or best.misread <= PARTLY:
            return best
        loud = self._own.sum(axis=1)
        if np.mean(loud > _SILENT * loud.max()) < _FEW:
            others = filter(None, map(self._read, self._grids))
            best = min((best, *others), key=lambda first: first.misread)
        return best

    def _read(self, grid: Grid) -> Demodulated | None:
        numerology, straight, carrier = self.numerology, self.straight, self._prefix.carrier
        clear = self.clear if grid is self.grid else self._clear(grid)
        begun = begin(grid, clear, numerology, FIRST[0], limit=_NOISE)
        if begun is None:
            return None
        # known far better than from fourth powers
        times = numerology.times_at(grid.starts, grid.first_long)
        shift, angles = whole_subcarriers(begun.grid.angles, begun.weight, times, numerology)
        step = carrier_step(angles, begun.weight, numerology)
        if shift:
            grid = replace(grid, angles=grid.angles + angles - begun.grid.angles)
            begun = replace(begun, grid=replace(begun.grid, angles=angles))
        if NEGLIGIBLE < abs(step) < (np.inf if shift else TURNS):
            carrier += step
            straight = straightened(self._frame, carrier, numerology)
            spectra = transforms(straight.samples, grid.starts, numerology)
            grid = retuned(grid, spectra, step, numerology)
            begun = replace(begun, grid=retuned(begun.grid, spectra, step, numerology))
        received = demodulate(grid, clear, numerology, FIRST, begun=begun)
        return Demodulated(numerology, carrier, straight, grid, clear, received, shift)
