"""Reports of finished runs, from anybody: what does not hold is refused in one line before it is pooled or shown."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.parsing import LARGEST, shown
from ...core.text import showable
from ..results.folder import SCHEMA, read_report
from ..results.rows import unbits
from ..results.score import BITS, pool
from .rows import COLUMNS

# keys of a scene that must be equal in all pooled runs
SCENE_PARTS = ("waveform", "altimeter", "segmenter")
ALTITUDE_KEYS = ("programme_m", "mode", "vertical_speed_m_per_s")
# keys of report.json in use, and their types
_NEEDED = {
    **dict.fromkeys(("source", "name", "title", "created"), str),
    **dict.fromkeys(("scene", "run", "methods", "versions", "scene.altitude", "scene.method_options"), dict),
    **dict.fromkeys((f"scene.{part}" for part in (*SCENE_PARTS, "channel")), dict),
    **dict.fromkeys(("seed", "scene.altitude.frames"), int),
    "trials_per_point": (int, str),  # a range in reports of 0.2.0 with --precision
    **dict.fromkeys(("rows", "ceiling", "scene.interference"), list),
    **{f"scene.altitude.{key}": object for key in ALTITUDE_KEYS},
}
# columns that may be empty: no interference, no noise, no detection
_OPEN = frozenset(COLUMNS.names) - COLUMNS.text - COLUMNS.whole - {"overlap"}
# largest report for pooling (rows, panels, overlaps): its figures are drawn within a minute
_MOST_ROWS, _MOST_PANELS, _MOST_OVERLAPS = 100_000, 60, 1_000


class PoolError(ValueError):
    """Runs that cannot be pooled; the message names them and the reason in one line."""


@dataclass(frozen=True)
class Run:
    """One result folder."""

    folder: str  # folder as named by the user
    report: dict[str, Any]  # content of report.json

    @property
    def frames(self) -> int:
        """Frames at each altitude."""
        return self.report["scene"]["altitude"]["frames"]


def read_run(folder: str | Path) -> Run:
    """A finished run of ota_eval.

    Raises FolderError, PoolError, one line: the part that is missing, unfinished or of another schema.
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
    rows = report["rows"]
    if rows and not any(isinstance(row, dict) and row.get("overlap") == 0 for row in rows):
        rows += report["ceiling"]  # measured apart where the sweep has no overlap 0
    for number, row in enumerate(rows, start=1):
        problem = _problem(row)
        if not problem and row["method"] not in report["methods"]:
            problem = f"method {shown(row['method'])} is not among the report's"
        if problem:
            raise PoolError(
                f"{folder}: row {number} of report.json does not hold: {problem}; measure it again"
            )
    if not any(row["trials"] for row in rows):
        raise PoolError(f"{folder}: report.json has no row with a trial; measure it again")
    panels = len({(r["interference"], r["snr_db"], r["sir_db"]) for r in rows})
    overlaps = len({r["overlap"] for r in rows})
    for count, most, what in ((panels, _MOST_PANELS, "panels"), (overlaps, _MOST_OVERLAPS, "overlaps")):
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
    for key in ("source", "name", "title", "created", "trials_per_point"):
        if not showable(str(report[key])):
            return f"{key} is {shown(report[key])}"
    if not showable(report["run"].get("by", "")):
        return f"run.by is {shown(report['run']['by'])}"
    for key in ("methods", "versions"):
        for name, value in report[key].items():
            if not showable(name) or (key == "versions" and not showable(value)):
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
    row |= {"pd_3pct": row.get("pd_3pct")} | {name: row.get(name, "") for name in BITS}  # of earlier releases
    for name in COLUMNS.names:
        if name not in row:
            return f"it has no {name}"
        if not _fits(name, row[name]):
            return f"{name} is {shown(row[name])}"
    correct, detections, trials = counts = [row[c] for c in ("correct", "detections", "trials")]
    if not 0 <= correct <= detections <= trials:
        return f"correct, detections, trials are {counts}"
    for name, count in zip(BITS, (correct, detections), strict=True):
        of = row[name]
        if of and (len(of) != 2 * -(-trials // 8) or unbits(of, trials).sum() != count):
            return f"{name} does not have a bit per trial and {count} of {trials} set"
    if trials and (row["pd"] is None or abs(row["pd"] - correct / trials) > 1e-6):
        return f"pd is {row['pd']} with {correct} correct of {trials}"
    try:
        pool([row]).row()
    except (TypeError, ValueError, ArithmeticError):
        return "its counts and means do not go together"
    return ""


def _fits(name: str, value: Any) -> bool:
    """Whether a value is valid in its column."""
    if value is None or isinstance(value, bool):
        return value is None and name in _OPEN
    if name in BITS:
        return isinstance(value, str) and re.fullmatch("[0-9a-f]*", value) is not None
    if name in COLUMNS.text:
        return showable(value)
    if name in COLUMNS.whole:
        return isinstance(value, int) and 0 <= value <= LARGEST
    low, high = (0, 1) if name == "overlap" else (-LARGEST, LARGEST)
    return isinstance(value, (int, float)) and low <= value <= high
