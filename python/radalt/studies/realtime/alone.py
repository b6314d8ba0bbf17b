"""Cost of each stage of the live path as a function in a loop, and of GNU Radio with blocks that only copy."""

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
from gnuradio import blocks, gr

from ...blocks._frames import frame_ring
from ...blocks._guard import WORK_DONE, guarded
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


class _Copy(gr.sync_block):
    """Copies frames."""

    def __init__(self, samples: int) -> None:
        gr.sync_block.__init__(self, "copy", [(np.complex64, samples)], [(np.complex64, samples)])
        frame_ring(self, samples)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        output_items[0][:] = input_items[0]
        return len(output_items[0])


class _Source(gr.sync_block):
    """A given number of frames with the ring's content."""

    def __init__(self, samples: int, frames: int) -> None:
        gr.sync_block.__init__(self, "source", None, [(np.complex64, samples)])
        self._left = frames
        frame_ring(self, samples)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        done = min(self._left, len(output_items[0]))
        self._left -= done
        return done or WORK_DONE


def gateway_seconds(samples: int, *, count: int = 6, frames: int = 2000) -> float:
    """CPU seconds per frame of ``count`` Python blocks that copy, between a source and a null sink."""
    top = gr.top_block()
    chain = [_Source(samples, frames), *(_Copy(samples) for _ in range(count)), blocks.null_sink(8 * samples)]
    top.connect(*chain)
    begin = time.process_time()
    top.run()
    return (time.process_time() - begin) / frames
