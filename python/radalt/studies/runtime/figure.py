"""Figure of the error-against-run-time report: numbered points, and a key of the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.interference.evm import EMITTERS
from ...evaluation.results.figure import new_figure, save_figure

__all__ = ["draw", "pareto", "place_labels"]

REAL_TIME_MS = 1.0  # duration of a frame
_FRONT, _REST = "#0072B2", "#777777"  # chains on the Pareto front, and all others
_LABEL_PT = 6.5  # font size of the numbers
_ANGLES = 2.0 * np.pi * np.arange(16) / 16 + 0.4  # from a point to its label; none along a bar
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def draw(report: dict[str, Any], path: Path) -> None:
    """Error and Pd against CPU time, with the Pareto front, the real-time line, the clean ceiling and the bound.

    Parameters
    ----------
    report : dict
        As of `report.summarise`.
    path : Path
        PNG file.
    """
    figure = new_figure(12.6, 4.9, dpi=180)
    left, right, key = figure.subplots(1, 3, width_ratios=(1, 1, 0.42))
    figure.suptitle(f"{EMITTERS}, but for NR 10 MHz ideal", fontsize=8)
    summary = report["summary"]
    clean = next(s for s in summary if s["chain"] == "none")["clean"]
    left.set_yscale("log")
    left.axhline(
        clean["rmse_forced_m"], color="#009E73", ls=":", lw=1.2, label="clean ceiling, no mitigation"
    )
    cramer = "Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao, clean"
    left.axhline(report["crb_m"], color="#D55E00", ls="-.", lw=1.0, label=cramer)
    right.axhline(clean["pd"], color="#009E73", ls=":", lw=1.2)
    left.set_ylabel("RMSE of forced decisions, pooled / m", fontsize=8)
    right.set_ylabel("Pd pooled over interferers and SIRs", fontsize=8)
    panels = (
        (left, {s["chain"]: s["pooled"]["rmse_forced_m"] for s in summary}, 1.0),
        (right, {s["chain"]: s["pooled"]["pd"] for s in summary}, -1.0),
    )
    fronts = [_panel(axis, summary, values, sign) for axis, values, sign in panels]
    _key(key, summary, set().union(*fronts))
    handles = dict(zip(*reversed(left.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=7.5, frameon=False
    )
    figure.draw_without_rendering()  # the places of points are known after the layout
    for axis, values, _ in panels:
        _number(axis, summary, values, figure.dpi)
    save_figure(figure, path)


def pareto(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Labels on the Pareto front of (cost, loss), smaller is better, in the order of cost."""
    front, best = [], float("inf")
    for label, (_, loss) in sorted(points.items(), key=lambda item: item[1]):
        if loss < best:
            front.append(label)
            best = loss
    return front


def _at(summary: dict[str, Any], value: float) -> tuple[float, float]:
    return summary["times"][1]["ms_median"], value


def _panel(
    axis: Any, summary: Sequence[dict[str, Any]], values: dict[str, float | None], sign: float
) -> set[str]:
    """Points, bars and front of one panel; returns the chains on its front."""
    from matplotlib.ticker import LogLocator, NullFormatter

    shown = [s for s in summary if values[s["chain"]] is not None]
    points = {s["chain"]: _at(s, values[s["chain"]]) for s in shown}
    front = pareto({k: (x, sign * y) for k, (x, y) in points.items()})
    line = np.array([points[k] for k in front])
    axis.axvline(REAL_TIME_MS, color="#666666", ls="--", lw=0.9, label="real time, 1 ms")
    axis.plot(*line.T, color=_FRONT, lw=1.2, drawstyle="steps-post", label="Pareto front", zorder=2)
    for s in shown:
        x, y = points[s["chain"]]
        colour = _FRONT if s["chain"] in front else _REST
        axis.plot([x, max(s["times"][1]["ms_p99"], x)], [y, y], color=colour, lw=0.6, alpha=0.6, zorder=2)
        axis.plot(x, y, marker=_marker(s), ms=_size(s), color=colour, ls="none", zorder=3)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("CPU time, method and altimeter, one frame at a time / ms (bar: to p99)", fontsize=8)
    axis.grid(True, which="both", lw=0.3, color="#DDDDDD")
    axis.tick_params(labelsize=7.5)
    axis.margins(x=0.06, y=0.08)
    return set(front)


def _marker(summary: dict[str, Any]) -> str:
    """A star for a network, a dot for a choice of the altimeter, a disc for a classical method."""
    if summary["chain"].startswith("tcae"):
        return "*"
    return "." if summary["chain"].startswith("none, ") else "o"


def _size(summary: dict[str, Any]) -> float:
    return {"*": 8.0, ".": 5.0, "o": 4.5}[_marker(summary)]


def _number(
    axis: Any, summary: Sequence[dict[str, Any]], values: dict[str, float | None], dpi: float
) -> None:
    """The number of each point beside it, with a line to the point."""
    numbered = [(k, s) for k, s in enumerate(summary, 1) if values[s["chain"]] is not None]
    at = axis.transData.transform([_at(s, values[s["chain"]]) for _, s in numbered])
    ends = axis.transData.transform([(s["times"][1]["ms_p99"], values[s["chain"]]) for _, s in numbered])
    bars = np.concatenate([np.linspace(a, b, 40) for a, b in zip(at, ends, strict=True)])
    point = dpi / 72.0
    size = (1.35 * _LABEL_PT * point, 1.1 * _LABEL_PT * point)
    places = place_labels(at, bars, size=size, inside=axis.bbox.extents)
    for (number, _), (x, y) in zip(numbered, (places - at) / point, strict=True):
        s = summary[number - 1]
        axis.annotate(
            str(number),
            _at(s, values[s["chain"]]),
            xytext=(x, y),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=_LABEL_PT,
            zorder=5,
            bbox={"boxstyle": "square,pad=0.05", "fc": "white", "ec": "none", "alpha": 0.7},
            arrowprops={"arrowstyle": "-", "lw": 0.4, "color": "#444444", "shrinkA": 0.0, "shrinkB": 0.0},
        )


def place_labels(
    at: np.ndarray, avoid: np.ndarray, size: tuple[float, float], inside: Sequence[float]
) -> np.ndarray:
    """Centres of labels that cover neither each other nor a point, each as near to its own as it can be.

    Greedy: rings of growing radius about each point, the first free place is taken.

    Parameters
    ----------
    at : (n, 2) array
        Points, in pixels.
    avoid : (m, 2) array
        Further places that no label may cover, in pixels.
    size : (width, height)
        Size of a label, in pixels.
    inside : (left, bottom, right, top)
        Area for labels, in pixels.

    Returns
    -------
    (n, 2) array
        A label that finds no free place within 40 rings lies on its point.
    """
    size_xy, inside = np.asarray(size, dtype=float), np.asarray(inside, dtype=float)
    steps = 0.55 * np.arange(2, 42)[:, None, None] * size_xy[1] * _DIRECTIONS
    placed = np.empty((0, 2))
    out = at.astype(float).copy()
    for k, own in enumerate(at):
        centres = (own + steps).reshape(-1, 2)  # ring by ring

        def free(places: np.ndarray, share: float, centres: np.ndarray = centres) -> np.ndarray:
            return ~(np.abs(centres[:, None] - places) < share * size_xy).all(axis=2).any(axis=1)

        fits = (centres - size_xy / 2 >= inside[:2]).all(axis=1) & (centres + size_xy / 2 <= inside[2:]).all(
            axis=1
        )
        good = np.flatnonzero(fits & free(placed, 1.0) & free(at, 0.75) & free(avoid, 0.5))
        if good.size:
            out[k] = centres[good[0]]
            placed = np.vstack([placed, out[k]])
    return out


def _key(axis: Any, summary: Sequence[dict[str, Any]], fronts: set[str]) -> None:
    """The key of the numbers, chains on a front in its colour."""
    axis.set_axis_off()
    axis.set_xlim(0.0, 1.0)
    axis.set_ylim(len(summary) + 0.5, 0.5)
    for k, s in enumerate(summary, 1):
        colour = _FRONT if s["chain"] in fronts else "#444444"
        axis.plot(0.03, k, marker=_marker(s), ms=_size(s), color=colour, ls="none", clip_on=False)
        axis.text(0.15, k, str(k), fontsize=7, color=colour, ha="right", va="center")
        axis.text(0.19, k, _name(s["chain"]), fontsize=7, color=colour, va="center")


def _name(label: str) -> str:
    """A network's chain by its file name; other chains by their label."""
    short = label.replace("lms_reference_input", "lms, ref. as input")
    return short.removeprefix("tcae ") + ".onnx" if short.startswith("tcae ") else short
