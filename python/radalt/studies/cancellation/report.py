"""Page of the cancellation study: break-points, wrong altitudes and costs by case, and one figure."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ...core.mitigation.ofdm.settings import OfdmSettings
from ...evaluation.engine.study import Run
from ...evaluation.results.break_point import break_point_of
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.score import pool
from ...evaluation.results.table import number, table
from .cases import CASES
from .study import CancellationStudy

Row = Mapping[str, Any]
_DRAWN = ("ideal", "evm_3", "evm_5", "evm_8", "qpsk_users")
_COLOURS = ("#000000", "#0072B2", "#009E73", "#D55E00", "#CC79A7")  # Okabe and Ito
_MARKERS = "os^Dv"
_SHOWN_DB = (-30.0, -40.0, -45.0, -50.0)  # SIRs whose Pd stands in the tables


def write_report(
    folder: RunFolder, study: CancellationStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write ``report.md``, its figure and ``report.json``; returns the page."""
    found = rows["rows"]
    draw_pd(found, folder.path / "pd.png")
    cancelled = [r for r in found if r["method"] != "none"]
    tables = {
        "best": {name: _break(found, name, "ofdm_cancel") for name in ("evm_3", "evm_8")},
        "settings_count": len(fields(OfdmSettings)),
        "single": _table(found, stream=False),
        "streams": _table(found, stream=True),
        "wrong": _wrong([r for r in cancelled if CASES[r["case"]].method == "ofdm_cancel"]),
        "wrong_none": _wrong([r for r in found if r["method"] == "none"]),
        "worst_ffts": number(max((r["ffts_most"] for r in cancelled), default=None), 0),
    }
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), rows, tables)


def _break(rows: Sequence[Row], case: str, method: str) -> str:
    some = [r for r in rows if (r["case"], r["method"]) == (case, method)]
    return str(break_point_of(some)) if some else ""


def _wrong(rows: Sequence[Row]) -> str:
    total = pool(rows)
    return f"{total.wrong} of {total.trials:,} (bound {100 * total.wrong_bound:.2f} %)"


def _table(rows: Sequence[Row], stream: bool) -> str:
    """A line per case: break-points without mitigation and behind its canceller, Pd, wrong altitudes, costs."""
    lines = []
    for name, case in CASES.items():
        mine = [r for r in rows if r["case"] == name]
        cancelled = [r for r in mine if r["method"] == case.method]
        if case.stream != stream or not cancelled:
            continue
        points = [_break(rows, name, method) for method in ("none", case.method)]
        pd = [next((number(r["pd"]) for r in cancelled if r["sir_db"] == sir_db), "") for sir_db in _SHOWN_DB]
        searched = [r for r in cancelled if r["sir_db"] <= -30.0] or cancelled
        median = number(float(np.median([r["ffts_mean" if stream else "ffts_median"] for r in searched])), 0)
        most = number(max(r["ffts_most"] for r in cancelled), 0)
        lines.append([case.title, *points, *pd, pool(cancelled).wrong, f"{median} / {most}"])
    cost = "FFTs, mean / most" if stream else "FFTs, median / most"
    shown = (f"{sir_db:g}" for sir_db in _SHOWN_DB)
    return table(["interference", "none", "cancelled", *shown, "wrong", cost], lines)


def draw_pd(rows: Sequence[Row], path: Path) -> None:
    """Pd over SIR by EVM, with 95 % intervals, and without mitigation."""
    figure = new_figure(4.8, 3.8)
    axis = figure.subplots()
    for name, colour, marker in zip(_DRAWN, _COLOURS, _MARKERS, strict=True):
        for method, line in (("ofdm_cancel", "-"), ("none", ":")):
            mine = sorted(
                (r for r in rows if (r["case"], r["method"]) == (name, method)), key=lambda r: r["sir_db"]
            )
            if not mine or (method == "none" and name != "evm_3"):
                continue
            sir_db = [r["sir_db"] for r in mine]
            pd = np.array([r["pd"] for r in mine])
            spread = np.abs([pd - [r["pd_low"] for r in mine], [r["pd_high"] for r in mine] - pd])
            label = CASES[name].title if method != "none" else "without mitigation"
            axis.errorbar(
                sir_db, pd, spread, color="0.5" if method == "none" else colour, marker=marker, ls=line, ms=4,
                capsize=2, lw=1.2, label=label,
            )  # fmt: skip
    axis.axhline(0.9, color="0.7", lw=0.8)
    axis.invert_xaxis()
    axis.set(xlabel="SIR / dB", ylabel="Pd within 5 m", ylim=(-0.03, 1.03))
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[0]:
        figure.legend(loc="outside upper center", ncols=2, fontsize=9, frameon=False)
    save_figure(figure, path)
