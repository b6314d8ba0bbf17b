"""Scores of recordings through the flowgraph: ``ota_eval.py --replay`` writes rows and frames."""

import csv
import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.altimeter.altimeter import Reason
from ...core.radio.recording import Capture, RecordingError, open_capture
from ...core.scene import Scene
from ..overlap.points import changed, sweep_points
from ..overlap.rows import COLUMNS
from ..overlap.study import check_methods, rows_of
from ..results.figure import new_figure, own_style, save_figure
from ..results.folder import FolderError, RunFolder
from ..results.style import series_style
from ..simulation import PointResult
from .generate import Prepared, generate, shipped
from .rewrite import from_recording, prune
from .run import load_class, result_of, run_to_end

_SPREAD = ("altitude_p05_m", "altitude_median_m", "altitude_p95_m")


def score_recording(
    path: Path | str,
    out: Path,
    *,
    scene: Scene | None = None,
    methods: Sequence[str] | None = None,
    own: Mapping[str, dict[str, Any]] | None = None,
    reference_m: float | None = None,
) -> list[dict[str, Any]]:
    """Run a recording through every method's chain; write ``rows.csv`` or ``summary.json``, and ``frames.csv``.

    Returns rows of `make_row` where the altitudes are known, else of `summary`. ``scene`` is needed for recordings of
    other programs; for those of this program it replaces all but altitudes and seed. ``reference_m`` is the altitude at
    the beginning of another program's recording; without it, altitudes are relative to that. Raises RecordingError,
    SceneError, MitigationError, FlowgraphError, one line.
    """
    capture = open_capture(path)
    placed, known = replay_scene(capture, scene)
    if known and reference_m is not None:
        raise RecordingError(
            f"--reference-m {reference_m:g}: {path} states its altitudes; leave the option out"
        )
    placed = changed(placed, methods=methods, own=own)
    check_methods(placed)
    if (out / "frames.csv").exists():
        raise FolderError(f"{out} holds a run already; name another --out")
    head = {"study": "replay", "recording": str(path), "methods": placed.methods}
    folder = RunFolder(out, head, replace=True)  # one that failed is begun anew
    prepared = prepare_replay(placed.methods, out / "flowgraph")
    result = run_replay(prepared, placed, path, known=known, reference_m=reference_m or 0.0)
    if not any(frames.size for frames in result.results.values()):
        w = placed.waveform
        missing = capture.what_is_missing() or (
            f"no sweep of {w.bandwidth_hz / 1e6:g} MHz in {w.sweep_s * 1e3:g} ms was found in it; check the scene's "
            "waveform against the recording, and the recording's core:datatype, core:sample_rate and length"
        )
        raise RecordingError(f"{path}: {missing}")
    relative = not known and reference_m is None
    _write_frames(out / "frames.csv", result)
    _draw(result, placed, out / "altitude.png", relative=relative)
    notes = [*capture.notes]
    if relative:
        remedy = "state their altitude with --reference-m"
        notes.append(f"{path}: altitudes are relative to its first sweeps; {remedy}")
    for note in notes:
        print(note, file=sys.stderr)
    if not known:
        rows = summary(result)
        content = {"version": 1, "recording": str(path), "segmenter": result.segmenter}
        folder.write_text("summary.json", json.dumps(content | {"methods": rows, "notes": notes}))
        return rows
    points = sweep_points(dataclasses.replace(placed, sweep=type(placed.sweep)()))
    rows = rows_of(placed, points[0], result)
    folder.write_text("rows.csv", COLUMNS.csv(rows))
    return rows


@own_style()
def _draw(result: PointResult, scene: Scene, path: Path, *, relative: bool) -> None:
    """Altitude over time, a panel per method, with a mark below for every frame without a detection."""
    methods = list(result.results)
    figure = new_figure(7.5, 0.8 + 1.9 * len(methods))
    axes = figure.subplots(len(methods), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (method, frames) in zip(axes, result.results.items(), strict=True):
        time_s, valid = frames["frame_index"] * scene.waveform.sweep_s, frames["valid"]
        found = frames["altitude_m"][valid]
        span_m = np.ptp(found) if found.size > 1 else 1.0
        floor_m = found.min(initial=np.inf if found.size else 0.0) - 0.1 * span_m - 1.0
        colour = series_style(method, methods)["color"]
        axis.plot(time_s[valid], found, ".", ms=4, color=colour, label="declared")
        axis.plot(time_s[~valid], np.full((~valid).sum(), floor_m), "|", color="#999999", label="no altitude")
        axis.set_title(f"{method}: declared in {valid.sum()} of {valid.size} frames", fontsize=10, loc="left")
        axis.set_ylabel("above start (m)" if relative else "altitude (m)")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", fontsize=8)
    axes[-1].set_xlabel("time (s)")
    save_figure(figure, path)


def _write_frames(path: Path, result: PointResult) -> None:
    """Write one line per frame and method, floats without loss."""
    names = next(iter(result.results.values())).dtype.names
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["method", *names])
        for method, frames in result.results.items():
            for frame in frames:
                values = {name: frame[name].item() for name in names}
                values["reason"] = Reason.NAMES[values["reason"]]
                writer.writerow([method, *values.values()])


def replay_scene(capture: Capture, scene: Scene | None = None) -> tuple[Scene, bool]:
    """Scene for the score of a recording, and whether its programme is known (a recording of this program).

    Raises RecordingError if neither the recording nor the caller gives a scene.
    """
    if scene is None and capture.scene is None:
        raise RecordingError(f"{capture.path}: the recording names no scene; give the sweep's with --scene")
    if capture.scene is None:
        return scene, False
    if scene is None:
        return dataclasses.replace(capture.scene, sweep=type(capture.scene.sweep)()), True
    return dataclasses.replace(scene, altitude=capture.scene.altitude, seed=capture.scene.seed), True


def prepare_replay(methods: Sequence[str], build_dir: Path | str) -> Prepared:
    """Generate the flowgraph with a recording in place of the receiver, without transmitters."""
    data = from_recording(prune(shipped(), methods, False), "ota_replay")
    return Prepared(generate(data, Path(build_dir)), tuple(methods))


def run_replay(
    prepared: Prepared,
    scene: Scene,
    path: Path | str,
    *,
    known: bool,
    time_limit_s: float = 600.0,
    reference_m: float = 0.0,
) -> PointResult:
    """Score every method on a recording, with the flowgraph of `prepare_replay`.

    Unless the scene's programme is ``known`` to be the recorded one, timing is acquired on the first sweeps, at
    ``reference_m``, and lock is kept for any altitude of the span.
    """
    capture = open_capture(path)
    options = {"drop_when_slow": 0, "capture_file": str(capture.path), "follow_programme": int(known)}
    top = load_class(prepared)(scene_file=scene, **options)
    if "full_scale" in capture.radio:
        top.frame_segmenter.set_full_scale(capture.radio["full_scale"])
    top.frame_segmenter.set_calibration(capture.radio.get("calibration_samples"))
    top.frame_segmenter.set_reference(reference_m)
    return result_of(top, prepared, scene, run_to_end(top, time_limit_s=time_limit_s))


def summary(result: PointResult) -> list[dict[str, Any]]:
    """One row per method of a recording without known altitudes: detections and altitudes, without a score."""
    rows = []
    for method, frames in result.results.items():
        found = frames["altitude_m"][frames["valid"]]
        spread = np.percentile(found, [5, 50, 95]) if found.size else np.full(3, np.nan)
        row = {"method": method, "frames": int(frames.size), "found": int(found.size)}
        rows.append(row | dict(zip(_SPREAD, spread.tolist(), strict=True)))
    return rows
