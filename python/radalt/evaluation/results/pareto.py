"""Error against run time: gain against cost, and the front of what no other is cheaper and better than."""

import textwrap
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .figure import COLUMN_IN, new_figure, save_figure
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
    points: Mapping[str, tuple[float, float]], path: Path, *, cost: str, gain: str, verb: str
) -> None:
    """Gain against cost on a logarithmic axis, every point named, with the front.

    ``points`` are (cost, gain) by name, ``cost`` and ``gain`` the axes' labels; the title says that the best ``verb``.
    """
    width = COLUMN_IN if len(points) <= _FEW else 7.0
    figure, fill = new_figure(width, 4.2), partial(textwrap.fill, width=int(12 * width))
    axis = figure.subplots()
    free = {name: gain for name, (cost, gain) in points.items() if not cost}
    points = {name: point for name, point in points.items() if point[0]}
    front = pareto(points)
    for name, gain_of in free.items():  # no place on a logarithmic axis
        axis.axhline(gain_of, color="0.4", ls=":", gid=f"series {name}")
        where = {"transform": axis.get_yaxis_transform(), "va": "bottom", "ha": "right"}
        axis.text(0.99, gain_of, f"{name}: no cost", fontsize=9, **where)
    if points:
        steps = zip(*(points[name] for name in front), strict=True)
        axis.plot(*steps, color="0.7", drawstyle="steps-post", zorder=1)
        axis.set_title(fill(f"{front[-1]} {verb}; on the line no other is cheaper and better"), fontsize=10)
    for name, point in points.items():
        style = series_style(name, tuple(points))
        axis.plot(*point, style["marker"], color=style["color"], ms=7, gid=f"series {name}")
    axis.set_xscale("log")
    costs = [x for x, _ in points.values()] or [1.0]
    decades = 10.0 ** np.arange(np.floor(np.log10(min(costs))), 1 + np.ceil(np.log10(max(costs))))
    ticks = [t for t in np.outer(decades, (1, 2, 3, 5)).ravel() if min(costs) / 3 < t < 3 * max(costs)]
    axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.set(xlabel=fill(cost), ylabel=gain)
    axis.margins(x=0.2, y=0.12)
    axis.grid(alpha=0.3)
    _name_points(figure, axis, points)
    save_figure(figure, path)


def _name_points(figure: Any, axis: Any, points: Mapping[str, tuple[float, float]]) -> None:
    """Names next to their points, each at the first place where it covers no other name and no point."""
    figure.draw_without_rendering()
    axis.set_autoscale_on(False)
    dots = axis.transData.transform(list(points.values())) if points else []
    taken: list[Any] = []
    sides = ((-6, "right"), (6, "left"), (0, "center"))
    places = [(x, y, side) for y in (5, -13, 17, -25, 29, -37) for x, side in sides]
    for name in sorted(points, key=lambda name: points[name]):
        for x, y, side in places:
            colour = series_style(name, tuple(points))["color"]
            style = {"textcoords": "offset points", "fontsize": 9, "ha": side, "color": colour}
            text = axis.annotate(name, points[name], xytext=(x, y), **style)
            box = text.get_window_extent()
            within = axis.bbox.containsx(box.x0) and axis.bbox.containsx(box.x1)
            if within and not (any(box.overlaps(other) for other in taken) or box.count_contains(dots)):
                break
            if (x, y, side) != places[-1]:
                text.remove()
        taken.append(box)
