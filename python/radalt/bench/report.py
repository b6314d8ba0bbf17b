"""Views of a run's rows: break-points, wrong altitudes, and error against run time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..evaluation.results.break_point import break_point_of
from ..evaluation.results.figure import new_figure, save_figure
from ..evaluation.results.page import write_result
from ..evaluation.results.proportion import clopper_pearson_bound
from ..evaluation.results.style import series_style
from ..evaluation.results.table import table
from .paired import curves, held_db
from .rows import Row

if TYPE_CHECKING:
    from ..evaluation.engine.study import Run
    from ..evaluation.results.folder import RunFolder
    from .study import BenchStudy

_LEAST_FRAMES = 36  # frames below which no Pd can be shown to be 0.9: 36 of 36 have a lower bound of 0.904


def write_report(
    folder: "RunFolder", study: "BenchStudy", tables: Mapping[str, list[Row]], run: "Run"
) -> Path:
    """Write report.md, report.html, report.json and the figure; returns the page."""
    rows, entries = tables["rows"], [entry.name for entry in study.entries]
    summary = summaries(rows, entries)
    draw_pareto(summary, folder.path / "error_vs_runtime.png")
    values = {
        "title": study.cases.title or study.cases.name,
        "breaks": break_points(rows, entries),
        "summary": summary_table(summary),
        "digest": study.cases.digest,
    }
    template = Path(__file__).with_name("report.md.j2")
    return write_result(folder, template, run.as_dict(), {"summary": summary}, values)


def break_points(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """A table of break-points with their intervals, a line per case; too few frames give no break-point."""
    lines = []
    for (case, overlap), by in curves(rows).items():
        cells = []
        for name in entries:
            found = by.get(name)
            if not found or found[0]["trials"] < _LEAST_FRAMES:
                cells.append("")
                continue
            at = break_point_of(found)
            cells.append(f"{at} ({at.low_db:.1f} to {at.high_db:.1f})")
        lines.append([case, f"{overlap:g}", *cells])
    return table(["case", "overlap", *entries], lines)


def summaries(rows: Sequence[Row], entries: Sequence[str]) -> dict[str, dict[str, float]]:
    """By entry: decibels held (mean over cases), wrong and valid, trials, milliseconds and FFTs per frame (medians).

    Wrong altitudes are counted at the levels that every entry ran: an entry that stops early has the easy ones only.
    """
    found, out = curves(rows), {}
    ran = [{_level(row) for row in rows if row["entry"] == name} for name in entries]
    common = set.intersection(*ran)
    for name in entries:
        mine = [row for row in rows if row["entry"] == name]
        held = [
            float(held_db(by[name], np.arange(by[name][0]["trials"])[None], _step(by[name]))[0])
            for by in found.values()
            if name in by
        ]
        out[name] = {
            "held_db": float(np.mean(held)) if held else float("nan"),
            "wrong": float(sum(row["detections"] - row["correct"] for row in mine if _level(row) in common)),
            "trials": float(sum(row["trials"] for row in mine if _level(row) in common)),
            "ms": float(np.median([row["ms"] for row in mine])),
            "ffts": float(np.median([row["ffts"] for row in mine])),
        }
    return out


def _level(row: Row) -> tuple[str, float, float | None]:
    return row["case"], row["overlap"], row["sir_db"]


def _step(curve: Sequence[Row]) -> float:
    return curve[0]["sir_db"] - curve[1]["sir_db"] if len(curve) > 1 else 0.0


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
                f"{s['ms']:.2f}",
                f"{s['ffts']:.0f}",
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
    points = {name: (s["ffts"], s["held_db"]) for name, s in summary.items() if np.isfinite(s["held_db"])}
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
    below = 0
    for name in sorted(points, key=lambda name: points[name]):
        (ffts, held), style = points[name], series_style(name, tuple(points))
        axis.plot(ffts, held, style["marker"], color=style["color"], ms=7)
        # names of the front stand above it; the others below, to the left and right by turns
        place = {"xytext": (-6, 5), "ha": "right"} if name in front else {"xytext": (5, -13), "ha": "left"}
        if name not in front:
            place = {"xytext": (-5, -13), "ha": "right"} if below % 2 else place
            below += 1
        axis.annotate(name, (ffts, held), textcoords="offset points", fontsize=9, **place)
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
    save_figure(figure, path)
