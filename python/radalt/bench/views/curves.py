"""Pd over the level with 95 % intervals, a panel per case and overlap; of many, at the largest overlap alone."""

from collections.abc import Sequence
from pathlib import Path

from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.style import series_style
from ..paired import curves, level_db
from ..rows import Row

_PANELS = 15  # panels of a figure: the first ones; the table has all
_LINES = 8  # entries in a panel


def draw_curves(rows: Sequence[Row], entries: Sequence[str], path: Path) -> None:
    """The figure; nothing is written where no case has three levels."""
    found = curves(rows)
    shown = [where for where, by in found.items() if max(map(len, by.values())) >= 3]
    if not shown:
        return
    if len(shown) > _PANELS:
        fullest = {case: max(overlap for name, overlap in shown if name == case) for case, _ in shown}
        shown = [where for where in shown if where[1] == fullest[where[0]]][:_PANELS]
    across = min(3 if len(shown) > 4 else 2, len(shown))
    down = -(-len(shown) // across)
    figure = new_figure(2.9 * across + 0.6, 2.3 * down + 0.7)
    axes = figure.subplots(down, across, sharey=True, squeeze=False)
    names = tuple(name for name in entries if any(name in found[where] for where in shown))[:_LINES]
    for axis, where in zip(axes.flat, shown, strict=False):
        for name in (name for name in names if name in found[where]):
            curve, style = found[where][name], series_style(name, names)
            bars = [[r["pd"] - r["pd_low"] for r in curve], [r["pd_high"] - r["pd"] for r in curve]]
            pds = [r["pd"] for r in curve]
            axis.errorbar([level_db(r) for r in curve], pds, yerr=bars, ms=4, lw=1.2, elinewidth=0.7, **style)
        axis.set_title(f"{where[0].replace('_', ' ')}, overlap {where[1]:g}", fontsize=10)
        axis.invert_xaxis()
        axis.axhline(0.9, color="0.8", lw=0.8)
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    jammed = all(r["sir_db"] is not None for where in shown for curve in found[where].values() for r in curve)
    figure.supxlabel("SIR / dB" if jammed else "SIR, or SNR without interference / dB", fontsize=10)
    axes[0, 0].set_ylabel("Pd")
    lines = {
        name: line for axis in axes.flat for line, name in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    handles = [lines[name] for name in names if name in lines]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=9, frameon=False)
    save_figure(figure, path)
