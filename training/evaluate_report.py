"""Tables and figures of `evaluate.py`: break-points, protection gain, targets, Pd, before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from scipy import signal

from radalt.core.mitigation import METHODS, PlotStyle
from radalt.core.waveform import Waveform

__all__ = ["break_point_db", "before_after", "write_report"]

# the methods' own, and for networks what those leave; a marker and dash each, so that print in grey keeps them apart
STYLES = {
    "fc": PlotStyle("#F0E442", "<", ":"),
    "cnn": PlotStyle("#8C6D1F", ">", ":"),
    "paper": PlotStyle("#5D3A9B", "X", "--"),
    "compact": METHODS["tcae"].style,
} | {name: method.style for name, method in METHODS.items() if method.style}
GAIN_CASES = ("tones", "qpsk_rectangular", "qpsk_shaped", "nr5", "mixture")
GAIN_OVERLAPS = (0.3, 0.6, 1.0)
SWEPT = (*GAIN_CASES, "qpsk_rectangular_delayed", "nr10")  # not the special cases


def break_point_db(sir_db: np.ndarray, pd: np.ndarray, level: float = 0.9) -> tuple[float, str]:
    """Break-point SIR in decibels of a curve with falling SIR.

    Returns the SIR at which Pd first falls through ``level``, linear between the grid's points, and a mark:
    ``"<="`` where the grid ends before that, ``">="`` where Pd starts below it.
    """
    below = np.nonzero(pd < level)[0]
    if below.size == 0:
        return float(sir_db[-1]), "<="
    i = int(below[0])
    if i == 0:
        return float(sir_db[0]), ">="
    share = (pd[i - 1] - level) / (pd[i - 1] - pd[i])
    return float(sir_db[i - 1] + share * (sir_db[i] - sir_db[i - 1])), ""


def _cases(rows: Any) -> list[tuple[str, float]]:
    """Interferer and overlap of every swept case, in the order measured."""
    seen: dict[tuple[str, float], None] = {}
    for row in rows.rows:
        if row["interferer"] in SWEPT:
            seen[row["interferer"], float(row["overlap"])] = None
    return list(seen)


def break_table(rows: Any, names: list[str]) -> dict[tuple[str, float], dict[str, tuple[float, str]]]:
    """Break-point of every method in every case."""
    return {case: {name: break_point_db(*rows.pd(*case, name)) for name in names} for case in _cases(rows)}


def _markdown(header: list[str], lines: list[list[str]]) -> str:
    rule = ["---"] * len(header)
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, rule, *lines]) + "\n"


def _special(rows: Any, name: str) -> list[dict[str, str]]:
    return [row for row in rows.rows if row["interferer"] == name]


def targets(rows: Any, names: list[str]) -> list[str]:
    """The issue's targets that this report can decide, one line each."""
    lines = []
    table = break_table(rows, names)
    paper_case = {row["method"]: row for row in _special(rows, "qpsk_rectangular_sinr_-15")}
    if {"paper", "lms", "lms_reference_input"} <= paper_case.keys():
        paper = float(paper_case["paper"]["rmse_forced_m"])
        lms = min(float(paper_case[m]["rmse_forced_m"]) for m in ("lms", "lms_reference_input"))
        lines.append(
            f"(a) paper at 100 % overlap, SINR -15 dB: forced RMSE {paper:.2f} m (target below 50 m), "
            f"{100 * (1 - paper / lms):.1f} % below LMS in its better wiring, {lms:.1f} m (target 85 %)"
        )
    if {"compact", "none"} <= set(names):
        gains = {case: v["none"][0] - v["compact"][0] for case, v in table.items()}
        picked = [g for (name, rho), g in gains.items() if name in GAIN_CASES and rho in GAIN_OVERLAPS]
        worst = min(gains, key=gains.__getitem__)
        lines.append(
            f"(c) compact against none: mean protection gain {np.mean(picked):.1f} dB over {len(picked)} "
            f"cases (target 12 dB); smallest of all {len(gains)} cases {gains[worst]:.1f} dB at {worst[0]}, "
            f"overlap {worst[1]:g} (target above -1 dB)"
        )
    if {"compact", "whitening"} <= set(names):
        ahead = {case: v["whitening"][0] - v["compact"][0] for case, v in table.items()}
        worst = min(ahead, key=ahead.__getitem__)
        lines.append(
            f"(d) compact against whitening: at least {ahead[worst]:.1f} dB ({worst[0]}, overlap "
            f"{worst[1]:g}; target above -3 dB), ahead in {sum(a > 0 for a in ahead.values())} of {len(ahead)} cases"
        )
    clean = {row["method"]: row for row in _special(rows, "clean")}
    if {"compact", "none"} <= clean.keys():
        ratio = float(clean["compact"]["rmse_forced_m"]) / float(clean["none"]["rmse_forced_m"])
        lines.append(f"(e) clean scene: RMSE of compact {ratio:.2f} times that of none (target at most 1.2)")
    return lines


def _score_table(rows: Any, name: str) -> str:
    header = ["method", "Pd (95 %)", "RMSE detected / m", "RMSE forced / m", "diverged frames"]
    lines = []
    for row in _special(rows, name):
        interval = f"{float(row['pd']):.3f} ({float(row['pd_low']):.3f}-{float(row['pd_high']):.3f})"
        lines.append(
            [
                row["method"],
                interval,
                row["rmse_detected_m"] or "-",
                row["rmse_forced_m"],
                row["diverged_frames"],
            ]
        )
    return _markdown(header, lines)


def _rmse_table(rows: Any, names: list[str], sir_db: float) -> str:
    """Pd and forced RMSE at one SIR."""
    lines = []
    for name, overlap in _cases(rows):
        line = [name, f"{overlap:g}"]
        for method in names:
            row = rows.find(interferer=name, overlap=overlap, sir_db=sir_db, method=method)
            line.append(f"{float(row['pd']):.2f} / {float(row['rmse_forced_m']):.3g}" if row else "broken")
        lines.append(line)
    return _markdown(["interferer", "overlap", *names], lines)


def _returns_table(rows: Any, names: list[str]) -> str:
    """One line a return and interferer; a name with a comma is such a case."""
    lines = []
    for case in dict.fromkeys(row["interferer"] for row in rows.rows if ", " in row["interferer"]):
        found = {row["method"]: row for row in _special(rows, case)}
        interferer, ground = case.split(", ")
        sir_db = next(iter(found.values()))["sir_db"]
        cells = [f"{float(found[m]['pd']):.2f} / {found[m]['rmse_detected_m'] or '-'}" for m in names]
        lines.append([ground, interferer, sir_db or "-", *cells])
    return _markdown(["return", "interferer, whole frame", "SIR / dB", *names], lines)


def write_report(folder: Path, rows: Any, names: list[str], about: dict[str, Any]) -> None:
    """``report.md`` and the figures of a finished sweep."""
    table = break_table(rows, names)
    text = ["# TCAE against the other methods\n"]
    text.append(
        f"Point return at 3-1500 m, SNR {about['snr_db']:g} dB, {about['trials']} paired frames a point, "
        f"seed {about['seed']} (no training saw it). Pd: |error| < 5 m of all frames. Models (SHA-256): "
        + ", ".join(f"{name} `{digest[:16]}`" for name, digest in about["models"].items())
        + ".\n"
    )
    text.append("## Targets\n\n" + "\n".join(f"- {line}" for line in targets(rows, names)) + "\n")
    text.append("## Break-point SIR in dB (Pd at least 0.9)\n")
    lines = []
    for (name, overlap), values in table.items():
        best = min(value for value, _ in values.values())
        cells = [f"{mark}{value:.1f}" for value, mark in values.values()]
        cells = [
            f"**{c}**" if v[0] <= best + 1e-9 else c for c, v in zip(cells, values.values(), strict=True)
        ]
        lines.append([name, f"{overlap:g}", *cells])
    text.append(_markdown(["interferer", "overlap", *names], lines))
    text.append("## Clean scene\n\n" + _score_table(rows, "clean"))
    text.append(
        "## Rectangular QPSK, 100 % overlap, SINR -15 dB\n\n"
        + _score_table(rows, "qpsk_rectangular_sinr_-15")
    )
    text.append("## Other returns: Pd / RMSE of detections in m\n\n" + _returns_table(rows, names))
    for sir_db in (-10.0, -20.0, -30.0, -40.0):
        text.append(f"## Pd / forced RMSE in m at SIR {sir_db:g} dB\n\n" + _rmse_table(rows, names, sir_db))
    draw_pd(folder / "pd.png", rows, names)
    draw_gain(folder / "gain.png", table, names)
    text.append("![Pd over SIR](pd.png)\n\n![Protection gain](gain.png)\n")
    (folder / "report.md").write_text("\n".join(text))


def _title(method: str) -> str:
    """A method's own title; a network goes by its name."""
    return METHODS[method].title if method in METHODS else method


def draw_pd(path: Path, rows: Any, names: list[str]) -> None:
    """Pd over SIR, one panel an interferer and overlap."""
    cases = _cases(rows)
    interferers = list(dict.fromkeys(name for name, _ in cases))
    overlaps = sorted({overlap for _, overlap in cases})
    figure, axes = plt.subplots(
        len(interferers), len(overlaps), figsize=(3.1 * len(overlaps), 2.0 * len(interferers) + 0.8),
        sharex=True, sharey=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    for name, overlap in cases:
        axis = axes[interferers.index(name), overlaps.index(overlap)]
        for method in names:
            style = STYLES[method]
            axis.plot(
                *rows.pd(name, overlap, method),
                color=style.colour,
                marker=style.marker,
                ls=style.line,
                ms=4,
                lw=1.1,
                label=_title(method),
            )
        axis.set_title(f"{name.replace('_', ' ')}, overlap {overlap:g}", fontsize=8)
        axis.axhline(0.9, color="0.8", lw=0.8)
        axis.grid(alpha=0.25)
    axes[0, 0].invert_xaxis()
    for axis in axes[-1]:
        axis.set_xlabel("SIR / dB")
    for axis in axes[:, 0]:
        axis.set_ylabel("Pd")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_gain(path: Path, table: dict, names: list[str]) -> None:
    """Protection gain against none: one row a case, one marker a method; nothing without none to compare with."""
    if "none" not in names:
        return
    figure, axis = plt.subplots(figsize=(8, 0.28 * len(table) + 1.5), layout="constrained")
    labels = [f"{name.replace('_', ' ')}, {overlap:g}" for name, overlap in table]
    for method in [m for m in names if m != "none"]:
        gain = [values["none"][0] - values[method][0] for values in table.values()]
        look = {"marker": STYLES[method].marker, "color": STYLES[method].colour, "label": _title(method)}
        axis.plot(gain, range(len(gain)), ls="", ms=7, alpha=0.9, **look)
    axis.axvline(0, color="k", lw=0.8)
    axis.set_yticks(range(len(labels)), labels, fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("protection gain against no mitigation / dB")
    axis.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=5, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def before_after(path: Path, waveform: Waveform, frames: dict[str, np.ndarray], title: str) -> None:
    """Spectrogram and spectrum of the same frame, one column a method: {label: (N,) complex}."""
    figure, axes = plt.subplots(2, len(frames), figsize=(3.0 * len(frames), 5.2), layout="constrained")
    image = None
    for column, (label, frame) in enumerate(frames.items()):
        frame = frame / np.sqrt(np.mean(np.abs(frame) ** 2))
        f, t, plane = signal.stft(frame, waveform.rate_hz, nperseg=128, noverlap=112, return_onesided=False)
        order = np.argsort(f)
        level = 20 * np.log10(np.abs(plane[order]) + 1e-9)
        level -= level.max()
        upper, lower = axes[:, column]
        image = upper.pcolormesh(
            t * 1e3, f[order] / 1e6, level, vmin=-50, vmax=0, cmap="cividis", rasterized=True
        )
        upper.set(title=label, xlabel="time / ms")
        lower_f, density = signal.welch(frame, waveform.rate_hz, nperseg=512, return_onesided=False)
        order = np.argsort(lower_f)
        lower.plot(lower_f[order] / 1e6, 10 * np.log10(density[order] + 1e-20) + 60, color="#0072B2", lw=1)
        lower.set(xlabel="frequency / MHz", ylim=(-45, 15))
        lower.grid(alpha=0.3)
    axes[0, 0].set_ylabel("frequency / MHz")
    axes[1, 0].set_ylabel("density at unit power / dB(1/MHz)")
    for axis in axes[1, 1:]:
        axis.set_yticklabels([])
    figure.colorbar(image, ax=axes[0], label="level / dB", shrink=0.9)
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)
