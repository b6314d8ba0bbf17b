"""Recordings into scores, through the same flowgraph: ``ota_eval.py --replay`` writes rows and frames."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.mitigation import CUSTOM, METHODS, MitigationError
from ...core.paths import share_dir
from ...core.radio.recording import Capture, RecordingError, open_capture
from ...core.receiver.altimeter import Reason
from ...core.scene import Scene
from ..overlap.points import sweep_points
from ..overlap.rows import COLUMNS
from ..overlap.study import rows_of
from ..results.folder import RunFolder
from ..simulation import PointResult
from .generate import Prepared, generate
from .rewrite import from_recording, load_grc, prune
from .run import make_top, result_of
from .watch import run_to_end

__all__ = ["prepare_replay", "replay_scene", "run_replay", "score_recording", "summary"]


def score_recording(
    path: Path | str,
    out: Path,
    *,
    scene: Scene | None = None,
    methods: Sequence[str] | None = None,
    method_options: Mapping[str, dict[str, Any]] | None = None,
    time_limit_s: float = 600.0,
) -> list[dict[str, Any]]:
    """Run a recording through every method's chain; write ``rows.csv`` or ``summary.json``, and ``frames.csv``.

    Parameters
    ----------
    path : path
        ``.sigmf-meta``.
    out : Path
        Result folder.
    scene : Scene, optional
        Needed for recordings of other programs; for ours it replaces everything but altitudes and seed.
    methods : sequence of str, optional
        Default: the scene's.
    method_options : mapping of method -> options, optional
        Options that replace the scene's; a method that is named here is scored as well.

    Returns
    -------
    list of dict
        Rows as of `make_row` where the altitudes are known, else of `summary`.

    Raises
    ------
    RecordingError, SceneError, MitigationError, FlowgraphError
        One line.
    """
    placed, known = replay_scene(open_capture(path), scene)
    if methods:
        placed = dataclasses.replace(placed, methods=tuple(methods))
    if method_options:
        added = tuple(m for m in method_options if m not in placed.methods)
        options = {**placed.method_options, **method_options}
        placed = dataclasses.replace(placed, methods=placed.methods + added, method_options=options)
    unknown = [m for m in placed.methods if m not in (*METHODS, CUSTOM)]
    if unknown:
        raise MitigationError(f"unknown method {unknown[0]!r}; known: {', '.join(METHODS)}")
    folder = RunFolder(out, {"study": "replay", "recording": str(path), "methods": placed.methods})
    prepared = prepare_replay(placed.methods, out / "flowgraph")
    result = run_replay(prepared, placed, path, known=known, time_limit_s=time_limit_s)
    if not any(frames.size for frames in result.results.values()):
        w = placed.waveform
        missing = open_capture(path).what_is_missing()
        if missing:
            raise RecordingError(f"{path}: {missing}; record it again")
        raise RecordingError(
            f"{path}: no sweep of {w.bandwidth_hz / 1e6:g} MHz in {w.sweep_s * 1e3:g} ms was found in it; "
            "check the scene's waveform against the recording, and the recording's core:datatype, core:sample_rate "
            "and length"
        )
    _write_frames(out / "frames.csv", result)
    if not known:
        rows = summary(result)
        content = {"version": 1, "recording": str(path), "segmenter": result.segmenter, "methods": rows}
        folder.write_text("summary.json", json.dumps(content))
        return rows
    points = sweep_points(dataclasses.replace(placed, sweep=type(placed.sweep)()))
    rows = rows_of(placed, points[0], result)
    folder.write_text("rows.csv", COLUMNS.csv(rows))
    return rows


def _write_frames(path: Path, result: PointResult) -> None:
    """One line per frame and method, numbers to the last bit."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = next(iter(result.results.values())).dtype.names
        writer.writerow(["method", *names])
        for method, frames in result.results.items():
            for frame in frames:
                values = (frame[name].item() for name in names)
                writer.writerow(
                    [
                        method,
                        *(
                            Reason.NAMES[v] if n == "reason" else v
                            for n, v in zip(names, values, strict=True)
                        ),
                    ]
                )


def replay_scene(capture: Capture, scene: Scene | None = None) -> tuple[Scene, bool]:
    """Scene to score a recording with, and whether its programme is known (a recording of ours).

    Raises
    ------
    RecordingError
        If the recording has no scene of its own and none is given.
    """
    if scene is None and capture.scene is None:
        raise RecordingError(f"{capture.path}: the recording names no scene; give the sweep's with --scene")
    if capture.scene is None:
        return scene, False
    if scene is None:
        return dataclasses.replace(capture.scene, sweep=type(capture.scene.sweep)()), True
    return dataclasses.replace(scene, altitude=capture.scene.altitude, seed=capture.scene.seed), True


def prepare_replay(methods: Sequence[str], build_dir: Path | str) -> Prepared:
    """Generate the flowgraph with a recording instead of the receiver and without transmitters."""
    name = "ota_replay"
    data = from_recording(prune(load_grc(share_dir() / "flowgraphs" / "ota_b210.grc"), methods, False), name)
    out = ("transmitters and channel: the samples come from a recording",)
    return Prepared(generate(data, Path(build_dir)), name, tuple(methods), out)


def run_replay(
    prepared: Prepared, scene: Scene, path: Path | str, *, known: bool, time_limit_s: float = 600.0
) -> PointResult:
    """Score every method on a recording.

    Parameters
    ----------
    prepared : Prepared
        Of `prepare_replay`.
    scene : Scene
        Waveform, altimeter and programme.
    path : path
        ``.sigmf-meta``.
    known : bool
        Whether the scene's programme is what was recorded; else timing is taken on the first sweeps, their altitude
        counts as zero, and lock is kept for any altitude of the span.
    """
    capture = open_capture(path)
    top = make_top(
        prepared, scene, drop_when_slow=0, capture_file=str(capture.path), follow_programme=int(known)
    )
    if "full_scale" in capture.radio:
        top.frame_segmenter.set_full_scale(capture.radio["full_scale"])
    top.frame_segmenter.set_calibration(capture.radio.get("calibration_samples"))
    return result_of(top, prepared, scene, run_to_end(top, time_limit_s=time_limit_s))


def summary(result: PointResult) -> list[dict[str, Any]]:
    """One row per method of a recording without known altitudes: what was found, with no claim about the truth."""
    rows = []
    for method, frames in result.results.items():
        found = frames["altitude_m"][frames["valid"]]
        low, middle, high = np.percentile(found, [5, 50, 95]) if found.size else [float("nan")] * 3
        rows.append(
            {
                "method": method,
                "frames": int(frames.size),
                "found": int(found.size),
                "altitude_p05_m": float(low),
                "altitude_median_m": float(middle),
                "altitude_p95_m": float(high),
            }
        )
    return rows
