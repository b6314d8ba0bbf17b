"""How many trials a Pd needs: two stages, so that looking at the data does not bias the interval.

The first batch of a point is the pilot. It fixes the number of batches, once; the others are then measured whatever
they show. Nothing is decided from them, so the final interval is that of a fixed number of trials (the idea: C. Stein,
"A two-sample test for a linear hypothesis whose power is independent of the variance", Ann. Math. Stat. 16, 1945).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.special import ndtri

from ..results.score import wilson_interval

__all__ = ["MAX_BATCHES", "batches_needed", "half_width"]

MAX_BATCHES = 10_000
_Z = float(ndtri(0.975))


def half_width(correct: int, trials: int) -> float:
    """Half the width of the 95 % Wilson interval."""
    low, high = wilson_interval(correct, trials)
    return 0.5 * (high - low)


def batches_needed(pilot: Sequence[dict[str, Any]], wanted: float) -> int:
    """Batches of a point until the 95 % half width of Pd is ``wanted`` for every method, the pilot among them.

    The Pd of the plan is the end of the pilot's interval nearer to one half, where the width is largest: a pilot that
    saw no failure by luck must not end the measurement.

    Parameters
    ----------
    pilot : rows of the first batch, with ``correct`` and ``trials``; rows without trials ask for no more.
    wanted : float
        Half width, within 0..0.5.

    Examples
    --------
    >>> batches_needed([{"correct": 75, "trials": 150}], 0.02)
    16
    >>> batches_needed([{"correct": 150, "trials": 150}], 0.05)
    1
    """
    most = 1
    for row in pilot:
        trials = row.get("trials")  # rows of times and facts have none
        if not trials or half_width(row["correct"], trials) <= wanted:
            continue
        low, high = wilson_interval(row["correct"], trials)
        p = min(max(0.5, low), high)  # of the interval, the value nearest to one half
        # normal approximation of the Wilson width, then upwards until the width itself is met
        count = max(2, int(_Z**2 * p * (1 - p) / wanted**2 / trials))
        while half_width(round(p * count * trials), count * trials) > wanted and count < MAX_BATCHES:
            count += 1
        most = max(most, count)
    return min(most, MAX_BATCHES)
