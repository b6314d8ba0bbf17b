"""A frame read once, with the long prefix where it leaves the fewest errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .acquisition import Grid, Prefix, acquired, carrier_step, retuned, transforms
from .burst import whole
from .demodulator import FIRST, Received, begin, demodulate
from .emission import PARTLY
from .lattice import power
from .numerology import Numerology
from .ridge import Ridge

__all__ = ["TURNS", "First", "Opened", "Straight", "straightened"]

_STRAIGHT = 1e-4  # subcarriers of carrier that do no harm: neighbours leak -75 dB
TURNS = 6e-3  # more than that are turns of the symbols' own (TS 38.211 clause 5.4)
_NOISE = (
    0.55  # mean error of the best symbol in the first turn; of what is read in the end 0.35, of noise 0.6
)
_SILENT = 0.1  # of the loudest symbol's power
_FEW = 0.75  # of a frame's symbols


@dataclass(frozen=True)
class Straight:
    """A frame's samples (N,) without the carrier, and the factor (N,) that took it out; None if it was negligible."""

    samples: np.ndarray
    turn: np.ndarray | None


def straightened(frame: np.ndarray, carrier: float, numerology: Numerology) -> Straight:
    """The frame without a carrier of so many subcarriers, as it is where that is negligible."""
    if abs(carrier) < _STRAIGHT:
        return Straight(frame, None)
    # a product of few long and few short steps
    step = -2j * np.pi * carrier / numerology.useful
    short = int(np.sqrt(frame.size)) + 1
    few = np.arange(short)
    turn = np.exp(step * short * few).astype(np.complex64)[:, None] * np.exp(step * few).astype(np.complex64)
    turn = turn.ravel()[: frame.size]
    return Straight(frame * turn, turn)


@dataclass(frozen=True)
class First:
    """A first reading: the frame without its carrier (in subcarriers), symbols, which of their elements (L, K) bool no
    return can be in, and what was received."""

    straight: Straight
    carrier: float
    grid: Grid
    clear: np.ndarray
    received: Received

    @property
    def misread(self) -> float:
        """Mean error of all symbols."""
        return float(self.received.misread.mean())


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
    """

    def __init__(self, frame: np.ndarray, prefix: Prefix, numerology: Numerology, ridge: Ridge) -> None:
        self._frame, self._prefix, self._numerology, self._ridge = frame, prefix, numerology, ridge
        self.straight = straightened(frame, prefix.carrier, numerology)
        self._grids = acquired(self.straight.samples, prefix, numerology, self.clear_of)
        self.grid = next(self._grids)

    def clear_of(self, starts: np.ndarray) -> np.ndarray:
        """(L, K) bool: elements of the symbols at ``starts`` that no return can be in."""
        return self._ridge.clear(starts, self._prefix.carrier)

    def read(self) -> First | None:
        """The frame read once; None if no symbol can be.

        A burst's few symbols do not say for certain where the long prefix is. So where much of them is misread, the
        other places that are nearly as likely are tried.
        """
        best = self._read(self.grid)
        if best is None or best.misread <= PARTLY:
            return best
        loud = power(self.grid.symbols).sum(axis=1)
        if np.mean(loud > _SILENT * loud.max()) < _FEW:
            others = filter(None, map(self._read, self._grids))
            best = min((best, *others), key=lambda first: first.misread)
        return best

    def _read(self, grid: Grid) -> First | None:
        numerology, straight, carrier = self._numerology, self.straight, self._prefix.carrier
        clear = self.clear_of(grid.starts) & whole(straight.samples, grid.starts, numerology)[:, None]
        begun = begin(grid, clear, numerology, FIRST[0], limit=_NOISE)
        if begun is None:
            return None
        # known far better than from fourth powers
        step = carrier_step(begun.grid.angles, begun.weight, numerology)
        if _STRAIGHT < abs(step) < TURNS:
            carrier += step
            straight = straightened(self._frame, carrier, numerology)
            spectra = transforms(straight.samples, grid.starts, numerology)
            grid = retuned(grid, spectra, step, numerology)
            begun = replace(begun, grid=retuned(begun.grid, spectra, step, numerology))
        received = demodulate(grid, clear, numerology, FIRST, begun=begun)
        return First(straight, carrier, grid, clear, received)
