"""The main study: Pd against overlap, SIR and SNR for every method, each point a run of the flowgraph."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...core.interference.emitters.recording import RecordingEmitter
from ...core.mitigation import CUSTOM, METHODS, MitigationError, create
from ...core.mitigation.tcae import default_model_path
from ...core.scene import Scene, SceneError, scene_to_mapping
from ...core.timing.leakage_file import UNCALIBRATED, leakage_canceller, leakage_path
from ..engine.own import option_files, with_option_files
from ..engine.study import Point, Run, Study
from ..results.folder import RunFolder
from ..results.rows import Columns
from ..results.score import frame_columns, trials_of
from ..simulation import run_chain
from .altitudes import ALTITUDE_COLUMNS, altitude_rows
from .points import OverlapPoint, scene_at, sweep_points
from .rows import COLUMNS, TRACKED_COLUMNS, make_row, tracked_row

DWELL_FRAMES = 400  # least frames at each altitude of a tracked flight: ten outputs
_KEPT = ("model", "sha256", "placeholder", "providers", "wiring", "step")


def check_scene(scene: Scene) -> None:
    """Construct the flowgraph's objects once, so that errors are raised before the run.

    Raises SceneError, MitigationError, one line.
    """
    from ...core.altimeter.altimeter import shared_altimeter
    from ...core.channel.simulated import SimulatedChannel

    try:
        programme = scene.altitude.programme
        true_delay = programme if scene.altitude.mode == "true_delay" else None
        shared_altimeter(scene.waveform, scene.altimeter_settings)
        frames = programme.total_frames
        SimulatedChannel(scene.waveform, scene.channel, true_delay=true_delay, frames=frames)
        for interferer in scene.interference:
            rng = np.random.default_rng(0)
            interferer.emitter.samples(scene.waveform.samples_per_frame, scene.waveform.rate_hz, rng)
        leakage_canceller(scene.segmenter.leakage_calibration, scene.waveform)
        sweep_points(scene)
        if scene.landing is not None and scene.return_model == "terrain":
            scene.landing.profile(scene.waveform, scene.altitude.landing_frames, scene.seed).check()
    except ValueError as error:
        raise SceneError(f"scene {scene.name}: {error}") from None
    check_methods(scene)


def check_methods(scene: Scene) -> dict[str, dict[str, Any]]:
    """Construct every method of a scene once, before the run; returns the description of each for reports.

    Raises SceneError, MitigationError if there is no method, one is unknown, named twice or cannot be built; one line.
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
        status = create(name, scene.waveform, **(scene.method_options.get(name) or {})).status()
        out[name] = {key: status[key] for key in _KEPT if key in status}
    return out


def _recordings(scene: Scene) -> dict[str, str]:
    """SHA-256 of the samples in use of each recording among the interferers, by its number."""
    found = {}
    for number, interferer in enumerate(scene.interference):
        emitter = interferer.emitter
        while hasattr(emitter, "emitter"):  # within effects or an amplifier
            emitter = emitter.emitter
        if isinstance(emitter, RecordingEmitter):
            found[str(number)] = hashlib.sha256(emitter.load(scene.waveform.rate_hz).tobytes()).hexdigest()
    return found


def scene_files(scene: Scene) -> dict[str, Path]:
    """Files that the rows of a scene depend on besides its methods': of its landing, and its leakage calibration."""
    landing = scene.landing if scene.return_model == "terrain" else None
    out = landing.files() if landing else {}
    if scene.segmenter.leakage_calibration not in ("", UNCALIBRATED):
        out["leakage"] = leakage_path(scene.segmenter.leakage_calibration)
    return out


def method_files(scene: Scene) -> dict[str, Path]:
    """Models and method files of a scene's methods, see `option_files`; the default network's with them."""
    out = option_files({m: scene.method_options.get(m) or {} for m in scene.methods})
    default = "tcae" in scene.methods and "tcae model" not in out
    return out | ({"tcae model": default_model_path(scene.waveform)} if default else {})


def rows_of(scene: Scene, point: OverlapPoint, result: Any) -> list[dict[str, Any]]:
    """Rows of a run (`simulation.PointResult`), one per method."""
    programme, rows = scene.altitude.programme, []
    for method, frames in result.results.items():
        trials, truth_m = trials_of(frames, programme)
        found = frame_columns(trials, truth_m, lost=programme.trial_frames - len(trials))
        row = make_row(
            *(method, scene.interference_name, point, scene.seed, found),
            diverged_frames=int(result.status[method].get("diverged_frames", 0)),
            segmenter=result.segmenter,
            ms_per_frame=result.ms_per_frame[method],
            real_time_factor=result.real_time_factor,
        )
        rows.append(row)
    return rows


def describe_rows(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    if "hazardous" in rows[0]:
        shares = ", ".join(f"{r['method']} {r['computed']}/{r['outputs']}" for r in rows)
        return f"overlap {rows[0]['overlap']:g}, tracked: computed {shares}"
    sir = "" if rows[0]["sir_db"] is None else f" SIR {rows[0]['sir_db']:g} dB"
    pds = ", ".join(f"{r['method']} {'-' if r['pd'] is None else format(r['pd'], '.3g')}" for r in rows)
    return f"overlap {rows[0]['overlap']:g}{sir}: Pd {pds}"


def _flowgraph_of(scene: Scene, point: OverlapPoint) -> str:
    """Name of the generated flowgraph for a point."""
    return f"{'jammer' if scene.has_jammer else 'clear'}{' tracked' * (point.table == 'tracked')}"


def capture_name(point: Point) -> str:
    """File name of a point's recording, without its ending."""
    return point.name.replace(", ", "_").replace(" ", "_")


@dataclass(frozen=True)
class OverlapStudy(Study):
    """A scene with its sweep, methods and seed."""

    scene: Scene
    # options of `radios.hardware.run_hardware`; None for the simulated channel
    hardware: dict[str, Any] | None = None
    # record the received samples of every point, as SigMF below ``captures`` of the result folder
    capture: bool = False
    # run every point a second time with a tracker and at least `DWELL_FRAMES` frames at each altitude
    tracked: bool = False
    # false calls the flowgraph's objects in turn (`simulation.run_chain`): equal rows without GNU Radio
    flowgraph: bool = True
    folder: Path | None = None
    prepared: tuple[tuple[str, Any], ...] = ()

    tables: ClassVar[Mapping[str, Columns]] = {
        "rows": COLUMNS,
        "ceiling": COLUMNS,
        "tracked": TRACKED_COLUMNS,
        "altitudes": ALTITUDE_COLUMNS,
    }
    published: ClassVar[Mapping[str, str]] = {"pd_vs_overlap.png": "figures/pd_vs_overlap.png"}

    @property
    def max_jobs(self) -> int | None:
        """1 with radios, since there is one pair of them."""
        return None if self.hardware is None else 1

    @property
    def stays_here(self) -> str:
        if self.capture:
            return "--capture writes its recordings where the flowgraph runs"
        return "" if self.hardware is None else "the radios are at this machine"

    @property
    def source(self) -> str:
        """Source of the samples."""
        return "simulated" if self.hardware is None else "air"

    @property
    def needs_network(self) -> bool:
        return any(METHODS[m].runs_network for m in self.scene.methods if m in METHODS)

    def check(self) -> None:
        """See `Study`; raises `SceneError` and `MitigationError`."""
        check_scene(self.scene)
        if self.tracked and self.scene.return_model == "terrain":
            raise SceneError(
                "--tracked: frames of a landing over terrain are apart in time, a tracker has nothing to sum; "
                "leave it out, or fly integrity.py --groups land"
            )

    def head(self) -> dict[str, Any]:
        files = scene_files(self.scene).items()
        inputs = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files}
        own = {"inputs_sha256": inputs, "recordings": _recordings(self.scene)}
        own["dwell_frames"] = DWELL_FRAMES if self.tracked else 0
        stated = {"source": self.source, "scene": scene_to_mapping(self.scene)}
        stated["methods"] = check_methods(self.scene)
        return stated | {name: value for name, value in own.items() if value}

    def points(self) -> Sequence[OverlapPoint]:
        """The sweep, and points without interference (the ceiling) unless the sweep has overlap 0."""
        points = sweep_points(self.scene)
        apart, tracked = [], []
        if not any(p.overlap == 0 for p in points):
            frames = self.scene.altitude.programme.trial_frames
            snrs = dict.fromkeys(p.snr_db for p in points)
            apart = [OverlapPoint.at(0.0, None, snr, frames, "ceiling") for snr in snrs]
        if self.tracked:
            frames = self._slow.altitude.programme.trial_frames
            tracked = [OverlapPoint.at(p.overlap, p.sir_db, p.snr_db, frames, "tracked") for p in points]
        return (*points, *apart, *tracked)

    @property
    def _slow(self) -> Scene:
        """The scene with altitudes that last for a tracker."""
        altitude = self.scene.altitude
        frames = max(altitude.frames, DWELL_FRAMES)
        return dataclasses.replace(self.scene, altitude=dataclasses.replace(altitude, frames=frames))

    def begin(self, folder: Path) -> OverlapStudy:
        """Generate the flowgraphs: with and without the jammer chain, as the points need."""
        if self.hardware is not None or not self.flowgraph:
            return dataclasses.replace(self, folder=folder)
        from ..flowgraph.generate import prepare

        scenes: dict[str, tuple[Scene, bool]] = {}
        for point in self.points():
            placed = scene_at(self.scene, point)
            scenes.setdefault(_flowgraph_of(placed, point), (placed, point.table == "tracked"))
        prepared = tuple(
            (name, prepare(scene, scene.methods, folder / "flowgraph", track=track))
            for name, (scene, track) in scenes.items()
        )
        return dataclasses.replace(self, folder=folder, prepared=prepared)

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """Run the flowgraph once and score every method."""
        track = point.table == "tracked"
        scene = scene_at(self._slow if track else self.scene, point)
        capture = self.folder / "captures" / capture_name(point) if self.capture else None
        if not self.flowgraph:
            result = run_chain(scene, scene.methods)
        elif self.hardware is None:
            from ..flowgraph.run import run_point

            prepared = dict(self.prepared)[_flowgraph_of(scene, point)]
            result = run_point(prepared, scene, capture=capture)
        else:
            from ..radios.hardware import run_hardware

            result = run_hardware(scene, scene.methods, capture=capture, **self.hardware)
        if track:
            programme = scene.altitude.programme
            return [
                tracked_row(m, scene.interference_name, point, scene.seed, outputs, programme)
                for m, outputs in result.outputs.items()
            ]
        return rows_of(scene, point, result) + altitude_rows(scene, point, result.results)

    def table_of(self, point: Point, row: Mapping[str, Any]) -> str:
        return "altitudes" if "altitude_low_m" in row else point.table

    def left_out(self) -> list[str]:
        """Parts that the flowgraphs leave out, with reasons."""
        from ..flowgraph.plan import make_plan

        scenes = [scene_at(self.scene, p) for p in self.points() if p.table != "tracked"]
        by_jammer = {scene.has_jammer: scene for scene in scenes}
        lists = [
            make_plan(by_jammer[jammer], self.scene.methods, simulated=self.hardware is None).left_out
            for jammer in sorted(by_jammer, reverse=True)
        ]
        first, *others = lists
        return first + [f"at overlap 0: {item}" for other in others for item in other if item not in first]

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        from .report import write_report

        return write_report(folder, self.scene, rows, run, left_out=self.left_out())

    def files(self) -> dict[str, Path]:
        """Flowgraphs, files of the scene, models and method files."""
        out = {f"flowgraph {name}": prepared.module for name, prepared in self.prepared}
        return out | scene_files(self.scene) | method_files(self.scene)

    def with_files(self, files: Mapping[str, Path]) -> OverlapStudy:
        scene, its = self.scene, scene_files(self.scene)
        segmenter, landing = scene.segmenter, scene.landing
        if "leakage" in its:
            segmenter = dataclasses.replace(segmenter, leakage_calibration=str(files["leakage"]))
        if landing and "trajectory" in its:
            landing = landing.with_files(files)
        prepared = tuple(
            (name, dataclasses.replace(one, module=files[f"flowgraph {name}"])) for name, one in self.prepared
        )
        options = with_option_files(scene.method_options, files)
        scene = dataclasses.replace(scene, segmenter=segmenter, landing=landing, method_options=options)
        return dataclasses.replace(self, scene=scene, prepared=prepared)
