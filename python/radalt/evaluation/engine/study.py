"""What a study is: points, a measurement of each, and a report of the rows."""

from __future__ import annotations

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
    """One unit of work: its rows follow from (study, point, batch) alone, in whatever process and order.

    Attributes
    ----------
    name : str
        Unique within the study; what progress lines, messages and the journal call it.
    frames : int
        Frames measured in one batch, for the estimate of the cost.
    table : str
        Which of the study's tables its rows go into.
    """

    name: str
    frames: int = 0
    table: str = "rows"

    @property
    def sampled(self) -> bool:
        """Whether more batches make its rows sharper, in a study that is `Study.sampled`."""
        return True


@dataclass(frozen=True)
class Run:
    """How a run went, for its report."""

    jobs: int
    points: int
    points_resumed: int
    wall_s: float
    peak_memory_bytes: int
    command: str = ""
    precision: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """For ``report.json``."""
        return {k: v for k, v in vars(self).items() if v not in (None, "")}


class Study:
    """Base of all studies; a study is a frozen dataclass, picklable, and says everything its rows depend on.

    Attributes
    ----------
    tables : mapping of name -> Columns
        Tables of the result; ``NAME.csv`` each.
    sampled : bool
        Whether a point's rows are estimates over trials, so that more batches of it make them sharper
        (``--precision``).
    max_jobs : int or None
        Most points measured at once; 1 where times are measured.
    published : mapping of file -> name
        Files of the result folder that the documentation holds, and their names there (``--publish``).
    """

    tables: ClassVar[Mapping[str, Columns]]
    sampled: ClassVar[bool] = False
    max_jobs: ClassVar[int | None] = None
    published: ClassVar[Mapping[str, str]] = {}

    def check(self) -> None:
        """Find what does not fit before anything is measured; raises an expected error, one line."""

    def head(self) -> dict[str, Any]:
        """Everything that a row depends on, versions and hashes included, as JSON."""
        raise NotImplementedError

    def points(self) -> Sequence[Point]:
        """Every point, in the order of the report."""
        raise NotImplementedError

    def begin(self, folder: Path) -> Study:
        """The study ready to be measured; what it generates for that lies in ``folder``."""
        return self

    def measure(self, point: Point, batch: int = 0) -> list[dict[str, Any]]:
        """Rows of one batch of a point; called in a worker process."""
        raise NotImplementedError

    def table_of(self, point: Point, row: Mapping[str, Any]) -> str:
        """Which table a row of a point goes into; all but the point's own hold detail, and steer nothing."""
        return point.table

    def pooled(self, batches: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
        """Rows of a point from those of its batches: counts added, intervals anew, the rest as in the first batch."""
        if len(batches) == 1:
            return list(batches[0])
        return [dict(same[0]) | pool(same).row() for same in zip(*batches, strict=True)]

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """Write the report of all rows by table; returns the page to show."""
        raise NotImplementedError

    def seconds(self, point: Point) -> float:
        """Rough CPU seconds of one batch of a point, for the estimate before the first is measured."""
        raise NotImplementedError

    def rehearsal(self) -> tuple[tuple[Study, Point], ...]:
        """Short points whose CPU time, over `seconds` of them, scales the estimate; none where it needs no scale."""
        return ()

    def files(self) -> dict[str, Path]:
        """Files that a measurement reads and a worker elsewhere may not have, by what `with_files` calls them."""
        return {}

    def with_files(self, files: Mapping[str, Path]) -> Study:
        """The same study with those files at other places."""
        return self

    @property
    def needs_network(self) -> bool:
        """Whether ONNX Runtime takes part, whose version then counts."""
        return False

    @property
    def stays_here(self) -> str:
        """Why this machine alone can measure it, in words; empty where any machine can."""
        return (
            ""
            if self.max_jobs is None
            else f"it measures at most {self.max_jobs} points at once, on this machine"
        )
