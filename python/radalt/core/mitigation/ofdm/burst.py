"""Bursts: which symbols one cuts, and which samples a loud one has."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .lattice import middle, power
from .numerology import Numerology

__all__ = ["loud_burst", "whole"]

_SILENT = 0.1  # of the loudest symbol's power: less is silence
_ENDS = 8  # part of a symbol at either end
_BEGUN = 0.5  # of the symbol's power, which that part has unless the emitter is silent there
_LOUDER = 6.0  # times the median power, in a burst
_LOUD = 0.9  # of a frame's power, at least, in a short burst that is blanked
_GAP = 64  # samples that are quiet within a burst, by chance


def whole(frame: np.ndarray, own: np.ndarray, starts: np.ndarray, numerology: Numerology) -> np.ndarray:
    """(L,) bool: symbols in whose transforms at ``starts`` no burst begins or ends; a frame without silence has no
    other.

    ``own`` (L,) is the power of their samples.
    """
    silent = own < _SILENT * own.max()
    if not silent.any():
        return ~silent
    level = power(frame.take(numerology.places(starts), mode="wrap"))
    end = level.shape[1] // _ENDS
    beside = np.pad(silent, 1, constant_values=True)
    begins = beside[:-2] & (level[:, :end].mean(axis=1) < _BEGUN * own)
    ends = beside[2:] & (level[:, -end:].mean(axis=1) < _BEGUN * own)
    return ~(begins | ends)


def loud_burst(frame: np.ndarray, most: float) -> np.ndarray | None:
    """(N,) bool: the burst of at most ``most`` of a frame that has nearly all of its power; None without."""
    level = power(frame)
    total = level.sum()
    # by Cauchy and Schwarz' inequality the loudest so many samples have no more
    if most * level.size * np.vdot(level, level) < (_LOUD * total) ** 2:
        return None
    loud = level > np.float32(_LOUDER) * middle(level)
    if np.count_nonzero(loud) > most * loud.size:
        return None
    widened = ndimage.maximum_filter1d(loud.view(np.uint8), _GAP)
    burst = ndimage.minimum_filter1d(widened, _GAP, origin=-1).view(bool)
    short = np.count_nonzero(burst) <= most * burst.size
    return burst if short and level[burst].sum() > _LOUD * total else None
