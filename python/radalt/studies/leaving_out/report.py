"""Report of what leaving out saves: medians of the runs, and the parts that each plan leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...evaluation.engine.study import Run
from ...evaluation.flowgraph.plan import make_plan
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.table import number, table
from .scenes import scene_of

if TYPE_CHECKING:
    from .study import LeavingOutStudy

__all__ = ["summarise", "write_report"]


def summarise(rows: Sequence[dict[str, Any]], frames: int) -> list[dict[str, Any]]:
    """An entry per scene: medians pruned and with all built, their ratios, and whether the results are identical.

    ``frames`` : frames at each altitude, as measured.
    """
    out = []
    for name in dict.fromkeys(r["scene"] for r in rows):
        mine = [r for r in rows if r["scene"] == name]
        pruned, full = (
            {
                key: float(np.median([r[key] for r in mine if r["built"] == built]))
                for key in ("cpu_s", "memory_bytes")
            }
            for built in ("pruned", "all")
        )
        scene = scene_of(name, frames)
        plan = make_plan(scene, scene.methods)
        out.append(
            {
                "scene": name,
                "methods": list(scene.methods),
                "frames": mine[0]["frames"],
                "pruned": pruned,
                "all": full,
                "cpu_ratio": full["cpu_s"] / pruned["cpu_s"],
                "memory_ratio": full["memory_bytes"] / pruned["memory_bytes"],
                "identical": len({r["digest"] for r in mine}) == 1,
                "modules": next(r["modules"] for r in mine if r["built"] == "pruned"),
                "left_out": list(plan.left_out),
                "fft_size": plan.altimeter.fft_size,
                "decimation": plan.altimeter.decimation,
            }
        )
    return out


def write_report(
    folder: RunFolder, study: LeavingOutStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write ``report.md`` and ``report.json``; returns the page."""
    summary = summarise(rows["rows"], study.frames)
    first, *others = (s["left_out"] for s in summary)
    everywhere = [item for item in first if all(item in other for other in others)]
    values = {"main_table": _main_table(summary), "everywhere": everywhere}
    report = {"summary": summary, "rows": rows["rows"]}
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), report, values)


def _main_table(summary: Sequence[dict[str, Any]]) -> str:
    lines = [
        [
            s["scene"],
            ", ".join(s["methods"]),
            *(number(1e3 * s[built]["cpu_s"] / s["frames"]) for built in ("pruned", "all")),
            number(s["cpu_ratio"], 1),
            *(number(s[built]["memory_bytes"] / 2**20, 0) for built in ("pruned", "all")),
            f"{s['decimation']}, {s['fft_size']}",
            "yes" if s["identical"] else "**no**",
        ]
        for s in summary
    ]
    header = [
        "scene",
        "methods",
        "CPU ms per frame, pruned",
        "all built",
        "ratio",
        "MiB, pruned",
        "all built",
    ]
    return table([*header, "decimation, FFT", "results bit-identical"], lines)
