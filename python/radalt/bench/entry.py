"""One chain from frames to altitudes: reset rule, method, altimeter, and what both cost."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft

from ..core.mitigation import METHODS, Mitigation, create, method_class
from ..core.receiver.altimeter import shared_altimeter
from .frames import Frames

_TIMED = 8  # frames whose cost is taken, one per call


@dataclass(frozen=True)
class Entry:
    """A method, its options under the name that rows have for it."""

    name: str
    method: str
    options: tuple[tuple[str, Any], ...] = ()

    def build(self, frames: Frames) -> Mitigation | None:
        """The method as the scene of the frames needs it; None for ``none``."""
        if self.method == METHODS["none"].name:
            return None
        options = dict(frames.scene.method_options.get(self.method) or {}) | dict(self.options)
        return create(
            self.method,
            frames.scene.waveform,
            max_altitude_m=frames.scene.altimeter_settings.max_altitude_m,
            independent=frames.scene.independent_frames,
            **options,
        )


@dataclass(frozen=True, eq=False)
class Outcome:
    """(trials,) altimeter's results, counters of the method, and cost per frame in milliseconds and FFTs."""

    results: np.ndarray
    diverged: int
    ms: float
    ffts: float


def run(entry: Entry, frames: Frames) -> Outcome:
    """Results of an entry on the frames of a level, equal to the flowgraph's rows to the bit.

    The cost is CPU time of method and altimeter for frames one at a time, over an FFT of the frame in the same thread.
    """
    waveform, settings = frames.scene.waveform, frames.scene.altimeter_settings
    method, altimeter = entry.build(frames), shared_altimeter(waveform, settings)
    cleaned = frames.samples
    if method is not None:
        cleaned, batch = np.empty_like(frames.samples), method_class(entry.method).batch
        for first in range(0, len(cleaned), batch):
            part = slice(first, first + batch)
            method.process_into(frames.samples[part], cleaned[part], frames.quality[part])
    spectra = altimeter.spectra(cleaned, frames.quality)
    results = altimeter.detect(spectra, timing_offset_s=frames.offset_s, frame_index=frames.index)[
        frames.trial
    ]
    diverged = 0 if method is None else method.diverged_frames
    spent, unit = [], []
    for frame in frames.samples[frames.trial][-_TIMED:]:
        begin = time.thread_time_ns()
        altimeter.process(frame[None] if method is None else method.process(frame[None]))
        spent.append(time.thread_time_ns() - begin)
        begin = time.thread_time_ns()
        fft.fft(frame)
        unit.append(time.thread_time_ns() - begin)
    ms = 1e-6 * float(np.median(spent))
    return Outcome(results, diverged, ms, 1e6 * ms / max(float(np.median(unit)), 1.0))
