"""The sweep engine: points of a study to workers, rows to the result folder, at the end the report."""

import contextlib
import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..results.figure import own_style
from ..results.folder import RunFolder, versions
from .options import Options
from .pool import WorkerError, run_tasks
from .study import Point, Run, Study
from .task import Outcome, kept_row, measure_point, peak_memory_bytes

if TYPE_CHECKING:
    from .cluster import Cluster


@dataclass(frozen=True)
class Progress:
    """State of a run after a point."""

    done: int  # points
    total: int
    resumed: int  # points that were measured before this start
    rows: Sequence[dict[str, Any]]  # rows of the last point; none at the first call
    remaining_s: float | None  # by the time of the points so far; None before the first
    rejected: Sequence[str] = ()  # invalid lines of the journal; their points are measured again


def head_of(study: Study) -> dict[str, Any]:
    """Content of a result folder's marker: the study's head, and the versions that its rows depend on."""
    return {"study": type(study).__name__, **study.head(), "versions": versions(study.needs_network)}


def run(study: Study, options: Options, progress: Callable[[Progress], None] = lambda _: None) -> Path:
    """Measure every point of a study and write its result folder; returns the path of its page.

    Rows are appended in the order of arrival and finally written in the study's order: they are equal to the byte for
    any number of workers, here or on a cluster, and for a run that was killed and resumed.

    Raises FolderError, WorkerError, and errors of the study, one line for the user; the rows so far are kept.
    """
    begin = time.monotonic()
    points = {point.name: point for point in study.points()}
    with contextlib.ExitStack() as stack:
        # connect first: without a cluster no folder is created
        cluster = None
        if options.scheduler:
            cluster = stack.enter_context(contextlib.closing(_cluster(study, options.scheduler)))
        inputs = None if cluster else _Inputs(study)  # workers elsewhere have copies
        holds = partial(_holds, study, points)
        folder = RunFolder(options.out, head_of(study), resume=options.resume, holds=holds)
        stack.enter_context(contextlib.closing(folder))
        resumed = len(folder.done)
        jobs = max(1, min(options.jobs, study.max_jobs or options.jobs))
        todo = [point for name, point in points.items() if name not in folder.done]
        outcomes = _outcomes(study.begin(folder.path), todo, options, jobs, cluster)
        remaining = _Remaining(todo, jobs)
        peaks: dict[int | str, int] = {}
        _write_tables(study, points, folder)
        progress(Progress(resumed, len(points), resumed, (), None, folder.rejected))
        for count, (index, outcome) in enumerate(outcomes, start=1):
            if inputs is not None:
                inputs.check()
            point = todo[index]
            folder.add(point.name, outcome.rows)
            _append(study, point, folder, outcome.rows)
            peaks[outcome.process] = outcome.peak_bytes
            shown = _own_rows(study, point, outcome.rows)
            progress(Progress(resumed + count, len(points), resumed, shown, remaining.seconds(point)))
        facts = Run(
            jobs=len(peaks) if cluster else jobs,
            points=len(points),
            points_resumed=resumed,
            wall_s=round(time.monotonic() - begin, 3),
            peak_memory_bytes=peak_memory_bytes() + sum(peaks.values()),
            command=options.command,
            by=options.by,
        )
        with own_style():
            return study.report(folder, _write_tables(study, points, folder), facts)


def in_memory(
    study: Study, jobs: int, progress: Callable[[Progress], None] = lambda _: None
) -> tuple[dict[str, list[dict[str, Any]]], Run]:
    """Rows by table and facts of a run that writes nothing; ``jobs`` as in `Options`.

    Raises WorkerError, and errors of the study, one line for the user.
    """
    begin = time.monotonic()
    points, options = {point.name: point for point in study.points()}, Options(Path(), jobs=jobs)
    found, todo, peaks = {}, list(points.values()), {}
    remaining = _Remaining(todo, max(1, jobs))
    outcomes = _outcomes(study.begin(options.out), todo, options, max(1, jobs), None)
    for count, (index, outcome) in enumerate(outcomes, start=1):
        found[todo[index].name] = outcome.rows
        peaks[outcome.process] = outcome.peak_bytes
        shown = _own_rows(study, todo[index], outcome.rows)
        progress(Progress(count, len(points), 0, shown, remaining.seconds(todo[index])))
    wall_s = round(time.monotonic() - begin, 3)
    facts = Run(max(1, jobs), len(points), 0, wall_s, peak_memory_bytes() + sum(peaks.values()))
    return _tables(study, points, found), facts


def _own_rows(study: Study, point: Point, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A point's rows in its own table."""
    return [row for row in rows if study.table_of(point, row) == point.table]


def _outcomes(
    study: Study, points: Sequence[Point], options: Options, jobs: int, cluster: "Cluster | None"
) -> Iterator[tuple[int, Outcome]]:
    """(index, outcome) of every point, as they are measured."""
    limit_s = options.time_limit_s
    if cluster is not None:
        return cluster.run_tasks(study, points, time_limit_s=limit_s)
    measure = partial(measure_point, study)
    if not options.jobs:
        return enumerate(map(measure, points))
    return run_tasks(measure, points, jobs=jobs, time_limit_s=limit_s, label=lambda point: point.name)


def _tables(
    study: Study, points: dict[str, Point], done: Mapping[str, Sequence[dict[str, Any]]]
) -> dict[str, list[dict[str, Any]]]:
    """Rows by table, in the study's order."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in study.tables}
    for name, point in points.items():
        for row in done.get(name, ()):
            rows[study.table_of(point, row)].append(row)
    return rows


def _write_tables(
    study: Study, points: dict[str, Point], folder: RunFolder
) -> dict[str, list[dict[str, Any]]]:
    """Write the tables of the journal's rows; returns the rows by table."""
    rows = _tables(study, points, folder.done)
    for name, table in rows.items():
        if table:
            folder.write_text(f"{name}.csv", study.tables[name].csv(table))
        else:
            (folder.path / f"{name}.csv").unlink(missing_ok=True)  # of an earlier start
    return rows


def _append(study: Study, point: Point, folder: RunFolder, rows: Sequence[dict[str, Any]]) -> None:
    """Append the rows of a point to their tables."""
    for name, columns in study.tables.items():
        mine = [row for row in rows if study.table_of(point, row) == name]
        path = folder.path / f"{name}.csv"
        if mine and not path.exists():
            folder.write_text(path.name, columns.csv(mine))
        elif mine:
            with path.open("a", encoding="utf-8", newline="") as file:
                file.write(columns.csv(mine, header=False))


class _Inputs:
    """Input files of a measurement, which must not change during the run."""

    def __init__(self, study: Study) -> None:
        self._held = {path: (_stamp(path), _sha256(path)) for path in study.files().values()}

    def check(self) -> None:
        """Raise if the content of a file has changed; a change of its time only is allowed."""
        for path, (stamp, digest) in self._held.items():
            now = _stamp(path)
            if now == stamp:
                continue
            if _sha256(path) != digest:
                raise WorkerError(
                    f"{path} was changed while the run read it; put it back and go on with --resume, or begin anew"
                )
            self._held[path] = now, digest


def _stamp(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:  # reported where the file is used
        return ""


def _holds(study: Study, points: dict[str, Point], entry: dict[str, Any]) -> bool:
    """Whether an entry holds rows of one of the study's points, with the columns and types of their tables."""
    point = points.get(entry["point"])
    try:
        return point is not None and all(kept_row(study, point, row) == row for row in entry["rows"])
    except (AttributeError, TypeError, ValueError, OverflowError):
        return False


def _cluster(study: Study, scheduler: str) -> "Cluster":
    if study.stays_here:
        raise WorkerError(f"--scheduler {scheduler}: {study.stays_here}; leave it out")
    from .cluster import Cluster

    return Cluster(scheduler)


class _Remaining:
    """Remaining time, in proportion to the frames of the points measured so far."""

    def __init__(self, points: Sequence[Point], jobs: int) -> None:
        self._left, self._jobs = {point.name: max(1, point.frames) for point in points}, jobs
        self._total, self._begun = sum(self._left.values()), time.monotonic()

    def seconds(self, point: Point) -> float:
        """When ``point`` has been measured, too."""
        del self._left[point.name]
        left = sum(self._left.values())
        # the other workers are in the middle of a point each
        under_way = 0.5 * min(self._jobs - 1, len(self._left)) * left / max(1, len(self._left))
        left -= under_way
        return (time.monotonic() - self._begun) * left / (self._total - left)
