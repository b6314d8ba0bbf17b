"""Positions of extended returns in a beat spectrum: centroid and leading edge of the run of cells around a peak."""

from __future__ import annotations

import numpy as np

__all__ = ["centroid_of", "edge_of"]


def centroid_of(power: np.ndarray, cell: int) -> float:
    """Power centroid of the run of cells around ``cell`` above a tenth of its power."""
    above = power > 0.1 * power[cell]
    low, high = _run(above, cell)
    weights = power[low : high + 1].astype(float)
    total = weights.sum()
    if not total > 0:  # a forced decision on a cell without power
        return float(cell)
    return float(np.dot(weights, np.arange(low, high + 1)) / total)


def edge_of(power: np.ndarray, cell: int) -> float:
    """Fractional cell where the rise towards ``cell`` crosses a quarter of its power, nearest edge of the run."""
    level = 0.25 * power[cell]
    low, _ = _run(power > level, cell)
    if low == 0:
        return 0.0
    # interpolate in decibels: the flank of a main lobe is close to a parabola there
    below, above, crossing = np.log(np.maximum([power[low - 1], power[low], level], 1e-37))
    if not above > below:  # a forced decision on a cell without power, or one that is not finite
        return float(low)
    return low - 1 + float((crossing - below) / (above - below))


def _run(mask: np.ndarray, cell: int) -> tuple[int, int]:
    """First and last index of the run of true cells around ``cell``."""
    below = np.nonzero(~mask[:cell])[0]
    above = np.nonzero(~mask[cell:])[0]
    low = int(below[-1]) + 1 if below.size else 0
    high = cell + int(above[0]) - 1 if above.size else mask.size - 1
    return low, high
