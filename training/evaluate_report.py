"""Tables and figures of `evaluate.py`: break-points, protection gain, targets, Pd, beat spectra."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt

from radalt.core.interference.evm import EMITTERS
from radalt.core.mitigation import METHODS, PlotStyle
from radalt.core.receiver.altimeter import AltimeterSettings, shared_altimeter
from radalt.core.waveform import Waveform
from radalt.evaluation.engine.study import Run
from radalt.evaluation.results.break_point import (
    BREAK_PD,
    BreakPoint,
    Gain,
    break_point_of,
    mean_gain,
    protection_gain,
)
from radalt.evaluation.results.folder import RunFolder
from radalt.evaluation.results.page import write_result
from radalt.evaluation.results.proportion import wilson_interval
from radalt.evaluation.results.score import pool
from radalt.evaluation.results.table import interval, metres, number, table

__all__ = ["PAPER_CASE", "beat_spectra", "break_points", "write_report"]

Row = dict[str, Any]
Case = tuple[str, float]  # interferer and overlap
Breaks = dict[Case, dict[str, BreakPoint]]

# those of the methods, and for networks colours, markers and dashes that differ from them also in grey
STYLES = {
    "fc": PlotStyle("#F0E442", "<", ":"),
    "cnn": PlotStyle("#8C6D1F", ">", ":"),
    "paper": PlotStyle("#5D3A9B", "X", "--"),
    "compact": METHODS["tcae"].style,
} | {name: method.style for name, method in METHODS.items() if method.style}
_EMITTERS = f"{EMITTERS}, unless called ideal"
GAIN_CASES = ("tones", "qpsk_rectangular", "qpsk_shaped", "nr5", "mixture")
GAIN_OVERLAPS = (0.3, 0.6, 1.0)
PAPER_CASE = "qpsk_rectangular_sinr_-15"
PAPERS = ("none", "fc", "cnn", "paper", "compact")  # the paper's comparison, and the default network
PAPERS_SIR_DB = (0.0, -5.0, -10.0, -15.0, -20.0)  # the range that the paper's networks were trained for
PANELS = ("qpsk_shaped", "nr5", "nr10", "mixture")  # interferers of the figure
CURVES = ("none", "whitening", "ofdm_cancel", "hybrid", "paper", "compact")  # methods of the figure
NEAR_DB = 2.0  # break-points closer than a step of the SIRs, 2.5 dB, count as equally low
IDEAL = "_ideal"  # suffix of an interferer's name without error vectors
SWEPT = (*GAIN_CASES, "qpsk_rectangular_delayed", "nr10")  # interferers of the sweep over SIR


def curves(rows: Sequence[Row]) -> dict[Case, dict[str, list[Row]]]:
    """Rows of the sweep by case and method, in the order measured: highest SIR first."""
    found: dict[Case, dict[str, list[Row]]] = {}
    for row in rows:
        if row["interferer"].removesuffix(IDEAL) in SWEPT:
            case = found.setdefault((row["interferer"], row["overlap"]), {})
            case.setdefault(row["method"], []).append(row)
    return found


def break_points(rows: Sequence[Row]) -> Breaks:
    """Break-point of every method in every case (`results.break_point`)."""
    return {
        case: {name: break_point_of(mine) for name, mine in methods.items()}
        for case, methods in curves(rows).items()
    }


def gains(breaks: Breaks, base: str, method: str) -> dict[Case, Gain]:
    """Protection gain of ``method`` against ``base`` by case, unknown ones left out."""
    pairs = {
        case: protection_gain(v[base], v[method]) for case, v in breaks.items() if {base, method} <= set(v)
    }
    return {case: gain for case, gain in pairs.items() if gain.mark != "?"}


def _special(rows: Sequence[Row], name: str) -> dict[str, Row]:
    return {row["method"]: row for row in rows if row["interferer"] == name}


def targets(rows: Sequence[Row], breaks: Breaks) -> list[str]:
    """A line for each target that these rows can decide."""
    lines = []
    case = {name: row["rmse_forced_m"] for name, row in _special(rows, PAPER_CASE).items()}
    wirings = [case[m] for m in ("lms", "lms_reference_input") if case.get(m)]
    if case.get("paper") and wirings:
        lower = 100 * (1 - case["paper"] / min(wirings))
        lines.append(
            f"(a) paper at 100 % overlap, SINR -15 dB: forced RMSE {metres(case['paper'])} m (target below 50 m), "
            f"{lower:.1f} % below LMS in its better wiring, {metres(min(wirings))} m (target 85 %)"
        )
    known = gains(breaks, "none", "compact")
    picked = [g for (name, rho), g in known.items() if name in GAIN_CASES and rho in GAIN_OVERLAPS]
    if picked:
        worst = min(known, key=lambda case: known[case].db)
        lines.append(
            f"(c) compact against none: mean protection gain {mean_gain(picked)} dB over "
            f"{len(picked)} cases (target 12 dB); smallest of all {len(known)} cases {known[worst]} dB at {worst[0]}, "
            f"overlap {worst[1]:g} (target above -1 dB)"
        )
    ahead = gains(breaks, "whitening", "compact")
    if ahead:
        worst = min(ahead, key=lambda case: ahead[case].db)
        lines.append(
            f"(d) compact against whitening: at worst {ahead[worst]} dB ({worst[0]}, overlap {worst[1]:g}; target "
            f"above -3 dB), ahead in {sum(g.db > 0 for g in ahead.values())} of {len(ahead)} cases"
        )
    clean = {name: row["rmse_forced_m"] for name, row in _special(rows, "clean").items()}
    if clean.get("compact") and clean.get("none"):
        ratio = clean["compact"] / clean["none"]
        lines.append(f"(e) clean scene: RMSE of compact {ratio:.2f} times that of none (target at most 1.2)")
    return lines


def _headline(breaks: Breaks, trials: int) -> str:
    """The two methods that are most often within `NEAR_DB` of the lowest break-point under typical emitters."""
    typical = [found for (name, _), found in breaks.items() if not name.endswith(IDEAL)]
    cases = typical or list(breaks.values())
    near = Counter(
        method
        for found in cases
        for method, b in found.items()
        if b.sir_db <= min(other.sir_db for other in found.values()) + NEAR_DB
    )
    often = ", ".join(f"`{method}` in {count}" for method, count in near.most_common(2))
    return (
        f"**Within {NEAR_DB:g} dB of the lowest break-point of {len(cases)} cases: {often}** ({trials} of {trials} "
        f"frames right are a Pd of {wilson_interval(trials, trials)[0]:.2f} to 1)."
    )


def _break_table(breaks: Breaks, names: Sequence[str]) -> str:
    lines = []
    for (name, overlap), found in breaks.items():
        best = min(b.sir_db for b in found.values())
        cells = [f"**{found[m]}**" if found[m].sir_db <= best + 1e-9 else str(found[m]) for m in names]
        lines.append([name, f"{overlap:g}", *cells])
    return table(["interferer", "overlap", *names], lines)


def _both_table(breaks: Breaks, names: Sequence[str]) -> str:
    """Break-points behind ideal and typical emitters side by side; empty unless both were measured."""
    lines = []
    for (name, overlap), typical in breaks.items():
        ideal = breaks.get((f"{name}{IDEAL}", overlap))
        if name == "tones":  # no symbols, no error vectors
            ideal = typical
        if ideal is not None:
            lines.append([name, f"{overlap:g}", *(f"{ideal[m]} / {typical[m]}" for m in names)])
    both = any(name.endswith(IDEAL) for name, _ in breaks)
    return table(["interferer", "overlap", *names], lines) if both and lines else ""


def _wrong_table(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Rate of wrong and valid altitudes over all SIRs of a case that a method was measured at, and its 95 % bound."""
    lines = []
    for (name, overlap), methods in curves(rows).items():
        scores = [pool(methods[m]) for m in names]
        cells = [f"{s.wrong / s.trials:.4f} ({s.wrong_bound:.3f})" for s in scores]
        lines.append([name, f"{overlap:g}", *cells])
    return table(["interferer", "overlap", *names], lines)


def _score_table(rows: Sequence[Row], name: str) -> str:
    errors = ["RMSE detected / m", "RMSE forced / m", "without decision", "diverged frames"]
    return table(
        ["method", "Pd (95 %)", *errors],
        (
            (method, interval(r["pd"], r["pd_low"], r["pd_high"]), metres(r["rmse_detected_m"]),
             metres(r["rmse_forced_m"]), r["trials"] - r["forced"], r["diverged_frames"])
            for method, r in _special(rows, name).items()
        ),
    )  # fmt: skip


def _error_table(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Forced RMSE of the paper's networks over SIR and overlap, under the interferer that they were trained for."""
    chosen = [name for name in PAPERS if name in names]
    found = {
        (r["overlap"], r["sir_db"], r["method"]): r for r in rows if r["interferer"] == "qpsk_rectangular"
    }
    lines = [
        [
            f"{overlap:g}",
            f"{sir_db:g}",
            *(
                metres(r["rmse_forced_m"]) if (r := found.get((overlap, sir_db, m))) else "not run"
                for m in chosen
            ),
        ]
        for overlap in GAIN_OVERLAPS
        for sir_db in PAPERS_SIR_DB
    ]
    return table(["overlap", "SIR / dB", *chosen], lines)


def _returns_table(rows: Sequence[Row], names: Sequence[str]) -> str:
    """A line per kind of return and interferer; names of such cases have a comma."""
    lines = []
    for case in dict.fromkeys(row["interferer"] for row in rows if ", " in row["interferer"]):
        found = _special(rows, case)
        interferer, ground = case.split(", ")
        cells = [f"{found[m]['pd']:.2f} / {metres(found[m]['rmse_detected_m'])}" for m in names]
        lines.append([ground, interferer, number(found[names[0]]["sir_db"], 1), *cells])
    return table(["return", "interferer, full overlap", "SIR / dB", *names], lines)


def write_report(folder: RunFolder, rows: Sequence[Row], names: Sequence[str], run: Run) -> Path:
    """Write the figures, ``report.md`` and ``report.json``; returns the page."""
    breaks = break_points(rows)
    special = bool(_special(rows, "clean"))
    report = {
        "targets": targets(rows, breaks),
        "break_points": [
            {"interferer": case[0], "overlap": case[1], "method": name} | vars(found) | {"text": str(found)}
            for case, methods in breaks.items()
            for name, found in methods.items()
        ],
        "rows": list(rows),
    }
    if breaks:
        draw_pd(folder.path / "pd.png", rows, names)
    values = {
        "break_table": _break_table(breaks, names) if breaks else "",
        "both_table": _both_table(breaks, names),
        "wrong_table": _wrong_table(rows, names) if breaks else "",
        "clean_table": _score_table(rows, "clean") if special else "",
        "paper_table": _score_table(rows, PAPER_CASE),
        "error_table": _error_table(rows, names) if breaks else "",
        "returns_table": _returns_table(rows, names),
        "headline": _headline(breaks, folder.head["trials"]) if breaks else "",
    }
    return write_result(folder, Path(__file__).with_name("evaluate.md.j2"), run.as_dict(), report, values)


def beat_spectra(
    path: Path, waveform: Waveform, frames: dict[str, np.ndarray], altitude_m: float, title: str
) -> None:
    """Beat spectra of the altimeter, a panel per method; ``frames`` is {label: (N,) complex}."""
    altimeter = shared_altimeter(waveform, AltimeterSettings())
    rows = -(-len(frames) // 2)
    figure, axes = plt.subplots(
        rows, 2, figsize=(6, 1.9 * rows + 0.6), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(frames) :]:
        axis.set_axis_off()
    for axis, (label, frame) in zip(axes.flat, frames.items(), strict=False):
        spectra = altimeter.spectra(frame[None])
        for half, dash, name in zip(spectra.power[0], ("-", ":"), ("up", "down"), strict=True):
            level_db = 10 * np.log10(np.maximum(half / spectra.power.max(), 1e-9))
            axis.plot(spectra.beat_hz / 1e3, level_db, dash, color="#0072B2", lw=1, label=name)
        true = axis.axvline(waveform.altitude_to_beat_hz(altitude_m) / 1e3, color="#D55E00", lw=0.8)
        axis.set(title=label, ylim=(-50, 3))
        axis.grid(alpha=0.3)
    true.set_label("true beat")
    figure.supxlabel("beat / kHz")
    figure.supylabel("dB of the peak")
    figure.legend(*axis.get_legend_handles_labels(), loc="lower right")
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_pd(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Pd over SIR at the largest overlap: four panels of six curves, readable at 400 pixels; the tables have all."""
    cases = curves(rows)
    fullest = max(overlap for _, overlap in cases)
    shown = [case for case in cases if case[1] == fullest and case[0] in PANELS] or list(cases)[:4]
    figure, axes = plt.subplots(
        -(-len(shown) // 2), 2, figsize=(6, 5.6), sharex=True, sharey=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    for case, axis in zip(shown, axes.flat, strict=False):
        for method in [name for name in names if name in CURVES]:
            style = STYLES[method]
            axis.plot(
                [r["sir_db"] for r in cases[case][method]],
                [r["pd"] for r in cases[case][method]],
                color=style.colour,
                marker=style.marker,
                ls=style.line,
                ms=5,
                lw=1.4,
                label=method,
            )
        axis.set_title(f"{case[0].replace('_', ' ')}, overlap {case[1]:g}", fontsize=11)
        axis.axhline(BREAK_PD, color="0.8", lw=0.8)
        axis.grid(alpha=0.25)
    axes[0, 0].invert_xaxis()
    for axis in axes[-1]:
        axis.set_xlabel("SIR / dB")
    for axis in axes[:, 0]:
        axis.set_ylabel("Pd")
    handles = axes[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=3, title=_EMITTERS)
    figure.savefig(path, dpi=150)
    plt.close(figure)
