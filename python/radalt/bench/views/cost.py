"""Error against run time: decibels held, wrong altitudes and cost of every entry."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.results.pareto import draw_pareto
from ...evaluation.results.proportion import clopper_pearson_bound
from ...evaluation.results.rows import grouped
from ...evaluation.results.score import pool
from ...evaluation.results.table import number, table
from ..paired import curves, held
from ..rows import Row

_LEVELS = 3  # of a case from which decibels are held: two are points, not a curve


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
