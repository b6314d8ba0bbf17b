"""The report of a real-time benchmark: rates, cost by block, latency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.engine.study import Run
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_pages
from ...evaluation.results.table import number, table
from .study import Measurement

__all__ = ["Benchmark", "write_report"]


@dataclass(frozen=True)
class Benchmark:
    """A measurement and its unit.

    Attributes
    ----------
    measured : Measurement
    fft_s : float
        CPU seconds of one transform of a frame, measured before and after the run.
    alone_s : dict of name -> float
        CPU seconds per frame of each block's function in a loop (`alone_seconds`); may be empty.
    """

    measured: Measurement
    fft_s: float
    alone_s: Mapping[str, float] = field(default_factory=dict)

    def numbers(self, sweep_s: float) -> dict[str, Any]:
        """For ``report.json``; costs in transforms per frame as well."""
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


def write_report(folder: RunFolder, found: Mapping[str, Benchmark], sweep_s: float, run: Run) -> Path:
    """Write ``report.md``, ``report.html`` and ``report.json``; returns the page.

    ``found`` : by how the flowgraph ran, in words.
    """
    runs = {name: one.numbers(sweep_s) for name, one in found.items()}
    report = folder.head | {"run": run.as_dict(), "runs": runs}
    tables = {
        "rate_table": _rates(runs),
        "block_table": _blocks(runs),
        "latency_table": _latency(runs),
    }
    page = write_pages(folder, Path(__file__).with_name("report.md.j2"), report | tables)
    folder.write_report(report)
    return page


def _rates(runs: Mapping[str, Mapping[str, Any]]) -> str:
    lines = [
        [
            name,
            number(r["signal_s"], 1),
            number(r["real_time_factor"]),
            number(r["ffts_per_frame"], 1),
            number(1e6 * r["fft_s"], 1),
            number(100 * r["measured_share"], 1),
            r["dropped_frames"],
            r["lost_samples"],
            number(r["memory_bytes"] / 2**20, 0),
            number(r["memory_growth_bytes"] / 2**20, 1),
            number(max(r["outside"]["longest_ms"]), 0),
            number(r["source_held_up_s"]),
        ]
        for name, r in runs.items()
    ]
    header = ["run", "signal / s", "real-time factor", "FFTs per frame", "one FFT / µs", "measured / %"]
    header += ["dropped frames", "lost samples", "memory / MiB", "growth / MiB", "latest wake-up / ms"]
    return table([*header, "samples waited / s"], lines)


def _blocks(runs: Mapping[str, Mapping[str, Any]]) -> str:
    cost = {name: r["ffts_per_frame_by_block"] for name, r in runs.items()}
    first, r = next(iter(cost.values())), next(iter(runs.values()))
    columns = cost | {
        "function alone": r["ffts_alone_by_block"],
        "calls per frame": r["calls_per_frame_by_block"],
    }
    blocks = dict.fromkeys(
        [
            *sorted((b for of in cost.values() for b in of), key=lambda b: -first.get(b, 0.0)),
            *r["ffts_alone_by_block"],
        ]
    )
    return table(["block", *columns], [[b, *(number(of.get(b)) for of in columns.values())] for b in blocks])


def _latency(runs: Mapping[str, Mapping[str, Any]]) -> str:
    lines = [
        [method, number(ms["median"], 1), number(ms["p99"], 1)]
        for r in runs.values()
        for method, ms in r["latency_ms"].items()
    ]
    return table(["method", "median / ms", "99 % below / ms"], lines) if lines else ""
