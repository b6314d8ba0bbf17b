"""Results by altitude: rows of altitudes.csv, distribution of errors, and intervals of RMSE."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ...core.scene import Scene
from ..results.rows import WHOLE, Columns, grouped
from ..results.score import SCORE_COLUMNS, pool, score_frames, trials_of
from .points import OverlapPoint
from .rows import POINT, place_of

# upper limits of the error's distribution, m
ERRORS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_WITHIN = tuple(f"within_{error:g}_m" for error in ERRORS_M)
_MOST_ALTITUDES, _BANDS = 30, 10  # above this number of altitudes (a landing) they are pooled into bands
_Z = 1.959964  # two-sided 95 % quantile of the normal distribution

ALTITUDE_COLUMNS = Columns(
    names=(
        *POINT,
        "altitude_low_m",
        "altitude_high_m",
        *SCORE_COLUMNS,
        "pd_3pct",
        *_WITHIN,
        "fourth_forced_m4",
    ),
    whole=WHOLE | {*_WITHIN},
)


def altitude_rows(scene: Scene, point: OverlapPoint, results: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """A row per method and altitude of one point, from the altimeters' results by method.

    ``within_X_m`` counts trials with an error of the forced decision of at most X metres, ``fourth_forced_m4`` is the
    mean fourth power of this error.
    """
    heights = np.unique(scene.altitude.programme.altitudes_m)
    bands = np.array_split(heights, _BANDS) if heights.size > _MOST_ALTITUDES else [[h] for h in heights]
    out = []
    for method, frames in results.items():
        trials, truth_m = trials_of(frames, scene.altitude.programme)
        for band in bands:
            mine = (truth_m >= band[0]) & (truth_m <= band[-1])
            off = np.abs(trials["forced_altitude_m"][mine] - truth_m[mine])
            off = off[np.isfinite(off)]
            values = {
                **place_of(method, scene.interference_name, point),
                "altitude_low_m": band[0],
                "altitude_high_m": band[-1],
                **score_frames(trials[mine], truth_m[mine]).row(),
                **{name: int((off <= error).sum()) for name, error in zip(_WITHIN, ERRORS_M, strict=True)},
                "fourth_forced_m4": float(np.mean(off**4)) if off.size else None,
            }
            out.append(ALTITUDE_COLUMNS.row(values))
    return out


def pool_altitudes(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Pooled row of several rows: sums of counts, weighted means, new intervals; other values of the first row."""
    forced = sum(r["forced"] for r in rows)
    fourth = sum(r["forced"] * r["fourth_forced_m4"] for r in rows if r["forced"])
    return (
        dict(rows[0])
        | pool(rows).row()
        | {name: sum(r[name] for r in rows) for name in _WITHIN}
        | {"fourth_forced_m4": fourth / forced if forced else None}
    )


def groups(rows: Iterable[dict[str, Any]], *names: str) -> dict[Any, dict[str, Any]]:
    """Pooled rows, by values of the named columns as `grouped`."""
    return {key: pool_altitudes(same) for key, same in grouped(rows, *names).items()}


def rmse_interval(row: dict[str, Any]) -> tuple[float, float]:
    """95 % interval of the forced RMSE in metres; NaN without a forced decision.

    The variance of the mean square error follows from that of the squared error over frames (delta method on the
    logarithm, which keeps the interval above zero). Errors of false peaks have long tails: with only a few of them
    the interval is too narrow.
    """
    n, fourth = row["forced"], row["fourth_forced_m4"]
    if not n or fourth is None:
        return math.nan, math.nan
    square = row["rmse_forced_m"] ** 2
    if square == 0:
        return 0.0, 0.0
    # the standard error of the root's logarithm is half the mean square's
    spread = _Z * 0.5 * math.sqrt(max(fourth - square**2, 0.0) / n) / square
    return row["rmse_forced_m"] * math.exp(-spread), row["rmse_forced_m"] * math.exp(spread)


def with_intervals(
    rows: Sequence[dict[str, Any]], altitudes: Iterable[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Rows of the study with ``rmse_low_m`` and ``rmse_high_m``, if there are rows by altitude."""
    known = groups(altitudes, *POINT)
    out = []
    for row in rows:
        whole = known.get(tuple(row[name] for name in POINT))
        if whole is not None:
            numbers = zip(("rmse_low_m", "rmse_high_m"), rmse_interval(whole), strict=True)
            row = row | {name: value if math.isfinite(value) else None for name, value in numbers}
        out.append(row)
    return out
