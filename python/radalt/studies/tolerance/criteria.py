"""Criteria of a usable altimeter, and the level at which one fails."""

from collections.abc import Callable

import numpy as np
from scipy.constants import foot

from ...core.tracker.tracker_settings import Status

# Mean error above 0.5 %, fewer than 98 % within 2 %, any output without computed data: commonly quoted from RTCA
# 274-20/PMC-2073, not read there.
_MEAN_SHARE, _WITHIN_SHARE, _WITHIN = 0.005, 0.02, 0.98
_LEAST_M = 3 * foot  # error up to which no altitude is called wrong (assumed)
_ALERT_S = 1.0  # longest time for which a wrong altitude may be called NORMAL (assumed)
# levels searched, behind the preselector; above, receivers are destroyed rather than wrong
LOWEST_DBM, HIGHEST_DBM = -150, 20
_BRACKET_DB = 8  # first step from the expected level, doubled until the level is enclosed
RUN_IN = 4  # outputs at the start that no criterion counts: a tracker confirms its track in them

CRITERIA = {
    "mean_error": "mean error above 0.5 %",
    "within": "fewer than 98 % within 2 %",
    "no_data": "any output without computed data",
    "wrong": "any output wrong (2 % and 3 ft) and NORMAL",
    "alert": "wrong and NORMAL for longer than 1 s",
}


def judged(status: np.ndarray, altitude_m: np.ndarray, truth_m: float, output_s: float) -> dict[str, bool]:
    """Which criteria have failed. ``status``, ``altitude_m`` (n,): outputs; ``output_s``: time between outputs."""
    normal = status == Status.NORMAL
    error = np.where(normal, altitude_m - truth_m, np.nan)
    within = normal & (np.abs(error) <= _WITHIN_SHARE * truth_m)
    wrong = normal & (np.abs(error) > max(_WITHIN_SHARE * truth_m, _LEAST_M))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], wrong, [0]])))
    longest = int(np.max(edges[1::2] - edges[::2], initial=0))
    mean = abs(np.mean(error[normal])) if normal.any() else np.inf
    return {
        "mean_error": bool(mean > _MEAN_SHARE * truth_m),
        "within": bool(np.mean(within) < _WITHIN),
        "no_data": bool(not normal.all()),
        "wrong": bool(wrong.any()),
        "alert": bool(longest * output_s > _ALERT_S),
    }


def break_level(
    failed: Callable[[int], bool], expected: float, highest_dbm: int = HIGHEST_DBM
) -> float | None:
    """The level at which a criterion fails, to +/-0.5 dB; None if it holds at the highest.

    Bisection over whole decibels, started about an expected level. It assumes that a criterion fails at all higher
    levels.
    """
    low = int(np.clip(round(expected) - _BRACKET_DB // 2, LOWEST_DBM, highest_dbm - 1))
    step = _BRACKET_DB
    while low > LOWEST_DBM and failed(low):
        low, step = max(low - step, LOWEST_DBM), 2 * step
    high, step = low + 1, _BRACKET_DB
    while not failed(high):
        if high == highest_dbm:
            return None
        low, high, step = high, min(high + step, highest_dbm), 2 * step
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if failed(middle) else (middle, high)
    return high - 0.5
