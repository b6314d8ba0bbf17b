"""What leaving out saves: scenes as the planner prunes them, against the same scenes with everything built."""

import hashlib
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...core.mitigation import METHODS
from ...core.scene import Scene, parse_scene
from ...evaluation.engine.pool import call_apart
from ...evaluation.engine.study import Point, Study, peak_memory_bytes
from ...evaluation.flowgraph.generate import prepare
from ...evaluation.flowgraph.run import run_point
from ...evaluation.results.rows import TEXT, WHOLE, Columns

_ALTITUDES = [1200.0, 600.0, 150.0, 30.0]
_QPSK = {"qpsk": {"sir_db": -20.0, "overlap": 0.5, "evm": "typical"}}
SCENES: dict[str, dict[str, Any]] = {
    "no interference, no mitigation": {"methods": ["none"]},
    "the same below 150 m": {"methods": ["none"], "altitude": {"programme_m": [150.0, 100.0, 50.0, 10.0]}},
    "no interference, whitening": {"methods": ["none", "whitening"]},
    "QPSK, whitening": {"methods": ["none", "whitening"], "interference": _QPSK},
    "QPSK, whitening and tcae": {"methods": ["none", "whitening", "tcae"], "interference": _QPSK},
}
# further paths through the channel, on which tests show that leaving out changes no bit; not in the table
CHECKED: dict[str, dict[str, Any]] = {
    "LMS with the reference as input, and NLMS": {
        "methods": ["lms_reference_input", "nlms"],
        "interference": _QPSK,
    },
    "true delay and Doppler, whitening": {
        "methods": ["none", "whitening"],
        "altitude": {"mode": "true_delay", "vertical_speed_m_per_s": -40.0},
    },
    "landing, extended ground, NLMS": {
        "methods": ["none", "nlms"],
        "landing": {},
        "return": "terrain",
        "altitude": {"frames": 1, "landing_frames": 6},
    },
}


def scene_of(name: str, frames: int) -> Scene:
    """A scene by its name, with ``frames`` at each altitude; a landing has its own number of frames."""
    data = dict((SCENES | CHECKED)[name])
    programme = {} if "landing" in data else {"programme_m": _ALTITUDES, "frames": frames}
    altitude = programme | data.pop("altitude", {})
    return parse_scene(data | {"altitude": altitude, "seed": 5})


def run_once(name: str, frames: int, built: str) -> dict[str, Any]:
    """CPU seconds, peak memory, digest of a scene's results; ``built``: ``pruned`` or ``all``; in this process."""
    scene = scene_of(name, frames)
    with tempfile.TemporaryDirectory() as folder:
        methods, jammer = (tuple(METHODS), True) if built == "all" else (scene.methods, None)
        prepared = prepare(scene, methods, folder, jammer=jammer)
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


_TIMING = ("cpu_s", "wall_s", "memory_bytes")
_COLUMNS = Columns(
    ("scene", "built", "turn", "frames", *_TIMING, "digest", "declared", "modules"),
    text=TEXT - {"declared"},  # here a count
    whole=WHOLE | {"declared"},
    timing=frozenset(_TIMING),
)


@dataclass(frozen=True)
class LeavingOutStudy(Study):
    """Scenes as planned and with everything built, by turns."""

    frames: int = 100  # frames at each altitude
    repeats: int = 3  # runs of each
    scenes: tuple[str, ...] = tuple(SCENES)  # names in `SCENES` and `CHECKED`

    tables: ClassVar[Mapping[str, Columns]] = {"rows": _COLUMNS}
    max_jobs: ClassVar[int | None] = 1
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "leaving_out.md",
        "rows.csv": "data/leaving_out.csv",
        "figures/leaving_out.png": "figures/leaving_out.png",
    }

    def head(self) -> dict[str, Any]:
        return dict(vars(self))

    def points(self) -> Sequence[Point]:
        """The scenes."""
        return [Point(name, 2 * self.repeats * self._total_frames(name)) for name in self.scenes]

    def _total_frames(self, name: str) -> int:
        return scene_of(name, self.frames).altitude.programme.total_frames

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """A row per run, each in a process of its own, so that memory and imports are that run's alone."""
        where = {"scene": point.name, "frames": self._total_frames(point.name)}
        return [
            where
            | {"built": built, "turn": turn}
            | call_apart(__name__, "run_once", point.name, self.frames, built)
            for turn in range(1, self.repeats + 1)
            for built in ("pruned", "all")
        ]

    @property
    def needs_network(self) -> bool:
        """Always: everything built includes the network."""
        return True
