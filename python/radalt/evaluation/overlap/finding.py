"""What rows say in a sentence: the titles of the figures, and the lead that the report's first line names."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..results.break_point import BREAK_PD, BreakPoint, break_point_of, leaders
from ..results.proportion import paired_difference
from ..results.rows import grouped, unbits
from ..results.score import Score, pool
from ..results.table import DASH, listed, metres, said
from .panels import Row, common, panels, series_of

_LESSER_PD = 0.5  # level of a break-point where nothing reaches `BREAK_PD`, as over extended ground


def by_pd(rows: Sequence[Row]) -> list[str]:
    """The rows' series, that with the highest Pd over all rows first."""
    totals = {name: pool(mine).pd for name, mine in series_of(rows).items()}
    return sorted(totals, key=lambda name: -totals[name])


def paired(rows: Sequence[Row], one: str, other: str) -> tuple[int, float, float, float] | None:
    """Frames that two series share, and the difference of their Pd on these with its 95 % interval; None without any.

    Rows of a point and a seed have the same frames; on the air, where none comes twice, those of one ``run``.
    """
    some = ({"run": None, "series": row["method"]} | row for row in rows if row.get("right"))
    points = grouped(some, "interference", "overlap", "sir_db", "snr_db", "seed", "trials", "run").values()
    at_points = ({row["series"]: row for row in mine} for mine in points)
    both = [(at[one], at[other]) for at in at_points if one in at and other in at]
    if not both:
        return None
    ours, theirs = (
        np.concatenate([unbits(r["right"], r["trials"]) for r in side]) for side in zip(*both, strict=True)
    )
    return ours.size, *paired_difference(ours, theirs)


def lead(rows: Sequence[Row]) -> tuple[list[str], str | None]:
    """The series that share the lead in Pd, the highest first, and the next one, which differs from the highest.

    Two differ by the 95 % interval of their difference on the frames of both; without such frames, by Wilson's.
    """
    best, *others = by_pd(rows)
    of, first = series_of(rows), [best]
    for name in others:
        found = paired(rows, best, name)
        apart = pool(of[best]).interval[0] > pool(of[name]).interval[1] if found is None else found[2] > 0
        if apart:
            return first, name
        first.append(name)
    return first, None


def most_wrong(rows: Sequence[Row]) -> tuple[Score, list[str]]:
    """The score of the series with the most wrong and valid altitudes, and their names; no name where all are equal."""
    totals = {name: pool(mine) for name, mine in series_of(rows).items()}
    total = max(totals.values(), key=lambda score: score.wrong)
    worst = [name for name, score in totals.items() if score.wrong == total.wrong]
    return total, worst if len(worst) < max(2, len(totals)) else []


def said_of_wrong(rows: Sequence[Row]) -> str:
    """Which series has the most wrong and valid altitudes."""
    total, worst = most_wrong(common(rows))
    if not total.wrong:
        return f"No altitude called valid is wrong, of {total.trials} trials of each method"
    who = f"{said(worst, 'has', 'have')} the most" if worst else "All methods have equally many"
    return f"{who} wrong altitudes called valid: {total.wrong} of {total.trials}"


def said_of_error(rows: Sequence[Row]) -> str:
    """Which series err least, all that three digits do not tell apart."""
    errors = {name: metres(pool(mine).rmse_forced_m) for name, mine in series_of(common(rows)).items()}
    least = min(errors.values(), key=lambda error: float("inf") if error == DASH else float(error))
    best = [name for name, error in errors.items() if error == least]
    return f"{said(best, 'errs least', 'err least')}: by {least} m rms{_without(errors, best, ' m')}"


def said_of_pd(
    rows: Sequence[Row], against: str = "overlap", frames: Sequence[Row] = (), mark: str = ""
) -> str:
    """Which series lead in Pd; against the SIR, how far down the furthest ones hold it, and `none`.

    ``frames``: rows of single runs, with a bit per frame, where ``rows`` are pooled; ``mark``: around names.
    """
    if against == "sir_db" and len({row["sir_db"] for row in rows} - {None}) > 2:
        return _said_of_reach(rows)
    rows = common(frames or rows)
    best, after = lead(rows)
    shares = {name: f"{pool(mine).pd:.3f}" for name, mine in series_of(rows).items()}
    each = listed(list(dict.fromkeys(shares[name] for name in best)))
    named = [f"{mark}{name}{mark}" for name in best]
    if len(shares) == 1:
        return f"{named[0]}: Pd {each}"
    if after is None:
        return f"{listed(named)} do not differ: Pd {each}"
    return f"{said(named, 'is', 'are')} right most often: Pd {each}{_without(shares, best)}"


def _said_of_reach(rows: Sequence[Row]) -> str:
    for level in (BREAK_PD, _LESSER_PD):
        curves = (series_of(mine).items() for _, mine in panels(rows, "sir_db"))
        found = [{name: break_point_of(of, level=level) for name, of in by} for by in curves]
        if any(at.mark != ">=" for by in found for at in by.values()):
            break
    else:
        return f"No method holds Pd {level:g} at any level"
    best, most, each = leaders(found)
    reach = _range(
        [by[name] for by, first in zip(found, each, strict=True) for name in best if name in first]
    )
    lesser = f"No method holds Pd {BREAK_PD:g}. " * (level != BREAK_PD)
    if len(best) == len({name for by in found for name in by}) > 1:
        return f"{lesser}No method differs: Pd {level:g} down to {reach}"
    where = f" furthest, or as far, in {most} of {len(found)} panels:" * (len(found) > 1)
    none = [by["none"] for by in found if "none" in by]
    without = _without({"none": f"to {_range(none)}"}, best) if none else ""
    return f"{lesser}{said(best, 'holds', 'hold')} Pd {level:g}{where} down to {reach}{without}"


def _without(values: Mapping[str, str], best: Sequence[str], unit: str = "") -> str:
    """What `none` has, where it is not among the best."""
    return f"; none {values['none']}{unit}" if "none" in values and "none" not in best else ""


def _range(ends: Sequence[BreakPoint]) -> str:
    """Break-points in words, from the first to break to the last; open ends are so named."""
    first, *_, last = 2 * sorted(ends, key=lambda at: -at.sir_db)
    named = dict.fromkeys(f"{at.sir_db:.0f}".replace("-", "\N{MINUS SIGN}") for at in (first, last))
    return f"{'above ' * (first.mark == '>=')}{' … '.join(named)} dB{' or lower' * (last.mark == '<=')}"
