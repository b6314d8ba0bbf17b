"""The main study's report as one HTML file that needs nothing beside it and no network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..results.page import render
from ..results.table import DASH, interval, metres, number
from .markdown import glance, summary

__all__ = ["report_html"]

# heading, column to sort by (None: the text)
_ROWS = (
    ("method", None),
    ("interference", None),
    ("overlap", "overlap"),
    ("SIR / dB", "sir_db"),
    ("SNR / dB", "snr_db"),
    ("trials", "trials"),
    ("Pd (95 % interval)", "pd"),
    ("wrong", "wrong"),
    ("its bound", "wrong_bound"),
    ("RMSE detected / m", "rmse_detected_m"),
    ("RMSE forced / m", "rmse_forced_m"),
    ("bias / m", "bias_m"),
    ("peak to sidelobe / dB", "peak_to_sidelobe_db"),
    ("ms per frame", "ms_per_frame_median"),
)


def report_html(report: dict[str, Any], figures: Sequence[tuple[str, str]], scene: str) -> str:
    """The page from the content of report.json; ``figures`` are (SVG, caption), ``scene`` is its YAML text."""
    header, lines = glance(report["rows"])
    return render(
        Path(__file__).with_name("report.html.j2"),
        **report,
        summary=summary(report),
        drawn=[(svg[svg.index("<svg") :], caption) for svg, caption in figures],
        glance_header=header,
        glance_lines=lines,
        row_header=[name for name, _ in _ROWS],
        row_lines=[_line(row) for row in report["rows"]],
        scene_text=scene,
    )


def _ends(row: dict[str, Any]) -> str:
    low, high = row.get("rmse_low_m"), row.get("rmse_high_m")
    return "" if low is None or high is None else f" ({metres(low)}{DASH}{metres(high)})"


def _line(row: dict[str, Any]) -> list[tuple[str, str]]:
    """(text, value to sort by) of each cell."""
    row = row | {"wrong": row["detections"] - row["correct"]}
    shown = {
        "pd": interval(row["pd"], row["pd_low"], row["pd_high"]),
        "wrong": f"{row['wrong']}",
        "wrong_bound": f"{row['wrong_bound']:.4f}",
        "rmse_detected_m": metres(row["rmse_detected_m"]),
        "rmse_forced_m": metres(row["rmse_forced_m"]) + _ends(row),
        "bias_m": metres(row["bias_m"]),
        "peak_to_sidelobe_db": number(row["peak_to_sidelobe_db"], 1),
        "ms_per_frame_median": f"{row['ms_per_frame_median']:.3f}",
    }
    cells = []
    for name, key in _ROWS:
        value = row[key or name]
        text = shown.get(key) or (DASH if value is None else f"{value:g}" if key else str(value))
        cells.append((text, "" if value is None else str(value)))
    return cells
