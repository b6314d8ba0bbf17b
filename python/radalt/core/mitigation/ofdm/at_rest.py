"""A frame whose channel only seems to move, read with one that stands still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .demodulated import Demodulated
from .demodulator import AGAIN, once_more

__all__ = ["at_rest"]

# times the error with a channel that moves, which has more to fit; after each of two turns of points and channel
_AS_WELL = 3.0, 1.2
_READ = 0.05  # mean error of the symbols in cells, each at most 1, up to which they were read


def at_rest(frame: Demodulated) -> Demodulated:
    """The ``frame`` with a channel (K,) that stands still, if that explains it nearly as well; or read once more.

    A channel that seems to move may have been a quarter turn off in some symbols, or its course may stand for the
    delays of symbols that were set upright by a wrong one. Where it does move, symbols have delays of their own,
    which are told once the channel's course is known.
    """
    grid, clear, received = frame.grid, frame.clear, frame.received
    if received.channel.ndim == 1:
        return frame
    resting = replace(received, channel=received.channel[len(received.channel) // 2])
    before = replace(received.as_before(clear & grid.used), steady=np.inf)
    for most in _AS_WELL:
        resting = once_more(grid, clear, resting, frame.numerology, AGAIN, before)
        if resting.noise > most * received.noise:
            break
    else:
        if resting.mean_misread < _READ:
            return replace(frame, received=resting)
    return replace(frame, received=once_more(grid, clear, received, frame.numerology, AGAIN))
