"""Pooling of runs: which result folders may be pooled, and their common report.

Counts are added and Wilson intervals recomputed. Only runs with equal settings are pooled; a repeated measurement
(equal scene and seed, so equal random numbers) counts once.
"""

import itertools
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.parsing import shown
from ..results.figure import own_style
from ..results.folder import SCHEMA, RunFolder, flatten, versions
from ..results.page import render, write_page
from ..results.rows import Columns
from ..results.score import BITS, pool
from ..results.table import table
from .figures import draw_cost, draw_pd
from .finding import by_pd
from .markdown import against, glance, pd_tables, verdict
from .panels import Row, common, series_of, swept_axes, with_interference
from .reading import ALTITUDE_KEYS, SCENE_PARTS, PoolError, Run, read_run
from .rows import COLUMNS, COUNTERS

_REPRODUCED = [c for c in COLUMNS.names if c not in COLUMNS.timing]  # columns that a repetition has again
_SINGLE = ("seed", *BITS, "real_time_factor")  # columns of a single run
POOLED_COLUMNS = Columns(
    ("source", "runs", *(c for c in COLUMNS.names if c not in _SINGLE)), timing=COLUMNS.timing
)
_KEY = ("source", "interference", "snr_db", "sir_db", "overlap", "method")
_NOT_EMITTER = ("sir_db", "overlap")  # keys of an interferer that are axes of the report
_BEFORE_ALL = -1e9  # order of a level that there is not: no interference, no noise


def pool_runs(runs: Sequence[Run]) -> tuple[list[Row], list[str], list[Row]]:
    """Pooled rows in canonical order, notes on repeated measurements, and the rows that were pooled.

    Raises PoolError if two runs are not comparable; names both, the key and both values.
    """
    for other, run in itertools.combinations(runs, 2):
        mine, theirs = (flatten(_settings(*of)) for of in ((other, run), (run, other)))
        for key in (k for k in {**mine, **theirs} if mine.get(k) != theirs.get(k)):
            raise PoolError(
                f"cannot pool {other.folder} and {run.folder}: {key} is {_brief(mine.get(key))} in the one, "
                f"{_brief(theirs.get(key))} in the other"
            )
    kept: dict[tuple[Any, ...], list[tuple[Run, Row]]] = {}
    repeated: dict[tuple[str, str], int] = {}
    for run in runs:
        for row in run.report["rows"]:
            row = row | {"source": run.report["source"]}
            group = kept.setdefault(tuple(row[k] for k in _KEY), [])
            twin = next((other for other, old in group if _same_draw(other, old, run, row)), None)
            if twin is None:
                group.append((run, row))
            else:
                repeated[twin.folder, run.folder] = repeated.get((twin.folder, run.folder), 0) + 1
    rows = [_pooled(key, [row for _, row in group]) for key, group in kept.items()]
    single = [
        row | {"run": run.report["created"] if row["source"] == "air" else ""}
        for group in kept.values()
        for run, row in group
    ]
    methods = list(dict.fromkeys(m for run in runs for m in run.report["methods"]))
    rows.sort(key=lambda row: _place(row, methods))
    notes = [
        f"{b} repeats {count} rows of {a} (same scene and seed): counted once"
        for (a, b), count in repeated.items()
    ]
    return rows, notes, single


def _place(row: Row, methods: Sequence[str]) -> tuple[Any, ...]:
    """Sort key: by panel, highest SIR first as in the figures, then overlap, then methods in the order of the runs."""
    sir, snr = (_BEFORE_ALL if row[key] is None else -row[key] for key in ("sir_db", "snr_db"))
    return row["interference"], snr, sir, row["overlap"], row["source"], methods.index(row["method"])


def _brief(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _settings(run: Run, other: Run) -> dict[str, Any]:
    """What a run has to have in common with another one, nested as in its scene."""
    report, scene = run.report, run.report["scene"]
    out = {part: scene[part] for part in SCENE_PARTS}
    out["altitude"] = {key: scene["altitude"][key] for key in ALTITUDE_KEYS}
    if report["source"] == other.report["source"] == "simulated":
        out["channel"] = _without(scene["channel"], "snr_db")
        out["snr_db"] = sorted({row["snr_db"] for row in report["rows"]}, key=lambda v: (v is None, v))
    mine, theirs = ({row["interference"] for row in of.report["rows"]} for of in (run, other))
    if mine & theirs:
        emitters = (item for entry in scene["interference"] for item in entry.items())
        out["interference"] = [{k: _without(v, *_NOT_EMITTER)} for k, v in emitters]
        if report.get("recordings") and other.report.get("recordings"):  # reports of 0.3.0 have none
            out["recordings"] = report["recordings"]
    both = [method for method in report["methods"] if method in other.report["methods"]]
    out["methods"] = {m: _without(report["methods"][m], "providers") for m in both}
    # a model is identified by its hash, not by its path
    out["method_options"] = {m: _without(scene["method_options"].get(m) or {}, "model") for m in both}
    return out


def _without(values: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {k: v for k, v in values.items() if k not in keys}


def _same_draw(a: Run, old: Row, b: Run, new: Row) -> bool:
    """Whether two rows of one key have the same random numbers.

    Raises PoolError if they have and differ, or if they share a part of them.
    """
    if old["source"] != "simulated":
        return a.report["created"] == b.report["created"]
    if old["seed"] != new["seed"]:
        return False
    what = f"cannot pool {a.folder} and {b.folder}: both have seed {a.report['seed']}"
    if a.frames != b.frames:
        raise PoolError(
            f"{what} but altitude.frames is {a.frames} in the one and {b.frames} in the other, so they are not "
            "independent; run one with another --seed"
        )
    if old["trials"] != new["trials"]:
        raise PoolError(
            f"{what}, so {old['method']} at overlap {old['overlap']:g} has {old['trials']} trials in the one and "
            f"{new['trials']} in the other, the first of them alike; leave one out, or run it with another --seed"
        )
    differing = next((c for c in _REPRODUCED if old[c] != new[c]), None)
    if differing:
        raise PoolError(
            f"{what}, but {old['method']} at overlap {old['overlap']:g} has {differing} {old[differing]!r} in the one "
            f"and {new[differing]!r} in the other; they are of different versions: leave one out"
        )
    return True


def _pooled(key: tuple[Any, ...], rows: Sequence[Row]) -> Row:
    values = dict(zip(_KEY, key, strict=True)) | {"runs": len(rows)} | pool(rows).row()
    values |= {c: sum(row[c] for row in rows) for c in COUNTERS}
    for column, of in (("ms_per_frame_median", np.median), ("ms_per_frame_p99", np.max)):
        times = [row[column] for row in rows if row[column] is not None]
        values[column] = float(of(times)) if times else None
    return POOLED_COLUMNS.row(values)


def collect(folders: Sequence[str | Path], out: Path, *, method: str = "") -> tuple[Path, list[str]]:
    """Pool result folders into one report in ``out``; returns the path of report.md and notes for the user.

    ``method`` is compared with every other, on the frames that both have; by default that with the highest Pd.

    Raises FolderError, PoolError, one line.
    """
    unique = {Path(folder).resolve(): folder for folder in reversed(folders)}
    runs = [read_run(folder) for folder in reversed(unique.values())]
    rows, notes, single = pool_runs(runs)
    sources = {row["source"] for row in rows}
    for row in (*rows, *single):
        air = row["source"] == "air" and len(sources) > 1
        row["series"] = f"{row['method']}, on the air" if air else row["method"]
    if method and method not in series_of(rows):
        raise PoolError(
            f"--against {shown(method)}: no such method in the runs; there are {', '.join(series_of(rows))}"
        )
    head = {"study": "collected", "runs": [run.folder for run in runs], "versions": versions(False)}
    target = RunFolder(out, head, replace=True)
    try:
        return _write(target, runs, rows, notes, single, method), notes
    finally:
        target.close()


@own_style()
def _write(
    folder: RunFolder,
    runs: Sequence[Run],
    rows: list[Row],
    notes: list[str],
    single: Sequence[Row],
    method: str,
) -> Path:
    title = " / ".join(dict.fromkeys(run.report["title"] for run in runs))
    report = {
        "schema": SCHEMA,
        "kind": "collected",
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "title": title,
        "notes": notes,
        "runs": [
            {key: run.report[key] for key in _ABOUT}
            | {"folder": run.folder, "by": run.report["run"].get("by", "not said")}
            for run in runs
        ],
        "rows": rows,
    }
    drawn = [row for row in rows if row["trials"]]
    drawn = [row for row in drawn if row["sir_db"] is not None] or drawn  # the ceiling is in the table
    axes = swept_axes(drawn)
    for figure in folder.path.glob("pd_vs_*"):  # of an earlier collection, perhaps against another axis
        figure.unlink()
    counted = f"{title} ({len(runs)} run{'s' * (len(runs) > 1)})"
    for axis, name in axes:
        draw_pd(drawn, folder.path / f"pd_vs_{name}.png", settings=counted, against=axis, frames=single)
    figures = [(f"pd_vs_{name}.png", f"Pd against {name}") for _, name in axes] + draw_cost(
        drawn, folder.path, single
    )
    folder.write_text("rows.csv", POOLED_COLUMNS.csv(rows))
    jammed = [row for row in with_interference(single) if row["trials"]]
    tables = {
        "axis": {"overlap": "overlap", "sir_db": "SIR"}[axes[0][0]],
        "figures": figures,
        "placeholder": any(m.get("placeholder") for run in runs for m in run.report["methods"].values()),
        "verdict": verdict(single, runs[0].report["source"], runs[0].report["scene"]["waveform"]),
        "against": against(jammed, method or by_pd(common(jammed))[0]),
        "hazard_table": glance(rows),
        "pd_tables": pd_tables(rows),
        "run_table": _run_table(report["runs"]),
    }
    text = render(Path(__file__).with_name("collected.md.j2"), **report, **tables)
    page = write_page(folder, text, {})
    folder.write_report(report)
    return page


_ABOUT = ("name", "source", "seed", "created", "versions", "methods", "trials_per_point")


def _run_table(runs: Sequence[dict[str, Any]]) -> str:
    names = ("folder", "by", "source", "seed", "trials_per_point", "created")
    lines = [[*(r[name] for name in names), ", ".join(map(" ".join, r["versions"].items()))] for r in runs]
    return table(
        ["folder", "who and where", "source", "seed", "trials per point", "created", "versions"], lines
    )
