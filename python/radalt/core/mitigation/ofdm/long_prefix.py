"""The long prefix put where the symbols beside it can be read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .acquisition import Grid
from .demodulator import AGAIN, once_more
from .lattice import decide, misread, unit
from .numerology import Numerology
from .received import Received

__all__ = ["well_placed"]

_AMISS = 0.3  # mean error of a symbol whose delay may be wrong; a random one has 0.75
_RIGHT = 0.6  # of that error is left where the delay was wrong
_ANGLES = 12  # in a quarter turn, tried for such a symbol: half a step keeps 64QAM in its cells
_TURNS = np.exp(-0.5j * np.pi * np.arange(_ANGLES) / _ANGLES).astype(np.complex64)


def well_placed(
    grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology
) -> tuple[Grid, Received]:
    """The frame read with the long prefix one symbol later or earlier, where the symbols between can be read then; or
    ``grid`` and ``received`` as they are.

    Acquisition places it by fourth powers, which tell little where the channel fades. A symbol on its wrong side comes
    too late or too early by what that prefix is longer, and nothing of it can be read. ``clear`` (L, K) bool tells
    which elements no return can be in.
    """
    if received.misread.max() <= _AMISS:
        return grid, received
    passed = numerology.halves(grid.starts, grid.first_long)
    last = np.flatnonzero(np.diff(passed))
    for later in (1, -1):
        between = last + (later > 0)
        if received.misread[between].max(initial=0) <= _AMISS:
            continue
        turn = np.ones_like(received.symbols)
        turn[between] = unit(np.float32(-later * numerology.longer) * numerology.turn)
        left, angles = 0.0, np.zeros(len(passed))
        for row in between:
            channel = received.channel if received.channel.ndim == 1 else received.channel[row]
            tried = received.symbols[row] * turn[row] / channel * _TURNS[:, None]
            asked = np.broadcast_to(clear[row] & grid.used, tried.shape)
            errors = misread(decide(tried, asked, np.arange(_ANGLES)).capped, asked, channel)
            best = int(errors.argmin())
            left += errors[best]
            turn[row] *= _TURNS[best]
            angles[row] = -np.angle(_TURNS[best])
        if left < _RIGHT * received.misread[between].sum():
            grid = replace(
                grid,
                first_long=grid.first_long + later * (numerology.useful + numerology.prefix),
                symbols=grid.symbols * turn,
                phase=grid.phase * turn,
                angles=grid.angles + angles,
            )
            received = replace(
                received,
                symbols=received.symbols * turn,
                phase=received.phase * turn,
                angles=received.angles + angles,
            )
            return grid, once_more(grid, clear, received, numerology, AGAIN)
    return grid, received
