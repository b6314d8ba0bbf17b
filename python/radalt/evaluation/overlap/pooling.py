"""Pooling of runs: which result folders may be pooled, and their common report.

Counts are added and Wilson intervals recomputed. Only runs with equal settings are pooled; a repeated measurement
(equal scene and seed, so equal random numbers) counts once.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.parsing import LARGEST, shown
from ..results.folder import SCHEMA, RunFolder, flatten, read_report, versions
from ..results.page import render, write_page
from ..results.score import pool
from ..results.table import table
from .figures import draw_pd
from .markdown import every_row, glance, pd_tables
from .rows import COLUMNS

__all__ = ["POOLED_COLUMNS", "PoolError", "Run", "collect", "pool_runs", "read_run"]

POOLED_COLUMNS = COLUMNS.subset(
    ("source", "runs", *(c for c in COLUMNS.names if c not in COLUMNS.timing and c != "seed"))
)
_KEY = ("source", "interference", "snr_db", "sir_db", "overlap", "method")
# keys of a scene that must be equal in all runs; the channel only in simulated ones
_SCENE_PARTS = ("waveform", "altimeter", "segmenter")
_ALTITUDE_KEYS = ("programme_m", "mode", "vertical_speed_m_per_s")
# keys of report.json in use, and their types
_NEEDED = {
    **dict.fromkeys(("source", "name", "title", "created"), str),
    **dict.fromkeys(("scene", "methods", "versions", "scene.altitude", "scene.method_options"), dict),
    **dict.fromkeys((f"scene.{part}" for part in (*_SCENE_PARTS, "channel")), dict),
    **dict.fromkeys(("seed", "scene.altitude.frames"), int),
    "trials_per_point": (int, str),  # text of a range where --precision measured some points longer
    **dict.fromkeys(("rows", "scene.interference"), list),
    **{f"scene.altitude.{key}": object for key in _ALTITUDE_KEYS},
}
# columns that may be empty: no interference, no noise, no detection
_OPEN = frozenset(COLUMNS.names) - COLUMNS.text - COLUMNS.whole - {"overlap"}
# largest report for pooling (rows, panels, overlaps, characters of a text): its figures are drawn within a minute
_MOST_ROWS, _MOST_PANELS, _MOST_OVERLAPS, _MOST_TEXT = 100_000, 60, 1_000, 300
_NOT_EMITTER = ("sir_db", "overlap")  # keys of an interferer that are axes of the report


class PoolError(ValueError):
    """Runs that cannot be pooled; the message names them and the reason in one line."""


@dataclass(frozen=True)
class Run:
    """One result folder.

    Attributes
    ----------
    folder : str
        Folder as named by the user.
    report : dict
        Content of report.json.
    """

    folder: str
    report: dict[str, Any]

    @property
    def frames(self) -> int:
        """Frames at each altitude."""
        return self.report["scene"]["altitude"]["frames"]


def read_run(folder: str | Path) -> Run:
    """A finished run of ota_eval.

    Raises
    ------
    FolderError, PoolError
        One line: the part that is missing, unfinished or of another schema.
    """
    report = read_report(Path(folder))
    if report["schema"] != SCHEMA:
        raise PoolError(
            f"{folder}: schema is {report['schema']!r}, this program reads {SCHEMA}; use the version that wrote it"
        )
    if report.get("kind") != "run":
        raise PoolError(
            f"{folder}: is itself a {report.get('kind')} report; name the folders of the runs in it"
        )
    problem = _malformed(report)
    if problem:
        raise PoolError(f"{folder}: report.json does not hold: {problem}; measure it again")
    for number, row in enumerate(report["rows"], start=1):
        problem = _problem(row)
        if not problem and row["method"] not in report["methods"]:
            problem = f"method {shown(row['method'])} is not among the report's"
        if problem:
            raise PoolError(
                f"{folder}: row {number} of report.json does not hold: {problem}; measure it again"
            )
    for what, most, count in (
        (
            "panels",
            _MOST_PANELS,
            len({(r["interference"], r["snr_db"], r["sir_db"]) for r in report["rows"]}),
        ),
        ("overlaps", _MOST_OVERLAPS, len({r["overlap"] for r in report["rows"]})),
    ):
        if count > most:
            raise PoolError(
                f"{folder}: report.json has {count} {what}, and a page shows {most} at most; pool parts"
            )
    return Run(str(folder), report)


def _malformed(report: dict[str, Any]) -> str:
    """First missing key or wrong type in a report; empty without any."""
    for key, kind in _NEEDED.items():
        value = report
        for part in key.split("."):
            if part not in value:
                return f"it has no {key}"
            value = value[part]
        if not isinstance(value, kind) or isinstance(value, bool):
            return f"{key} is {shown(value)}"
    if len(report["rows"]) > _MOST_ROWS:
        return f"it has {len(report['rows'])} rows, more than {_MOST_ROWS}"
    for key in ("source", "name", "title", "created"):
        if not _showable(report[key]):
            return f"{key} is {shown(report[key])}"
    for key in ("methods", "versions"):
        for name, value in report[key].items():
            if not _showable(name) or (key == "versions" and not _showable(value)):
                return f"{key} holds {shown(name)}: {shown(value)}"
    scene = report["scene"]
    inner = [*report["methods"].items(), *((m, given or {}) for m, given in scene["method_options"].items())]
    for entry in scene["interference"]:
        inner += entry.items() if isinstance(entry, dict) else [("interference", entry)]
    return next((f"{shown(k)} is {shown(v)}" for k, v in inner if not isinstance(v, dict)), "")


def _problem(row: Any) -> str:
    """First invalid value of a row; empty without any."""
    if not isinstance(row, dict):
        return "it is no mapping"
    missing = [c for c in COLUMNS.names if c not in row]
    if missing:
        return f"it has no {missing[0]}"
    for name, value in row.items():
        if name in COLUMNS.names and not _fits(name, value):
            return f"{name} is {shown(value)}"
    counts = [row[c] for c in ("correct", "detections", "trials")]
    if not all(type(c) is int for c in counts) or not 0 <= counts[0] <= counts[1] <= counts[2]:
        return f"correct, detections, trials are {_brief(counts)}"
    if counts[2] and (row["pd"] is None or abs(row["pd"] - counts[0] / counts[2]) > 1e-6):
        return f"pd is {_brief(row['pd'])} with {counts[0]} correct of {counts[2]}"
    try:
        pool([row]).row()
    except (TypeError, ValueError, ArithmeticError):
        return "its counts and means do not go together"
    return ""


def _fits(name: str, value: Any) -> bool:
    """Whether a value is valid in its column."""
    if value is None or isinstance(value, bool):
        return value is None and name in _OPEN
    if name in COLUMNS.text:
        return _showable(value)
    if name == "overlap":
        return isinstance(value, (int, float)) and 0 <= value <= 1
    if name in COLUMNS.whole:
        return isinstance(value, int) and 0 <= value <= LARGEST
    return isinstance(value, (int, float)) and abs(value) <= LARGEST


def _showable(text: Any) -> bool:
    """Whether a text is short and safe in a page: printable, without markup and table delimiters."""
    return (
        isinstance(text, str)
        and len(text) <= _MOST_TEXT
        and text.isprintable()
        and not set("<>|") & set(text)
    )


def pool_runs(runs: Sequence[Run]) -> tuple[list[dict[str, Any]], list[str]]:
    """Pooled rows in canonical order, and notes on repeated measurements.

    Raises
    ------
    PoolError
        If two runs are not comparable; names both, the key and both values.
    """
    for k, run in enumerate(runs):
        for other in runs[:k]:
            _compare(other, run)
    kept: dict[tuple, list[tuple[Run, dict[str, Any]]]] = {}
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
    rows.sort(key=_order(runs))
    notes = [
        f"{b} repeats {count} rows of {a} (same scene and seed): counted once"
        for (a, b), count in repeated.items()
    ]
    return rows, notes


def _order(runs: Sequence[Run]) -> Any:
    """Sort key: by panel, then overlap, then methods in the order of the runs."""
    methods = list(dict.fromkeys(m for run in runs for m in run.report["methods"]))

    def key(row: dict[str, Any]) -> tuple:
        # highest SIR first, as in the panels; no interference before all
        sir = -1e9 if row["sir_db"] is None else -row["sir_db"]
        snr = -1e9 if row["snr_db"] is None else -row["snr_db"]
        return row["interference"], snr, sir, row["overlap"], row["source"], methods.index(row["method"])

    return key


def _compare(a: Run, b: Run) -> None:
    """Raise `PoolError` for the first forbidden difference between two runs."""
    for key, left, right in _differences(a, b):
        raise PoolError(
            f"cannot pool {a.folder} and {b.folder}: {key} is {_brief(left)} in the one, "
            f"{_brief(right)} in the other"
        )


def _brief(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _differences(a: Run, b: Run) -> Iterator[tuple[str, Any, Any]]:
    """(key, value in a, value in b) of all forbidden differences."""
    left, right = a.report["scene"], b.report["scene"]
    simulated = a.report["source"] == b.report["source"] == "simulated"
    for part in (*_SCENE_PARTS, *(("channel",) if simulated else ())):
        yield from _unequal(part, left[part], right[part], ignore=("channel.snr_db",))
    for key in _ALTITUDE_KEYS:
        yield from _unequal(f"altitude.{key}", left["altitude"][key], right["altitude"][key])
    if simulated:
        yield from _unequal("snr_db", _snrs(a), _snrs(b))
    if _names(a) & _names(b):
        yield from _unequal("interference", _emitters(left), _emitters(right))
    for method in a.report["methods"].keys() & b.report["methods"].keys():
        known = [{k: v for k, v in r.report["methods"][method].items() if k != "providers"} for r in (a, b)]
        yield from _unequal(f"methods.{method}", *known)
        # a model is identified by its hash, not by its path
        options = [
            {k: v for k, v in (scene["method_options"].get(method) or {}).items() if k != "model"}
            for scene in (left, right)
        ]
        yield from _unequal(f"method_options.{method}", *options)


def _unequal(prefix: str, a: Any, b: Any, ignore: Sequence[str] = ()) -> Iterator[tuple[str, Any, Any]]:
    left, right = flatten(a, prefix), flatten(b, prefix)
    for key in dict.fromkeys([*left, *right]):
        if left.get(key) != right.get(key) and key not in ignore:
            yield key, left.get(key), right.get(key)


def _snrs(run: Run) -> list[float | None]:
    return sorted({row["snr_db"] for row in run.report["rows"]}, key=lambda v: (v is None, v))


def _names(run: Run) -> set[str]:
    return {row["interference"] for row in run.report["rows"]}


def _emitters(scene: dict[str, Any]) -> list[dict[str, Any]]:
    """The interferers without the swept keys."""
    return [
        {kind: {k: v for k, v in values.items() if k not in _NOT_EMITTER}}
        for entry in scene["interference"]
        for kind, values in entry.items()
    ]


def _same_draw(a: Run, old: dict[str, Any], b: Run, new: dict[str, Any]) -> bool:
    """Whether two rows of one key have the same random numbers.

    Raises
    ------
    PoolError
        If they have and differ, or if they share a part of them.
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
    differing = next((c for c in COLUMNS.names if c not in COLUMNS.timing and old[c] != new[c]), None)
    if differing:
        raise PoolError(
            f"{what}, but {old['method']} at overlap {old['overlap']:g} has {differing} {old[differing]!r} in the one "
            f"and {new[differing]!r} in the other; they are of different versions: leave one out"
        )
    return True


def _pooled(key: tuple, rows: list[dict[str, Any]]) -> dict[str, Any]:
    summed = {c: sum(row[c] for row in rows) for c in ("diverged_frames", "discontinuities", "lock_losses")}
    return POOLED_COLUMNS.row(
        dict(zip(_KEY, key, strict=True)) | {"runs": len(rows)} | pool(rows).row() | summed
    )


def collect(folders: Sequence[str | Path], out: Path) -> tuple[Path, list[str]]:
    """Pool result folders into one report in ``out``; returns the path of report.md and notes for the user.

    Raises
    ------
    FolderError, PoolError
        One line.
    """
    unique = {Path(folder).resolve(): folder for folder in reversed(folders)}
    runs = [read_run(folder) for folder in reversed(unique.values())]
    rows, notes = pool_runs(runs)
    head = {"study": "collected", "runs": [run.folder for run in runs], "versions": versions(False)}
    target = RunFolder(out, head, replace=True)
    try:
        return _write(target, runs, rows, notes), notes
    finally:
        target.close()


def _write(folder: RunFolder, runs: Sequence[Run], rows: list[dict[str, Any]], notes: list[str]) -> Path:
    sources = {row["source"] for row in rows}
    for row in rows:
        air = row["source"] == "air" and len(sources) > 1
        row["series"] = f"{row['method']}, on the air" if air else row["method"]
    title = " / ".join(dict.fromkeys(run.report["title"] for run in runs))
    report = {
        "schema": SCHEMA,
        "kind": "collected",
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "title": title,
        "notes": notes,
        "runs": [_about(run) for run in runs],
        "rows": rows,
    }
    draw_pd(rows, folder.path / "pd_vs_overlap.png", title=f"{title} ({len(runs)} runs)")
    folder.write_text("rows.csv", POOLED_COLUMNS.csv(rows))
    page = write_page(folder, _markdown(report), {}, more=every_row(rows))
    folder.write_report(report)
    return page


def _about(run: Run) -> dict[str, Any]:
    report = run.report
    return {"folder": run.folder} | {
        key: report[key]
        for key in ("name", "source", "seed", "created", "versions", "methods", "trials_per_point")
    }


def _markdown(report: dict[str, Any]) -> str:
    lines = [
        [
            *(r["folder"], r["source"], r["seed"], r["trials_per_point"], r["created"]),
            ", ".join(f"{k} {v}" for k, v in r["versions"].items()),
        ]
        for r in report["runs"]
    ]
    header = ["folder", "source", "seed", "trials per point", "created", "versions"]
    placeholder = any(m.get("placeholder") for run in report["runs"] for m in run["methods"].values())
    tables = {"pd_tables": "\n\n".join(pd_tables(report["rows"])), "run_table": table(header, lines)}
    tables["hazard_table"] = table(*glance(report["rows"]))
    return render(Path(__file__).with_name("collected.md.j2"), **report, **tables, placeholder=placeholder)
