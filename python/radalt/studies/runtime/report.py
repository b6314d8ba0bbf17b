"""The error-against-run-time report: tables, Pareto fronts and figure from its rows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from ...core.receiver.cramer_rao import altitude_crb_m
from ...core.waveform import Waveform
from ...evaluation.engine.study import Run
from ...evaluation.results.break_point import break_point_of, mean_gain, protection_gain
from ...evaluation.results.folder import RunFolder, plain_json
from ...evaluation.results.page import write_result
from ...evaluation.results.score import pool
from ...evaluation.results.table import metres, number, table
from .cases import CLEAN, SNR_DB, TRANSFORM
from .figure import draw, pareto
from .study import RuntimeStudy


def write_report(
    folder: RunFolder, study: RuntimeStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write the figure, ``report.md`` and ``report.json``; returns the page."""
    report = {"crb_m": float(altitude_crb_m(Waveform(), SNR_DB)), **summarise(rows, study.interferers)}
    draw(report, folder.path / "figures" / "error_vs_runtime.png")
    tables = {
        "main_table": _main_table(report),
        "transform_table": _transform_table(report),
        "break_table": _break_table(report),
    }
    template = Path(__file__).with_name("report.md.j2")
    return write_result(folder, template, run.as_dict(), report | {"rows": rows["rows"]}, tables)


def summarise(tables: Mapping[str, Sequence[dict[str, Any]]], interferers: Sequence[str]) -> dict[str, Any]:
    """Content of the report from the tables of `RuntimeStudy`: a summary per chain, and the Pareto fronts.

    Protection gains are against the chain ``none``.
    """
    rows, labels = tables["rows"], list(dict.fromkeys(r["chain"] for r in tables["rows"]))
    facts = {fact["chain"]: fact for fact in tables["facts"]}
    transform_ms = float(np.median([t["ms_method"] for t in tables["times"] if t["chain"] == TRANSFORM]))
    broken = {
        label: {
            i: break_point_of([r for r in rows if (r["chain"], r["interferer"]) == (label, i)])
            for i in interferers
        }
        for label in labels
    }
    summary = []
    for label in labels:
        mine = [r for r in rows if r["chain"] == label]
        gains = {i: protection_gain(broken["none"][i], broken[label][i]) for i in interferers}
        mean = mean_gain(list(gains.values()))
        summary.append(
            facts[label]
            | {
                "clean": _pooled([r for r in mine if r["interferer"] == "clean"]),
                "pooled": _pooled([r for r in mine if r["interferer"] != "clean"]),
                "by_interferer": {i: _pooled([r for r in mine if r["interferer"] == i]) for i in interferers},
                "break_points": {i: vars(b) | {"text": str(b)} for i, b in broken[label].items()},
                "protection_gains": {i: plain_json(vars(g)) | {"text": str(g)} for i, g in gains.items()},
                "mean_gain": plain_json(vars(mean)) | {"text": str(mean)},
                "times": _times([t for t in tables["times"] if t["chain"] == label]),
                "transforms": {
                    i: _median_ms(tables["times"], label, i) / transform_ms for i in (CLEAN, *interferers)
                },
            }
        )
    trials = sorted({r["trials"] for r in rows})
    return {
        "summary": summary,
        "transform_ms": transform_ms,
        "fronts": _fronts(summary, interferers),
        "sirs_db": sorted({r["sir_db"] for r in rows if r["sir_db"] is not None}),
        "trials": [trials[0], trials[-1]],
        "agreement": {"pd": _agreement_of_errors(rows, labels), "time": _agreement_of_times(summary)},
    }


def _pooled(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    total = pool(rows)
    squared = sum(r["squared_correct_m2"] for r in rows)
    own = {
        "rmse_correct_m": float(np.sqrt(squared / total.correct)) if total.correct else None,
        "wrong_rate": total.wrong / total.trials,
    }
    return plain_json(total.row() | own)


def _median_ms(rows: Sequence[dict[str, Any]], label: str, interferer: str) -> float:
    """Median time of method and altimeter, one frame per call."""
    mine = [t for t in rows if (t["chain"], t["interferer"], t["batch"]) == (label, interferer, 1)]
    return float(np.median([t["ms_method"] + t["ms_altimeter"] for t in mine]))


def _times(rows: Sequence[dict[str, Any]]) -> dict[int, dict[str, float]]:
    """By frames per call: means over the interferers of the medians, and the 99th percentile over all of them."""
    out: dict[int, dict[str, float]] = {}
    jammed = [t for t in rows if t["interferer"] != CLEAN]
    for batch in dict.fromkeys(t["batch"] for t in jammed):
        by: dict[str, list[list[float]]] = {}
        for t in jammed:
            if t["batch"] == batch:
                by.setdefault(t["interferer"], []).append([t["ms_method"], t["ms_altimeter"]])
        taken = np.array(list(by.values()))  # (interferers, times, 2)
        total = taken.sum(axis=2)
        halves = np.array_split(total, 2, axis=1)
        out[batch] = {
            "ms_method": float(np.median(taken[..., 0], axis=1).mean()),
            "ms_altimeter": float(np.median(taken[..., 1], axis=1).mean()),
            "ms_median": float(np.median(total, axis=1).mean()),
            "ms_p99": float(np.percentile(total, 99)),
            "ms_first_half": float(np.median(halves[0], axis=1).mean()),
            "ms_second_half": float(np.median(halves[1], axis=1).mean()),
        }
    return out


def _fronts(summary: Sequence[dict[str, Any]], interferers: Sequence[str]) -> dict[str, list[str]]:
    """Chains that no other beats in both time and Pd: pooled, and by interferer with the time of its frames."""
    pooled = {s["chain"]: (s["times"][1]["ms_median"], 1 - s["pooled"]["pd"]) for s in summary}
    fronts = {"pooled": pareto(pooled)}
    for i in interferers:
        fronts[i] = pareto(
            {s["chain"]: (s["transforms"][i], 1 - s["by_interferer"][i]["pd"]) for s in summary}
        )
    return fronts


def _agreement_of_errors(rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> float:
    """Kendall's tau of the chains ranked by correct altitudes in the even and in the odd frames."""
    halves = (
        [sum(r[half] for r in rows if r["chain"] == label) for label in labels]
        for half in ("correct_even", "correct_odd")
    )
    return float(kendalltau(*halves).statistic)


def _agreement_of_times(summary: Sequence[dict[str, Any]]) -> float:
    """Kendall's tau of the chains ranked by time in the first and in the second half of the rounds."""
    halves = ([s["times"][1][half] for s in summary] for half in ("ms_first_half", "ms_second_half"))
    return float(kendalltau(*halves).statistic)


_MAIN = ("chain", "precision", "ms per frame, mean / p99", "in batches of 8", "of it method", "memory / MiB")
_MAIN += ("model / MiB", "decimation, FFT", "Pd clean", "RMSE clean / m", "Pd pooled", "wrong")
_MAIN += ("RMSE of correct / m", "RMSE forced / m", "mean gain / dB")


def _main_table(report: dict[str, Any]) -> str:
    lines = []
    for s in report["summary"]:
        one, eight = s["times"][1], s["times"][8]
        lines.append(
            [
                s["chain"],
                s["precision"],
                f"{one['ms_median']:.2f} / {one['ms_p99']:.2f}",
                f"{eight['ms_median']:.2f} / {eight['ms_p99']:.2f}",
                number(one["ms_method"]),
                number(s["memory_bytes"] / 2**20, 1),
                number(s["model_bytes"] / 2**20) if s["model_bytes"] else "",
                f"{s['decimation']}, {s['fft_size']}",
                number(s["clean"]["pd"]),
                metres(s["clean"]["rmse_forced_m"]),
                number(s["pooled"]["pd"], 3),
                number(s["pooled"]["wrong_rate"], 3),
                metres(s["pooled"]["rmse_correct_m"]),
                metres(s["pooled"]["rmse_forced_m"]),
                s["mean_gain"]["text"],
            ]
        )
    return table(_MAIN, lines)


def _transform_table(report: dict[str, Any]) -> str:
    names = list(report["summary"][0]["transforms"])
    lines = [[s["chain"], *(number(s["transforms"][name], 0) for name in names)] for s in report["summary"]]
    return table(["chain", *names], lines)


def _break_table(report: dict[str, Any]) -> str:
    names = [name for name in report["fronts"] if name != "pooled"]
    lines = [
        [s["chain"], *(f"{s['break_points'][i]['text']} ({s['protection_gains'][i]['text']})" for i in names)]
        for s in report["summary"]
    ]
    return table(["chain", *names], lines)
