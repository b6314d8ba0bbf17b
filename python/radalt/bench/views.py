"""Views of rows: the tables and figures of a run's report."""

import textwrap
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ..evaluation.overlap.figures import draw_pd
from ..evaluation.results.break_point import BREAK_PD, BreakPoint, break_point_of, leaders
from ..evaluation.results.figure import new_figure, save_figure
from ..evaluation.results.pareto import draw_pareto
from ..evaluation.results.proportion import clopper_pearson, clopper_pearson_bound
from ..evaluation.results.rows import grouped
from ..evaluation.results.score import pool
from ..evaluation.results.table import metres, number, said, table
from .lists import CaseList
from .paired import curves, held, level_db
from .rows import Row

_LEAST_FRAMES = 36  # frames below which no Pd can be shown to be 0.9: 36 of 36 have a lower bound of 0.904
_MOST = 40  # lines up to which a table is of use
_LEVELS = 3  # of a case from which decibels are held and break: two are points, not a curve
_PANELS = 15  # panels of a figure: the first ones; the table has all
_LINES = 8  # entries in a panel: `none`, and those that hold most
_COLUMNS = 7  # cases next to each other in a page's width
_LEVEL = ("case", "overlap", "sir_db", "snr_db")


def _found(rows: Sequence[Row], entries: Sequence[str]) -> dict[tuple[str, float], dict[str, BreakPoint]]:
    """By (case, overlap) and entry, of cases that have three levels or more; too few frames give no break-point."""
    out = {}
    for at, by in curves(rows).items():
        if len({level_db(row) for curve in by.values() for row in curve}) >= _LEVELS:
            mine = {n: by[n] for n in entries if n in by and by[n][0]["trials"] >= _LEAST_FRAMES}
            axes = {n: "snr_db" if curve[0]["sir_db"] is None else "sir_db" for n, curve in mine.items()}
            out[at] = {n: break_point_of(curve, axes[n]) for n, curve in mine.items()}
    return {at: by for at, by in out.items() if by}


def break_points(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """Table of break-points with their intervals."""
    lines = []
    for (case, overlap), by in _found(rows, entries).items():
        cells = {name: f"{at} ({at.low_db:.1f} to {at.high_db:.1f})" for name, at in by.items()}
        lines.append([case, f"{overlap:g}", *(cells.get(name, "") for name in entries)])
    return table(["case", "overlap", *entries], lines) if lines else ""


def levels(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """A line per case and level: Pd / wrong and valid, per cent / RMSE of forced decisions; "" for too many lines."""
    places = grouped(rows, *_LEVEL)
    if not 0 < len(places) <= _MOST:
        return ""
    lines = []
    for (case, overlap, sir_db, snr_db), mine in places.items():
        by = {row["entry"]: row for row in mine}
        where = [case, f"{overlap:g}", number(sir_db, 1), number(snr_db, 1)]
        lines.append([*where, *(_cell(by.get(name)) for name in entries)])
    return table(["case", "overlap", "SIR / dB", "SNR / dB", *entries], lines)


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    wrong = 100 * (row["detections"] - row["correct"]) / row["trials"]
    return f"{row['pd']:.2f} / {wrong:.1f} / {metres(row['rmse_forced_m'])}"


def false_altitudes(rows: Sequence[Row], bounds: Mapping[str, float]) -> str:
    """A line per entry: false altitudes, their rate's 95 % interval, the most at one level, and the design's bound.

    ``bounds`` are the false altitudes per frame of white noise that an entry's altimeter has by design, at most.
    """
    lines = []
    for name, mine in grouped(rows, "entry").items():
        false, trials = (sum(row[key] for row in mine) for key in ("detections", "trials"))
        low, high = clopper_pearson(false, trials)
        most = max(mine, key=lambda row: row["detections"] / row["trials"])
        inr = "" if most["sir_db"] is None else f", INR {most['snr_db'] - most['sir_db']:g} dB"
        worst = f"{most['detections']} of {most['trials']} ({most['case']}, {most['overlap']:g}{inr})"
        lines.append(
            [
                name,
                f"{false} of {trials}",
                f"{low:.2g} to {high:.2g}",
                worst if false else "",
                f"{bounds[name]:.3g}",
            ]
        )
    head = ["entry", "false altitudes", "rate, 95 %", "most at one level", "white noise, by design at most"]
    return table(head, lines)


def summaries(
    rows: Sequence[Row], entries: Sequence[str], turns: Sequence[Mapping[str, Any]] = ()
) -> dict[str, dict[str, float]]:
    """By entry: decibels held (mean over cases), wrong and valid, trials, milliseconds and FFTs per frame (medians).

    Costs are those of ``turns``, where an entry took turns. Wrong altitudes are counted at the levels that every
    entry ran, and (``all_``) at all of its own: an entry that stops early has the easy ones only.
    """
    found, by_entry, timed, out = curves(rows), grouped(rows, "entry"), grouped(turns, "entry"), {}
    level = itemgetter(*_LEVEL)
    common = set.intersection(*({level(row) for row in by_entry.get(name, ())} for name in entries))
    for name in entries:
        mine = by_entry.get(name, [])
        each = [held(by[name]) for by in found.values() if len(by.get(name, ())) >= _LEVELS]
        shared, own = pool([row for row in mine if level(row) in common]), pool(mine)
        cost = timed.get(name, mine)
        out[name] = {
            "held_db": float(np.mean(each)) if each else float("nan"),
            **{"wrong": shared.wrong, "trials": shared.trials},
            **{"all_wrong": own.wrong, "all_trials": own.trials},
            **{key: float(np.median([row[key] or np.nan for row in cost])) for key in ("ms", "ffts")},
        }
    return out


def turns_table(turns: Sequence[Mapping[str, Any]]) -> str:
    """Cost of entries that took turns: the mean over the cases of the medians, the most, memory and start-up."""
    lines = []
    for name, mine in grouped(turns, "entry").items():
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
    lines = []
    for name in sorted(summary, key=lambda name: -np.nan_to_num(summary[name]["held_db"], nan=-1e9)):
        s = summary[name]
        counts = [(int(s[f"{of}wrong"]), int(s[f"{of}trials"])) for of in ("", "all_")]
        rates = (f"{wrong} of {of} ({clopper_pearson_bound(wrong, of):.2g})" for wrong, of in counts)
        ms, ffts = ("" if np.isnan(s[key]) else f"{s[key]:.{n}f}" for key, n in (("ms", 2), ("ffts", 0)))
        lines.append([name, number(s["held_db"], 1), *rates, ms, ffts])
    head = ["entry", "held / dB", "wrong and valid (95 % bound), levels of all", "at all its own levels"]
    return table([*head, "ms per frame", "FFTs per frame"], lines)


def headline(summary: Mapping[str, Mapping[str, float]]) -> str:
    """The entries that hold most, all that the table does not tell apart."""
    held_db = {name: round(s["held_db"], 1) for name, s in summary.items() if np.isfinite(s["held_db"])}
    best = [name for name, db in held_db.items() if db == max(held_db.values())]
    return said(best, "holds most", "hold most") if best else ""


def draw_held(summary: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """Decibels held against cost per frame, every entry named, with the front."""
    every = {name: (s["ffts"], s["held_db"]) for name, s in summary.items()}
    points = {name: point for name, point in every.items() if np.isfinite(point).all()}
    cost = "CPU per frame, method and altimeter, one at a time / FFTs of the frame"
    draw_pareto(points, path, cost=cost, gain="held / dB, mean of cases", title=headline(summary))


def draw_levels(rows: Sequence[Row], entries: Sequence[str], path: Path, cases: CaseList) -> None:
    """Break-points with intervals, a panel per case at its fullest overlap, a row per entry; an arrow: it holds on.

    Filled are the entries that carry furthest, or whose interval reaches the one that does.
    """
    found = _found([row for row in rows if row["sir_db"] is not None], entries)
    full = {case: by for (case, _), by in sorted(found.items(), key=lambda item: item[0][1])}
    panels = [(case.title, full.pop(case.name)) for case in cases.cases if case.name in full]
    names = [name for name in entries if panels and all(name in by for _, by in panels)]
    if len(names) < 2:
        return
    best, most, each = leaders([{name: by[name] for name in names} for _, by in panels])
    names.sort(key=lambda n: (-sum(n in first for first in each), sum(by[n].sir_db for _, by in panels)))
    lines, columns = -(-len(panels) // _COLUMNS), min(len(panels), _COLUMNS)
    figure = new_figure(7.8, 0.9 + lines * (1.0 + 0.2 * len(names)))
    axes = list(figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).flat)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for k, (axis, (title, by)) in enumerate(zip(axes, panels, strict=False)):
        for y, at in enumerate(by[name] for name in names):
            colour, fill = ("#0072B2",) * 2 if names[y] in each[k] else ("0.4", "white")
            axis.plot([at.low_db, at.high_db], [y, y], color=colour, lw=1.5)
            axis.plot(at.sir_db, y, "o", color=colour, mfc=fill, ms=5)
            if at.mark:
                beyond = at.sir_db + {"<=": -9, ">=": 9}[at.mark]
                style = {"arrowstyle": "->", "color": colour, "shrinkB": 0}
                axis.annotate("", (beyond, y), (at.sir_db, y), arrowprops=style)
        axis.set_title(textwrap.fill(title, 13), fontsize=8.5)
        axis.grid(color="0.9")
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8.5, left=False)
    ends = [end for _, by in panels for at in by.values() for end in (at.low_db, at.high_db)]
    axes[0].set(xlim=(max(ends) + 4, min(ends) - 10), ylim=(len(names) - 0.5, -0.5))
    axes[0].locator_params(axis="x", nbins=4, steps=[1, 2, 10])
    axes[0].set_yticks(range(len(names)), names)
    head = said(best, "carries furthest", "carry furthest")
    figure.suptitle(f"{head}, or as far, in {most} of {len(panels)} cases", fontsize=11)
    below = f"SIR / dB down to which Pd is {BREAK_PD:g} at the case's largest overlap, with 95 % interval\n"
    below += "filled: furthest, or the interval reaches the furthest; arrow: it holds at the end of the list"
    figure.supxlabel(below, fontsize=9)
    save_figure(figure, path)


def draw_curves(rows: Sequence[Row], entries: Sequence[str], path: Path, cases: CaseList) -> None:
    """The figure; nothing is written where no case has three levels. Without interference, the level is the SNR."""
    found = {at: by for at, by in curves(rows).items() if max(map(len, by.values())) >= 3}
    if len(found) > _PANELS:
        fullest = {case: max(overlap for name, overlap in found if name == case) for case, _ in found}
        found = {at: by for at, by in found.items() if at[1] == fullest[at[0]]}
    shown = list(found.values())[:_PANELS]
    names = [name for name in entries if any(name in by for by in shown)]
    most = sorted(names, key=lambda n: -sum(held(by[n]) for by in shown if n in by))[: _LINES - 1]
    settings = cases.title
    if len(names) > _LINES:
        settings += f"; of {len(names)} entries those that hold most"
        names = [name for name in names if name in (*most, "none")]
    every = [row for name in names for by in shown for row in by.get(name, ())]
    of = [row | {"method": row["entry"], "sir_db": level_db(row), "snr_db": None} for row in every]
    titled = {name: title for title, name in {c.title: c.name for c in cases.cases}.items()}  # one per title
    if of:
        drawn = [row | {"interference": titled.get(row["case"], row["case"])} for row in of]
        draw_pd(drawn, path, settings=settings, against="sir_db")
