"""Figures of the integrity campaign; matplotlib is imported when one is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.interference.evm import EMITTERS
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.integrity import Integrity
from ...evaluation.results.score import Score
from ...evaluation.results.style import series_style
from .columns import EDGES, FRAMES

_EMITTERS = f"{EMITTERS}; paper_qpsk: ideal"

__all__ = ["draw_sir", "draw_stanford"]

Row = Mapping[str, Any]


def stanford_counts(rows: Sequence[Row]) -> np.ndarray:
    """(k, k) outputs by error and protection level, in alert limits: the sum over rows."""
    counts = np.zeros((EDGES.size - 1, EDGES.size - 1), dtype=np.int64)
    for row in rows:
        for cell in (row["stanford"] or "").split():
            error, level, count = map(int, cell.split(","))
            counts[error, level] += count
    return counts


def draw_stanford(rows: Sequence[Row], path: Path) -> None:
    """Stanford diagram of all methods: error against protection level of computed outputs, over the alert limit."""
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Rectangle

    counts = stanford_counts(rows)
    edges = EDGES.copy()
    edges[0] = edges[1] ** 2 / edges[2]  # the first bin, from 0, is drawn as wide as the others
    figure = new_figure(5.2, 4.3)
    axis = figure.subplots()
    figure.suptitle(_EMITTERS, fontsize=7)
    top = max(2, int(counts.max(initial=0)))
    image = axis.pcolormesh(
        edges, edges, np.ma.masked_equal(counts.T, 0), cmap="Greys", norm=LogNorm(0.1, top)
    )
    axis.plot([edges[0], edges[-1]], [edges[0], edges[-1]], "k-", lw=0.8)
    for line in (axis.axvline, axis.axhline):
        line(1.0, color="black", lw=0.8, ls="--")
    axis.add_patch(
        Rectangle((1.0, edges[0]), edges[-1] - 1.0, 1.0 - edges[0], fill=False, hatch="///", lw=0, alpha=0.35)
    )
    middle = np.sqrt(edges[1:] * edges[:-1])
    error, level = np.nonzero(counts * (middle[:, None] > 1.0) * (middle < 1.0))
    axis.plot(middle[error], middle[level], "kx", ms=5)  # a single one would not be seen in the hatching
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    for text, x, y, at in (
        ("hazardous", 10.0, 0.0015, "center"),
        ("misleading", 0.25, 0.0015, "center"),
        ("bounded", 0.0012, 0.018, "left"),
        ("not to be used", 0.0012, 30.0, "left"),
    ):
        axis.text(x, y, text, ha=at, va="center", fontsize=8, bbox=box)
    axis.set(
        xscale="log",
        yscale="log",
        xlim=(edges[0], edges[-1]),
        ylim=(edges[0], edges[-1]),
        xlabel="error / alert limit (last column: 100 and more, or no return)",
        ylabel="protection level / alert limit",
    )
    figure.colorbar(image, label="outputs")
    save_figure(figure, path)


def draw_sir(rows: Sequence[Row], path: Path) -> None:
    """Pd, availability and the rate of wrong altitudes against SIR, over all cases of the kind `jammed`."""
    rows = [r for r in rows if r["kind"] == "jammed"]
    methods = list(dict.fromkeys(r["method"] for r in rows))
    figure = new_figure(7.6, 3.6)
    left, right = figure.subplots(1, 2)
    figure.suptitle(_EMITTERS, fontsize=7)
    for method in methods:
        mine = [r for r in rows if r["method"] == method]
        sirs = sorted({r["sir_db"] for r in mine})
        at = [[r for r in mine if r["sir_db"] == sir] for sir in sirs]
        frames = [Score(**{name: sum(r[name] for r in some) for name in FRAMES}) for some in at]
        tracked = [sum((Integrity.of_row(r) for r in some), Integrity()) for some in at]
        alone, after = series_style(method, methods), series_style(f"{method}, tracked", methods)
        left.plot(sirs, [s.pd for s in frames], **alone)
        left.plot(sirs, [t.availability for t in tracked], **after)
        _rates(right, sirs, [s.wrong / s.trials for s in frames], [s.wrong_bound for s in frames], alone)
        bounds = [t.bound("wrong_20m") for t in tracked]
        _rates(right, sirs, [t.rate("wrong_20m") for t in tracked], bounds, after)
    left.set(ylabel="Pd per frame; availability tracked", ylim=(-0.02, 1.02))
    right.set(ylabel="rate of wrong altitudes called valid", yscale="log")
    right.set_title(
        "off by 5 m per frame, by 20 m tracked;\narrow: none seen, marker at the 95 % bound", fontsize=7
    )
    for axis in (left, right):
        axis.set_xlabel("SIR over the whole sweep / dB")
        axis.grid(color="0.9")
    if methods:
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=7, frameon=False)
    save_figure(figure, path)


def _rates(
    axis: Any, sirs: Sequence[float], rates: Sequence[float], bounds: Sequence[float], style: dict
) -> None:
    """Rates with their upper bounds; for a rate of zero the bound, with an arrow down."""
    rate, bound = np.array(rates), np.array(bounds)
    none = rate == 0
    shown = np.where(none, bound, rate)
    axis.plot(sirs, shown, **style)
    spread = np.array([np.where(none, 0.4 * bound, 0.0), np.where(none, 0.0, bound - rate)])
    style_options = {"fmt": "none", "ecolor": style["color"], "elinewidth": 0.8, "capsize": 2}
    axis.errorbar(sirs, shown, yerr=spread, uplims=none, **style_options)
