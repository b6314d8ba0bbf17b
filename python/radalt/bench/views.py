"""Views of rows: the tables and figures of a run's report."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..evaluation.overlap.figures import draw_pd
from ..evaluation.results.break_point import break_point_of
from ..evaluation.results.pareto import draw_pareto
from ..evaluation.results.proportion import clopper_pearson, clopper_pearson_bound
from ..evaluation.results.rows import grouped
from ..evaluation.results.score import pool
from ..evaluation.results.table import metres, number, table
from .lists import CaseList
from .paired import curves, held, level_db
from .rows import Row

_LEAST_FRAMES = 36  # frames below which no Pd can be shown to be 0.9: 36 of 36 have a lower bound of 0.904
_MOST = 40  # lines up to which a table is of use
_LEVELS = 3  # of a case from which decibels are held: two are points, not a curve
_PANELS = 15  # panels of a figure: the first ones; the table has all
_LINES = 8  # entries in a panel


def break_points(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """Table of break-points of the cases that have three levels or more; too few frames give no break-point."""
    lines = []
    for (case, overlap), by in curves(rows).items():
        levels = {(row["sir_db"], row["snr_db"]) for curve in by.values() for row in curve}
        if len(levels) < 3:
            continue
        axis = "snr_db" if any(sir is None for sir, _ in levels) else "sir_db"
        cells = []
        for name in entries:
            found = by.get(name)
            if not found or found[0]["trials"] < _LEAST_FRAMES:
                cells.append("")
                continue
            at = break_point_of(found, axis)
            cells.append(f"{at} ({at.low_db:.1f} to {at.high_db:.1f})")
        if any(cells):
            lines.append([case, f"{overlap:g}", *cells])
    return table(["case", "overlap", *entries], lines) if lines else ""


def levels(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """A line per case and level: Pd / wrong and valid, per cent / RMSE of forced decisions; "" for too many lines."""
    places: dict[tuple[str, float, float | None, float | None], dict[str, Row]] = {}
    for row in rows:
        place = row["case"], row["overlap"], row["sir_db"], row["snr_db"]
        places.setdefault(place, {})[row["entry"]] = row
    if not 0 < len(places) <= _MOST:
        return ""
    lines = []
    for (case, overlap, sir_db, snr_db), by in places.items():
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
        worst = ""
        if false:
            worst = f"{most['detections']} of {most['trials']} ({most['case']}, {most['overlap']:g}{inr})"
        lines.append([name, f"{false} of {trials}", f"{low:.2g} to {high:.2g}", worst, f"{bounds[name]:.3g}"])
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
    common = set.intersection(*({_level(row) for row in by_entry.get(name, ())} for name in entries))
    for name in entries:
        mine = by_entry.get(name, [])
        each = [held(by[name]) for by in found.values() if len(by.get(name, ())) >= _LEVELS]
        shared, own = pool([row for row in mine if _level(row) in common]), pool(mine)
        cost = timed.get(name, mine)
        out[name] = {
            "held_db": float(np.mean(each)) if each else float("nan"),
            **{"wrong": shared.wrong, "trials": shared.trials},
            **{"all_wrong": own.wrong, "all_trials": own.trials},
            **{key: float(np.median([row[key] or np.nan for row in cost])) for key in ("ms", "ffts")},
        }
    return out


def _level(row: Row) -> tuple[str, float, float | None, float | None]:
    return row["case"], row["overlap"], row["sir_db"], row["snr_db"]


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
    order = sorted(summary, key=lambda name: -np.nan_to_num(summary[name]["held_db"], nan=-1e9))
    lines = []
    for name in order:
        s = summary[name]
        counts = [(int(s[f"{of}wrong"]), int(s[f"{of}trials"])) for of in ("", "all_")]
        lines.append(
            [
                name,
                number(s["held_db"], 1),
                *(
                    f"{wrong} of {trials} ({clopper_pearson_bound(wrong, trials):.2g})"
                    for wrong, trials in counts
                ),
                "" if np.isnan(s["ms"]) else f"{s['ms']:.2f}",
                "" if np.isnan(s["ffts"]) else f"{s['ffts']:.0f}",
            ]
        )
    head = ["entry", "held / dB", "wrong and valid (95 % bound), levels of all", "at all its own levels"]
    head += ["ms per frame", "FFTs per frame"]
    return table(head, lines)


def draw_held(summary: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """Decibels held against cost per frame, every entry named, with the front."""
    points = {
        name: (s["ffts"], s["held_db"])
        for name, s in summary.items()
        if np.isfinite(s["held_db"] + s["ffts"])
    }
    cost = "CPU per frame, method and altimeter, one at a time / FFTs of the frame"
    draw_pareto(points, path, cost=cost, gain="held / dB, mean of cases", verb="holds most")


def draw_curves(rows: Sequence[Row], entries: Sequence[str], path: Path, cases: CaseList) -> None:
    """The figure; nothing is written where no case has three levels. Without interference, the level is the SNR."""
    found = {at: by for at, by in curves(rows).items() if max(map(len, by.values())) >= 3}
    if len(found) > _PANELS:
        fullest = {case: max(overlap for name, overlap in found if name == case) for case, _ in found}
        found = {at: by for at, by in found.items() if at[1] == fullest[at[0]]}
    shown = list(found.values())[:_PANELS]
    names = [name for name in entries if any(name in by for by in shown)][:_LINES]
    every = [row for name in names for by in shown for row in by.get(name, ())]
    of = [row | {"method": row["entry"], "sir_db": level_db(row), "snr_db": None} for row in every]
    titled = {name: title for title, name in {c.title: c.name for c in cases.cases}.items()}  # one per title
    if of:
        drawn = [row | {"interference": titled.get(row["case"], row["case"])} for row in of]
        draw_pd(drawn, path, title=cases.title, against="sir_db")
