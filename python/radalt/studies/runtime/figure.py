"""Figure of the error-against-run-time report: Pd against CPU time, with the names of the chains to choose from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...core.interference.evm import EMITTERS
from ...evaluation.results.figure import new_figure, save_figure, say

REAL_TIME_MS = 1.0  # duration of a frame
_FRONT, _REST = "#0072B2", "#777777"  # chains on the Pareto front, and all others
# Offset of a name from its point, in points of 1/72 inch, so that neighbours do not cover each other. Other chains are
# dots without a name: at 400 pixels eight names can be read.
_NAMES = {
    "none": (-16, 8),
    "whitening": (-26, 8),
    "linear_prediction": (-4, -13),
    "blanking": (2, 8),
    "qpsk_cancel": (34, -12),
    "ofdm_cancel": (0, -12),
    "tcae tcae": (16, 8),
    "hybrid": (0, -12),
}


def draw(report: dict[str, Any], path: Path) -> None:
    """Pd against CPU time, with the Pareto front and the real-time line.

    Parameters
    ----------
    report : dict
        As of `report.summarise`.
    path : Path
        PNG file.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = new_figure(5.6, 4.6, dpi=180)
    axis = figure.subplots()
    figure.suptitle(f"{EMITTERS}, but for NR 10 MHz ideal", fontsize=8)
    points = {s["chain"]: (s["times"][1]["ms_median"], s["pooled"]["pd"]) for s in report["summary"]}
    p99 = {s["chain"]: s["times"][1]["ms_p99"] for s in report["summary"]}
    front = pareto({chain: (x, -y) for chain, (x, y) in points.items()})
    axis.axvline(REAL_TIME_MS, color="#666666", ls="--", lw=0.9, label="real time, 1 ms")
    axis.plot(
        *zip(*(points[k] for k in front), strict=True),
        color=_FRONT, lw=1.2, drawstyle="steps-post", label="Pareto front", zorder=2,
    )  # fmt: skip
    for chain, (x, y) in points.items():
        colour = _FRONT if chain in front else _REST
        named = chain in _NAMES
        axis.plot(x, y, marker="o", ms=5 if named else 2.5, color=colour, ls="none", zorder=3)
        if named:
            axis.plot([x, max(p99[chain], x)], [y, y], color=colour, lw=0.7, alpha=0.6, zorder=2)
            axis.annotate(
                chain.removeprefix("tcae "), (x, y), xytext=_NAMES[chain], textcoords="offset points",
                ha="center", va="center", fontsize=9, color=colour, zorder=4,
            )  # fmt: skip
    say(axis, *zip(*points.values(), strict=True), list(points))
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("CPU time per frame, method and altimeter / ms (bar: to p99)", fontsize=9)
    axis.set_ylabel("Pd over all interferers and SIRs", fontsize=9)
    axis.set_ylim(-0.05, 1.08)
    axis.margins(x=0.08)
    axis.grid(True, which="both", lw=0.3, color="#DDDDDD")
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    save_figure(figure, path)


def pareto(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Labels on the Pareto front of (cost, loss), smaller is better, in the order of cost."""
    front, best = [], float("inf")
    for label, (_, loss) in sorted(points.items(), key=lambda item: item[1]):
        if loss < best:
            front.append(label)
            best = loss
    return front
