"""The sweep engine: points of a study to workers, rows to the result folder, at the end the report."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..results.folder import RunFolder, versions
from .estimate import estimate
from .options import Options
from .pool import WorkerError, run_tasks
from .precision import batches_needed, check_precision
from .study import Point, Run, Study
from .task import Outcome, Task, kept_row, measure_task, peak_memory_bytes

if TYPE_CHECKING:
    from .cluster import Cluster

__all__ = ["Progress", "run"]


@dataclass(frozen=True)
class Progress:
    """State of a run after a batch of a point.

    Attributes
    ----------
    done, total : int
        Batches; ``total`` grows once, when the pilots have set the number of batches.
    resumed : int
        Batches that were measured before this start.
    rejected : sequence of str
        Invalid lines of the journal; their batches are measured again.
    rows : list of dict
        Rows of the last batch; none at the first call.
    remaining_s : float
        Estimated remaining time.
    """

    done: int
    total: int
    resumed: int
    rows: Sequence[dict[str, Any]]
    remaining_s: float
    rejected: Sequence[str] = ()


def _own(study: Study, point: Point, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the point's table."""
    return [row for row in rows if study.table_of(point, row) == point.table]


def head_of(study: Study) -> dict[str, Any]:
    """Content of a result folder's marker: the study's head, and the versions that its rows depend on."""
    return {"study": type(study).__name__, **study.head(), "versions": versions(study.needs_network)}


def run(study: Study, options: Options, progress: Callable[[Progress], None] = lambda _: None) -> Path:
    """Measure every point of a study and write its result folder; returns the path of its page.

    Rows are appended in the order of arrival and finally written in the study's order: they are equal to the byte for
    any number of workers, here or on a cluster, and for a run that was killed and resumed.

    Raises
    ------
    FolderError, WorkerError, and errors of the study
        One line for the user; the rows so far are kept.
    """
    begin = time.monotonic()
    points = list(study.points())
    if options.precision is not None:
        check_precision([p.frames for p in points], options.precision)
    with contextlib.ExitStack() as stack:
        # connect first: without a cluster no folder is created
        cluster = stack.enter_context(_cluster(study, options.scheduler)) if options.scheduler else None
        inputs = None if cluster else _Inputs(study)  # workers elsewhere have copies
        folder = stack.enter_context(
            contextlib.closing(
                RunFolder(
                    options.out,
                    head_of(study),
                    resume=options.resume,
                    holds=lambda entry: _holds(study, points, entry),
                )
            )
        )
        return _run(study, points, _Watch(study, folder, options, progress, cluster, inputs), begin)


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


def _holds(study: Study, points: Sequence[Point], entry: dict[str, Any]) -> bool:
    """Whether an entry holds rows of one of the study's points, with the columns and types of their tables."""
    point = next((p for p in points if p.name == entry["point"]), None)
    if point is None or entry["batch"] < 0:
        return False
    try:
        return all(kept_row(study, point, row) == row for row in entry["rows"])
    except (AttributeError, TypeError, ValueError, OverflowError):
        return False


def _cluster(study: Study, scheduler: str) -> Cluster:
    if study.stays_here:
        raise WorkerError(f"--scheduler {scheduler}: {study.stays_here}; leave it out")
    from .cluster import Cluster

    return Cluster(scheduler)


def _run(study: Study, points: list[Point], watch: _Watch, begin: float) -> Path:
    folder, options = watch.folder, watch.options
    ready = study.begin(folder.path)
    watch.stage(ready, [(point, 0) for point in points])
    if options.precision is not None:
        more = {
            p.name: batches_needed(_own(study, p, folder.done[p.name, 0]), options.precision)
            if p.sampled
            else 1
            for p in points
        }
        watch.stage(ready, [(p, b) for p in points for b in range(1, more[p.name])])
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in study.tables}
    for point in points:
        count = 1 if options.precision is None else more[point.name]
        batches = [folder.done[point.name, b] for b in range(count)]
        for row in study.pooled(batches) if count > 1 else batches[0]:
            rows[study.table_of(point, row)].append(kept_row(study, point, row))
    for name, table in rows.items():
        if table:
            folder.write_text(f"{name}.csv", study.tables[name].csv(table))
    how = Run(
        jobs=len(watch.peaks) if options.scheduler else watch.jobs,
        points=len(points),
        points_resumed=watch.resumed,
        wall_s=round(time.monotonic() - begin, 3),
        peak_memory_bytes=peak_memory_bytes() + sum(watch.peaks.values()),
        command=options.command,
        precision=options.precision,
    )
    return study.report(folder, rows, how)


class _Watch:
    """Submits batches and collects results, with an estimate of the remaining time."""

    def __init__(
        self,
        study: Study,
        folder: RunFolder,
        options: Options,
        progress: Callable[[Progress], None],
        cluster: Cluster | None,
        inputs: _Inputs | None,
    ) -> None:
        self.folder, self.options, self.progress = folder, options, progress
        self.jobs = max(1, min(options.jobs, study.max_jobs or options.jobs))
        self.peaks: dict[int | str, int] = {}
        self._cluster, self._inputs = cluster, inputs
        self.total = self.done = self.resumed = 0
        self._study = study
        self._streamed: set[str] = set()
        self._begun = time.monotonic()

    def stage(self, study: Study, wanted: Sequence[tuple[Point, int]]) -> None:
        """Measure the missing batches."""
        todo = [(p, b) for p, b in wanted if (p.name, b) not in self.folder.done]
        self.total += len(wanted)
        self.done += len(wanted) - len(todo)
        self.resumed += len(wanted) - len(todo)
        if not wanted:
            return
        first = estimate(self._study, [p for p, _ in todo], self.jobs) if todo else 0.0
        self._tell((), first, 0, len(todo))
        stream = self._stream_files(study)
        tasks = [Task(study, p, b) for p, b in todo]
        for count, (index, outcome) in enumerate(self._outcomes(tasks), start=1):
            if self._inputs is not None:
                self._inputs.check()
            point, batch = todo[index]
            self.folder.add(point.name, batch, outcome.rows)
            stream(point, outcome.rows)
            self.peaks[outcome.process] = outcome.peak_bytes
            self.done += 1
            self._tell(_own(study, point, outcome.rows), first, count, len(todo))

    def _stream_files(self, study: Study) -> Callable[[Point, Sequence[dict[str, Any]]], None]:
        """Append rows to the tables in the order of arrival; `run` rewrites them in the study's order.

        Each table starts with the rows of the journal, whatever an earlier start has written.
        """
        points = {point.name: point for point in self._study.points()}

        def held(table: str) -> list[dict[str, Any]]:
            entries = self.folder.done.items()
            return [r for (p, _), rows in entries for r in rows if study.table_of(points[p], r) == table]

        def append(point: Point, rows: Sequence[dict[str, Any]]) -> None:
            for table in dict.fromkeys(study.table_of(point, row) for row in rows):
                name, columns = f"{table}.csv", study.tables[table]
                if name not in self._streamed:
                    self._streamed.add(name)
                    self.folder.write_text(name, columns.csv(held(table)))
                    continue
                mine = [row for row in rows if study.table_of(point, row) == table]
                with (self.folder.path / name).open("a", encoding="utf-8", newline="") as file:
                    file.write(columns.csv(mine, header=False))

        return append

    def _outcomes(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
        limit = self.options.time_limit_s
        if self._cluster is not None:
            return self._cluster.run_tasks(tasks, time_limit_s=limit)
        if not self.options.jobs:
            return ((index, measure_task(task)) for index, task in enumerate(tasks))
        return run_tasks(measure_task, tasks, jobs=self.jobs, time_limit_s=limit, label=lambda t: t.label)

    def _tell(self, rows: Sequence[dict[str, Any]], first_s: float, count: int, todo: int) -> None:
        """Report progress; measured times replace the study's estimates point by point."""
        spent = time.monotonic() - self._begun
        known = spent / count * (todo - count) if count else 0.0
        weight = min(1.0, count / max(2 * self.jobs, 1))
        remaining = weight * known + (1 - weight) * max(0.0, first_s - spent if count else first_s)
        rejected = self.folder.rejected
        self.progress(Progress(self.done, self.total, self.resumed, rows, remaining, rejected))
