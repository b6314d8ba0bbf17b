"""Runs flowgraphs: start, poll, stop, raise the exceptions of blocks; of a generated one, collects the results."""

import importlib.util
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...blocks._guard import in_turns, raise_stored
from ...core.scene import Scene
from ..simulation import PointResult
from . import FlowgraphError
from .generate import Prepared
from .rewrite import CHANNEL

_STOP_S = 10.0  # longest stop of a flowgraph, s


def load_class(prepared: Prepared) -> type:
    """The generated top-block class; imported once per process."""
    name = prepared.module.stem
    key = f"radalt_generated_{name}_{abs(hash(str(prepared.module)))}"
    if key not in sys.modules:
        spec = importlib.util.spec_from_file_location(key, prepared.module)
        module = importlib.util.module_from_spec(spec)
        sys.modules[key] = module
        sys.path.insert(0, str(prepared.module.parent))  # Embedded Python blocks are in the same folder
        try:
            spec.loader.exec_module(module)
        finally:
            sys.path.remove(str(prepared.module.parent))
    return getattr(sys.modules[key], name)


def run_point(
    prepared: Prepared, scene: Scene, *, time_limit_s: float = 300.0, capture: Path | str | None = None
) -> PointResult:
    """Run the flowgraph once for a scene at one point of its sweep; ``capture`` names a SigMF recording of it.

    Raises FlowgraphError if it does not end within ``time_limit_s``. An exception of a block's ``work`` is raised
    unchanged.
    """
    top = load_class(prepared)(scene_file=scene, drop_when_slow=0)
    for block in blocks_of(top).values():
        block.logger.set_level("error")  # losses are in the rows; the console shows the study's progress
    recorder = attach_recorder(top, getattr(top, CHANNEL), scene, capture) if capture else None
    try:
        with in_turns():
            elapsed = run_to_end(top, time_limit_s=time_limit_s)
    finally:
        if recorder is not None:
            finish_recorder(top, recorder)
    return result_of(top, prepared, scene, elapsed)


def attach_recorder(
    top: Any,
    source: Any,
    scene: Scene,
    path: Path | str,
    *,
    start_s: float = 0.0,
    radio: Mapping[str, float] | None = None,
) -> Any:
    """Connect an `iq_recorder` to a block's output in a flowgraph that is not yet started; `finish_recorder` ends it.

    Parameters
    ----------
    path : path
        Path of the recording without ending.
    start_s : float
        Device time of the transmitter's first sample.
    radio : mapping, optional
        With radios: see `write_metadata`; samples are dropped when the disk cannot keep up.
    """
    from ...blocks.iq_recorder import iq_recorder

    block = iq_recorder(scene, str(path), drop_when_slow=radio is not None)
    block.finish_at_stop = False
    block.set_start_time(start_s)
    block.radio = dict(radio or {})
    top.connect((source, 0), (block, 0))
    return block


def finish_recorder(top: Any, block: Any) -> None:
    """Write the metadata of a recording, with the latency that the segmenter found."""
    raise_stored([block])
    latency = top.frame_segmenter.latency_samples
    block.latency_samples = latency if np.isfinite(latency) else 0.0
    block.finish()


def result_of(top: Any, prepared: Prepared, scene: Scene, elapsed_s: float) -> PointResult:
    """Results of a finished flowgraph."""
    mitigations = {m: getattr(top, f"mitigation_{m}", None) for m in prepared.methods}
    altimeters = {m: getattr(top, f"altimeter_{m}") for m in prepared.methods}
    return PointResult(
        results={m: block.results() for m, block in altimeters.items()},
        ms_per_frame={m: block.milliseconds() if block else np.zeros(0) for m, block in mitigations.items()},
        status={m: block.status() if block else {"method": m} for m, block in mitigations.items()},
        segmenter=top.frame_segmenter.status(),
        real_time_factor=top.frames * scene.waveform.sweep_s / elapsed_s,
        outputs={m: block.outputs() for m, block in altimeters.items() if hasattr(block, "outputs")},
    )


def blocks_of(top: Any) -> dict[str, Any]:
    """Blocks of a generated flowgraph that are written in Python, by name."""
    return {
        name: block
        for name, block in vars(top).items()
        if hasattr(block, "work") or hasattr(block, "general_work")
    }


def _too_long(limit_s: float) -> str:
    return f"the flowgraph did not end within {limit_s:g} s; raise the limit or use fewer frames"


def run_to_end(
    top: Any,
    *,
    time_limit_s: float | None = None,
    over: Callable[[], bool] | None = None,
    poll_s: float = 0.05,
    too_long: Callable[[float], str] = _too_long,
) -> float:
    """Run a flowgraph that is not yet started until its stream ends or ``over`` says so; returns its wall seconds.

    It has ended when the function returns or raises: FlowgraphError if it does not end within its limit (by
    ``too_long``), or does not stop; an exception of a block's ``work``, unchanged. ``over``, for endless streams and
    for observation, is called every ``poll_s`` seconds during the run, and once after its end.
    """
    begin = time.perf_counter()
    top.start()
    has_ended = threading.Event()  # an interrupted `Thread.join` takes the thread for ended (Python < 3.13)

    def wait() -> None:
        try:
            top.wait()
        finally:
            has_ended.set()

    threading.Thread(target=wait, daemon=True).start()
    timed_out = ended = False
    try:
        while not (ended or timed_out):
            left = float("inf") if time_limit_s is None else begin + time_limit_s - time.perf_counter()
            has_ended.wait(max(0.0, min(left, poll_s)))
            ended = bool(over is not None and over()) or has_ended.is_set()
            timed_out = not ended and left <= 0
        elapsed = time.perf_counter() - begin
    finally:  # also after an interrupt
        top.stop()
        stopped = has_ended.wait(_STOP_S)
    if timed_out:
        raise FlowgraphError(too_long(time_limit_s))
    if not stopped:
        raise FlowgraphError(f"the flowgraph did not stop within {_STOP_S:g} s")
    raise_stored(list(blocks_of(top).values()))
    return elapsed
