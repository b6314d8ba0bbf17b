"""Report of the real-time benchmark: rates, cost by block, latency."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.engine.study import Run
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.table import number, table
from .study import Measurement

_COLOURS = ("#0072B2", "#E69F00")  # Okabe and Ito


@dataclass(frozen=True)
class Benchmark:
    """A measurement and its unit."""

    measured: Measurement
    fft_s: float  # CPU seconds of one FFT of a frame, measured before and after the run
    alone_s: Mapping[str, float] = field(default_factory=dict)
    """CPU seconds per frame of each block's function in a loop (`alone_seconds`); may be empty."""

    def numbers(self, sweep_s: float) -> dict[str, Any]:
        """For ``report.json``, with costs in FFTs per frame as well."""
        m = self.measured
        frames = m.signal_s / sweep_s
        ffts = 1 / (frames * self.fft_s)
        latency = {
            method: dict(zip(("median", "p99"), np.percentile(ms, [50, 99]).tolist(), strict=True))
            for method, ms in m.latency_ms.items()
            if ms.size
        }
        return vars(m) | {
            "fft_s": self.fft_s,
            "real_time_factor": m.real_time_factor,
            "ffts_per_frame": ffts * m.process_cpu_s,
            "ffts_per_frame_by_block": {name: ffts * s for name, s in m.cpu_s.items()},
            "ffts_alone_by_block": {name: s / self.fft_s for name, s in self.alone_s.items()},
            "calls_per_frame_by_block": {name: count / frames for name, count in m.calls.items()},
            "measured_share": min(1.0, min(m.frames.values()) / frames),
            "latency_ms": latency,
            "outside": vars(m.outside),
        }


def tables_of(runs: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Tables of the page and the terminal from the `Benchmark.numbers` of each run, by title of the run."""
    rates = table(["", *runs], [[name, *map(shown, runs.values())] for name, shown in _SHOWN.items()])
    return {"rate_table": rates, "block_table": _blocks(runs), "latency_table": _latency(runs)}


def write_report(folder: RunFolder, found: Mapping[str, Benchmark], sweep_s: float, run: Run) -> Path:
    """Write the figure, ``report.md``, ``report.html`` and ``report.json`` of the runs by title; returns the page."""
    runs = {title: benchmark.numbers(sweep_s) for title, benchmark in found.items()}
    costs = {title: r["ffts_per_frame_by_block"] for title, r in runs.items()}
    draw(costs, folder.path / "figures" / "blocks.png")
    template = Path(__file__).with_name("report.md.j2")
    return write_result(folder, template, run.as_dict(), {"runs": runs}, tables_of(runs))


def draw(runs: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """FFTs per frame by block as bars, one colour per run; ``runs`` is {title: {block: FFTs}}."""
    each = dict.fromkeys(b for r in runs.values() for b in r)
    blocks = sorted(each, key=lambda b: -max(r.get(b, 0.0) for r in runs.values()))
    figure = new_figure(4.6, 1.3 + 0.34 * len(blocks))
    axis = figure.subplots()
    width = 0.8 / len(runs)
    for k, (title, cost) in enumerate(runs.items()):
        y = [b + width * (k - 0.5 * (len(runs) - 1)) for b in range(len(blocks))]
        label = f"{title}, {sum(cost.values()):.0f} together"
        lengths, colour = [cost.get(b, 0.0) for b in blocks], _COLOURS[k % len(_COLOURS)]
        axis.barh(y, lengths, width, color=colour, label=label)
    axis.set_yticks(range(len(blocks)), blocks, fontsize=9)
    axis.invert_yaxis()
    axis.set_xlabel("CPU time per frame / FFTs of the frame")
    axis.grid(axis="x", alpha=0.3)
    axis.legend(loc="lower right", fontsize=9)
    save_figure(figure, path)


_SHOWN: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    "signal / s": lambda r: number(r["signal_s"], 1),
    "wall time / s": lambda r: number(r["wall_s"], 1),
    "real-time factor": lambda r: number(r["real_time_factor"]),
    "FFTs per frame": lambda r: number(r["ffts_per_frame"], 1),
    "one FFT / µs": lambda r: number(1e6 * r["fft_s"], 1),
    "measured / %": lambda r: number(100 * r["measured_share"], 1),
    "dropped frames": lambda r: r["dropped_frames"],
    "lost samples": lambda r: r["lost_samples"],
    "frames that skipped the network": lambda r: r["skipped_frames"],
    "memory / MiB": lambda r: number(r["memory_bytes"] / 2**20, 0),
    "its growth / MiB": lambda r: number(r["memory_growth_bytes"] / 2**20, 1),
    "latest wake-up / ms": lambda r: number(max(r["outside"]["longest_ms"]), 0),
    "wake-ups over 20 ms late, sum / s": lambda r: number(1e-3 * max(r["outside"]["total_ms"])),
    "stolen core time / s": lambda r: number(r["outside"]["steal_s"]),
    "samples waited / s": lambda r: number(r["source_held_up_s"]),
    "longest wait / ms": lambda r: number(1e3 * r["source_longest_hold_up_s"], 0),
}


def _blocks(runs: Mapping[str, Mapping[str, Any]]) -> str:
    first = next(iter(runs.values()))
    columns = {title: r["ffts_per_frame_by_block"] for title, r in runs.items()}
    if first["ffts_alone_by_block"]:
        columns["function alone"] = first["ffts_alone_by_block"]
    columns["calls per frame"] = first["calls_per_frame_by_block"]
    cost = first["ffts_per_frame_by_block"]
    each = dict.fromkeys(b for values in columns.values() for b in values)
    blocks = sorted(each, key=lambda b: -cost.get(b, 0.0))
    return table(["block", *columns], [[b, *(number(v.get(b)) for v in columns.values())] for b in blocks])


def _latency(runs: Mapping[str, Mapping[str, Any]]) -> str:
    lines = [
        [method, number(ms["median"], 1), number(ms["p99"], 1)]
        for r in runs.values()
        for method, ms in r["latency_ms"].items()
    ]
    return table("method | median / ms | 99 % below / ms", lines) if lines else ""
