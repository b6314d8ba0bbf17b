"""Speed of the live path: real-time factor, CPU by block, latency from frame end to altitude, drops, memory."""

import dataclasses
import gc
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import fft

from ...core.cores import allowed_cores
from ...core.mitigation import OwnProcess
from ...core.scene import Scene
from ...evaluation.flowgraph.generate import Prepared, generate, shipped
from ...evaluation.flowgraph.rewrite import prune, simulate, tracked
from ...evaluation.flowgraph.run import blocks_of, load_class, run_to_end

_POLL_S = 0.1  # between two readings of thread times and memory, s
_ARRIVALS = 200_000  # newest arrivals at the segmenter that are kept for the latency: 200 s of frames
_REPEATS = 2000  # FFTs whose median is the unit of cost
_WARM_UP = 0.1  # share of the run after which growth of memory counts
# lateness of a wake-up above which it is added up, ms: about the path's latency (docs/real-time.md)
_LONG_MS = 20.0
# a process per core that sleeps 5 ms at a time, with the standard library alone: it shares neither interpreter nor lock
_WATCHER = """
import os, sys, threading, time
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {core})
done = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), done.set()), daemon=True).start()
ended = longest = total = 0.0
before = time.monotonic()
while not ended:  # the last wait counts, too
    ended, now = done.wait(0.005), time.monotonic()
    gap = 1e3 * (now - before) - 5.0
    longest, total, before = max(longest, gap), total + gap * (gap > {long}), now
print(longest, total)
"""


@dataclass(frozen=True)
class Outside:
    """Findings of one run."""

    steal_s: float
    """Core seconds that the host of a virtual machine took, as the kernel counts them; NaN where it does not."""
    longest_ms: tuple[float, ...]  # by core: the latest wake-up of a process that only sleeps
    total_ms: tuple[float, ...]  # by core: the sum of lateness above 20 ms


class OutsideWatch:
    """One sleeping process per core, from its construction to `end`; each takes some 0.5 % of its core."""

    def __init__(self) -> None:
        self._steal_s = _steal_s()
        self._watchers = [
            subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _WATCHER.format(core={core}, long=_LONG_MS)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for core in allowed_cores()
        ]

    def end(self) -> Outside:
        """Stop watching."""
        said = [watcher.communicate("")[0].split() for watcher in self._watchers]
        longest, total = zip(*(map(float, words) for words in said), strict=True)
        return Outside(_steal_s() - self._steal_s, longest, total)


def _steal_s() -> float:
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        return int(fields[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError):
        return float("nan")


@dataclass(frozen=True)
class Measurement:
    """One run of the live path.

    - ``signal_s``, ``wall_s``: seconds of signal that were processed, and how long that took
    - ``dropped_frames``, ``lost_samples``: frames dropped for a slow method, samples lost
    - ``memory_bytes``, ``memory_growth_bytes``: resident memory at the end, that of the network's process included,
      and its growth after the first tenth of the run
    - ``source_held_up_s``, ``source_longest_hold_up_s``: for how long, in all and at most, the simulated radio's
      samples had to wait; 0 unless held to real time. A radio's samples would wait in its ring, 0.5 s long in the
      flowgraphs.
    """

    signal_s: float
    wall_s: float
    cpu_s: dict[str, float]
    """CPU seconds of each block's thread, and of the network's process where it has one of its own."""
    process_cpu_s: float  # CPU seconds of everything
    calls: dict[str, int]  # how often GNU Radio called each block's ``work``
    frames: dict[str, int]  # altitude results
    latency_ms: dict[str, np.ndarray]
    """(dict of method -> (frames,) float array): from the arrival of a frame's last sample at the segmenter to its
    altitude; empty unless held to real time, since it would measure the depth of the buffers."""
    dropped_frames: int
    lost_samples: int
    skipped_frames: int  # frames that skipped the network
    memory_bytes: int
    memory_growth_bytes: int
    outside: Outside  # how long other programs held up the cores
    source_held_up_s: float
    source_longest_hold_up_s: float

    @property
    def real_time_factor(self) -> float:
        """Seconds of signal per second."""
        return self.signal_s / self.wall_s


def fft_seconds(points: int) -> float:
    """Median CPU time of one complex64 FFT on this machine: a unit for costs.

    In FFTs the cost of a frame is about the same on all machines, in milliseconds it is not.
    """
    frame = np.ones(points, dtype=np.complex64)
    times = np.empty(_REPEATS)
    for k in range(_REPEATS):
        begin = time.thread_time_ns()
        fft.fft(frame)
        times[k] = time.thread_time_ns() - begin
    return 1e-9 * float(np.median(times))


def prepare_benchmark(
    scene: Scene,
    methods: Sequence[str],
    build_dir: Path,
    *,
    realtime: bool,
    batch: int,
    skip_clean: bool,
    own_process: bool,
    track: bool = False,
) -> Prepared:
    """Generate the simulated flowgraph, held to real time or as fast as it goes; with ``track`` it tracks altitudes."""
    name = f"ota_realtime_{'paced' if realtime else 'free'}"
    data = prune(simulate(shipped(), name, realtime=realtime), methods, scene.has_jammer)
    if track:
        data = tracked(data, name)
    for block in data["blocks"]:
        if block["name"] == "mitigation_tcae":
            block["parameters"] |= {
                "batch": str(batch),
                "skip_clean": str(skip_clean),
                "own_process": str(own_process),
            }
    return Prepared(generate(data, build_dir), tuple(methods))


def at_rate(scene: Scene, rate_hz: float) -> Scene:
    """The scene at another sample rate, with a sweep as wide as that rate and as long as before.

    Raises `ValueError` if a frame is then no whole even number of samples, or an interferer does not fit.
    """
    waveform = dataclasses.replace(scene.waveform, rate_hz=rate_hz, bandwidth_hz=rate_hz)
    return dataclasses.replace(scene, waveform=waveform)


def long_scene(scene: Scene, seconds: float) -> Scene:
    """The scene with its altitudes flown for so many seconds in all."""
    frames = max(1, round(seconds / scene.waveform.sweep_s / len(scene.altitude.programme_m)))
    altitude = dataclasses.replace(scene.altitude, frames=frames, sync_every_frames=0)
    return dataclasses.replace(scene, altitude=altitude)


def fly_benchmark(prepared: Prepared, scene: Scene, *, realtime: bool, time_limit_s: float) -> Measurement:
    """Run once, watching threads and memory from outside the signal path; FlowgraphError if it does not end in time.

    With ``realtime``, the channel holds the samples to their rate, and frames are dropped where a method is too slow.
    """
    gc.collect()  # frees the rings of an earlier flowgraph, which would count as memory of this one
    top = load_class(prepared)(scene_file=scene, drop_when_slow=int(realtime))
    segmenter = top.frame_segmenter
    segmenter.arrivals = deque(maxlen=_ARRIVALS) if realtime else None
    sinks = {m: getattr(top, f"altimeter_{m}") for m in prepared.methods}
    tcae = getattr(top, "mitigation_tcae", None)
    apart = tcae.method if tcae is not None and isinstance(tcae.method, OwnProcess) else None
    watch = _Watch(blocks_of(top), apart)
    cores = OutsideWatch()
    cpu = time.process_time()
    try:
        wall = run_to_end(
            top,
            time_limit_s=time_limit_s,
            over=lambda: watch.look(segmenter.segmenter.sample_counter),
            poll_s=_POLL_S,
            too_long=lambda limit_s: f"the run did not end within {limit_s:g} s; use fewer --seconds",
        )
        cpu = time.process_time() - cpu
    finally:
        outside = cores.end()
    status = segmenter.status()
    if apart is not None:
        watch.cpu_s["network's process"] = 1e-9 * apart.outside_cpu_ns
        cpu += watch.cpu_s["network's process"]
    return Measurement(
        signal_s=segmenter.segmenter.sample_counter / scene.waveform.rate_hz,
        wall_s=wall,
        cpu_s=watch.cpu_s,
        process_cpu_s=cpu,
        calls={name: getattr(block, "calls", 0) for name, block in blocks_of(top).items()},
        frames={m: sink.count for m, sink in sinks.items()},
        latency_ms={m: _latency_ms(sink.times(), segmenter.arrivals, scene) for m, sink in sinks.items()},
        dropped_frames=status["dropped_slow"],
        lost_samples=status["lost_samples"],
        skipped_frames=tcae.status().get("skipped_frames", 0) if tcae is not None else 0,
        memory_bytes=watch.memory[-1][1],
        memory_growth_bytes=watch.growth_bytes(),
        outside=outside,
        source_held_up_s=top.simulated_channel.held_up_s,
        source_longest_hold_up_s=top.simulated_channel.longest_hold_up_s,
    )


def _latency_ms(times: np.ndarray, arrivals: Any, scene: Scene) -> np.ndarray:
    if not arrivals or not times.size:
        return np.zeros(0)
    counter, when = np.array(arrivals).T
    at = np.searchsorted(counter, times[:, 0] + scene.waveform.samples_per_frame)
    inside = at < when.size
    return 1e3 * (times[inside, 1] - when[at[inside]])


class _Watch:
    """CPU time of the blocks' threads and resident memory, read while they run."""

    def __init__(self, blocks: dict[str, Any], apart: OwnProcess | None) -> None:
        self._blocks = blocks
        self._processes = ["self"] if apart is None else ["self", str(apart.process_id)]
        self._tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
        self._page = os.sysconf("SC_PAGE_SIZE")
        self.cpu_s: dict[str, float] = {}
        self.memory: list[tuple[int, int]] = [(0, self._resident())]

    def look(self, samples: int) -> bool:
        """Read both from the kernel; returns false, since it never ends a run."""
        self.memory.append((samples, self._resident()))
        for name, block in self._blocks.items():
            thread = getattr(block, "thread_id", None)
            try:
                text = Path(f"/proc/self/task/{thread}/stat").read_text(encoding="ascii")
            except OSError:  # the thread has ended; its last reading stays
                continue
            fields = text.rpartition(")")[2].split()
            self.cpu_s[name] = (int(fields[11]) + int(fields[12])) * self._tick_s
        return False

    def _resident(self) -> int:
        pages = (Path(f"/proc/{p}/statm").read_text(encoding="ascii").split()[1] for p in self._processes)
        return self._page * sum(map(int, pages))

    def growth_bytes(self) -> int:
        """Growth from the end of the warm-up to the end."""
        last = self.memory[-1][0]
        settled = next(m for samples, m in self.memory if samples >= _WARM_UP * last)
        return self.memory[-1][1] - settled
