"""Cost of each stage of the live path as a function in a loop, without GNU Radio."""

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.altimeter.altimeter import Spectra
from ...core.mitigation import OwnProcess
from ...core.mitigation.onnx_network import OnnxNetwork
from ...core.mitigation.tcae import default_model_path
from ...core.scene import Scene
from ...evaluation.flowgraph.generate import Prepared
from ...evaluation.flowgraph.run import load_class

_AT_ONCE = 64  # frames per call of sources, channel and altimeters, as in a flowgraph that runs free


def alone_seconds(prepared: Prepared, scene: Scene, *, batch: int, frames: int = 320) -> dict[str, float]:
    """CPU seconds per frame of each block's function, by the block's name, and of the network's bare graph.

    The functions of a flowgraph's own blocks are called one after the other on the same frames: sources, channel and
    altimeters with 64 frames, the network with ``batch``; the first 64 frames are not timed. With a tracker instead of
    an altimeter, ``tracker_METHOD`` is what it does beyond an altimeter, and ``received_METHOD`` the spectra of its
    second input.
    """
    top = load_class(prepared)(scene_file=scene, drop_when_slow=0)
    n = scene.waveform.samples_per_frame
    spent: defaultdict[str, float] = defaultdict(float)
    counted: defaultdict[str, int] = defaultdict(int)

    def timed(name: str, count: int, work: Callable[[], Any]) -> Any:
        begin = time.thread_time_ns()
        out = work()
        spent[name] += 1e-9 * (time.thread_time_ns() - begin)
        counted[name] += count
        return out

    sent, arrived = np.empty((2, _AT_ONCE, n), dtype=np.complex64)
    channel, jammer = top.simulated_channel.channel, getattr(top, "jammer_source", None)
    jammed = np.zeros_like(sent)
    for first in range(0, frames, _AT_ONCE):
        if first == _AT_ONCE:  # the first frames include what is made once: tables, memory pages, FFT plans
            spent.clear()
            counted.clear()
        for k in range(_AT_ONCE):
            sent[k] = timed("chirp_source", 1, lambda at=first + k: top.chirp_source._sweeps.sweep(at))
        for row in jammed if jammer is not None else ():
            timed("jammer_source", 1, lambda at=row: jammer.stream.next_frame(at))
        other = jammed.ravel() if jammer is not None else None
        timed(
            "simulated_channel",
            _AT_ONCE,
            lambda two=other: channel.process(sent.ravel(), two, arrived.ravel()),
        )
        found = timed(
            "frame_segmenter", _AT_ONCE, lambda: top.frame_segmenter.segmenter.push(arrived.ravel())
        )
        if not found:
            continue
        received = np.stack([frame.samples for frame in found])
        # by the block of the segmenter, for all methods
        quality = timed("frame_segmenter", 0, lambda x=received: top.frame_segmenter._quality(x))
        for method in prepared.methods:
            cleaned = _cleaned(timed, top, method, (received, quality), batch)
            block = getattr(top, f"altimeter_{method}")
            spectra, _ = timed(
                f"altimeter_{method}", len(found), lambda b=block, x=(cleaned, quality): _measured(b, *x)
            )
            if hasattr(block, "tracker"):
                uncleaned = None if method == "none" else received
                _track(timed, method, block, spectra, uncleaned)
    if "tcae" in prepared.methods:
        _run_graph(timed, n, batch, frames)
    return {name: seconds / counted[name] for name, seconds in spent.items()}


def _measured(block: Any, frames: np.ndarray, quality: np.ndarray) -> tuple[Spectra, np.ndarray]:
    spectra = block.altimeter.spectra(frames, quality)
    return spectra, block.altimeter.detect(spectra)


def _cleaned(
    timed: Callable, top: Any, method: str, known: tuple[np.ndarray, np.ndarray], batch: int
) -> np.ndarray:
    received, quality = known
    block = getattr(top, f"mitigation_{method}", None)
    if block is None:  # none
        return received
    if isinstance(block.method, OwnProcess):
        raise ValueError(f"{method} has a process of its own, whose CPU time cannot be measured from here")
    out = np.empty_like(received)
    step = batch if method == "tcae" else type(block.method).batch
    for first in range(0, len(received), step):
        span = slice(first, first + step)
        work = lambda at=span: block.method.process_into(received[at], out[at], quality[at])  # noqa: E731
        timed(f"mitigation_{method}", len(received[span]), work)
    return out


def _track(timed: Callable, method: str, block: Any, spectra: Spectra, received: np.ndarray | None) -> None:
    """What a tracker does beyond an altimeter: spectra of the received frames, sums and decisions."""
    count, uncleaned = len(spectra.power), None
    if received is not None:
        work = lambda: block.altimeter.spectra(received, spectra.quality)  # noqa: E731
        uncleaned = timed(f"received_{method}", count, work)
    timed(f"tracker_{method}", count, lambda: block.tracker.process(spectra, received=uncleaned))


def _run_graph(timed: Callable, samples: int, batch: int, frames: int) -> None:
    """ONNX Runtime alone, on frames of unit noise."""
    network = OnnxNetwork(default_model_path(), 1)
    noise = np.random.default_rng(0).standard_normal((batch, 2, samples), dtype=np.float32)
    network.run(noise)
    for _ in range(0, frames, batch):
        timed("network's graph", batch, lambda: network.run(noise))
