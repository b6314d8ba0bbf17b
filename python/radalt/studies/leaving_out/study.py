"""What leaving out saves: scenes pruned by the planner against the same scenes with everything built, in one run."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...core.mitigation import METHODS
from ...core.paths import share_dir
from ...core.scene import Scene
from ...evaluation.engine.study import Point, Run, Study
from ...evaluation.engine.task import peak_memory_bytes
from ...evaluation.flowgraph import FlowgraphError
from ...evaluation.flowgraph.generate import Prepared, generate, prepare
from ...evaluation.flowgraph.rewrite import load_grc, prune, simulate
from ...evaluation.flowgraph.run import run_point
from ...evaluation.results.chain import seconds_per_frame
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.rows import Columns
from .scenes import SCENES, scene_of

__all__ = ["LeavingOutStudy", "run_apart", "run_once"]


def prepare_unpruned(scene: Scene, build_dir: Path) -> Prepared:
    """The flowgraph of a scene with every chain that the companion's file has, the jammer's included."""
    data = simulate(load_grc(share_dir() / "flowgraphs" / "ota_b210.grc"), "ota_sim_full")
    return Prepared(generate(prune(data, tuple(METHODS), True), build_dir), tuple(METHODS))


def run_once(name: str, frames: int, built: str) -> dict[str, Any]:
    """CPU seconds, peak memory and a digest of the scene's own results, in this process.

    ``built``: ``pruned`` or ``all``.
    """
    scene = scene_of(name, frames)
    with tempfile.TemporaryDirectory() as folder:
        if built == "all":
            prepared = prepare_unpruned(scene, Path(folder))
        else:
            prepared = prepare(scene, scene.methods, folder)
        begin, wall = time.process_time(), time.monotonic()
        result = run_point(prepared, scene)
        cpu, wall = time.process_time() - begin, time.monotonic() - wall
    digest = hashlib.sha256(
        b"".join(np.ascontiguousarray(result.results[m]).tobytes() for m in scene.methods)
    )
    asked = ("onnxruntime", "matplotlib", "gnuradio.uhd", "PyQt5")
    return {
        "cpu_s": cpu,
        "wall_s": wall,
        "memory_bytes": peak_memory_bytes(),
        "digest": digest.hexdigest(),
        "declared": int(sum(result.results[m]["valid"].sum() for m in scene.methods)),
        "modules": ", ".join(m for m in asked if m in sys.modules),
    }


def run_apart(name: str, frames: int, built: str) -> dict[str, Any]:
    """`run_once` in a process of its own, whose memory and imports are the run's alone."""
    code = (
        f"import json; from {__name__} import run_once; "
        f"print('RESULT', json.dumps(run_once({name!r}, {frames}, {built!r})))"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=300)
    for line in done.stdout.splitlines():
        if line.startswith("RESULT "):
            return json.loads(line.removeprefix("RESULT "))
    last = done.stderr.strip().splitlines()[-1:] or ["no output"]
    raise FlowgraphError(f"{name}: {last[0]}")


_COLUMNS = Columns(
    names=(
        "scene",
        "built",
        "turn",
        "frames",
        "cpu_s",
        "wall_s",
        "memory_bytes",
        "digest",
        "declared",
        "modules",
    ),
    text=frozenset({"scene", "built", "digest", "modules"}),
    whole=frozenset({"turn", "frames", "memory_bytes", "declared"}),
    timing=frozenset({"cpu_s", "wall_s", "memory_bytes"}),
)
_START_S = 3.0  # imports, and GNU Radio's compiler
_ALL_S_PER_FRAME = 0.02


@dataclass(frozen=True)
class LeavingOutStudy(Study):
    """Scenes run as planned and with everything built, by turns.

    Attributes
    ----------
    frames : int
        At each altitude.
    repeats : int
        Runs of each.
    scenes : tuple of str
        Of `SCENES` and `CHECKED`.
    """

    frames: int = 100
    repeats: int = 3
    scenes: tuple[str, ...] = tuple(SCENES)

    tables: ClassVar[Mapping[str, Columns]] = {"rows": _COLUMNS}
    max_jobs: ClassVar[int | None] = 1
    published: ClassVar[Mapping[str, str]] = {"report.md": "leaving_out.md"}

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return dict(vars(self))

    def points(self) -> Sequence[Point]:
        """The scenes."""
        return [Point(name, 2 * self.repeats * self._total_frames(name)) for name in self.scenes]

    def _total_frames(self, name: str) -> int:
        return scene_of(name, self.frames).altitude.programme.total_frames

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """A row per run."""
        where = {"scene": point.name, "frames": self._total_frames(point.name)}
        return [
            where | {"built": built, "turn": turn} | run_apart(point.name, self.frames, built)
            for turn in range(1, self.repeats + 1)
            for built in ("pruned", "all")
        ]

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `report.write_report`."""
        from .report import write_report

        return write_report(folder, self, rows["rows"], run)

    def seconds(self, point: Point) -> float:
        """See `Study`."""
        scene = scene_of(point.name, self.frames)
        alone = sum(seconds_per_frame(m, scene.waveform, scene.altimeter_settings) for m in scene.methods)
        per_frame = 3e-4 + 1.6 * alone + _ALL_S_PER_FRAME
        return self.repeats * (2 * _START_S + self._total_frames(point.name) * per_frame)

    @property
    def needs_network(self) -> bool:
        """Always: among everything that can be built is the network."""
        return True
