"""How many trials a Pd needs: two stages, so that looking at the data does not bias the interval.

The first batch of a point is the pilot. It fixes the number of batches, once; the others are then measured whatever
they show, and all of them count (the idea: C. Stein, "A two-sample test for a linear hypothesis whose power is
independent of the variance", Ann. Math. Stat. 16, 1945). A Pd is no normal mean: its variance tells of the Pd, so a
pilot that was lucky at Pd 0.97 also ends the point sooner. Over all outcomes of both stages the interval still covers
as a Wilson interval of a fixed count does, the Pd itself is off by less than a seventh of the precision, away from one
half, and one point in a hundred or fewer ends wider than was asked (tests/test_precision.py: exact, not simulated).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.special import ndtri

from ..results.proportion import wilson_interval

__all__ = ["MAX_BATCHES", "PrecisionError", "batches_needed", "check_precision", "half_width", "most_batches"]

MAX_BATCHES = 10_000
_Z = float(ndtri(0.975))


class PrecisionError(ValueError):
    """A precision that would take too long; the message is one line for the user."""


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
        most = max(most, 2, _batches(p, trials, wanted))
    return most


def most_batches(trials: int, wanted: float) -> int:
    """Batches of ``trials`` that reach the precision at any Pd, so at one half: what a fixed count has to be."""
    return _batches(0.5, trials, wanted)


def check_precision(trials: Sequence[int], wanted: float) -> None:
    """Refuse what may need more than `MAX_BATCHES` of a point's batches; ``trials`` are those of a batch, by point.

    Raises
    ------
    PrecisionError
        One line with the precision that can be had.
    """
    fewest = min((t for t in trials if t), default=0)
    if not fewest or most_batches(fewest, wanted) <= MAX_BATCHES:
        return
    best = _Z / (2 * (MAX_BATCHES * fewest) ** 0.5)
    raise PrecisionError(
        f"--precision {wanted:g} may take {most_batches(fewest, wanted)} batches of {fewest} trials; at most "
        f"{MAX_BATCHES}: ask for {best * 1.01:.2g} or more, or for more frames per point"
    )


def _batches(p: float, trials: int, wanted: float) -> int:
    """Smallest number of batches whose Wilson interval around ``p`` has half the width ``wanted`` or less."""
    # normal approximation of the Wilson width, a little below, then upwards until the width itself is met
    count = max(1, int(_Z**2 * (p * (1 - p) / wanted**2 - 1) / trials))
    while half_width(round(p * count * trials), count * trials) > wanted:
        count += 1
    return count
