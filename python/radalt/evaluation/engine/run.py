"""The sweep engine: points of a study to workers, rows to the result folder, at the end the report."""

import contextlib
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
from .study import Outcome, Point, Run, Study, kept_row, measure_point, peak_memory_bytes

if TYPE_CHECKING:
    from .cluster import Cluster


@dataclass(frozen=True)
class Progress:
    """State of a run after a point."""

    done: int  # points
    total: int
    resumed: int  # points that were measured before this start
    rows: Sequence[dict[str, Any]]  # rows of the last point; none at the first call
    measured: int  # frames of this start, of ``frames``
    frames: int
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
            if study.stays_here:
                raise WorkerError(f"--scheduler {options.scheduler}: {study.stays_here}; leave it out")
            from .cluster import Cluster

            cluster = stack.enter_context(contextlib.closing(Cluster(options.scheduler)))
        # workers elsewhere have copies
        inputs = {} if cluster else {path: _stamp(path) for path in study.files().values()}
        holds = partial(_holds, study, points)
        folder = RunFolder(options.out, head_of(study), resume=options.resume, holds=holds)
        stack.enter_context(contextlib.closing(folder))
        resumed = len(folder.done)
        jobs = max(1, min(options.jobs, study.max_jobs or options.jobs))
        todo = [point for name, point in points.items() if name not in folder.done]
        measured = _measured(study.begin(folder.path), todo, options, jobs, cluster, resumed)
        peaks: dict[int | str, int] = {}
        _write_tables(study, points, folder)
        progress(Progress(resumed, len(points), resumed, (), 0, _frames(todo), folder.rejected))
        for point, outcome, state in measured:
            for path, stamp in inputs.items():
                if _stamp(path) != stamp:
                    raise WorkerError(
                        f"{path} was changed while the run read it; put it back and go on with --resume, or begin anew"
                    )
            folder.add(point.name, outcome.rows)
            _append(study, point, folder, outcome.rows)
            peaks[outcome.process] = outcome.peak_bytes
            progress(state)
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
    found, peaks = {}, {}
    begun = study.begin(options.out)
    for point, outcome, state in _measured(begun, [*points.values()], options, max(1, jobs)):
        found[point.name] = outcome.rows
        peaks[outcome.process] = outcome.peak_bytes
        progress(state)
    wall_s = round(time.monotonic() - begin, 3)
    facts = Run(max(1, jobs), len(points), 0, wall_s, peak_memory_bytes() + sum(peaks.values()))
    return _tables(study, points, found), facts


def _measured(
    study: Study,
    points: Sequence[Point],
    options: Options,
    jobs: int,
    cluster: "Cluster | None" = None,
    resumed: int = 0,
) -> Iterator[tuple[Point, Outcome, Progress]]:
    """Every point as it is measured, and the state of the run after it, with the rows of the point's own table."""
    measured, frames, total = 0, _frames(points), resumed + len(points)
    for done, (index, outcome) in enumerate(_outcomes(study, points, options, jobs, cluster), resumed + 1):
        point = points[index]
        shown = [row for row in outcome.rows if study.table_of(point, row) == point.table]
        measured += _frames([point])
        yield point, outcome, Progress(done, total, resumed, shown, measured, frames)


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


def _stamp(path: Path) -> tuple[int, ...]:
    """Time and size of an input file, which must not change during a run; empty where there is none."""
    try:
        status = path.stat()
    except OSError:  # reported where the file is used
        return ()
    return status.st_mtime_ns, status.st_size


def _holds(study: Study, points: dict[str, Point], entry: dict[str, Any]) -> bool:
    """Whether an entry holds rows of one of the study's points, with the columns and types of their tables."""
    point = points.get(entry["point"])
    try:
        return point is not None and all(kept_row(study, point, row) == row for row in entry["rows"])
    except (AttributeError, TypeError, ValueError, OverflowError):
        return False


def _frames(points: Sequence[Point]) -> int:
    """Frames of points, at least one each, by which progress is counted."""
    return sum(max(1, point.frames) for point in points)
