"""Error against run time: decibels held, wrong altitudes and cost of every entry."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.proportion import clopper_pearson_bound
from ...evaluation.results.style import series_style
from ...evaluation.results.table import table
from ..paired import curves, held
from ..rows import Row

_LEVELS = 3  # of a case from which decibels are held: two are points, not a curve


def summaries(
    rows: Sequence[Row], entries: Sequence[str], turns: Sequence[Mapping[str, Any]] = ()
) -> dict[str, dict[str, float]]:
    """By entry: decibels held (mean over cases), wrong and valid, trials, milliseconds and FFTs per frame (medians).

    Costs are those of ``turns``, where an entry took turns. Wrong altitudes are counted at the levels that every entry
    ran: an entry that stops early has the easy ones only.
    """
    found, out = curves(rows), {}
    timed = {row["entry"] for row in turns}
    ran = [{_level(row) for row in rows if row["entry"] == name} for name in entries]
    common = set.intersection(*ran)
    for name in entries:
        mine = [row for row in rows if row["entry"] == name]
        each = [held(by[name]) for by in found.values() if len(by.get(name, ())) >= _LEVELS]
        cost = [row for row in turns if row["entry"] == name] if name in timed else mine
        out[name] = {
            "held_db": float(np.mean(each)) if each else float("nan"),
            "wrong": float(sum(row["detections"] - row["correct"] for row in mine if _level(row) in common)),
            "trials": float(sum(row["trials"] for row in mine if _level(row) in common)),
            **{key: float(np.median([row[key] or np.nan for row in cost])) for key in ("ms", "ffts")},
        }
    return out


def _level(row: Row) -> tuple[str, float, float | None, float | None]:
    return row["case"], row["overlap"], row["sir_db"], row["snr_db"]


def turns_table(turns: Sequence[Mapping[str, Any]]) -> str:
    """Cost of entries that took turns: the mean over the cases of the medians, the most, memory and start-up."""
    lines = []
    for name in dict.fromkeys(row["entry"] for row in turns):
        mine = [row for row in turns if row["entry"] == name]
        ms, ffts = (f"{np.mean([row[key] for row in mine]):.3g}" for key in ("ms", "ffts"))
        most = max(row["ffts_p99"] for row in mine)
        memory, model = (f"{mine[0][key] / 2**20:.1f}" for key in ("memory_bytes", "model_bytes"))
        lines.append([name, ms, ffts, f"{most:.0f}", memory, f"{mine[0]['start_ms']:.0f}", model])
    head = [
        "entry",
        "ms per frame",
        "FFTs",
        "99 %, largest of cases",
        "memory / MiB",
        "start / ms",
        "model / MiB",
    ]
    return table(head, lines)


def summary_table(summary: Mapping[str, Mapping[str, float]]) -> str:
    """The entries, those that hold most first."""
    order = sorted(summary, key=lambda name: -np.nan_to_num(summary[name]["held_db"], nan=-1e9))
    lines = []
    for name in order:
        s = summary[name]
        wrong, trials = int(s["wrong"]), int(s["trials"])
        bound = clopper_pearson_bound(wrong, trials)
        lines.append(
            [
                name,
                f"{s['held_db']:.1f}",
                f"{wrong} of {trials}",
                f"{bound:.2g}",
                "" if np.isnan(s["ms"]) else f"{s['ms']:.2f}",
                "" if np.isnan(s["ffts"]) else f"{s['ffts']:.0f}",
            ]
        )
    head = ["entry", "held / dB", "wrong and valid", "95 % bound", "ms per frame", "FFTs per frame"]
    return table(head, lines)


def pareto(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Names on the front of (cost, gain), in the order of cost: no other entry is cheaper and better."""
    front, best = [], -np.inf
    for name in sorted(points, key=lambda name: points[name]):
        if points[name][1] > best:
            front.append(name)
            best = points[name][1]
    return front


def draw_pareto(summary: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """Decibels held against cost per frame, every entry named, with the front."""
    points = {
        name: (s["ffts"], s["held_db"])
        for name, s in summary.items()
        if np.isfinite(s["held_db"] + s["ffts"])
    }
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    front = pareto(points)
    if points:
        axis.plot(
            *zip(*(points[name] for name in front), strict=True),
            color="0.7",
            drawstyle="steps-post",
            zorder=1,
        )
        axis.set_title(f"{front[-1]} holds most; on the line no other is cheaper and better", fontsize=11)
    for name, point in points.items():
        style = series_style(name, tuple(points))
        axis.plot(*point, style["marker"], color=style["color"], ms=7)
    axis.set_xscale("log")
    ticks = [
        t
        for t in (10, 20, 30, 50, 100, 200, 300, 500, 1000)
        if not points or t < 3 * max(x for x, _ in points.values())
    ]
    axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.set(
        xlabel="CPU per frame, method and altimeter, one at a time / FFTs of the frame",
        ylabel="held / dB, mean of cases",
    )
    axis.margins(x=0.2, y=0.12)
    axis.grid(alpha=0.3)
    _name_points(figure, axis, points)
    save_figure(figure, path)


def _name_points(figure: Any, axis: Any, points: Mapping[str, tuple[float, float]]) -> None:
    """Names next to their points, each at the first place where it covers no other name and no point."""
    figure.draw_without_rendering()
    axis.set_autoscale_on(False)
    dots = axis.transData.transform(list(points.values())) if points else []
    taken: list[Any] = []
    places = [
        (x, y, side)
        for y in (5, -13, 17, -25, 29, -37)
        for x, side in ((-6, "right"), (6, "left"), (0, "center"))
    ]
    for name in sorted(points, key=lambda name: points[name]):
        for x, y, side in places:
            text = axis.annotate(
                name, points[name], xytext=(x, y), textcoords="offset points", fontsize=9, ha=side
            )
            box = text.get_window_extent()
            if not (any(box.overlaps(other) for other in taken) or box.count_contains(dots)):
                break
            if (x, y, side) != places[-1]:
                text.remove()
        taken.append(box)
