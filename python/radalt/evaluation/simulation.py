"""Simulation of a scene without a flowgraph: sources, channel, segmenter, methods and altimeters, called in turn.

The flowgraph's blocks are adapters over these objects (`core.scene.build`), so both give equal rows for one seed.
"""

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..core.altimeter.altimeter import RESULT_DTYPE, AltimeterSettings, shared_altimeter
from ..core.altimeter.frame_quality import FrameQuality
from ..core.mitigation import METHODS, method_class
from ..core.scene import Scene
from ..core.scene.build import canceller_of, channel_of, jammers_of, method_of, segmenter_of, sweeps_of
from ..core.timing.auxiliary_samples import AuxiliarySamples
from ..core.timing.segmenter import Frame, FrameSegmenter

# Sweeps after the last trial: latency is up to one frame, and the segmenter releases a frame after the next one. The
# flowgraph's variable `frames` uses this number, too.
TAIL_FRAMES = 3
_AT_ONCE = 16  # frames per call, 1 MB at the default waveform; results do not depend on it


@dataclass
class PointResult:
    """Results of one run."""

    results: dict[str, np.ndarray]  # by method: (frames,) of RESULT_DTYPE
    # by method: (frames,) CPU milliseconds of the mitigation; empty for ``none``
    ms_per_frame: dict[str, np.ndarray]
    status: dict[str, dict[str, Any]]  # by method: counters and state of the method
    segmenter: Mapping[str, Any]  # state, lock quality and counters
    real_time_factor: float  # seconds of signal per second of wall time
    # by method: outputs of the tracker; empty without one
    outputs: dict[str, np.ndarray] = field(default_factory=dict)


def received(
    scene: Scene, frames: int, *, radar_sends: bool = True, trials_only: bool = False
) -> Iterator[tuple[int, np.ndarray]]:
    """(sample counter, complex64 samples) of received pieces of ``frames`` sweeps; see `both_received`."""
    both = both_received(scene, frames, radar_sends=radar_sends, trials_only=trials_only)
    return ((counter, samples) for counter, samples, _ in both)


def both_received(
    scene: Scene, frames: int, *, radar_sends: bool = True, trials_only: bool = False
) -> Iterator[tuple[int, np.ndarray, np.ndarray | None]]:
    """(sample counter, complex64 samples, samples of the second channel or None) of pieces of ``frames`` sweeps.

    A jump of the counter is a gap; the arrays are never overwritten. Without ``radar_sends`` the radar sends zeros.
    With ``trials_only`` it begins as late before the first trial as leaves the trials as they are.
    """
    sweeps, channel, jammers = sweeps_of(scene), channel_of(scene), jammers_of(scene)
    begin = 0
    if trials_only and channel.terrain is None:
        # a free-running jammer's window before the first trial reaches into it
        begin = max(0, scene.altitude.preamble_frames - max(channel.memory_frames, 1))
        channel.skip(begin)
        for jammer in jammers:
            jammer.frame_index = begin  # it is silent before the first trial
    for first in range(begin, frames, _AT_ONCE):
        count = min(_AT_ONCE, frames - first)
        radar = np.concatenate([sweeps.sweep(first + k) for k in range(count)])
        if not radar_sends:
            radar[:] = 0
        jam = [np.concatenate([jammer.next_frame() for _ in range(count)]) for jammer in jammers]
        both = None if not jam else jam[0] if len(jam) == 1 else np.stack(jam)
        second = None if channel.auxiliary is None else np.empty_like(radar)
        for counter, samples in channel.process(radar, both, second=second):
            at = counter - first * scene.waveform.samples_per_frame
            yield counter, samples, None if second is None else second[at : at + samples.size]


def segmented(scene: Scene, segmenter: FrameSegmenter) -> Iterator[list[Frame]]:
    """Frames of a scene from its segmenter (`segmenter_of`), in groups; with a second channel behind the canceller."""
    tagged, expected = scene.channel.drops.tagged, None
    canceller, kept = canceller_of(scene), AuxiliarySamples(segmenter)

    def cleaned(frames: list[Frame]) -> list[Frame]:
        if canceller is not None and frames:
            samples = canceller.process(np.stack([frame.samples for frame in frames]), kept.cut(frames))
            for frame, row in zip(frames, samples, strict=True):
                frame.samples = row
        return frames

    for counter, samples, second in both_received(scene, scene.altitude.programme.total_frames + TAIL_FRAMES):
        frames: list[Frame] = []
        if expected is None:
            segmenter.reset(counter)
        elif counter != expected and tagged:
            frames = cleaned(segmenter.jump(counter - segmenter.sample_counter))
        expected = counter + samples.size
        if second is not None:
            kept.push(second)
        yield frames + cleaned(segmenter.push(samples))
    if canceller is not None and canceller.status()["off"]:
        warnings.warn(f"scene {scene.name}, second channel: {canceller.status()['off']}", stacklevel=2)


def found_latency(scene: Scene) -> float:
    """Samples from the transmitter's sweep to the receiver's as the segmenter finds them; NaN where it does not."""
    w = scene.waveform
    for frame in (frames[0] for frames in segmented(scene, segmenter_of(scene)) if frames):
        return frame.start_sample - frame.index * w.samples_per_frame + frame.offset_s * w.rate_hz
    return float("nan")


class MethodPath:
    """One method and its altimeter: the chain from frames to altitudes, in runs without a flowgraph and in the bench.

    Parameters
    ----------
    scene : Scene
    method : str
        Name in the registry.
    options : mapping or None
        Of the method, over the scene's.
    settings : AltimeterSettings or None
        None takes the scene's.
    """

    def __init__(
        self,
        scene: Scene,
        method: str,
        options: Mapping[str, Any] | None = None,
        settings: AltimeterSettings | None = None,
    ) -> None:
        settings = settings or scene.altimeter_settings
        self.altimeter = shared_altimeter(scene.waveform, settings)
        none = method == METHODS["none"].name
        self.method = None if none else method_of(scene, method, options, settings=settings)
        self._batch = method_class(method).batch
        self._milliseconds: list[float] = []
        self._results: list[np.ndarray] = []
        self.name = method

    def clean(self, frames: np.ndarray, quality: np.ndarray | None) -> np.ndarray:
        """(n, N) frames behind the method, in batches of its own size; ``quality`` is what the received ones hold."""
        if self.method is None:
            return frames
        cleaned = np.empty_like(frames)
        for first in range(0, len(frames), self._batch):
            span = slice(first, first + self._batch)
            begin = time.thread_time_ns()
            self.method.process_into(frames[span], cleaned[span], None if quality is None else quality[span])
            count = len(frames[span])
            self._milliseconds += [(time.thread_time_ns() - begin) * 1e-6 / count] * count
        return cleaned

    def take(
        self, frames: np.ndarray, quality: np.ndarray | None, index: np.ndarray, offset_s: np.ndarray
    ) -> None:
        """Process and measure (n, N) frames."""
        spectra = self.altimeter.spectra(self.clean(frames, quality), quality)
        self._results.append(self.altimeter.detect(spectra, timing_offset_s=offset_s, frame_index=index))

    def results(self) -> np.ndarray:
        """Results of all frames so far."""
        return np.concatenate([np.empty(0, dtype=RESULT_DTYPE), *self._results])

    def milliseconds(self) -> np.ndarray:
        """CPU time of the method per frame."""
        return np.array(self._milliseconds)

    def status(self) -> dict[str, Any]:
        """Counters and state of the method."""
        return {"method": self.name} if self.method is None else self.method.status()


def run_chain(scene: Scene, methods: Sequence[str]) -> PointResult:
    """Results of a scene at one point of its sweep, as `flowgraph.run.run_point`, without GNU Radio."""
    begin = time.perf_counter()
    paths = [MethodPath(scene, method) for method in methods]
    segmenter = segmenter_of(scene)
    highest_m = scene.altimeter_settings.max_altitude_m
    assert highest_m is not None  # a scene resolves an open span
    examine = FrameQuality(scene.waveform, highest_m)
    # as in the flowgraph: the rounding of BLAS depends on the number of its threads
    with threadpool_limits(1, user_api="blas"):
        for frames in segmented(scene, segmenter):
            if not frames:
                continue
            samples = np.stack([frame.samples for frame in frames])
            index = np.array([frame.index for frame in frames])
            offset_s = np.array([frame.offset_s for frame in frames])
            quality = examine(samples)
            for path in paths:
                path.take(samples, quality, index, offset_s)
    signal_s = (scene.altitude.programme.total_frames + TAIL_FRAMES) * scene.waveform.sweep_s
    return PointResult(
        results={path.name: path.results() for path in paths},
        ms_per_frame={path.name: path.milliseconds() for path in paths},
        status={path.name: path.status() for path in paths},
        segmenter=segmenter.status(),
        real_time_factor=signal_s / (time.perf_counter() - begin),
    )
