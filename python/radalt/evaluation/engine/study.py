"""Base class of studies: points, their measurement, and a report of the rows."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ..results.rows import Columns
from ..results.score import pool

if TYPE_CHECKING:
    from ..results.folder import RunFolder

__all__ = ["Point", "Run", "Study"]


@dataclass(frozen=True)
class Point:
    """One unit of work; its rows are a function of (study, point, batch), in any process and order.

    Attributes
    ----------
    name : str
        Unique name within the study, for progress, messages and the journal.
    frames : int
        Frames measured in one batch, for the estimate of the cost.
    table : str
        Table of the study for its rows.
    """

    name: str
    frames: int = 0
    table: str = "rows"

    @property
    def sampled(self) -> bool:
        """Whether more batches reduce the uncertainty of its rows, in a study that is `Study.sampled`."""
        return True


@dataclass(frozen=True)
class Run:
    """Facts of a run for its report."""

    jobs: int
    points: int
    points_resumed: int
    wall_s: float
    peak_memory_bytes: int
    command: str = ""
    precision: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """As a mapping for ``report.json``."""
        return {k: v for k, v in vars(self).items() if v not in (None, "")}


class Study:
    """Base of all studies: a frozen, picklable dataclass that holds everything on which its rows depend.

    Attributes
    ----------
    tables : mapping of name -> Columns
        Tables of the result, each as ``NAME.csv``.
    sampled : bool
        Whether a point's rows are estimates over trials, so that more batches reduce their uncertainty
        (``--precision``).
    max_jobs : int or None
        Most points measured at once; 1 where times are measured.
    published : mapping of file -> name
        Files of the result folder for the documentation, and their names there (``--publish``).
    """

    tables: ClassVar[Mapping[str, Columns]]
    sampled: ClassVar[bool] = False
    max_jobs: ClassVar[int | None] = None
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

    def begin(self, folder: Path) -> Study:
        """The study ready to be measured; generated files are in ``folder``."""
        return self

    def measure(self, point: Point, batch: int = 0) -> list[dict[str, Any]]:
        """Rows of one batch of a point; runs in a worker process."""
        raise NotImplementedError

    def table_of(self, point: Point, row: Mapping[str, Any]) -> str:
        """Table of a row; only rows in the point's table control progress and precision."""
        return point.table

    def pooled(self, batches: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
        """Pooled rows of two or more batches of a point: sums of counts, new intervals, the rest of the first batch."""
        return [dict(same[0]) | pool(same).row() for same in zip(*batches, strict=True)]

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """Write the report of all rows by table; returns the path of its page.

        By default ``write_report(folder, study, rows, run)`` of the module ``report`` beside the study's.
        """
        room = type(self).__module__.rpartition(".")[0]
        page: Path = importlib.import_module(".report", room).write_report(folder, self, rows, run)
        return page

    def seconds(self, point: Point) -> float:
        """Approximate CPU seconds of one batch of a point, for the estimate before the run."""
        raise NotImplementedError

    def rehearsal(self) -> tuple[tuple[Study, Point], ...]:
        """Short points whose measured CPU time over `seconds` scales the estimate; none for no scaling."""
        return ()

    def files(self) -> dict[str, Path]:
        """Input files that a remote worker may lack, by their names in `with_files`."""
        return {}

    def with_files(self, files: Mapping[str, Path]) -> Study:
        """The study with its input files at other paths."""
        return self

    @property
    def needs_network(self) -> bool:
        """Whether rows depend on ONNX Runtime and its version."""
        return False

    @property
    def stays_here(self) -> str:
        """Why only this machine can measure the study, in words; empty if any can."""
        return (
            ""
            if self.max_jobs is None
            else f"it measures at most {self.max_jobs} points at once, on this machine"
        )
