"""The threshold on the sum of both half sweeps' significance, from the crossings of a noise spectrum."""

import numpy as np

# Of the law's false alarms. White noise then makes 0.8 to 1.0 of the bound, 0.91 in the mean, over 14 settings of
# speed, span, window and sweep (3,000 to 40,000 frames each).
_HAPPENS = 0.93


def upcrossings(window: np.ndarray) -> float:
    """Constant ``a``: a noise spectrum crosses ``u`` upwards ``a sqrt(u) exp(-u)`` times per resolution cell.

    ``a = sqrt(lambda / pi)`` with ``lambda = (2 pi)^2 var(t / T_h)`` under the squared window: the envelope of a
    complex Gaussian process (S. O. Rice, Bell Syst. Tech. J. 24, 1945, sec. 3.8).
    """
    weight = np.asarray(window, dtype=float) ** 2
    time = np.arange(weight.size) / weight.size
    mean = np.average(time, weights=weight)
    return float(np.sqrt(4.0 * np.pi * np.average((time - mean) ** 2, weights=weight)))


def pair_threshold(rate: float, cells: float, partners: float, crossing: float, floor: float) -> float:
    """Threshold on the sum of both half sweeps' significance that white noise exceeds ``rate`` times per frame.

    Along one difference the sum of two is a chi-square process of four degrees of freedom, which crosses ``T`` ``a
    T^1.5 exp(-T)`` times per resolution cell. Over a width of differences there is one trial per pair of local
    maxima; a strong peak of one half sweep is counted once, however many partners lift it over ``T``. The floor
    leaves ``(T - 2 floor + 1)/(T + 1)`` of the exceedances. Only the share `_HAPPENS` of them has to be within the
    rate: peaks cluster, fall between points, and the pair of greatest power need not be the one that exceeds the
    floor.

    ``rate``: expected false alarms per frame; ``cells``: resolution cells searched; ``partners``: width of the
    differences between up and down cell that are searched, in resolution cells; 0 for one partner; ``crossing``: see
    `upcrossings`; ``floor``: least significance that each half sweep has to show on its own.
    """

    def log_excess(level: float) -> float:
        expected = _HAPPENS * _false_alarms(level, cells, partners, crossing, floor)
        return float(np.log(expected) - np.log(rate))

    # false position, the Illinois way: the logarithm is nearly a straight line. scipy.optimize takes 10 MB
    low, high = 2.0 * floor + 1e-3, 200.0
    above, below = log_excess(low), log_excess(high)
    if above < 0:
        return low
    level = high
    for _ in range(100):
        before, level = level, (low * below - high * above) / (below - above)
        excess = log_excess(level)
        if abs(level - before) < 1e-9 or excess == 0:
            break
        if excess > 0:
            low, above, below = level, excess, 0.5 * below if before < level else below
        else:
            high, below, above = level, excess, 0.5 * above if before > level else above
    return level


def _false_alarms(level: float, cells: float, partners: float, crossing: float, floor: float) -> float:
    """Expected false alarms per frame at a threshold."""

    def maxima(u: np.ndarray | float) -> np.ndarray:  # per resolution cell, above u
        return crossing * np.sqrt(np.maximum(u, 0.5)) * np.exp(-np.asarray(u, dtype=float))

    both = (level - 2.0 * floor + 1.0) / (level + 1.0) * np.exp(-level)
    count = both * (cells * crossing * level**1.5 + 1.0 + level)
    if partners > 0:
        u = np.linspace(0.5 * level, level + 12.0, 600)
        middle = 0.5 * (u[1:] + u[:-1])
        lifted = -np.expm1(-partners * maxima(np.maximum(level - middle, floor)))
        pairs = 2.0 * np.sum(-np.diff(maxima(u)) * lifted) - partners * maxima(0.5 * level) ** 2
        count += cells * max(0.0, float(pairs))
    return float(count)
