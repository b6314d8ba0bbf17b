"""Positions of extended returns in a beat spectrum: centroid and leading edge of the run of cells around a peak."""

import numpy as np


def centroid_of(power: np.ndarray, cell: int) -> float:
    """Power centroid of the run of cells around ``cell`` above a tenth of its power."""
    above = power > 0.1 * power[cell]
    low, high = _run(above, cell)
    weights = power[low : high + 1].astype(float)
    total = weights.sum()
    if not total > 0:  # a forced decision on a cell without power
        return float(cell)
    return float(np.dot(weights, np.arange(low, high + 1)) / total)


def edge_of(power: np.ndarray, cell: int, peak: float, lobe: tuple[np.ndarray, np.ndarray]) -> float:
    """Fractional cell of the nearest target on the rise towards ``cell``.

    The first cell of the run above a quarter of the peak lies on the near flank of the nearest target's main lobe;
    its level says how far before that target it lies. Exact for a point target, for which the run is the main lobe.

    ``power`` (J,); ``cell``: peak cell; ``peak``: power of the peak between the cells, at least ``power[cell]``;
    ``lobe`` (power, distance): main lobe of a point target: rising relative power, and the distance from its peak in
    cells.
    """
    above = power > 0.25 * peak
    # interference of two scatterers: a dip of one cell, a quarter of a resolution cell, does not end the run
    above[1:-1] |= above[:-2] & above[2:]
    low, _ = _run(above, cell)
    return low + float(np.interp(power[low] / max(peak, 1e-37), *lobe))


def _run(mask: np.ndarray, cell: int) -> tuple[int, int]:
    """First and last index of the run of true cells around ``cell``."""
    below = np.nonzero(~mask[:cell])[0]
    above = np.nonzero(~mask[cell:])[0]
    low = int(below[-1]) + 1 if below.size else 0
    high = cell + int(above[0]) - 1 if above.size else mask.size - 1
    return low, high
