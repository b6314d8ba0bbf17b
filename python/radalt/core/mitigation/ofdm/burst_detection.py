"""Short loud bursts: better blanked than demodulated from their few symbols."""

import numpy as np
from scipy import ndimage

from .arrays import median, power
from .settings import OfdmSettings


def loud_burst(frame: np.ndarray, settings: OfdmSettings) -> np.ndarray | None:
    """(N,) bool: the samples of a burst that has nearly all of an (N,) frame's power in a short part of it; or None."""
    level = power(frame)
    total = level.sum()
    most = settings.burst_longest * level.size
    # by Cauchy and Schwarz' inequality the loudest so many samples have no more
    if most * np.vdot(level, level) < (settings.burst_power * total) ** 2:
        return None
    loud = level > np.float32(settings.burst_loud) * median(level)
    if np.count_nonzero(loud) > most:
        return None
    gap = settings.burst_gap
    widened = ndimage.maximum_filter1d(loud.view(np.uint8), gap)
    burst = ndimage.minimum_filter1d(widened, gap, origin=-1).view(bool)
    short = np.count_nonzero(burst) <= most
    return burst if short and level[burst].sum() > settings.burst_power * total else None
