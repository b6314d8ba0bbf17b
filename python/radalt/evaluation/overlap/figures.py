"""Figures of Pd, errors and wrong altitudes; matplotlib is imported when one is drawn.

Colours are Okabe and Ito's, distinguishable with any colour vision; marker, filling and line style distinguish the
methods in grey as well. Every figure is written as PNG, PDF and SVG; in the SVG, a tooltip shows a point's values.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.mitigation import CUSTOM, METHODS, PlotStyle, method_class
from ..results.figure import new_figure, save_figure, say
from ..results.score import CORRECT_LIMIT_M
from .altitudes import ERRORS_M, groups

__all__ = [
    "draw_error",
    "draw_error_cdf",
    "draw_pd",
    "draw_pd_by_altitude",
    "draw_wrong",
    "panels",
    "series_style",
]

# for methods without a registered style
_RESERVE = (
    PlotStyle("#666666", "X", "--"),
    PlotStyle("#8C6D1F", "<", "-."),
    PlotStyle("#5D3A9B", ">", ":"),
    PlotStyle("#A0A0A0", "h", "-"),
)
_AXES = {
    "overlap": "temporal overlap of the interference",
    "sir_db": "SIR, averaged over the sweep / dB",
    "altitude_m": "altitude / m",
    "error_m": "error of the forced decision / m",
}
_NAMES = {
    "overlap": ("overlap", ""),
    "sir_db": ("SIR", " dB"),
    "altitude_m": ("altitude", " m"),
    "error_m": ("error", " m"),
}
_WIDTH = 3.5  # width of a panel, inches: the column of a two-column page


def series_style(series: str, order: Sequence[str]) -> dict[str, Any]:
    """Line style of one series (a method, or ``method, on the air``), equal in all figures."""
    method = series.split(",")[0]
    style = _style(method)
    if style is None:
        plain = [name for name in dict.fromkeys(o.split(",")[0] for o in order) if _style(name) is None]
        style = _RESERVE[plain.index(method) % len(_RESERVE)]
    colour = style.colour
    solid = series != method
    return {
        "color": colour,
        "marker": style.marker,
        "linestyle": style.line,
        "markerfacecolor": colour if solid else "white",
        "markeredgecolor": colour,
        "label": series,
    }


def _style(method: str) -> PlotStyle | None:
    return method_class(method).style if method in (*METHODS, CUSTOM) else None


def panels(
    rows: Sequence[dict[str, Any]], against: str = "overlap"
) -> list[tuple[str, list[dict[str, Any]]]]:
    """Rows grouped by all values but the horizontal axis, with titles of what differs between panels.

    Parameters
    ----------
    rows : sequence of dict
    against : str
        ``"overlap"`` or ``"sir_db"``; for the latter rows without interference are left out.
    """
    other = "sir_db" if against == "overlap" else "overlap"
    names = ("interference", other, "snr_db")
    rows = [r for r in rows if against == "overlap" or (r["overlap"] > 0 and r["sir_db"] is not None)]
    keys = list(dict.fromkeys(tuple(r[n] for n in names) for r in rows))
    many = [len({key[k] for key in keys}) > 1 for k in range(3)]
    out = []
    for key in keys:
        interference, middle, snr = key
        name = "no interference" if interference == "none" else interference.replace("_", " ")
        parts = [name] if many[0] or middle is None else []
        if middle is not None:
            parts += [f"SIR {_minus(middle)} dB" if other == "sir_db" else f"overlap {middle:g}"]
        parts += [f"SNR {_minus(snr)} dB" if snr is not None else "no noise"] if many[2] else []
        out.append((", ".join(parts), [r for r in rows if tuple(r[n] for n in names) == key]))
    return out


def _minus(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def draw_pd(
    rows: Sequence[dict[str, Any]],
    path: Path | None,
    *,
    title: str,
    ceiling: float | None = None,
    against: str = "overlap",
) -> Any:
    """Pd with 95 % Wilson intervals against overlap, a panel for each SIR, or against SIR, a panel for each overlap.

    Parameters
    ----------
    rows : sequence of dict
        Rows of a report; a key ``series`` overrides ``method`` as the label.
    path : Path or None
        PNG to write; None leaves the returned figure to pyplot.
    title : str
        Title of the figure.
    ceiling : float, optional
        Pd without interference and without mitigation, drawn as a line.
    against : str
        ``"overlap"`` or ``"sir_db"``.
    """
    rows = [row for row in rows if row["trials"]]  # a point without a frame has no Pd
    split = panels(rows, against)
    figure, axes = _grid(len(split), against, shown=path is None)
    series = _series(rows)
    for axis, (heading, mine) in zip(axes, split, strict=True):
        if ceiling is not None:
            axis.axhline(ceiling, color="#999999", lw=0.8, zorder=0, label="no interference")
        for k, name in enumerate(series):
            of = _sorted(mine, name, against)
            pd, low, high = (np.array([_number(r[c]) for r in of]) for c in ("pd", "pd_low", "pd_high"))
            error = np.clip([pd - low, high - pd], 0, None)
            x = _across(of, mine, against, k, len(series))
            style = series_style(name, series)
            _plot(axis, x, pd, error, k, style)
            _say(axis, x, pd, style, of, against, _pd_words)
        axis.set_title(heading, fontsize=10)
        axis.set_ylim(-0.04, 1.04)
    label = f"Pd: altitude within {CORRECT_LIMIT_M:g} m"
    trials = sorted({r["trials"] for r in rows})
    count = f"{trials[0]}" if len(trials) == 1 else f"{trials[0]}\N{EN DASH}{trials[-1]}"
    note = f"{count} trials per point, bars: 95 % Wilson intervals; series set side by side at each value"
    return _finish(figure, axes, path, f"{title}\n{note}", label)


def draw_error(
    rows: Sequence[dict[str, Any]],
    path: Path | None,
    *,
    title: str,
    bounds_m: dict[float | None, float],
    against: str = "overlap",
) -> Any:
    """RMSE of the forced decision on a logarithmic axis, with the Cramer-Rao bound by SNR; axes as in `draw_pd`."""
    rows = [row for row in rows if row["trials"]]  # a point without a frame has no Pd
    split = panels(rows, against)
    figure, axes = _grid(len(split), against, shown=path is None)
    series = _series(rows)
    for axis, (heading, mine) in zip(axes, split, strict=True):
        bound = bounds_m.get(mine[0]["snr_db"])
        if bound:
            axis.axhline(
                bound,
                color="#999999",
                lw=0.8,
                zorder=0,
                label="Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound",
            )
        axis.axhline(CORRECT_LIMIT_M, color="#999999", lw=0.8, ls=":", zorder=0, label="5 m, limit of Pd")
        for k, name in enumerate(series):
            of = _sorted(mine, name, against)
            error = np.array([_number(r["rmse_forced_m"]) for r in of])
            ends = [[_number(r.get(c)) for r in of] for c in ("rmse_low_m", "rmse_high_m")]
            bars = np.nan_to_num(np.clip([error - ends[0], ends[1] - error], 0, None))
            x = _across(of, mine, against, k, len(series))
            style = series_style(name, series)
            _plot(axis, x, error, bars, k, style)
            _say(axis, x, error, style, of, against, _error_words)
        axis.set_title(heading, fontsize=10)
        axis.set_yscale("log")
    note = "all trials, detected or not; bars: 95 % intervals (delta method)"
    return _finish(figure, axes, path, f"{title}\n{note}", "RMSE, forced decision / m")


def draw_pd_by_altitude(rows: Sequence[dict[str, Any]], path: Path | None, *, title: str) -> Any:
    """Pd with 95 % Wilson intervals against altitude, over all overlaps; ``rows`` have `ALTITUDE_COLUMNS`."""
    split = panels(rows)
    figure, axes = _grid(len(split), "altitude_m", shown=path is None)
    series = _series(rows)
    lowest, highest = min(r["altitude_low_m"] for r in rows), max(r["altitude_high_m"] for r in rows)
    for axis, (heading, mine) in zip(axes, split, strict=True):
        if lowest > 0:
            axis.set_xscale("log")
            axis.set_xlim(lowest / 1.3, highest * 1.3)
        for k, name in enumerate(series):
            of = sorted(
                groups((r for r in mine if r["method"] == name), "altitude_low_m").values(),
                key=lambda r: r["altitude_low_m"],
            )
            of = [r | {"altitude_m": 0.5 * (r["altitude_low_m"] + r["altitude_high_m"])} for r in of]
            pd, low, high = (np.array([_number(r[c]) for r in of]) for c in ("pd", "pd_low", "pd_high"))
            # side by side on a logarithmic axis
            x = _values(of, "altitude_m") * 1.02 ** (k - (len(series) - 1) / 2)
            style = series_style(name, series)
            _plot(axis, x, pd, np.clip([pd - low, high - pd], 0, None), k, style)
            _say(axis, x, pd, style, of, "altitude_m", _pd_words)
        axis.set_title(heading, fontsize=10)
        axis.set_ylim(-0.04, 1.04)
    note = (
        "all overlaps above 0 together; bars: 95 % Wilson intervals; series set side by side at each altitude"
    )
    return _finish(figure, axes, path, f"{title}\n{note}", f"Pd: altitude within {CORRECT_LIMIT_M:g} m")


def draw_error_cdf(rows: Sequence[dict[str, Any]], path: Path | None, *, title: str) -> Any:
    """Distribution of the forced decision's error over trials; ``rows`` have `ALTITUDE_COLUMNS`."""
    split = panels(rows)
    figure, axes = _grid(len(split), "error_m", shown=path is None)
    series = _series(rows)
    for axis, (heading, mine) in zip(axes, split, strict=True):
        axis.axvline(CORRECT_LIMIT_M, color="#999999", lw=0.8, ls=":", zorder=0, label="5 m, limit of Pd")
        for k, (name, whole) in enumerate((n, g) for (n,), g in groups(mine, "method").items()):
            counts = [whole[f"within_{error:g}_m"] for error in ERRORS_M]
            share = np.array(counts) / max(whole["trials"], 1)
            style = series_style(name, series)
            _plot(axis, np.array(ERRORS_M), share, None, k, style)
            of = [
                {"error_m": e, "count": c, "trials": whole["trials"]}
                for e, c in zip(ERRORS_M, counts, strict=True)
            ]
            _say(axis, np.array(ERRORS_M), share, style, of, "error_m", _share_words)
        axis.set_title(heading, fontsize=10)
        axis.set_xscale("log")
        axis.set_ylim(-0.04, 1.04)
    note = "all trials, detected or not, all overlaps above 0 together"
    return _finish(figure, axes, path, f"{title}\n{note}", "share of trials with this error or less")


def _share_words(row: dict[str, Any]) -> str:
    return f"{row['count']} of {row['trials']} trials within {row['error_m']:g} m"


def draw_wrong(rows: Sequence[dict[str, Any]], path: Path, *, title: str, against: str = "overlap") -> Any:
    """Rate of declared altitudes with errors of 5 m or more, bars to the 95 % upper bound; axes as in `draw_pd`."""
    rows = [row for row in rows if row["trials"]]  # a point without a frame has no Pd
    split = panels(rows, against)
    figure, axes = _grid(len(split), against, shown=path is None)
    series = _series(rows)
    top = max((_number(r["wrong_bound"]) for _, mine in split for r in mine), default=1.0)
    for axis, (heading, mine) in zip(axes, split, strict=True):
        for k, name in enumerate(series):
            of = _sorted(mine, name, against)
            rate = np.array([(r["detections"] - r["correct"]) / max(r["trials"], 1) for r in of])
            above = np.array([_number(r["wrong_bound"]) for r in of]) - rate
            x = _across(of, mine, against, k, len(series))
            style = series_style(name, series)
            _plot(axis, x, rate, np.stack([np.zeros_like(rate), np.clip(above, 0, None)]), k, style)
            _say(axis, x, rate, style, of, against, _wrong_words)
        axis.set_title(heading, fontsize=10)
        axis.set_ylim(-0.04 * top, 1.04 * top)
    note = f"declared and {CORRECT_LIMIT_M:g} m off or more; bars: 95 % upper bound (Clopper and Pearson)"
    return _finish(figure, axes, path, f"{title}\n{note}", "rate of wrong altitudes, per trial")


def _pd_words(row: dict[str, Any]) -> str:
    return f"Pd {row['pd']:.3f} ({row['pd_low']:.3f} to {row['pd_high']:.3f}), {row['correct']} of {row['trials']}"


def _error_words(row: dict[str, Any]) -> str:
    ends = [row.get("rmse_low_m"), row.get("rmse_high_m")]
    text = "" if None in ends else f" ({ends[0]:.3g} to {ends[1]:.3g})"
    return f"RMSE {_number(row['rmse_forced_m']):.3g} m{text} over {row['forced']} forced decisions"


def _wrong_words(row: dict[str, Any]) -> str:
    wrong = row["detections"] - row["correct"]
    return f"{wrong} wrong of {row['trials']}, rate at most {_number(row['wrong_bound']):.4f}"


def _say(
    axis: Any,
    x: np.ndarray,
    y: np.ndarray,
    style: dict[str, Any],
    rows: Sequence[dict[str, Any]],
    against: str,
    words: Any,
) -> None:
    """Add the tooltips of a series to the SVG."""
    name, unit = _NAMES[against]
    say(axis, x, y, [f"{style['label']}\n{name} {r[against]:g}{unit}: {words(r)}" for r in rows])


def _series(rows: Sequence[dict[str, Any]]) -> list[str]:
    return list(dict.fromkeys(r.get("series", r["method"]) for r in rows))


def _sorted(rows: Sequence[dict[str, Any]], series: str, against: str) -> list[dict[str, Any]]:
    return sorted((r for r in rows if r.get("series", r["method"]) == series), key=lambda r: r[against])


def _values(rows: Sequence[dict[str, Any]], column: str) -> np.ndarray:
    return np.array([r[column] for r in rows], dtype=float)


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _across(
    of: Sequence[dict[str, Any]], mine: Sequence[dict[str, Any]], against: str, k: int, count: int
) -> np.ndarray:
    """Positions of the points of series ``k``: beside the others', within the range of the axis."""
    x = _values(of, against) + _dodge(mine, against, k, count)
    return np.clip(x, 0.0, 1.0) if against == "overlap" else x


def _dodge(rows: Sequence[dict[str, Any]], against: str, k: int, count: int) -> float:
    """Horizontal shift of one series, so that bars and markers of equal Pd are side by side."""
    values = sorted({r[against] for r in rows})
    spacing = min(np.diff(values), default=0.1)
    return (k - (count - 1) / 2) * min(0.7 * spacing, 0.1 * (values[-1] - values[0]) or 0.1) / max(count, 2)


def _plot(axis: Any, x: np.ndarray, y: np.ndarray, error: Any, k: int, style: dict[str, Any]) -> None:
    size = 6.5 if style["marker"] == "*" else 4.2
    axis.errorbar(
        x,
        y,
        yerr=error,
        lw=1.1,
        elinewidth=0.7,
        capsize=1.5,
        ms=size,
        markeredgewidth=0.9,
        zorder=3 + k,
        **style,
    )


def _grid(count: int, against: str, *, shown: bool) -> tuple[Any, list[Any]]:
    """An Agg figure with ``count`` panels, at most three in a row."""
    columns = min(count, 3)
    lines = -(-count // columns)
    figure = new_figure(max(_WIDTH * columns, 5.0) + 0.3, 2.9 * lines + 1.5, dpi=200, shown=shown)
    axes = list(figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).flat)
    for axis in axes[count:]:
        axis.set_visible(False)
    for k, axis in enumerate(axes[:count]):
        axis.grid(True, lw=0.4, color="#DDDDDD")
        axis.set_axisbelow(True)
        # the last panel of each column has the axis labels, also if the last row is not full
        axis.tick_params(labelsize=8, labelbottom=k + columns >= count)
        axis.spines[["top", "right"]].set_visible(False)
        if k + columns >= count:
            axis.set_xlabel(_AXES[against], fontsize=9)
    return figure, axes[:count]


def _finish(figure: Any, axes: Sequence[Any], path: Path | None, title: str, ylabel: str) -> Any:
    """Add one legend below all panels, write the file, and return the figure."""
    for axis in axes:
        if axis.get_subplotspec().is_first_col():
            axis.set_ylabel(ylabel, fontsize=9)
    handles = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=4,
        fontsize=7.5,
        frameon=False,
        handlelength=3.4,
    )
    wide = int(13 * figure.get_figwidth())  # characters of this size in a line
    figure.suptitle("\n".join(textwrap.fill(line, wide) for line in title.splitlines()), fontsize=9)
    if path is not None:
        save_figure(figure, path)
    return figure
