"""Report of the landing study: tables, the comparison with the paper, report.json and report.md."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...core.receiver.altimeter import RESULT_DTYPE
from ...core.receiver.cramer_rao import altitude_crb_m
from ...evaluation.engine.study import Run
from ...evaluation.results.break_point import BREAK_PD, break_point_of
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.score import score_frames
from ...evaluation.results.table import DASH, interval, metres, number, signed_metres, table
from .assumptions import ASSUMPTIONS
from .config import LandingConfig
from .figures import condition, curve_of, draw_figures
from .points import MEASURED, accuracy
from .study import LandingStudy

Row = dict[str, Any]

BANDS = (
    ("whole approach", 0.0, np.inf),
    ("flare, below 30 m", 0.0, 30.0),
    ("30..150 m", 30.0, 150.0),
    ("above 150 m", 150.0, np.inf),
)
PAPER_RMSE_M, PAPER_SINR_DB = 400.0, -15.0  # the paper: "over 400 m without mitigation" at -15 dB
PAPER_REDUCTION = 0.85  # "reduces altitude estimation error by more than 85% compared to [...] LMS": abstract


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


def clean_of(rows: Sequence[Row]) -> dict[str, Row]:
    """The interference-free ceiling by method, from the rows of the curve."""
    return {r["method"]: r for r in rows if r["asked_sinr_db"] is None}


def break_points(config: LandingConfig, rows: Sequence[Row]) -> list[Row]:
    """SINR at which Pd falls through 0.9 of the interference-free Pd without mitigation, by overlap and method.

    The usual level, a Pd of 0.9, is out of reach of extended ground at 20 m resolution, interference or not.
    """
    clean = clean_of(rows)
    if not clean:
        return []
    level = BREAK_PD * clean.get("none", next(iter(clean.values())))["pd"]
    return [
        {"overlap": overlap, "method": method, "pd_needed": level, **vars(found), "text": str(found)}
        for overlap in config.curve.overlap
        for method in config.methods
        for curve in [curve_of(rows, overlap, method)]
        if curve
        for found in [break_point_of(curve, "asked_sinr_db", level=level)]
    ]


def comparison(config: LandingConfig, rows: Sequence[Row]) -> list[Row]:
    """The paper's statements beside our numbers, if the curve has the paper's SINR."""
    full = max(config.curve.overlap, default=0.0)
    curves = {m: curve_of(rows, full, m) for m in config.methods}
    at = {m: next((r for r in c if r["asked_sinr_db"] == PAPER_SINR_DB), None) for m, c in curves.items()}
    where = f"at {PAPER_SINR_DB:g} dB, overlap {full:g}"
    none, lms = at.get("none"), at.get("lms")
    lines = []
    if none:
        beyond = [r["asked_sinr_db"] for r in curves["none"] if (r["rmse_forced_m"] or 0) > PAPER_RMSE_M]
        lines += [
            (
                f"altitude error without mitigation {where}",
                f"over {PAPER_RMSE_M:g} m",
                f"{metres(none['rmse_forced_m'])} m over all frames, {metres(none['rmse_detected_m'])} m over "
                f"detections (Pd {none['pd']:.2f})",
            ),
            (
                f"where error without mitigation exceeds {PAPER_RMSE_M:g} m, overlap {full:g}",
                f"{PAPER_SINR_DB:g} dB",
                f"{max(beyond):g} dB and below" if beyond else "nowhere on the curve",
            ),
        ]
    if lms:
        ours = f"{metres(lms['rmse_forced_m'])} m over all frames (Pd {lms['pd']:.2f})"
        lines.append((f"altitude error of LMS {where}", DASH, ours))
    for method, row in at.items():
        if lms and row and method not in ("lms", "nlms") and lms["rmse_forced_m"] and row["rmse_forced_m"]:
            lower = 1 - row["rmse_forced_m"] / lms["rmse_forced_m"]
            ours = f"{lower:.0%} lower ({metres(row['rmse_forced_m'])} m against {metres(lms['rmse_forced_m'])} m)"
            lines.append(
                (f"error of {method} against LMS {where}", f"TCAE {PAPER_REDUCTION:.0%} lower or more", ours)
            )
    return [dict(zip(("statement", "paper", "ours"), line, strict=True)) for line in lines]


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
        (not config.curve.trials, "error against SINR (curve.trials: 0)"),
        (not config.curve.sensitivity_trials, "sensitivity table (curve.sensitivity_trials: 0)"),
        ("tcae" not in config.methods, "the TCAE (not among the methods): onnxruntime was not imported"),
        (not config.terrain.files, "DTED terrain (terrain.files is empty: flat earth)"),
    )
    return [text for missing, text in parts if missing]


def write_report(folder: RunFolder, study: LandingStudy, rows: Mapping[str, Sequence[Row]], run: Run) -> Path:
    """Write study.yaml, the figures, ``report.md`` and ``report.json``; returns the page."""
    text = "# the study as used, with all defaults and the changes of the command line\n"
    folder.write_text("study.yaml", text + yaml.safe_dump(folder.head["landing"], sort_keys=False))
    config, curve = study.config, rows["curve"]
    bounds = {f"{snr:g} dB": float(altitude_crb_m(config.waveform, snr)) for snr in (-30, -20, -10, 0, 20)}
    approach = approach_table(rows["approach"])
    whole = [e for e in approach if e["band"] == BANDS[0][0]]
    report = {
        "left_out": _left_out(config),
        "approach": approach,
        "ceiling": list(clean_of(curve).values()),
        "cramer_rao_point_target_m": bounds,
        "break_points": break_points(config, curve),
        "comparison": comparison(config, curve),
        "sensitivity": sensitivity(rows["assumptions"]),
        "trials": sorted({r["trials"] for r in curve}),
        "figures": draw_figures(config, rows, whole, folder.path),
    }
    values = _page_values(config, report)
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), report, values)


def _page_values(config: LandingConfig, report: Row) -> Row:
    tables = {
        "approach_table": _approach_lines(report["approach"]),
        "ceiling_table": _ceiling_lines(report["ceiling"]),
        "break_point_table": _break_point_lines(config, report["break_points"]),
        "comparison_table": table(("", "paper", "ours"), (r.values() for r in report["comparison"])),
        "sensitivity_table": _sensitivity_lines(report["sensitivity"]),
    }
    over = [r["text"] for r in report["sensitivity"] if r["over_400_m"] and r["method"] == "none"]
    return tables | {"config": config, "over": over, "paper_rmse_m": PAPER_RMSE_M}


def _errors(row: Row, over: str) -> str:
    """An error with its interval: ``3.2 (1.0-5.8)``."""
    value, low, high = (row[f"rmse_{over}{end}_m"] for end in ("", "_low", "_high"))
    return DASH if value is None else f"{metres(value)} ({metres(low)}{DASH}{metres(high)})"


def _approach_lines(entries: Sequence[Row]) -> str:
    header = ("condition", "heights", "frames", "detected", "within 5 m", "in band", "RMSE detections / m",
              "RMSE all frames / m", "bias / m", "vertical speed error (mean ± s.e.) / (m/s)")  # fmt: skip
    return table(
        header,
        (
            (r["condition"], r["band"], r["trials"], number(r["detections"] / r["trials"]), number(r["pd"]),
             number(r["in_band"]), metres(r["rmse_detected_m"]), metres(r["rmse_forced_m"]),
             signed_metres(r["bias_m"]),
             f"{number(r['speed_bias_m_per_s'], 1)} ± {number(r['speed_bias_error_m_per_s'], 1)}")
            for r in entries
        ),
    )  # fmt: skip


def _ceiling_lines(entries: Sequence[Row]) -> str:
    header = ("method", "trials", "Pd (5 m)", "in accuracy band", "RMSE detections (95 %) / m", "bias / m")
    return table(
        header,
        (
            (r["method"], r["trials"], interval(r["pd"], r["pd_low"], r["pd_high"]), number(r["in_band"]),
             _errors(r, "detected"), signed_metres(r["bias_m"]))
            for r in entries
        ),
    )  # fmt: skip


def _break_point_lines(config: LandingConfig, entries: Sequence[Row]) -> str:
    found = {(e["overlap"], e["method"]): e for e in entries}

    def cell(overlap: float, method: str) -> str:
        e = found.get((overlap, method))
        return f"{e['text']} ({e['low_db']:.1f} to {e['high_db']:.1f})" if e else DASH

    return table(
        ["method", *(f"overlap {o:g}" for o in config.curve.overlap)],
        ([m, *(cell(o, m) for o in config.curve.overlap)] for m in config.methods),
    )


def _sensitivity_lines(entries: Sequence[Row]) -> str:
    header = ("assumption", "method", "SNR / dB", "SIR / dB", "Pd (5 m)", "in band", "RMSE detections / m",
              "RMSE all frames (95 %) / m", "bias / m", "vertical speed mean / rms, m/s")  # fmt: skip
    return table(
        header,
        (
            (r["text"], r["method"], number(r["snr_db"], 0), number(r["sir_db"], 1), number(r["pd"]),
             number(r["in_band"]), metres(r["rmse_detected_m"]), _errors(r, "forced"), signed_metres(r["bias_m"]),
             f"{number(r['speed_bias_m_per_s'], 1)} / {number(r['speed_rmse_m_per_s'], 1)}")
            for r in entries
        ),
    )  # fmt: skip
