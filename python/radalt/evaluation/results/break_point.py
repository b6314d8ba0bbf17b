"""Break-point SIR and protection gain: one definition for every study."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

BREAK_PD = 0.9  # least Pd at which a method holds, usual for detection requirements


@dataclass(frozen=True)
class Gain:
    """Difference of two break-points in decibels."""

    db: float  # the value, or the end of the range that ``mark`` names; NaN if unknown
    mark: str = ""  # ``""`` exact, ``"<="`` or ``">="`` at the end of a grid, ``"?"`` if both ends are open

    def __str__(self) -> str:
        return "\N{EN DASH}" if self.mark == "?" else f"{_SIGN[self.mark]}{self.db:.1f}"


@dataclass(frozen=True)
class BreakPoint:
    """Break-point SIR of a method: the lowest SIR down to which Pd is at least the level."""

    sir_db: float  # SIR at which Pd crosses the level, or the end of the grid that ``mark`` names
    # ``""``, ``"<="`` if Pd holds down to the lowest measured SIR, ``">="`` if it fails at the highest
    mark: str
    # break-points of the upper and lower 95 % Wilson bounds of Pd: an interval of the break-point; an end of the grid
    # stands for everything beyond it
    low_db: float
    high_db: float

    def __str__(self) -> str:
        return f"{_SIGN[self.mark]}{self.sir_db:.1f}"


_SIGN = {"": "", "<=": "\N{LESS-THAN OR EQUAL TO} ", ">=": "\N{GREATER-THAN OR EQUAL TO} "}


def break_point(
    sir_db: Sequence[float],
    pd: Sequence[float],
    low: Sequence[float] | None = None,
    high: Sequence[float] | None = None,
    *,
    level: float = BREAK_PD,
) -> BreakPoint:
    """SIR at which a curve of Pd falls below a level.

    From the highest SIR down, Pd is replaced by its running minimum: a method that fails at one SIR and holds again
    at a lower one is not reliable below the first. Pd is interpolated linearly between points of the grid.

    Parameters
    ----------
    sir_db : (n,) float
        In decibels, in any order.
    pd : (n,) float
        Probabilities; NaN (nothing measured) counts as failed.
    low, high : (n,) float
        Bounds of Pd; default ``pd`` itself.
    level : float
        Within 0..1.

    Examples
    --------
    >>> str(break_point([-10, -20, -30, -40], [1, 0.95, 0.5, 0.1]))
    '-21.1'
    >>> str(break_point([-10, -20], [1, 0.95]))
    '≤ -20.0'
    """
    sir = np.asarray(sir_db, dtype=float)
    if not sir.size:
        raise ValueError("a break-point needs at least one SIR; none was measured")
    order = np.argsort(-sir, kind="stable")

    def falls(values: Sequence[float]) -> tuple[float, str]:
        curve = np.nan_to_num(np.asarray(values, dtype=float)[order], nan=0.0)
        return _crossing(sir[order], np.minimum.accumulate(curve), level)

    value, mark = falls(pd)
    ends = (falls(pd if end is None else end)[0] for end in (high, low))
    return BreakPoint(value, mark, *ends)


def break_point_of(
    rows: Sequence[Mapping[str, Any]], sir: str = "sir_db", *, level: float = BREAK_PD
) -> BreakPoint:
    """`break_point` of the rows of one curve, with ``pd``, ``pd_low`` and ``pd_high``, over the column ``sir``."""
    return break_point(*([r[c] for r in rows] for c in (sir, "pd", "pd_low", "pd_high")), level=level)


def leaders(cases: Sequence[Mapping[str, BreakPoint]]) -> tuple[list[str], int, list[list[str]]]:
    """Names that carry furthest in most cases, in how many, and the names that do in each.

    Those carry furthest that have the lowest break-point, or whose interval reaches it.
    """
    each = [
        [n for n, at in by.items() if at.low_db <= min(other.sir_db for other in by.values())] for by in cases
    ]
    counts = Counter(chain.from_iterable(each))
    most = max(counts.values())
    return [name for name in counts if counts[name] == most], most, each


def _crossing(sir: np.ndarray, pd: np.ndarray, level: float) -> tuple[float, str]:
    """Crossing (SIR, mark) of a falling curve, highest SIR first."""
    below = np.nonzero(pd < level)[0]
    if not below.size:
        return float(sir[-1]), "<="
    i = int(below[0])
    if i == 0:
        return float(sir[0]), ">="
    share = (pd[i - 1] - level) / (pd[i - 1] - pd[i])
    return float(sir[i - 1] + share * (sir[i] - sir[i - 1])), ""


_TURNED = {"": "", "<=": ">=", ">=": "<="}


def protection_gain(base: BreakPoint, method: BreakPoint) -> Gain:
    """Protection gain of a method over ``base`` (no mitigation): ``base - method`` in decibels.

    An end of the grid stays an open end of the difference; open ends in opposite directions make it unknown.

    Examples
    --------
    >>> none = break_point([-20, -30], [1, 0])
    >>> str(protection_gain(none, break_point([-20, -60], [1, 1])))
    '≥ 39.0'
    """
    marks = {base.mark, _TURNED[method.mark]} - {""}
    return Gain(float("nan"), "?") if len(marks) > 1 else Gain(base.sir_db - method.sir_db, *marks)
