"""Error against run time: gain against cost, and the front of what no other is cheaper and better than."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from .figure import COLUMN_IN, in_lines, new_figure, save_figure
from .labels import name_curves
from .style import series_style

_FEW = 7  # points whose names have room in a figure of one column


def pareto(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Names on the front of (cost, gain), in the order of cost: no other entry is cheaper and better."""
    front, best = [], -np.inf
    for name in sorted(points, key=lambda name: points[name]):
        if points[name][1] > best:
            front.append(name)
            best = points[name][1]
    return front


def draw_pareto(
    points: Mapping[str, tuple[float, float]], path: Path, *, cost: str, gain: str, title: str
) -> None:
    """Gain against cost on a logarithmic axis, every point named, with the front.

    ``points`` are (cost, gain) by name, ``cost`` and ``gain`` the axes' labels; ``title`` says what they show.
    """
    from matplotlib.ticker import LogLocator

    width = COLUMN_IN if len(points) <= _FEW else 7.0
    figure, fill = new_figure(width, 4.2), partial(in_lines, width=int(12 * width))
    axis = figure.subplots()
    free = {name: gain for name, (cost, gain) in points.items() if not cost}
    points = {name: point for name, point in points.items() if point[0]}
    front = pareto(points)
    for name, gain_of in free.items():  # no place on a logarithmic axis
        axis.axhline(gain_of, color="0.4", ls=":", gid=f"series {name}", label=f"{name}: no cost")
    if points:
        x, y = np.repeat([points[name] for name in front], 2, axis=0).T
        axis.plot(x[1:], y[:-1], color="0.7", zorder=1)
        if len(front) > 1:
            axis.set_title("on the line no other is cheaper and better", fontsize=9)
    for name, point in points.items():
        style = series_style(name, tuple(points))
        axis.plot(*point, style["marker"], color=style["color"], ms=7, gid=f"series {name}", label=name)
    figure.suptitle(fill(title), fontsize=10.5)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.minorticks_off()
    axis.set(xlabel=fill(cost), ylabel=gain)
    axis.margins(x=0.2, y=0.12)
    axis.grid(alpha=0.3)
    name_curves(figure, [axis], size=9)
    save_figure(figure, path)
