"""A frame that its first reading leaves doubtful: users of unequal powers, or a channel that moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .acquisition import Grid
from .amplitudes import levelled
from .demodulator import AGAIN, MORE, MOVING, READ, SCALED, bridged, demodulate, once_more
from .drift import moves
from .echoes import grown
from .emission import PARTLY
from .lattice import middle
from .numerology import Numerology
from .onward import read_onward
from .received import Received, astray

__all__ = ["read_thoroughly"]

_WELL = 0.013  # the same of most symbols, where only some symbols are misread
_NEARLY = 0.1  # mean error at first where unequal powers explain a frame; other faults leave 0.15 and more
_TOLD = 0.5  # error in cells up to which an element tells its user's amplitude
_EVENED = 0.7  # of the error is left in the end
_HARDLY = 0.08  # of the subcarriers wrong: perhaps the channel moves; the receiver's skirts are 0.05
_MOST_READINGS = 8  # of a frame whose channel moves
_MENDS = 0.97  # of the error that was left, for one more reading


def read_thoroughly(
    grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology, *, unequal: bool = True
) -> Received:
    """A frame as it was ``received``, or read with what else may be in it: ``unequal`` powers, a moving channel."""
    if received.mean_misread < READ:
        return received
    received = _turned_back(grid, clear, received, numerology)
    scaled = _scaled(grid, clear, received, numerology) if unequal else None
    heard = clear & grid.used
    if scaled is not None and scaled.mean_misread < PARTLY and scaled.capped[heard].mean() < PARTLY:
        return scaled
    if received.mean_misread > READ and (
        moves(received, grid) or astray(received.capped, clear & grid.used).mean() > _HARDLY
    ):
        received = _moving(grid, clear, received, numerology)
    return scaled if scaled and _less_misread(scaled, received, heard) else received


def _less_misread(one: Received, other: Received, heard: np.ndarray) -> bool:
    """By power and by elements: users' amplitudes make weak elements, which a mean by power hides."""
    by_power = one.mean_misread < other.mean_misread
    return bool(by_power and one.capped[heard].mean() < other.capped[heard].mean())


def _moving(grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> Received:
    """The frame read with a channel that moves, first around its middle, or as it was."""
    quarter = len(grid.starts) // 4
    amid = grid.around(slice(quarter, len(grid.starts) - quarter))
    moving = demodulate(replace(grid, channel=amid), clear, numerology, MOVING)
    if moving.mean_misread < received.mean_misread:
        received = moving
    return _settled(grid, clear, received, numerology)


def _turned_back(grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> Received:
    """The frame read without the quarter turns that its channel made by chance, or as it was."""
    other = bridged(received.channel, received.capped, clear & grid.used & (received.weight > 0)[:, None])
    if other is None:
        return received
    finer = once_more(grid, clear, replace(received, channel=other), numerology, AGAIN)
    return finer if finer.mean_misread < _EVENED * received.mean_misread else received


def _scaled(grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> Received | None:
    """The frame read with users of unequal powers; None where these do not explain what was misread."""
    # the ends of a burst are misread, too, but they are few
    if received.mean_misread < READ or middle(received.misread) < _WELL:
        return None
    scaled = demodulate(grid, clear, numerology, SCALED[:1], scaled=True)
    # amplitudes of users that have none of their own only add errors
    if scaled.mean_misread > min(_NEARLY, received.mean_misread):
        return None
    for turns in (SCALED[1:], SCALED[1:], AGAIN):
        told = clear & grid.used & (scaled.error < _TOLD)
        few, (dense, scanty) = scaled.few, scaled.amplitudes
        level = levelled(scaled.channel, np.where(few, scanty, dense), told)
        finer = once_more(grid, clear, replace(scaled, channel=level), numerology, turns)
        if finer.mean_misread < scaled.mean_misread:
            scaled = finer
    return scaled if scaled.mean_misread < _EVENED * received.mean_misread else None


def _settled(grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> Received:
    """The frame read on from its best symbols, with a channel of echoes, and again while that mends symbols.

    The echoes need not be few.
    """
    if received.mean_misread > PARTLY:
        received = read_onward(grid, clear, received, numerology)
    if received.mean_misread > PARTLY:
        received = grown(grid, clear, received, numerology)
    for _ in range(_MOST_READINGS if received.mean_misread > PARTLY else 0):
        better = once_more(grid, clear, received, numerology, MORE)
        if better.mean_misread > _MENDS * received.mean_misread:
            break
        received = better
    return received
