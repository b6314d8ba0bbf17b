"""Figures of Pd, errors and wrong altitudes; matplotlib is imported when one is drawn.

Every figure is written as PNG, PDF and SVG; in the SVG, a tooltip shows a point's values.
"""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..results.figure import COLUMN_IN, new_figure, save_figure, say
from ..results.pareto import draw_pareto
from ..results.score import CORRECT_LIMIT_M, pool
from ..results.style import series_style
from .altitudes import ERRORS_M, groups
from .panels import Row, common, panels, series_of, spread

_PD_LABEL = f"Pd: altitude within {CORRECT_LIMIT_M:g} m"
_TWO_IN = 7.3  # width of two panels, inches: that of a page of print
_MOST_PANELS = 6  # of altitudes and of errors: altitudes.csv has all SIRs, and each panel takes 0.3 s
_GREY = {"color": "#999999", "lw": 0.8, "zorder": 0}  # lines for comparison


@dataclass(frozen=True)
class _Axis:
    """Horizontal axis: column of the rows, its name and unit in tooltips, and the label."""

    column: str
    name: str
    unit: str
    label: str


_AXES = {
    axis.column: axis
    for axis in (
        _Axis("overlap", "overlap", "", "temporal overlap of the interference"),
        _Axis("sir_db", "SIR", " dB", "SIR, averaged over the sweep / dB"),
        _Axis("altitude_m", "altitude", " m", "altitude / m"),
        _Axis("error_m", "error", " m", "error of the forced decision / m"),
    )
}


def draw_pd(
    rows: Sequence[Row],
    path: Path | None,
    *,
    title: str,
    ceiling: float | None = None,
    against: str = "overlap",
) -> Any:
    """Pd with 95 % Wilson intervals against overlap, a panel for each SIR, or against SIR, a panel for each overlap.

    ``rows``: rows of a report; a key ``series`` overrides ``method`` as the label; ``path``: PNG to write; None
    leaves the returned figure to pyplot. ``title``: title of the figure; ``ceiling``: Pd without interference and
    without mitigation, drawn as a line; ``against``: ``"overlap"`` or ``"sir_db"``.
    """

    def dress(axis: Any, mine: Sequence[Row]) -> None:
        if ceiling is not None:
            axis.axhline(ceiling, label="no interference", **_GREY)
        axis.set_ylim(-0.04, 1.04)

    measured = [row for row in rows if row["trials"]]
    note = f"{spread(measured)} trials per point, bars: 95 % Wilson intervals"
    return _draw(rows, path, against, f"{title}\n{note}", _PD_LABEL, _pd, _pd_words, dress)


def draw_error(
    rows: Sequence[Row],
    path: Path | None,
    *,
    title: str,
    bounds_m: dict[float | None, float],
    against: str = "overlap",
) -> Any:
    """RMSE of the forced decision on a logarithmic axis, with the Cramer-Rao bound by SNR; axes as in `draw_pd`."""

    def dress(axis: Any, mine: Sequence[Row]) -> None:
        bound = bounds_m.get(mine[0]["snr_db"])
        if bound:
            axis.axhline(bound, label="Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound", **_GREY)
        axis.axhline(CORRECT_LIMIT_M, ls=":", label="5 m, limit of Pd", **_GREY)
        axis.set_yscale("log")

    note = "all trials, detected or not; bars: 95 % intervals (delta method)"
    label = "RMSE, forced decision / m"
    return _draw(rows, path, against, f"{title}\n{note}", label, _error, _error_words, dress)


def draw_wrong(rows: Sequence[Row], path: Path, *, title: str, against: str = "overlap") -> Any:
    """Rate of declared altitudes with errors of 5 m or more, bars to the 95 % upper bound; axes as in `draw_pd`."""
    measured = [row for row in rows if row["trials"]]
    top = max((_number(r["wrong_bound"]) for _, mine in panels(measured, against) for r in mine), default=1.0)

    def dress(axis: Any, mine: Sequence[Row]) -> None:
        axis.set_ylim(-0.04 * top, 1.04 * top)

    note = f"declared and {CORRECT_LIMIT_M:g} m off or more; bars: 95 % upper bound (Clopper and Pearson)"
    label = "rate of wrong altitudes, per trial"
    return _draw(rows, path, against, f"{title}\n{note}", label, _wrong, _wrong_words, dress)


def draw_pd_by_altitude(rows: Sequence[Row], path: Path | None, *, title: str) -> Any:
    """Pd with 95 % Wilson intervals against altitude, over all overlaps; ``rows`` have `ALTITUDE_COLUMNS`."""
    split, left_out = _few(rows)
    figure, axes = _grid(len(split), "altitude_m", shown=path is None)
    series = list(series_of(rows))
    lowest, highest = min(r["altitude_low_m"] for r in rows), max(r["altitude_high_m"] for r in rows)
    for axis, (heading, mine) in zip(axes, split, strict=True):
        if lowest > 0:
            axis.set_xscale("log")
            axis.set_xlim(lowest / 1.3, highest * 1.3)
        for k, name in enumerate(series):
            pooled = groups((r for r in mine if r["method"] == name), "altitude_low_m")
            of = [
                row | {"altitude_m": 0.5 * (row["altitude_low_m"] + row["altitude_high_m"])}
                for _, row in sorted(pooled.items())
            ]
            x = _values(of, "altitude_m")
            tips = _tips(of, name, "altitude_m", _pd_words)
            _plot(axis, x, *_pd(of), (k, len(series)), series_style(name, series), tips)
        axis.set_title(heading, fontsize=10)
        axis.set_ylim(-0.04, 1.04)
    note = f"all overlaps above 0 together{left_out}; bars: 95 % Wilson intervals"
    return _finish(figure, axes, path, f"{title}\n{note}", _PD_LABEL)


def draw_cost(rows: Sequence[Row], path: Path) -> list[tuple[str, str]]:
    """Draw Pd against run time of several methods into a folder; returns (file, caption), none for a single method."""
    by_method = series_of(common(rows))
    points = {
        name: (float(np.median([_number(row["ms_per_frame_median"]) for row in mine])), pool(mine).pd)
        for name, mine in by_method.items()
    }
    points = {name: point for name, point in points.items() if np.isfinite(point[0])}
    if len(points) < 2:
        return []
    draw_pareto(
        points,
        path / "pd_vs_runtime.png",
        cost="CPU time of the method per frame / ms, median, in the method's batches",
        gain="Pd, all overlaps above 0",
        verb="is right most often",
    )
    return [("pd_vs_runtime.png", "Error against run time: Pd over all overlaps above 0, and time per frame")]


def _few(rows: Sequence[Row]) -> tuple[list[tuple[str, list[Row]]], str]:
    """At most `_MOST_PANELS` panels, from the first to the last in equal steps, and what a note says of the others."""
    split = panels(rows)
    at = np.linspace(0, len(split) - 1, min(len(split), _MOST_PANELS)).round().astype(int)
    left_out = f"; {len(at)} of {len(split)} panels" if len(at) < len(split) else ""
    return [split[k] for k in at], left_out


def draw_error_cdf(rows: Sequence[Row], path: Path | None, *, title: str) -> Any:
    """Distribution of the forced decision's error over trials; ``rows`` have `ALTITUDE_COLUMNS`."""
    split, left_out = _few(rows)
    figure, axes = _grid(len(split), "error_m", shown=path is None)
    series = list(series_of(rows))
    for axis, (heading, mine) in zip(axes, split, strict=True):
        axis.axvline(CORRECT_LIMIT_M, ls=":", label="5 m, limit of Pd", **_GREY)
        for k, ((name,), whole) in enumerate(groups(mine, "method").items()):
            of = [
                {"error_m": error, "count": whole[f"within_{error:g}_m"], "trials": whole["trials"]}
                for error in ERRORS_M
            ]
            share = _values(of, "count") / max(whole["trials"], 1)
            tips = _tips(of, name, "error_m", _share_words)
            _plot(axis, np.array(ERRORS_M), share, None, (k, len(series)), series_style(name, series), tips)
        axis.set_title(heading, fontsize=10)
        axis.set_xscale("log")
        axis.set_ylim(-0.04, 1.04)
    note = f"all trials, detected or not, all overlaps above 0 together{left_out}"
    return _finish(figure, axes, path, f"{title}\n{note}", "share of trials with this error or less")


def _draw(
    rows: Sequence[Row],
    path: Path | None,
    against: str,
    title: str,
    label: str,
    curve: Callable[[Sequence[Row]], tuple[np.ndarray, np.ndarray]],
    words: Callable[[Row], str],
    dress: Callable[[Any, Sequence[Row]], None],
) -> Any:
    """A panel for each value of the other axis, a curve for each series; `dress` adds scale and lines of a panel."""
    rows = [row for row in rows if row["trials"]]  # a point without a frame has no Pd
    split = panels(rows, against)
    figure, axes = _grid(len(split), against, shown=path is None)
    series, values = list(series_of(rows)), {row[against] for row in rows}
    for axis, (heading, mine) in zip(axes, split, strict=True):
        dress(axis, mine)
        by_series = series_of(mine)
        for k, name in enumerate(series):
            of = sorted(by_series.get(name, ()), key=lambda row: row[against])
            # of one value, the methods are the axis
            x = np.full(len(of), float(k)) if len(values) == 1 else _values(of, against)
            tips = _tips(of, name, against, words)
            _plot(axis, x, *curve(of), (k, len(series)), series_style(name, series), tips)
        axis.set_title(heading, fontsize=10)
    if len(values) == 1:
        (one,) = values
        axes[0].set_xticks(range(len(series)), series)  # of all panels
        for axis in axes:
            axis.tick_params(axis="x", labelrotation=40, labelsize=7)
            if axis.get_xlabel():
                axis.set_xlabel(f"methods, at {_AXES[against].name} {one:g}{_AXES[against].unit}", fontsize=9)
    elif against == "sir_db":
        axes[0].invert_xaxis()  # of all panels: interference grows to the right
    return _finish(figure, axes, path, title, label)


# -- curves: (values, lengths of the bars below and above) of rows, and their words in tooltips ---------------


def _pd(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    pd, low, high = (_values(rows, column) for column in ("pd", "pd_low", "pd_high"))
    return pd, np.clip([pd - low, high - pd], 0, None)


def _pd_words(row: Row) -> str:
    return f"Pd {row['pd']:.3f} ({row['pd_low']:.3f} to {row['pd_high']:.3f}), {row['correct']} of {row['trials']}"


def _error(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    error, low, high = (_values(rows, column) for column in ("rmse_forced_m", "rmse_low_m", "rmse_high_m"))
    return error, np.nan_to_num(np.clip([error - low, high - error], 0, None))


def _error_words(row: Row) -> str:
    ends = [row.get("rmse_low_m"), row.get("rmse_high_m")]
    text = "" if None in ends else f" ({ends[0]:.3g} to {ends[1]:.3g})"
    return f"RMSE {_number(row['rmse_forced_m']):.3g} m{text} over {row['forced']} forced decisions"


def _wrong(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    rate = np.array([(r["detections"] - r["correct"]) / max(r["trials"], 1) for r in rows])
    above = _values(rows, "wrong_bound") - rate
    return rate, np.stack([np.zeros_like(rate), np.clip(above, 0, None)])


def _wrong_words(row: Row) -> str:
    wrong = row["detections"] - row["correct"]
    return f"{wrong} wrong of {row['trials']}, rate at most {_number(row['wrong_bound']):.4f}"


def _share_words(row: Row) -> str:
    return f"{row['count']} of {row['trials']} trials within {row['error_m']:g} m"


def _values(rows: Sequence[Row], column: str) -> np.ndarray:
    return np.array([_number(row.get(column)) for row in rows], dtype=float)


def _number(value: float | None) -> float:
    return np.nan if value is None else value


# -- drawing -------------------------------------------------------------------------------------------------


def _plot(
    axis: Any,
    x: np.ndarray,
    y: np.ndarray,
    bars: np.ndarray | None,
    place: tuple[int, int],
    style: dict[str, Any],
    tips: Sequence[str],
) -> None:
    """Draw a series with its bars and tooltips; ``place`` is its number and how many there are."""
    k, count = place
    size = (6.0 if style["marker"] == "*" else 4.0) + 0.9 * (count - 1 - k)
    style_options = {"lw": 1.1, "elinewidth": 0.7, "capsize": 1.5, "ms": size, "markeredgewidth": 0.9}
    drawn = axis.errorbar(x, y, yerr=bars, zorder=3 + k, **style_options, **style)
    for part in drawn.get_children():
        part.set_gid(f"series {style['label']}")  # for the switches of report.html
    say(axis, x, y, tips)


def _tips(rows: Sequence[Row], name: str, against: str, words: Callable[[Row], str]) -> list[str]:
    quantity = _AXES[against]
    return [f"{name}\n{quantity.name} {r[against]:g}{quantity.unit}: {words(r)}" for r in rows]


def _grid(count: int, against: str, *, shown: bool) -> tuple[Any, list[Any]]:
    """A figure with ``count`` panels, two in a row: one alone is legible at 400 px."""
    columns = min(count, 2)
    lines = -(-count // columns)
    figure = new_figure(COLUMN_IN if count == 1 else _TWO_IN, 2.9 * lines + 1.5, dpi=200, shown=shown)
    axes = list(figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).flat)
    for axis in axes[count:]:
        axis.set_visible(False)
    for k, axis in enumerate(axes[:count]):
        axis.grid(True, lw=0.4, color="#DDDDDD")
        axis.set_axisbelow(True)
        # the last panel of each column has the axis labels, also if the last row is not full
        axis.tick_params(labelsize=8.5, labelbottom=k + columns >= count)
        axis.spines[["top", "right"]].set_visible(False)
        if k + columns >= count:
            axis.set_xlabel(_AXES[against].label, fontsize=9)
    return figure, axes[:count]


def _finish(figure: Any, axes: Sequence[Any], path: Path | None, title: str, ylabel: str) -> Any:
    """Add one legend below all panels, write the file, and return the figure."""
    for axis in axes:
        if len(axes) > 1:
            axis.minorticks_off()  # a third of the time of such a figure
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel(ylabel, fontsize=9)
    handles = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
    style_options = {"loc": "outside lower center", "fontsize": 8.5, "frameon": False, "handlelength": 3.4}
    for columns in (4, 3, 2, 1):  # as many as the figure is wide for
        legend = figure.legend(handles.values(), handles.keys(), ncols=columns, **style_options)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    wide = int(13 * figure.get_figwidth())  # characters of this size in a line
    figure.suptitle("\n".join(textwrap.fill(line, wide) for line in title.splitlines()), fontsize=9)
    if path is not None:
        save_figure(figure, path)
    return figure
