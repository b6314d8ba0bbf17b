"""Measurement of a point in a worker."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .study import Point, Study


@dataclass(frozen=True)
class Outcome:
    """Rows of a point; ``process`` is unique among the processes of the run."""

    rows: list[dict[str, Any]]
    process: int | str
    peak_bytes: int


def measure_point(study: Study, point: Point) -> Outcome:
    """Measure a point in a worker process."""
    rows = [kept_row(study, point, row) for row in study.measure(point)]
    return Outcome(rows, os.getpid(), peak_memory_bytes())


def kept_row(study: Study, point: Point, row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with the columns and rounding of its table."""
    return study.tables[study.table_of(point, row)].row(row)


def peak_memory_bytes() -> int:
    """Peak resident memory of this process; 0 where the system does not report it.

    From ``/proc/self``: ``ru_maxrss`` of a spawned process starts at its parent's value.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM:")), 0)
