"""Rows of an over-the-air run on disk: appended as they are measured, whole points survive a killed run."""

from __future__ import annotations

import csv
import io
import math
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..results.score import Score
from .points import Point

__all__ = ["COLUMNS", "TIMING_COLUMNS", "RowFile", "make_row", "read_rows", "rows_as_csv"]

COLUMNS = (
    "method",
    "interference",
    "overlap",
    "sir_db",
    "snr_db",
    "trials",
    "detections",
    "correct",
    "pd",
    "pd_low",
    "pd_high",
    "rmse_detected_m",
    "rmse_forced_m",
    "bias_m",
    "forced",
    "frames_lost",
    "diverged_frames",
    "discontinuities",
    "lock_losses",
    "seed",
    "ms_per_frame_median",
    "ms_per_frame_p99",
    "real_time_factor",
)
# everything else is a function of scene and seed
TIMING_COLUMNS = ("ms_per_frame_median", "ms_per_frame_p99", "real_time_factor")
_TEXT = ("source", "method", "interference")
_WHOLE = ("trials", "detections", "correct", "forced", "frames_lost", "diverged_frames")
_WHOLE += ("discontinuities", "lock_losses", "seed", "runs")


def make_row(
    method: str,
    interference: str,
    point: Point,
    seed: int,
    result: Score,
    *,
    diverged_frames: int,
    segmenter: dict[str, Any],
    ms_per_frame: np.ndarray,
    real_time_factor: float,
) -> dict[str, Any]:
    """One row of a report; numbers that do not exist (no detection, no noise) are None.

    ``segmenter`` holds the counters of the whole path, the same for every method of a point.
    Values are rounded as `RowFile` writes them, so that a fresh and a resumed run report the same digits.
    """
    low, high = result.interval
    times = np.asarray(ms_per_frame, dtype=float)
    row = {
        "method": method,
        "interference": interference,
        "overlap": point.overlap,
        "sir_db": point.sir_db,
        "snr_db": point.snr_db,
        "trials": result.trials,
        "detections": result.detections,
        "correct": result.correct,
        "pd": result.pd,
        "pd_low": low,
        "pd_high": high,
        "rmse_detected_m": result.rmse_detected_m,
        "rmse_forced_m": result.rmse_forced_m,
        "bias_m": result.bias_m,
        "forced": result.forced,
        "frames_lost": result.lost,
        "diverged_frames": diverged_frames,
        "discontinuities": segmenter.get("discontinuities", 0),
        "lock_losses": segmenter.get("lock_losses", 0),
        "seed": seed,
        "ms_per_frame_median": float(np.median(times)) if times.size else 0.0,
        "ms_per_frame_p99": float(np.percentile(times, 99)) if times.size else 0.0,
        "real_time_factor": real_time_factor,
    }
    return {column: _parse(column, _format(column, row[column])) for column in COLUMNS}


def _format(column: str, value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return str(value) if column in _TEXT or column in _WHOLE else f"{float(value):.9g}"


def _parse(column: str, text: str) -> Any:
    if column in _TEXT:
        return text
    if text == "":
        return None
    return int(text) if column in _WHOLE else float(text)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of a file; a missing file has none, and a line that was cut by a kill is left out."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        text = file.read()
    rows = []
    # the last line counts only with its end: a cut inside a number leaves a shorter, valid number
    for raw in csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1], newline="")):
        if None in raw or any(raw.get(c) is None for c in COLUMNS):
            continue
        rows.append({c: _parse(c, raw[c]) for c in COLUMNS})
    return rows


class RowFile:
    """``rows.csv`` of a run.

    Parameters
    ----------
    path : Path
        The file. Points that are whole in it are kept, the rest is cut off.
    points : sequence of Point
        All points of the run, in canonical order.
    methods : sequence of str
        Methods of every point, in canonical order.

    Attributes
    ----------
    rows : list of dict
        What is there, in the order it was measured.
    """

    def __init__(self, path: Path, points: Sequence[Point], methods: Sequence[str]) -> None:
        self.path = path
        self._rank = {_key(p.overlap, p.sir_db, p.snr_db): k for k, p in enumerate(points)}
        self._methods = {method: k for k, method in enumerate(methods)}
        rows = [r for r in read_rows(path) if self._of(r) in self._rank and r["method"] in self._methods]
        have = Counter(self._of(row) for row in rows)
        self.rows = [row for row in rows if have[self._of(row)] == len(methods)]
        if path.exists():
            self._rewrite()

    @staticmethod
    def _of(row: dict[str, Any]) -> tuple:
        return _key(row["overlap"], row["sir_db"], row["snr_db"])

    def has(self, point: Point) -> bool:
        """Whether a point is there."""
        key = _key(point.overlap, point.sir_db, point.snr_db)
        return any(self._of(row) == key for row in self.rows)

    def append(self, rows: Sequence[dict[str, Any]]) -> None:
        """Add a point's rows and push them to the disk."""
        new = not self.path.exists()
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(rows_as_csv(rows, header=new))
            file.flush()
            os.fsync(file.fileno())
        self.rows += rows

    def sort(self) -> None:
        """Put the rows in canonical order, whatever order they were measured in."""
        self.rows.sort(key=lambda row: (self._rank[self._of(row)], self._methods[row["method"]]))
        self._rewrite()

    def _rewrite(self) -> None:
        fresh = self.path.with_suffix(".tmp")
        fresh.write_text(rows_as_csv(self.rows), encoding="utf-8", newline="")
        fresh.replace(self.path)


def _key(*values: float | None) -> tuple[str, ...]:
    return tuple("" if v is None else f"{v:.9g}" for v in values)


def rows_as_csv(
    rows: Sequence[dict[str, Any]], *, columns: Sequence[str] = COLUMNS, header: bool = True
) -> str:
    """Rows as comma-separated text; what does not exist is an empty field, floats have nine digits."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    if header:
        writer.writerow(columns)
    writer.writerows([_format(c, row[c]) for c in columns] for row in rows)
    return out.getvalue()
