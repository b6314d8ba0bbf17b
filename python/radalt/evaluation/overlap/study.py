"""One evaluation: points to worker processes, rows to the result folder, at the end the report."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.mitigation import CUSTOM, METHODS, MitigationError, create
from ...core.scene import Scene, SceneError
from ..engine.workers import run_tasks
from ..results.folder import ResultFolder
from ..results.score import score
from .points import Point, scene_at, sweep_points
from .rows import RowFile, make_row

__all__ = ["Outcome", "Task", "check_methods", "check_scene", "evaluate", "measure"]

_KEPT = ("model", "sha256", "placeholder", "providers", "wiring", "step")


@dataclass(frozen=True)
class Task:
    """What a worker needs for one point.

    Attributes
    ----------
    scene : Scene
        At the point.
    point : Point
    prepared : flowgraph.Prepared or None
        The generated flowgraph; None on the air.
    hardware : dict or None
        Options of `hardware.run_hardware`; None in simulation.
    capture : Path or None
        SigMF recording of the point, without ending; None for none.
    """

    scene: Scene
    point: Point
    prepared: Any = None
    hardware: dict[str, Any] | None = None
    capture: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """What a worker gives back: rows of a point, its process id and highest memory use so far."""

    rows: list[dict[str, Any]]
    process: int
    peak_bytes: int


def check_scene(scene: Scene) -> None:
    """Build once what the flowgraph will build, so that whatever does not fit is said before anything runs.

    Raises
    ------
    SceneError, MitigationError
        One line.
    """
    from ...core.channel.simulated import SimulatedChannel
    from ...core.receiver.altimeter import Altimeter

    try:
        programme = scene.altitude.programme
        true_delay = programme if scene.altitude.mode == "true_delay" else None
        Altimeter(scene.waveform, scene.altimeter_settings)
        frames = programme.total_frames
        SimulatedChannel(scene.waveform, scene.channel, true_delay=true_delay, frames=frames)
        for interferer in scene.interference:
            rng = np.random.default_rng(0)
            interferer.emitter.samples(scene.waveform.samples_per_frame, scene.waveform.rate_hz, rng)
        sweep_points(scene)
    except ValueError as error:
        raise SceneError(f"scene {scene.name}: {error}") from None
    check_methods(scene)


def check_methods(scene: Scene) -> dict[str, dict[str, Any]]:
    """Build every method of a scene once, before anything runs; returns what reports say of each.

    Raises
    ------
    SceneError, MitigationError
        If there is no method, one is unknown, named twice or cannot be built; one line.
    """
    if not scene.methods:
        raise SceneError(f"methods is empty; name at least one of: {', '.join(METHODS)}")
    twice = [m for m in scene.methods if scene.methods.count(m) > 1]
    if twice:
        raise SceneError(f"methods holds {twice[0]!r} more than once")
    stray = [m for m in scene.method_options if m not in METHODS and m != CUSTOM]
    if stray:
        raise MitigationError(f"method_options names {stray[0]!r}; known methods: {', '.join(METHODS)}")
    out = {}
    for name in scene.methods:
        options = scene.method_options.get(name) or {}
        status = create(name, scene.waveform, **options).status()
        out[name] = {key: status[key] for key in _KEPT if key in status}
    return out


def measure(task: Task) -> Outcome:
    """Run the flowgraph once and score every method; called in a worker."""
    if task.hardware is None:
        from ..flowgraph.run import run_point

        result = run_point(task.prepared, task.scene, capture=task.capture)
    else:
        from ..radios.hardware import run_hardware

        result = run_hardware(task.scene, task.scene.methods, capture=task.capture, **task.hardware)
    programme = task.scene.altitude.programme
    rows = [
        make_row(
            method,
            task.scene.interference_name,
            task.point,
            task.scene.seed,
            score(frames, programme),
            diverged_frames=int(result.status[method].get("diverged_frames", 0)),
            segmenter=result.segmenter,
            ms_per_frame=result.ms_per_frame[method],
            real_time_factor=result.real_time_factor,
        )
        for method, frames in result.results.items()
    ]
    return Outcome(rows, os.getpid(), peak_memory_bytes())


def peak_memory_bytes() -> int:
    """Highest resident memory of this process so far.

    From the process's own page: ``ru_maxrss`` of a spawned process starts at what its parent had.
    """
    for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return 0


def evaluate(
    scene: Scene,
    out: Path,
    *,
    jobs: int = 2,
    resume: bool = False,
    time_limit_s: float = 120.0,
    progress: Callable[[int, int, Sequence[dict[str, Any]]], None] = lambda done, total, rows: None,
    hardware: dict[str, Any] | None = None,
    capture: bool = False,
) -> Path:
    """Measure every point of a scene through the flowgraph and write the result folder (DESIGN.md 8).

    Parameters
    ----------
    scene : Scene
        With its sweep, methods and seed: everything the rows depend on.
    out : Path
        Result folder.
    jobs : int
        Worker processes; changes no row.
    resume : bool
        Complete the run that ``out`` holds.
    time_limit_s : float
        Longest time for one point.
    progress : callable
        Called as ``progress(points done, points in all, rows of the point just measured)``, first without rows.
    hardware : dict, optional
        Measure on the air, with these options of `hardware.run_hardware`; default the simulated channel.
    capture : bool
        Record what the receiver hears at every point, as SigMF below ``out/captures``.

    Returns
    -------
    Path
        ``report.md``.

    Raises
    ------
    SceneError, MitigationError, flowgraph.FlowgraphError, workers.WorkerError
        One line for the user; the rows so far are kept.
    """
    from ..flowgraph import run as flowgraph
    from .report import write_report

    begin = time.monotonic()
    points = sweep_points(scene)
    methods = check_methods(scene)
    source = "simulated" if hardware is None else "air"
    folder = ResultFolder(out, scene, methods, resume=resume, source=source)
    rows = RowFile(out / "rows.csv", points, scene.methods)
    # the interference-free ceiling is part of every report; where the sweep has no overlap 0 it is measured apart
    apart = [] if any(p.overlap == 0 for p in points) else _ceiling_points(points)
    ceiling = RowFile(out / "ceiling.csv", apart, scene.methods) if apart else rows
    todo = [(p, rows) for p in points if not rows.has(p)] + [
        (p, ceiling) for p in apart if not ceiling.has(p)
    ]
    total = len(points) + len(apart)
    if hardware is None:
        tasks, left_out = _tasks(scene, [p for p, _ in todo], out / "flowgraph")
    else:
        tasks = [Task(scene_at(scene, p), p, hardware=hardware) for p, _ in todo]
        left_out = flowgraph.left_out(scene, scene.methods, simulated=False)
    if capture:
        tasks = [replace(task, capture=out / "captures" / _file_name(task.point)) for task in tasks]
    folder.begin(left_out)
    peaks: dict[int, int] = {}
    done = itertools.count(total - len(todo))
    progress(next(done), total, ())
    for index, outcome in run_tasks(
        measure, tasks, jobs=jobs, time_limit_s=time_limit_s, label=lambda task: task.point.label
    ):
        todo[index][1].append(outcome.rows)
        peaks[outcome.process] = outcome.peak_bytes
        progress(next(done), total, outcome.rows)
    rows.sort()
    ceiling.sort()
    return write_report(
        folder,
        rows.rows,
        [r for r in ceiling.rows if r["overlap"] == 0],
        run={
            "jobs": jobs,
            "points": total,
            "points_resumed": total - len(todo),
            "wall_s": round(time.monotonic() - begin, 3),
            "peak_memory_bytes": peak_memory_bytes() + sum(peaks.values()),
        },
    )


def _file_name(point: Point) -> str:
    parts = [f"overlap_{point.overlap:g}"]
    parts += [] if point.sir_db is None else [f"sir_{point.sir_db:g}"]
    parts += [] if point.snr_db is None else [f"snr_{point.snr_db:g}"]
    return "_".join(parts)


def _ceiling_points(points: Sequence[Point]) -> list[Point]:
    return [Point(0.0, None, snr) for snr in dict.fromkeys(p.snr_db for p in points)]


def _tasks(scene: Scene, points: Sequence[Point], build: Path) -> tuple[list[Task], list[str]]:
    """Tasks, and what is left out of their flowgraphs: one flowgraph with and one without the jammer chain."""
    from ..flowgraph.run import prepare

    scenes = [scene_at(scene, point) for point in points]
    prepared = {}
    for placed in scenes:
        if placed.has_jammer not in prepared:
            prepared[placed.has_jammer] = prepare(placed, scene.methods, build)
    tasks = [Task(s, p, prepared[s.has_jammer]) for s, p in zip(scenes, points, strict=True)]
    left_out = list(
        prepared[True].left_out if True in prepared else prepared[False].left_out if prepared else ()
    )
    if True in prepared and False in prepared:
        only = [item for item in prepared[False].left_out if item not in left_out]
        left_out += [f"at overlap 0: {item}" for item in only]
    return tasks, left_out
