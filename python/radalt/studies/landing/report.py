"""Report of the landing study: tables, report.json and report.md."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...core.altimeter.altimeter import RESULT_DTYPE
from ...evaluation.engine.study import Run
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.score import score_frames
from ...evaluation.results.table import DASH, metres, number, signed_metres, table
from .assumptions import ASSUMPTIONS
from .config import LandingConfig
from .figures import condition, draw_figures
from .study import MEASURED, LandingStudy, accuracy

Row = dict[str, Any]

BANDS = (
    ("whole approach", 0.0, np.inf),
    ("flare, below 30 m", 0.0, 30.0),
    ("30..150 m", 30.0, 150.0),
    ("above 150 m", 150.0, np.inf),
)
PAPER_RMSE_M = 400.0  # the paper: "over 400 m without mitigation" at a SINR of -15 dB


def approach_table(rows: Sequence[Row]) -> list[Row]:
    """Per condition and height band of the approach: detections, accuracy, errors, vertical speed."""
    entries = []
    for label in dict.fromkeys(condition(r) for r in rows):
        mine = [r for r in rows if condition(r) == label]
        for band, low, high in BANDS:
            part = [r for r in mine if low <= r["height_m"] < high]
            if part:
                entries.append({"condition": label, "band": band, **_band(part)})
    return entries


def _band(rows: Sequence[Row]) -> Row:
    """Rows of single frames as one, by the score of the other tables."""

    def column(name: str) -> np.ndarray:
        return np.array([r[name] for r in rows], dtype=float)  # None is NaN

    results = np.zeros(len(rows), RESULT_DTYPE)
    for name in ("valid", *MEASURED):
        results[name] = column(name)
    height, climb = column("height_m"), column("climb_m_per_s")
    speed = (results["vertical_speed_m_per_s"] - climb)[results["valid"]]
    return {
        **score_frames(results, height).row(),
        **accuracy(results, height, climb),
        "speed_bias_error_m_per_s": speed.std() / np.sqrt(speed.size) if speed.size > 1 else None,
    }


def sensitivity(rows: Sequence[Row]) -> list[Row]:
    """Rows of the sensitivity table, with the text of each assumption."""
    known = {a.name: {"group": a.group, "text": a.text} for a in ASSUMPTIONS}
    return [
        row | known[row["assumption"]] | {"over_400_m": (row["rmse_forced_m"] or 0.0) > PAPER_RMSE_M}
        for row in rows
    ]


def _left_out(config: LandingConfig) -> list[str]:
    parts = (
        (not config.approach.frames, "approach over time (approach.frames: 0)"),
        (not config.sensitivity_trials, "sensitivity table (sensitivity_trials: 0)"),
        ("tcae" not in config.methods, "the TCAE (not among the methods): onnxruntime was not imported"),
        (not config.terrain.files, "DTED terrain (terrain.files is empty: flat earth)"),
    )
    return [text for missing, text in parts if missing]


def write_report(folder: RunFolder, study: LandingStudy, rows: Mapping[str, Sequence[Row]], run: Run) -> Path:
    """Write study.yaml, the figures, ``report.md`` and ``report.json``; returns the page."""
    text = "# the study as used, with all defaults and the changes of the command line\n"
    folder.write_text("study.yaml", text + yaml.safe_dump(folder.head["landing"], sort_keys=False))
    config = study.config
    approach = approach_table(rows["approach"])
    whole = [e for e in approach if e["band"] == BANDS[0][0]]
    report = {
        "left_out": _left_out(config),
        "approach": approach,
        "sensitivity": sensitivity(rows["assumptions"]),
        "figures": draw_figures(config, rows, whole, folder.path),
    }
    values = _page_values(config, report)
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), report, values)


def _page_values(config: LandingConfig, report: Row) -> Row:
    tables = {
        "approach_table": _approach_lines(report["approach"]),
        "whole_table": _approach_lines([e for e in report["approach"] if e["band"] == BANDS[0][0]]),
        "sensitivity_table": _sensitivity_lines(report["sensitivity"]),
    }
    over = [r["text"] for r in report["sensitivity"] if r["over_400_m"] and r["method"] == "none"]
    return tables | {"config": config, "over": over, "paper_rmse_m": PAPER_RMSE_M}


def _errors(row: Row, over: str) -> str:
    """An error with its interval: ``3.2 (1.0-5.8)``."""
    value, low, high = (row[f"rmse_{over}{end}_m"] for end in ("", "_low", "_high"))
    return DASH if value is None else f"{metres(value)} ({metres(low)}{DASH}{metres(high)})"


def _accuracy(row: Row, forced: str) -> tuple[str, ...]:
    """Pd, share in the accuracy band, errors and bias; ``forced`` is the error of all frames."""
    shares = number(row["pd"]), number(row["in_band"])
    return (*shares, metres(row["rmse_detected_m"]), forced, signed_metres(row["bias_m"]))


def _approach_lines(entries: Sequence[Row]) -> str:
    header = "condition | heights | frames | detected | within 5 m | in band | RMSE detections / m"
    rows = []
    for r in entries:
        where = r["condition"], r["band"], r["trials"], number(r["detections"] / r["trials"])
        speed = f"{number(r['speed_bias_m_per_s'], 1)} ± {number(r['speed_bias_error_m_per_s'], 1)}"
        rows.append((*where, *_accuracy(r, metres(r["rmse_forced_m"])), speed))
    return table(f"{header} | RMSE all / m | bias / m | vertical speed error (mean ± s.e.) / (m/s)", rows)


def _sensitivity_lines(entries: Sequence[Row]) -> str:
    header = "assumption | method | SNR / dB | SIR / dB | Pd (5 m) | in band | RMSE detections / m"
    rows = []
    for r in entries:
        where = r["text"], r["method"], number(r["snr_db"], 0), number(r["sir_db"], 1)
        speed = f"{number(r['speed_bias_m_per_s'], 1)} / {number(r['speed_rmse_m_per_s'], 1)}"
        rows.append((*where, *_accuracy(r, _errors(r, "forced")), speed))
    return table(f"{header} | RMSE all frames (95 %) / m | bias / m | vertical speed mean / rms, m/s", rows)
