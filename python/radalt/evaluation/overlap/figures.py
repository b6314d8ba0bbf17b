"""Figures of Pd, errors and wrong altitudes; matplotlib is imported when one is drawn.

Every figure is written as PNG, PDF and SVG; in the SVG, a tooltip shows a point's values.
"""

import itertools
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..results.figure import COLUMN_IN, in_lines, new_figure, save_figure, say
from ..results.labels import name_curves
from ..results.pareto import draw_pareto
from ..results.score import CORRECT_LIMIT_M, pool
from ..results.style import series_style
from .altitudes import ERRORS_M, groups
from .finding import said_of_error, said_of_pd, said_of_wrong
from .panels import Row, common, panels, series_of, spread

_WIDTH_IN = {1: COLUMN_IN, 2: 7.3, 3: 7.8}  # by panels in a row: a page of print, a column of the site
_MOST_PANELS = 6  # of altitudes and of errors: altitudes.csv has all SIRs, and each panel takes 0.3 s
_GREY = {"color": "#999999", "lw": 0.8, "zorder": 0}  # lines for comparison
_LIMIT = (CORRECT_LIMIT_M, "5 m, limit of Pd", ":")
_Line = tuple[float, str, str]  # value, label and style of a line for comparison
_Split = list[tuple[str, list[Row]]]  # panels: heading and rows

_AXES = {  # horizontal axes, by column of the rows: name and unit in tooltips, label
    "overlap": ("overlap", "", "temporal overlap of the interference"),
    "sir_db": ("SIR", " dB", "SIR, averaged over the sweep / dB"),
    "altitude_m": ("altitude", " m", "altitude / m"),
    "error_m": ("error", " m", "error of the forced decision / m"),
}


class _Quantity(NamedTuple):
    """A vertical axis: label, values of rows with the ends of their bars, and the words of a row in its tooltip."""

    label: str
    columns: tuple[str, str, str]  # of the value, of the lower and of the upper end of its bar
    words: Callable[[Row], str]


def draw_pd(
    rows: Sequence[Row],
    path: Path | None,
    *,
    settings: str,
    ceiling: float | None = None,
    against: str = "overlap",
    frames: Sequence[Row] = (),
) -> Any:
    """Pd with 95 % Wilson intervals against overlap, a panel for each SIR, or against SIR, a panel for each overlap.

    ``rows``: rows of a report; a key ``series`` overrides ``method`` as the label; ``path``: PNG to write; None
    leaves the returned figure to pyplot. ``settings``: what was measured, written below; ``ceiling``: Pd without
    interference and without mitigation, drawn as a line; ``against``: ``"overlap"`` or ``"sir_db"``; ``frames``: see
    `said_of_pd`, which is the title.
    """
    rows = _measured(rows)
    titles = said_of_pd(rows, against, frames), f"{settings}\n{spread(rows)} trials per point, 95 % intervals"
    lines = [] if ceiling is None else [(ceiling, "no interference", "-")]
    return _draw(panels(rows, against), path, against, titles, _PD, lambda _: lines)


def draw_error(
    rows: Sequence[Row],
    path: Path | None,
    *,
    settings: str,
    bounds_m: dict[float | None, float],
    against: str = "overlap",
) -> Any:
    """RMSE of the forced decision on a logarithmic axis, with the Cramer-Rao bound by SNR; axes as in `draw_pd`."""

    def lines(mine: Sequence[Row]) -> list[_Line]:
        bound = bounds_m.get(mine[0]["snr_db"])
        named = bound, "Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound", "-"
        return [named, _LIMIT] if bound else [_LIMIT]

    rows = _measured(rows)
    titles = said_of_error(rows), f"{settings}\nall trials, detected or not; 95 % intervals (delta method)"
    return _draw(panels(rows, against), path, against, titles, _ERROR, lines, top=None)


def draw_wrong(rows: Sequence[Row], path: Path, *, settings: str, against: str = "overlap") -> Any:
    """Rate of declared altitudes with errors of 5 m or more, bars to the 95 % upper bound; axes as in `draw_pd`."""
    rows = [row | {"wrong": pool([row]).wrong / row["trials"]} for row in _measured(rows)]
    split = panels(rows, against)
    top = max((_number(r["wrong_bound"]) for _, mine in split for r in mine), default=1.0)
    limit = f"{CORRECT_LIMIT_M:g} m off or more"
    note = f"declared and {limit}; bars: 95 % upper bound (Clopper and Pearson)"
    return _draw(split, path, against, (said_of_wrong(rows), f"{settings}\n{note}"), _WRONG, top=top)


def draw_pd_by_altitude(rows: Sequence[Row], path: Path | None, *, title: str, settings: str) -> Any:
    """Pd with 95 % Wilson intervals against altitude, over all overlaps; ``rows`` have `ALTITUDE_COLUMNS`."""

    def pooled(mine: Sequence[Row]) -> list[Row]:
        of = groups(mine, "method", "altitude_low_m").values()
        return [r | {"altitude_m": 0.5 * (r["altitude_low_m"] + r["altitude_high_m"])} for r in of]

    split, left_out = _few(rows, pooled)
    note = f"{settings}\nall overlaps above 0 together{left_out}; 95 % intervals"
    return _draw(split, path, "altitude_m", (title, note), _PD)


def draw_error_cdf(rows: Sequence[Row], path: Path | None, *, settings: str) -> Any:
    """Distribution of the forced decision's error over trials; ``rows`` have `ALTITUDE_COLUMNS`."""

    def counted(mine: Sequence[Row]) -> list[Row]:
        return [
            whole | {"error_m": error, "share": whole[f"within_{error:g}_m"] / whole["trials"]}
            for whole, error in itertools.product(groups(mine, "method").values(), ERRORS_M)
        ]

    split, left_out = _few(rows, counted)
    note = f"{settings}\nall trials, detected or not, all overlaps above 0 together{left_out}"
    return _draw(split, path, "error_m", (said_of_error(rows), note), _SHARE)


def draw_cost(rows: Sequence[Row], path: Path, frames: Sequence[Row] = ()) -> list[tuple[str, str]]:
    """Draw Pd against run time of several methods into a folder; returns (file, caption), none for a single method."""
    points = {
        name: (float(np.median(_values(mine, "ms_per_frame_median"))), pool(mine).pd)
        for name, mine in series_of(common(rows)).items()
    }
    points = {name: point for name, point in points.items() if np.isfinite(point[0])}
    if len(points) < 2:
        return []
    draw_pareto(
        points,
        path / "pd_vs_runtime.png",
        cost="CPU time of the method per frame / ms, median, in the method's batches",
        gain="Pd, all overlaps above 0",
        title=said_of_pd(rows, frames=frames),
    )
    return [("pd_vs_runtime.png", "Error against run time: Pd over all overlaps above 0, and time per frame")]


def _measured(rows: Sequence[Row]) -> list[Row]:
    """Rows with a trial: a point without a frame has no Pd."""
    return [row for row in rows if row["trials"]]


def _few(rows: Sequence[Row], of: Callable[[Sequence[Row]], list[Row]]) -> tuple[_Split, str]:
    """At most `_MOST_PANELS` panels, from the first to the last in equal steps, and what a note says of the others."""
    split = panels(rows)
    at = np.linspace(0, len(split) - 1, min(len(split), _MOST_PANELS)).round().astype(int)
    left_out = f"; {len(at)} of {len(split)} panels" if len(at) < len(split) else ""
    return [(split[k][0], of(split[k][1])) for k in at], left_out


def _draw(
    split: _Split,
    path: Path | None,
    against: str,
    titles: tuple[str, str],
    quantity: _Quantity,
    lines: Callable[[Sequence[Row]], Sequence[_Line]] = lambda _: (),
    *,
    top: float | None = 1.0,
) -> Any:
    """A panel for each of ``split``, a curve for each series; without ``top`` the vertical axis is logarithmic.

    ``titles``: what the figure shows, and what was measured.
    """
    rows = [row for _, mine in split for row in mine]
    many = len(split) > 4 and len({row["interference"] for row in rows}) > 2
    figure, axes = _grid(len(split), against, shown=path is None, many=many)
    series, values = list(series_of(rows)), {row[against] for row in rows}
    for axis, (heading, mine) in zip(axes, split, strict=True):
        for value, label, style in lines(mine):
            axis.axhline(value, label=label, ls=style, **_GREY)
        if against == "error_m":
            axis.axvline(_LIMIT[0], label=_LIMIT[1], ls=_LIMIT[2], **_GREY)
        by_series = series_of(mine)
        for k, name in enumerate(series):
            of = sorted(by_series.get(name, ()), key=lambda row: row[against])
            # of one value, the methods are the axis
            x = np.full(len(of), float(k)) if len(values) == 1 else _values(of, against)
            _plot(axis, x, of, against, quantity, len(series) - 1 - k, series_style(name, series))
        axis.set_title(textwrap.fill(heading, 31), fontsize=9.5)
        axis.set_yscale("log") if top is None else axis.set_ylim(-0.04 * top, 1.04 * top)
    if len(values) == 1:
        (one,), (name, unit, _) = values, _AXES[against]
        axes[0].set_xticks(range(len(series)), series)  # of all panels
        for axis in axes:
            axis.tick_params(axis="x", labelrotation=40, labelsize=7.5)
            if axis.get_xlabel():
                axis.set_xlabel(f"methods, at {name} {one:g}{unit}", fontsize=9)
    elif against == "sir_db":
        axes[0].invert_xaxis()  # of all panels: interference grows to the right
    elif against != "overlap" and min(values) > 0:
        axes[0].set_xscale("log")
    return _finish(figure, axes, path, titles, quantity.label, len(values) > 1)


_PD = _Quantity(
    f"Pd: altitude within {CORRECT_LIMIT_M:g} m",
    ("pd", "pd_low", "pd_high"),
    lambda r: f"Pd {r['pd']:.3f} ({r['pd_low']:.3f} to {r['pd_high']:.3f}), {r['correct']} of {r['trials']}",
)
_ERROR = _Quantity(
    "RMSE, forced decision / m",
    ("rmse_forced_m", "rmse_low_m", "rmse_high_m"),
    lambda r: f"RMSE {_number(r['rmse_forced_m']):.3g} m{_ends(r)} over {r['forced']} forced decisions",
)
_WRONG = _Quantity(
    "rate of wrong altitudes, per trial",
    ("wrong", "wrong", "wrong_bound"),
    lambda r: f"{pool([r]).wrong} wrong of {r['trials']}, rate at most {_number(r['wrong_bound']):.4f}",
)
_SHARE = _Quantity(
    "share of trials with this error or less",
    ("share", "share", "share"),
    lambda r: f"{r['share'] * r['trials']:.0f} of {r['trials']} trials within {r['error_m']:g} m",
)


def _ends(row: Row) -> str:
    low, high = row.get("rmse_low_m"), row.get("rmse_high_m")
    return "" if low is None or high is None else f" ({low:.3g} to {high:.3g})"


def _values(rows: Sequence[Row], column: str) -> np.ndarray:
    return np.array([_number(row.get(column)) for row in rows], dtype=float)


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _plot(
    axis: Any,
    x: np.ndarray,
    rows: Sequence[Row],
    against: str,
    quantity: _Quantity,
    above: int,
    style: dict[str, Any],
) -> None:
    """Draw the rows of a series with bars and tooltips; ``above``: number of series that are drawn over it."""
    y, low, high = (_values(rows, column) for column in quantity.columns)
    bars = np.nan_to_num(np.clip([y - low, high - y], 0, None))
    size = (6.0 if style["marker"] == "*" else 4.0) + 0.9 * above
    lines = {"lw": 1.1, "elinewidth": 0.7, "capsize": 1.5, "ms": size, "markeredgewidth": 0.9}
    drawn = axis.errorbar(x, y, yerr=bars if bars.any() else None, zorder=99 - above, **lines, **style)
    for part in drawn.get_children():
        part.set_gid(f"series {style['label']}")  # for the switches of report.html
    name, unit, _ = _AXES[against]
    head = f"{style['label']}\n{name} "
    say(axis, x, y, [f"{head}{row[against]:g}{unit}: {quantity.words(row)}" for row in rows])


def _grid(count: int, against: str, *, shown: bool, many: bool) -> tuple[Any, list[Any]]:
    """A figure with ``count`` panels, two in a row, of many cases three; one alone is legible at 400 px."""
    columns = min(count, 3 if many else 2)
    lines = -(-count // columns)
    figure = new_figure(_WIDTH_IN[columns], (2.3 if many else 2.9) * lines + 1.5, dpi=200, shown=shown)
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
            axis.set_xlabel(_AXES[against][2], fontsize=9)
    return figure, axes[:count]


def _finish(
    figure: Any, axes: Sequence[Any], path: Path | None, titles: tuple[str, str], ylabel: str, names: bool
) -> Any:
    """Write title, settings below and the names of the curves, write the file, and return the figure."""
    for axis in axes:
        if len(axes) > 1:
            axis.minorticks_off()  # a third of the time of such a figure
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel(ylabel, fontsize=9)
    head, foot = titles
    figure.suptitle(in_lines(head, int(11 * figure.get_figwidth())), fontsize=10.5)
    wide = int(14 * figure.get_figwidth())  # characters of this size in a line
    figure.supxlabel("\n".join(textwrap.fill(line, wide) for line in foot.splitlines()), fontsize=8.5)
    if names:
        name_curves(figure, axes, size=8.5 if len(axes) < 5 else 7.5)
    if path is not None:
        save_figure(figure, path)
    return figure
