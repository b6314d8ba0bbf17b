"""Cost of entries, all in turn in one process; memory and start-up, each in a process of its own."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..core.scene import parse_scene
from ..evaluation.engine.pool import call_apart
from ..evaluation.engine.study import peak_memory_bytes
from ..evaluation.results.rows import Columns
from .entry import Entry, costs
from .frames import Frames
from .lists import Case

_FRAMES = 8  # of a case, per turn
TURN_COLUMNS = Columns(
    ("entry", "case", "ms", "ms_p99", "ffts", "ffts_p99", "memory_bytes", "start_ms", "model_bytes"),
    timing=frozenset({"ms", "ms_p99", "ffts", "ffts_p99", "memory_bytes", "start_ms"}),
)


def turn_rows(
    entries: Sequence[Entry], cases: Sequence[tuple[Case, Frames]], turns: int
) -> Iterator[dict[str, Any]]:
    """A row per entry and case; the entries take turns, so that a slow moment of the machine meets all of them."""
    sweep = dataclasses.asdict(cases[0][1].scene.waveform)
    apart = {e: (e.method, dict(e.options), dict(e.altimeter), sweep) for e in entries}
    found = {e: call_apart(__name__, "started", *arguments) for e, arguments in apart.items()}
    for case, frames in cases:
        paths = {entry: entry.path(frames.scene) for entry in entries if not entry.detector}
        some = frames.samples[frames.trial][:_FRAMES]
        for path in paths.values():  # tables, caches
            list(costs(path, some))
        taken: dict[Entry, list[tuple[float, float]]] = {entry: [] for entry in paths}
        for _ in range(turns):
            for entry, path in paths.items():
                taken[entry] += costs(path, some)
        unit = float(np.median([fft_ms for spent in taken.values() for _, fft_ms in spent]))
        for entry, spent in taken.items():
            ms = np.array(spent)[:, 0]
            memory_bytes, start_ms, model_bytes = found[entry]
            mid, most = float(np.median(ms)), float(np.percentile(ms, 99))
            where = {"entry": entry.name, "case": f"{case.name}, {case.overlap:g}"}
            cost = {"ms": mid, "ms_p99": most, "ffts": mid / unit, "ffts_p99": most / unit}
            sizes = {"memory_bytes": memory_bytes, "start_ms": start_ms, "model_bytes": model_bytes}
            yield TURN_COLUMNS.row(where | cost | sizes)


def started(
    method: str, options: dict[str, Any], altimeter: dict[str, Any], waveform: dict[str, Any]
) -> tuple[int, float, int]:
    """In a new process: growth of peak memory in bytes, CPU milliseconds to the first altitude, bytes of the model."""
    entry = Entry("", method, tuple(options.items()), tuple(altimeter.items()))
    scene = parse_scene({"waveform": waveform})
    frame = scene.waveform.reference[None].astype(np.complex64)
    before, begin = peak_memory_bytes(), time.process_time()
    path = entry.path(scene)
    path.altimeter.process(path.clean(frame, None))
    ms = 1e3 * (time.process_time() - begin)
    files = getattr(path.method, "files", ())
    return peak_memory_bytes() - before, ms, sum(file.stat().st_size for file in files)
