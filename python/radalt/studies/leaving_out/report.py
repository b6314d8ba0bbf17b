"""Report of what leaving out saves: medians of the runs, and the parts that each plan leaves out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.engine.study import Run
from ...evaluation.flowgraph.plan import make_plan
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.rows import grouped
from ...evaluation.results.table import number, table
from .study import LeavingOutStudy, scene_of


def summarise(rows: Sequence[dict[str, Any]], frames: int) -> list[dict[str, Any]]:
    """An entry per scene: medians pruned and with all built, their ratios, and whether the results are identical."""
    out = []
    for name, mine in grouped(rows, "scene").items():
        turns = [[r for r in mine if r["built"] == built] for built in ("pruned", "all")]
        pruned, full = (
            {key: float(np.median([r[key] for r in each])) for key in ("cpu_s", "memory_bytes")}
            for each in turns
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
                "cpu_ratios": [b["cpu_s"] / a["cpu_s"] for a, b in zip(*turns, strict=True)],
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
    """Write the figure, ``report.md`` and ``report.json``; returns the page."""
    summary = summarise(rows["rows"], study.frames)
    draw(summary, folder.path / "figures" / "leaving_out.png")
    first, *others = (s["left_out"] for s in summary)
    everywhere = [item for item in first if all(item in other for other in others)]
    values = {"main_table": _main_table(summary), "everywhere": everywhere}
    report = {"summary": summary, "rows": rows["rows"]}
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), report, values)


def draw(summary: Sequence[dict[str, Any]], path: Path) -> None:
    """CPU time per frame of each scene, pruned and with all built, as bars; a number says how many times longer."""
    figure = new_figure(4.6, 1.2 + 0.5 * len(summary))
    axis = figure.subplots()
    for offset, built, colour, label in (
        (-0.2, "all", "#999999", "all built"),
        (0.2, "pruned", "#0072B2", "what the scene needs"),
    ):
        ms = [_ms(s, built) for s in summary]
        axis.barh([y + offset for y in range(len(summary))], ms, 0.38, color=colour, label=label)
    for y, s in enumerate(summary):
        axis.text(_ms(s, "all"), y - 0.2, f" x {s['cpu_ratio']:.0f}", va="center", fontsize=9)
    axis.set_yticks(range(len(summary)), [s["scene"].replace(", ", ",\n", 1) for s in summary], fontsize=8)
    axis.invert_yaxis()
    axis.margins(x=0.16)
    axis.set_xlabel("CPU time of the flowgraph per frame / ms")
    axis.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2, fontsize=9, frameon=False)
    save_figure(figure, path)


def _ms(scene: dict[str, Any], built: str) -> float:
    """CPU milliseconds per frame."""
    return 1e3 * scene[built]["cpu_s"] / scene["frames"]


def _main_table(summary: Sequence[dict[str, Any]]) -> str:
    lines = [
        [
            s["scene"],
            ", ".join(s["methods"]),
            *(number(_ms(s, built)) for built in ("pruned", "all")),
            number(s["cpu_ratio"], 1),
            *(number(s[built]["memory_bytes"] / 2**20, 0) for built in ("pruned", "all")),
            f"{s['decimation']}, {s['fft_size']}",
            "yes" if s["identical"] else "**no**",
        ]
        for s in summary
    ]
    header = "scene | methods | CPU ms per frame, pruned | all built | ratio | MiB, pruned | all built"
    return table(f"{header} | decimation, FFT | results bit-identical", lines)
