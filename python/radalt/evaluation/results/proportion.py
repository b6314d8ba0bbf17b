"""95 % intervals of a binomial proportion."""

import numpy as np
from scipy.special import betaincinv, ndtri

_CONFIDENCE = 0.95


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Score interval of a binomial proportion; (0, 1) without trials.

    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 22,
    1927. Unlike the normal interval it stays within 0..1 and keeps its width at 0 and at 1.

    Examples
    --------
    >>> low, high = wilson_interval(8, 10)
    >>> round(low, 3), round(high, 3)
    (0.49, 0.943)
    """
    if trials == 0:
        return 0.0, 1.0
    z2 = float(ndtri(0.5 + 0.5 * _CONFIDENCE)) ** 2
    p = successes / trials
    centre = p + z2 / (2 * trials)
    half = np.sqrt(z2 * (p * (1 - p) / trials + z2 / (4 * trials**2)))
    low, high = (centre - half) / (1 + z2 / trials), (centre + half) / (1 + z2 / trials)
    # at 0 and 1 the bound is exact; rounding must not exceed it
    return (0.0 if successes == 0 else float(low)), (1.0 if successes == trials else float(high))


def clopper_pearson(events: int, trials: int) -> tuple[float, float]:
    """Two-sided interval of a binomial proportion, from the exact distribution; (0, 1) without trials.

    C. J. Clopper, E. S. Pearson, Biometrika 26, 1934. For zero events the upper end is ``1 - 0.025 ** (1 / n)``.

    Examples
    --------
    >>> low, high = clopper_pearson(0, 10_000)
    >>> low, round(high, 6)
    (0.0, 0.000369)
    """
    tail = 0.5 * (1.0 - _CONFIDENCE)
    low = float(betaincinv(events, trials - events + 1, tail)) if events else 0.0
    high = float(betaincinv(events + 1, trials - events, 1.0 - tail)) if events < trials else 1.0
    return low, high


def clopper_pearson_bound(events: int, trials: int) -> float:
    """One-sided upper bound of a rate; 1 without trials. Zero events give a bound too, about 3 / trials.

    Examples
    --------
    >>> round(clopper_pearson_bound(0, 300), 5)
    0.00994
    """
    return 1.0 if events >= trials else float(betaincinv(events + 1, trials - events, _CONFIDENCE))


def paired_difference(ours: np.ndarray, theirs: np.ndarray) -> tuple[float, float, float]:
    """Difference of two proportions on the same (n,) trials, with its normal 95 % interval.

    Its variance is that of the trials in which they differ (Q. McNemar, Psychometrika 12, 1947).

    Examples
    --------
    >>> difference = paired_difference(np.array([True] * 90 + [False] * 10), np.array([True] * 60 + [False] * 40))
    >>> [round(float(d), 3) for d in difference]
    [0.3, 0.21, 0.39]
    """
    each = ours.astype(float) - theirs
    mean, half = each.mean(), float(ndtri(0.5 + 0.5 * _CONFIDENCE)) * each.std() / np.sqrt(each.size)
    return float(mean), float(mean - half), float(mean + half)
