"""The error-against-run-time report: tables, Pareto fronts and figure from its rows."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.receiver.cramer_rao import altitude_crb_m
from ...core.waveform import Waveform
from ..overlap.markdown import table
from ..results.folder import versions
from .figure import draw
from .study import INTERFERERS, agreement, break_point_db, pareto

__all__ = ["summarise", "write_runtime_report"]


def summarise(
    rows: Sequence[dict[str, Any]], times: Sequence[dict[str, Any]], facts: dict[str, Any]
) -> dict[str, Any]:
    """The report's content: one summary a variant, pooled and by interferer, and the Pareto fronts."""
    labels = list(dict.fromkeys(r["variant"] for r in rows))
    sirs = sorted({r["sir_db"] for r in rows if r["sir_db"] is not None})
    out = []
    for label in labels:
        mine = [r for r in rows if r["variant"] == label]
        timing = {t["batch"]: t for t in times if t["variant"] == label}
        breaks = {i: break_point_db([r for r in mine if r["interferer"] == i]) for i in INTERFERERS}
        jammed = [r for r in mine if r["interferer"] != "clean"]
        out.append(
            {
                "variant": label,
                **facts[label],
                "clean": _pooled([r for r in mine if r["interferer"] == "clean"]),
                "pooled": _pooled(jammed),
                "by_interferer": {
                    i: _pooled([r for r in jammed if r["interferer"] == i]) for i in INTERFERERS
                },
                "break_point_db": breaks,
                "times": timing,
            }
        )
    step = float(np.median(np.diff(sirs))) if len(sirs) > 1 else 0.0
    base = next(s for s in out if s["variant"] == "none")["break_point_db"]
    for s in out:
        # where no SIR of the sweep is good enough, the break point is taken one step above its top
        gain = {
            i: _or(base[i], sirs[-1] + step) - _or(s["break_point_db"][i], sirs[-1] + step)
            for i in INTERFERERS
        }
        s["protection_gain_db"] = gain
        s["mean_gain_db"] = float(np.mean(list(gain.values())))
    costs = {s["variant"]: s["times"][min(s["times"])]["ms_median"] for s in out}
    fronts = {"pooled": pareto({s["variant"]: (costs[s["variant"]], 1 - s["pooled"]["pd"]) for s in out})}
    for i in INTERFERERS:
        fronts[i] = pareto(
            {s["variant"]: (costs[s["variant"]], 1 - s["by_interferer"][i]["pd"]) for s in out}
        )
    return {"summary": out, "fronts": fronts, "sirs_db": sirs, "agreement": _agreement(rows, times, labels)}


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


def _pooled(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    def total(key: str) -> float:
        return float(sum(r[key] for r in rows))

    def root(square: str, count: str) -> float | None:
        return float(np.sqrt(total(square) / total(count))) if total(count) else None

    return {
        "trials": int(total("trials")),
        "pd": total("correct") / total("trials"),
        "rmse_correct_m": root("squared_correct_m2", "correct"),
        "rmse_detected_m": root("squared_detected_m2", "detections"),
        "rmse_forced_m": root("squared_forced_m2", "forced"),
        "wrong": (total("detections") - total("correct")) / total("trials"),
    }


def _agreement(
    rows: Sequence[dict[str, Any]], times: Sequence[dict[str, Any]], labels: Sequence[str]
) -> dict[str, float]:
    """Kendall's tau of the rankings that two halves of the frames, and of the rounds, give."""
    halves = [
        [sum(r[key] for r in rows if r["variant"] == label) for label in labels]
        for key in ("correct_even", "correct_odd")
    ]
    first = [t["ms_first_half"] for t in times if t["batch"] == 1]
    second = [t["ms_second_half"] for t in times if t["batch"] == 1]
    return {"pd": agreement(*halves), "time": agreement(first, second)}


def write_runtime_report(
    folder: Path,
    rows: Sequence[dict[str, Any]],
    times: Sequence[dict[str, Any]],
    facts: dict[str, Any],
    command: str,
) -> Path:
    """Write ``error_vs_runtime.json``, ``.csv``, ``.md`` and ``figures/error_vs_runtime.png``."""
    content = summarise(rows, times, facts)
    crb = float(altitude_crb_m(Waveform(), 10.0))
    report = {
        "schema": 1,
        "command": command,
        "versions": versions(True),
        "crb_m": crb,
        **content,
        "rows": list(rows),
    }
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    (folder / "error_vs_runtime.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    with (folder / "error_vs_runtime.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    draw(report, folder / "figures" / "error_vs_runtime.png")
    path = folder / "error_vs_runtime.md"
    path.write_text(_markdown(report), encoding="utf-8")
    return path


def _markdown(report: dict[str, Any]) -> str:
    summary, sirs = report["summary"], report["sirs_db"]
    trials = summary[0]["by_interferer"][next(iter(INTERFERERS))]["trials"] // len(sirs)
    parts = [
        "# Error against run time",
        f"Made by `{report['command']}`. "
        + ", ".join(f"{k} {v}" for k, v in report["versions"].items())
        + ".",
        f"Point target, 10..1450 m, SNR 10 dB; {len(INTERFERERS)} interferers at SIR {sirs[0]:g}..{sirs[-1]:g} dB, "
        f"{trials} frames a point, the same for every variant. Time is CPU time of the one thread that computes, "
        "method and altimeter together, all variants by turns in each round. The machine was shared while this "
        "ran, so ratios say more than milliseconds. Two halves of the frames rank the variants by Pd with Kendall's "
        f"tau {report['agreement']['pd']:.2f}, two halves of the rounds by time with "
        f"{report['agreement']['time']:.2f}. A network's float16 and int8 variants are files that `training/export.py "
        "--precision` makes; they are here where `--models` named them.",
        "![Error and protection against run time](figures/error_vs_runtime.png)",
        "## All variants",
        _main_table(report),
        "## Pareto fronts",
        "Variants that none beats in both CPU time (one frame at a time) and Pd over all SIRs.",
        "\n".join(f"- {name}: " + "; ".join(front) for name, front in report["fronts"].items()),
        "## Break points",
        f"Lowest SIR in dB, of {sirs[0]:g}..{sirs[-1]:g}, down to which Pd is at least 0.9 throughout; in brackets the "
        "protection gain against no mitigation. A dash: below 0.9 everywhere.",
        _break_table(summary),
    ]
    return "\n\n".join(parts) + "\n"


def _main_table(report: dict[str, Any]) -> str:
    lines = []
    for s in report["summary"]:
        one, eight = s["times"].get(1), s["times"].get(8)
        lines.append(
            [
                s["variant"],
                s["precision"],
                f"{one['ms_median']:.2f} / {one['ms_p99']:.2f}" if one else "",
                f"{eight['ms_median']:.2f} / {eight['ms_p99']:.2f}" if eight else "",
                f"{one['ms_method']:.2f}" if one else "",
                f"{s['memory_bytes'] / 2**20:.1f}",
                f"{s['model_bytes'] / 2**20:.2f}" if s["model_bytes"] else "",
                f"{s['decimation']}, {s['fft_size']}",
                f"{s['clean']['pd']:.2f}",
                _metres(s["clean"]["rmse_forced_m"]),
                f"{s['pooled']['pd']:.3f}",
                f"{s['pooled']['wrong']:.3f}",
                _metres(s["pooled"]["rmse_correct_m"]),
                _metres(s["pooled"]["rmse_forced_m"]),
                f"{s['mean_gain_db']:+.1f}",
            ]
        )
    header = [
        "variant",
        "precision",
        "ms a frame, median / p99",
        "in batches of 8",
        "of it method",
        "memory / MiB",
    ]
    header += [
        "model / MiB",
        "decimation, FFT",
        "Pd clean",
        "RMSE clean / m",
        "Pd pooled",
        "wrong",
        "RMSE of correct / m",
    ]
    note = (
        "\n\nThe Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound without interference is "
        f"{report['crb_m']:.3f} m. Pooled is over all interferers and SIRs; *wrong* the share of frames with an "
        "altitude declared more than 5 m off. Memory is what a method adds to the peak resident memory of a "
        "process, at batch 8."
    )
    return table([*header, "RMSE forced / m", "mean gain / dB"], lines) + note


def _metres(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _break_table(summary: Sequence[dict[str, Any]]) -> str:
    lines = []
    for s in summary:
        cells = []
        for name in INTERFERERS:
            value = s["break_point_db"][name]
            cells.append(
                "\N{EN DASH}" if value is None else f"{value:g} ({s['protection_gain_db'][name]:+g})"
            )
        lines.append([s["variant"], *cells])
    return table(["variant", *INTERFERERS], lines)
