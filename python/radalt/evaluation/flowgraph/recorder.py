"""Runs into recordings, and recordings into scores: capture and replay through the same flowgraph."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.paths import share_dir
from ...core.radio.recording import Capture, RecordingError, open_capture
from ...core.scene import Scene
from .generate import Prepared, generate
from .rewrite import from_recording, load_grc, prune
from .run import PointResult, make_top, result_of
from .watch import run_to_end

__all__ = ["Recorder", "attach_recorder", "prepare_replay", "replay_scene", "run_replay", "summary"]


class Recorder:
    """A recorder block in a flowgraph, closed by `finish` once the flowgraph has ended."""

    def __init__(self, top: Any, block: Any) -> None:
        self._top, self._block = top, block

    def finish(self) -> Path | None:
        """Write the metadata; returns their path, or None where nothing was received."""
        from ...blocks._guard import raise_stored

        raise_stored([self._block])
        latency = self._top.frame_segmenter.latency_samples
        self._block.latency_samples = latency if np.isfinite(latency) else 0.0
        return self._block.finish()


def attach_recorder(
    top: Any,
    source: Any,
    scene: Scene,
    path: Path | str,
    *,
    start_s: float = 0.0,
    drop_when_slow: bool = False,
    radio: Mapping[str, float] | None = None,
) -> Recorder:
    """Connect a recorder to a flowgraph that is not yet started.

    Parameters
    ----------
    top : object
        Generated flowgraph.
    source : block
        Whose output 0 is recorded.
    path : path
        Recording without ending.
    start_s : float
        Device time of the transmitter's first sample.
    drop_when_slow : bool
        For radios; see `iq_recorder`.
    radio : mapping, optional
        For radios; see `write_metadata`.
    """
    from ...blocks.iq_recorder import iq_recorder

    block = iq_recorder(scene, str(path), drop_when_slow)
    block.finish_at_stop = False
    block.set_start_time(start_s)
    block.radio = dict(radio or {})
    top.connect((source, 0), (block, 0))
    return Recorder(top, block)


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
