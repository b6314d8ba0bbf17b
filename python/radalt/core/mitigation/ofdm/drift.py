"""How a channel changes from symbol to symbol, and so within each one, which spreads subcarriers over neighbours."""

from __future__ import annotations

import numpy as np

from .acquisition import Grid
from .emission import PARTLY
from .lattice import power
from .received import Received

__all__ = ["change_of_all", "matters", "moves"]

_MOVES = 0.05  # of the error, what a change within a symbol has to add to it
_ORDER = 2  # of the course of the symbols' angles
_SCATTER = 0.02  # radians about that course, where a carrier moves; turns of the symbols' own leap
_FASTEST = 0.1  # radians per symbol: a carrier is acquired more exactly, and no car is so fast


def moves(received: Received, grid: Grid) -> bool:
    """Whether the channel's own change, beside what all subcarriers have in common, matters."""
    return received.channel.ndim > 1 and matters(np.gradient(received.channel, axis=0), received, grid)


def change_of_all(received: Received, grid: Grid) -> np.ndarray | None:
    """(L, K) change of what subcarriers are multiplied by, from symbol to symbol; None where it does not matter.

    What all of them have in common is not in the channel but in the symbols' angles: the strongest path's Doppler
    turns them. Angles of frames that were badly read tell nothing.
    """
    channel = received.channel
    change = np.gradient(channel, axis=0) if channel.ndim > 1 else None
    turning = _turning(received) if received.mean_misread < PARTLY else None
    if turning is not None:
        turned = channel * (1j * turning[:, None]).astype(np.complex64)
        change = turned if change is None else change + turned
    return change if change is not None and matters(change, received, grid) else None


def matters(change: np.ndarray, received: Received, grid: Grid) -> bool:
    """Whether a change evenly spread over a symbol, which leaves a twelfth of its power to others, adds to errors."""
    return bool(power(change)[:, grid.used].mean() / 12 > _MOVES * received.noise)


def _turning(received: Received) -> np.ndarray | None:
    """(L,) radians per symbol by which a carrier turns; None where the symbols' angles have no smooth course."""
    heard = np.flatnonzero(received.weight > 0)
    if heard.size < 2 * _ORDER:
        return None
    angles = received.angles[heard]
    if np.abs(np.diff(angles)).max() > np.pi / 4:
        angles = np.unwrap(4 * angles) / 4
    if np.square(np.diff(angles)).mean() / 12 < _MOVES * received.noise:
        return None  # an emitter that is followed does not turn
    index = heard - heard.mean()
    weight = np.sqrt(received.weight[heard])
    half = np.abs(index).max()
    powers = np.arange(_ORDER + 1)
    basis = (index[:, None] / half) ** powers
    course = np.linalg.lstsq(basis * weight[:, None], angles * weight, rcond=None)[0]
    if np.abs(basis @ course - angles).max() > _SCATTER:
        return None
    every = (np.arange(received.angles.size) - heard.mean()) / half
    turning = every[:, None] ** powers[:-1] @ (course[1:] * powers[1:]) / half
    return turning if np.abs(turning).max() < _FASTEST else None
