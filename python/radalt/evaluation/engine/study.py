"""Base class of studies: points, their measurement in a worker, and a report of the rows."""

import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ..results.rows import Columns

if TYPE_CHECKING:
    from ..results.folder import RunFolder


@dataclass(frozen=True)
class Point:
    """One unit of work; its rows are a function of (study, point), in any process and order."""

    name: str  # unique name within the study, for progress, messages and the journal
    frames: int = 0  # frames measured, in whose proportion the remaining time is estimated
    table: str = "rows"  # table of the study for its rows


@dataclass(frozen=True)
class Run:
    """Facts of a run for its report."""

    jobs: int
    points: int
    points_resumed: int
    wall_s: float
    peak_memory_bytes: int
    command: str = ""
    by: str = ""  # who measured and where

    def as_dict(self) -> dict[str, Any]:
        """As a mapping for ``report.json``."""
        return {k: v for k, v in vars(self).items() if v != ""}


class Study:
    """Base of all studies: a frozen, picklable dataclass that holds everything on which its rows depend."""

    # tables of the result, each as ``NAME.csv``
    tables: ClassVar[Mapping[str, Columns]]
    max_jobs: ClassVar[int | None] = None  # most points measured at once; 1 where times are measured
    # files of the result folder for the documentation, and their names there (``--publish``)
    published: ClassVar[Mapping[str, str]] = {}

    def check(self) -> None:
        """Check all settings before the run; raises an expected error, one line. By default `head` finds it."""
        self.head()

    def head(self) -> dict[str, Any]:
        """Everything on which a row depends, versions and hashes included, as JSON."""
        raise NotImplementedError

    def points(self) -> Sequence[Point]:
        """Every point, in the order of the report."""
        raise NotImplementedError

    def begin(self, folder: Path) -> "Study":
        """The study ready to be measured; generated files are in ``folder``."""
        return self

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """Rows of a point; runs in a worker process."""
        raise NotImplementedError

    def table_of(self, point: Point, row: Mapping[str, Any]) -> str:
        """Table of a row; the console shows the rows in the point's own table."""
        return point.table

    def report(self, folder: "RunFolder", rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """Write the report of all rows by table; returns the path of its page.

        By default ``write_report(folder, study, rows, run)`` of the module ``report`` next to the study's.
        """
        room = type(self).__module__.rpartition(".")[0]
        page: Path = importlib.import_module(".report", room).write_report(folder, self, rows, run)
        return page

    def files(self) -> dict[str, Path]:
        """Input files that a remote worker may lack, by their names in `with_files`."""
        return {}

    def with_files(self, files: Mapping[str, Path]) -> "Study":
        """The study with its input files at other paths."""
        return self

    @property
    def needs_network(self) -> bool:
        """Whether rows depend on ONNX Runtime and its version."""
        return False

    @property
    def stays_here(self) -> str:
        """Why only this machine can measure the study, in words; empty if any can."""
        if self.max_jobs is None:
            return ""
        return f"it measures at most {self.max_jobs} points at once, on this machine"


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
