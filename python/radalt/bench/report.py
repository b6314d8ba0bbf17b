"""The report of a run: the views that its list has rows for."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.altimeter.altimeter import shared_altimeter
from ..evaluation.results.page import write_result
from . import views

if TYPE_CHECKING:
    from ..evaluation.engine.study import Run
    from ..evaluation.results.folder import RunFolder
    from .study import BenchStudy


def write_report(
    folder: "RunFolder", study: "BenchStudy", tables: Mapping[str, list[dict[str, Any]]], run: "Run"
) -> Path:
    """Write report.md, report.html, report.json and the figures; returns the page."""
    entries = [entry.name for entry in study.entries]
    without = {case.name for case in study.cases.cases if case.scene.return_model == "none"}
    rows = [row for row in tables["rows"] if row["case"] not in without]
    null = [row for row in tables["rows"] if row["case"] in without]
    summary = views.summaries(rows, entries, tables["turns"]) if rows else {}
    if views.headline(summary):
        views.draw_held(summary, folder.path / "error_vs_runtime.png")
        views.draw_levels(rows, entries, folder.path / "break_points.png", study.cases)
        views.draw_curves(rows, entries, folder.path / "pd.png", study.cases)
    else:  # no case has two levels: nothing is held
        summary = {}
    values = {
        "title": study.cases.title or study.cases.name,
        "drawn": (folder.path / "break_points.png").is_file(),
        "breaks": views.break_points(rows, entries),
        "levels": views.levels(rows, entries),
        "summary": views.summary_table(summary) if summary else "",
        "headline": views.headline(summary),
        "turns": views.turns_table(tables["turns"]) if tables["turns"] else "",
        "null": views.false_altitudes(null, _bounds(study)) if null else "",
        "digest": study.cases.digest,
    }
    template = Path(__file__).with_name("report.md.j2")
    return write_result(folder, template, run.as_dict(), {"summary": summary}, values)


def _bounds(study: "BenchStudy") -> dict[str, float]:
    """False altitudes per frame of noise by design, by entry: of the first case's altimeter."""
    scene = study.cases.cases[0].scene
    settings = {
        e.name: dataclasses.replace(scene.altimeter_settings, **dict(e.altimeter)) for e in study.entries
    }
    return {name: shared_altimeter(scene.waveform, s).false_alarms_per_frame for name, s in settings.items()}
