"""Number of trials for a Pd: two-stage sampling, so that the stopping rule does not bias the interval.

The first batch of a point is the pilot. It sets the number of batches, once; all of them are then measured and pooled
(after C. Stein, "A two-sample test for a linear hypothesis whose power is independent of the variance", Ann. Math.
Stat. 16, 1945). The variance of a Pd depends on the Pd, so a pilot above the true Pd also ends the point sooner. Over
all outcomes of both stages, the interval covers like a Wilson interval of a fixed count, the bias of Pd is below a
seventh of the precision, away from one half, and at most one point in a hundred ends wider than requested
(tests/test_precision.py: exact, not simulated).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.special import ndtri

from ..results.proportion import wilson_interval

__all__ = ["MAX_BATCHES", "PrecisionError", "batches_needed", "check_precision", "half_width", "most_batches"]

MAX_BATCHES = 10_000  # most batches of a point: 150 frames each are 25 minutes of signal
_Z = float(ndtri(0.975))  # two-sided 95 % quantile of the normal distribution


class PrecisionError(ValueError):
    """A precision that would take too long; the message is one line for the user."""


def half_width(correct: int, trials: int) -> float:
    """Half the width of the 95 % Wilson interval."""
    low, high = wilson_interval(correct, trials)
    return 0.5 * (high - low)


def batches_needed(pilot: Sequence[dict[str, Any]], wanted: float) -> int:
    """Batches of a point, pilot included, until the 95 % half width of Pd is at most ``wanted`` for every method.

    They are planned for the end of the pilot's interval nearer to one half, where the width is largest: a pilot
    without a failure by chance must not end the measurement.

    Parameters
    ----------
    pilot : rows of the first batch, with ``correct`` and ``trials``; rows without trials need no more batches.
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
        p = min(max(0.5, low), high)  # the value within the interval nearest to one half
        most = max(most, 2, _batches(p, trials, wanted))
    return most


def most_batches(trials: int, wanted: float) -> int:
    """Batches of ``trials`` that reach the precision at every Pd, that is at one half."""
    return _batches(0.5, trials, wanted)


def check_precision(trials: Sequence[int], wanted: float) -> None:
    """Refuse a precision that may need more than `MAX_BATCHES` batches; ``trials`` per batch, by point.

    Raises
    ------
    PrecisionError
        One line with the best possible precision.
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
    # start from the normal approximation of the Wilson width, and increase until the width is met
    count = max(1, int(_Z**2 * (p * (1 - p) / wanted**2 - 1) / trials))
    while half_width(round(p * count * trials), count * trials) > wanted:
        count += 1
    return count
