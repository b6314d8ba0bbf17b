"""Names of curves in the free space next to them, in place of a legend. Lengths are in points."""

from collections.abc import Sequence
from itertools import chain, product
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.distance import cdist

_CELL = 4.0  # of the grid on which free places are searched
_LINE, _LONG = 1.2, 17  # height of a line of text, in its size; letters of a name in one line
_FAR = 7.0  # distance from which a name has a leader to its curve
_CLEAR = 12.0  # distance to other curves from which on a place is clearly that of one curve
_UNCLEAR, _CROSSED = 40.0, 25.0  # what a place on another curve, and a leader across one, cost as a distance
_WIDER = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.9)  # of the horizontal axis, tried in turn


def name_curves(figure: Any, axes: Sequence[Any], *, size: float = 8.5) -> None:
    """Write the name of each labelled line next to it, in its colour; the layout is computed here and stays.

    Where names have no room, the horizontal axis, which all ``axes`` share, goes on to the right without ticks. Lines
    that coincide have their names below one another. A name has the ``gid`` of its line.
    """
    figure.get_layout_engine().execute(figure)
    left, right = axes[0].get_xlim()
    ticks = [t for t in axes[0].get_xticks() if min(left, right) <= t <= max(left, right)]
    for end in [(axes[0].transAxes + axes[0].transData.inverted()).transform((1 + w, 0))[0] for w in _WIDER]:
        axes[0].set_xlim(left, end)
        found = [_labels(axis, size) for axis in axes]
        if None not in found:
            break
    if end != right:
        axes[0].set_xticks(ticks[:: 1 + len(ticks) // 7])
    for axis, labels in zip(axes, found, strict=True):
        if labels is None:  # no room at all
            axis.legend(fontsize=size)
        axis.spines["bottom"].set_bounds(left, right)
        for lines, corner, leader in labels or ():
            _write(axis, lines, corner, leader, size)


def _write(axis: Any, lines: dict[str, Any], corner: np.ndarray, leader: Any, size: float) -> None:
    """Names from a corner upwards, the last one first, and a leader."""
    from matplotlib.colors import to_rgb

    extent, up = axis.bbox.size * 72.0 / axis.figure.dpi, 0.2 * size
    at = {"xycoords": "axes fraction", "zorder": 200, "annotation_clip": False}
    for name, line in reversed(lines.items()):
        dark = [0.72 * part for part in to_rgb(line.get_color())]  # legible on white
        texts = [axis.annotate(name, (corner + (0.0, up)) / extent, fontsize=size, color=dark, **at)]
        up += _LINE * size * (1 + name.count("\n"))
        if leader is not None:
            (start, end), leader = leader / extent, None
            style = {"arrowstyle": "-", "color": line.get_color(), "lw": 0.6, "shrinkA": 0, "shrinkB": 0}
            texts.append(axis.annotate("", end, start, textcoords="axes fraction", arrowprops=style, **at))
        for text in texts:
            text.set_gid(line.get_gid())
            text.set_in_layout(False)


def _labels(axis: Any, size: float) -> list[tuple[dict[str, Any], np.ndarray, np.ndarray | None]] | None:
    """Of lines that coincide, the lines by name, the corner of the names and a leader; None where one has no room."""
    from matplotlib.font_manager import FontProperties

    scale, font = 72.0 / axis.figure.dpi, FontProperties(size=size)
    renderer = axis.figure.canvas.get_renderer()
    shape = np.floor(axis.bbox.size * scale / _CELL).astype(int)

    def points(transform: Any, data: Any) -> np.ndarray:
        found = (transform.transform(np.reshape(data, (-1, 2))) - axis.bbox.p0) * scale
        return found[np.isfinite(found).all(axis=1)]

    def mark(grid: np.ndarray, where: np.ndarray) -> None:
        grid[tuple(np.clip(where // _CELL, 0, shape - 1).astype(int).T)] = True

    handles = {_broken(name): of for of, name in zip(*axis.get_legend_handles_labels(), strict=True)}
    lines = {name: getattr(handle, "lines", (handle,))[0] for name, handle in handles.items()}
    paths = {name: _along(points(of.get_transform(), of.get_xydata()), shape) for name, of in lines.items()}
    taken, written, out = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool), []
    for line in axis.get_lines():
        dots = points(line.get_transform(), line.get_xydata())
        if line.get_linestyle() != "None":
            mark(taken, _along(dots, shape))
        for side in product((-0.5, 0.5), repeat=2 * (line.get_marker() != "None")):
            mark(taken, dots + np.array(side or (0.0, 0.0)) * line.get_markersize())
    bars = chain.from_iterable(handle.lines[2] for handle in handles.values() if hasattr(handle, "lines"))
    for segment in chain.from_iterable(bar.get_segments() for bar in bars):
        mark(taken, _along(points(axis.transData, segment), shape))
    groups = _coinciding({name: path for name, path in paths.items() if len(path)}, 0.4 * size)
    for group in sorted(groups, key=lambda names: len(paths[names[0]])):  # the shortest has fewest places
        rows = [row for name in group for row in name.split("\n")]
        wide = max(renderer.get_text_width_height_descent(row, font, False)[0] for row in rows)
        extent, others = np.array([wide * scale, _LINE * size * len(rows)]), np.zeros(shape, dtype=bool)
        for name in paths.keys() - group:
            mark(others, paths[name])
        place = _place(taken, others, written, extent, np.concatenate([paths[name] for name in group]))
        if place is None:
            return None
        corner, leader = place
        mark(written, corner + np.array([*product(*(np.arange(0.0, length, _CELL) for length in extent))]))
        mark(written, np.linspace(*(leader if leader is not None else (corner, corner)), 50))
        out.append(({name: lines[name] for name in group}, corner, leader))
    return out


def _broken(name: str) -> str:
    """A long name in two lines, the break behind an underscore or a space near its middle."""
    breaks = [k + 1 for k, letter in enumerate(name) if letter in "_ "]
    at = min(breaks, key=lambda k: abs(k - len(name) / 2), default=0)
    return f"{name[:at]}\n{name[at:]}" if at and len(name) > _LONG else name


def _along(points: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Points close together along a curve, within a grid of cells."""
    if len(points) > 1:
        length = np.append(0.0, np.hypot(*np.diff(points, axis=0).T).cumsum())
        at = np.linspace(0.0, length[-1], 2 + int(length[-1] / (0.75 * _CELL)))
        points = np.stack([np.interp(at, length, column) for column in points.T], axis=1)
    return points[((points >= 0) & (points <= (shape + 1) * _CELL)).all(axis=1)]


def _coinciding(paths: dict[str, np.ndarray], limit: float) -> list[list[str]]:
    """Names of paths that lie within a distance of each other, all along."""
    groups: list[list[str]] = []
    for name, path in paths.items():
        apart = ((group, cdist(path, paths[group[0]])) for group in groups)
        same = [group for group, d in apart if max(d.min(axis=0).max(), d.min(axis=1).max()) < limit]
        (same[0] if same else groups).append(name if same else [name])  # type: ignore[arg-type]
    return groups


def _place(
    taken: np.ndarray, others: np.ndarray, written: np.ndarray, extent: np.ndarray, own: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None] | None:
    """Lower left corner of a label near its own points, and its leader; None without a free place.

    Cells: those ``taken`` by curves, of them those of ``others`` than its own, and those with names ``written``.
    """

    def at(grid: np.ndarray, where: np.ndarray) -> np.ndarray:
        cells = np.clip(where // _CELL, 0, np.array(grid.shape) - 1).astype(int)
        return grid[tuple(np.moveaxis(cells, -1, 0))]

    wide, tall = np.ceil(extent / _CELL).astype(int) + 1
    sums = np.pad((taken | written).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    inside = sums[wide:, tall:] - sums[:-wide, tall:] - sums[wide:, :-tall] + sums[:-wide, :-tall]
    corners = _CELL * (np.argwhere(inside == 0) + 0.5)
    if not len(corners):
        return None
    away = _CELL * distance_transform_edt(~others) / _CLEAR if others.any() else np.ones(others.shape)
    unclear, own = _UNCLEAR * np.clip(1.0 - away, 0.0, None) ** 2, own[:: 1 + len(own) // 60]
    # of the label, the point that is nearest to each point of its curve: (places, points, 2)
    nearest = np.clip(own, corners[:, None], corners[:, None] + extent)
    cost = np.hypot(*np.moveaxis(nearest - own, -1, 0)) + at(unclear, own)
    best, cost = cost.argmin(axis=1), cost.min(axis=1)
    for share in product((0.0, 0.5, 1.0), (0.0, 1.0)):  # the label itself is away from other curves
        cost += 0.2 * at(unclear, corners + share * extent)
    order = cost.argsort()[:80]
    leaders = np.stack([nearest[order, best[order]], own[best[order]]], axis=1)
    crossed = at(others | written, np.linspace(leaders[:, 0], 0.1 * leaders[:, 0] + 0.9 * leaders[:, 1], 20))
    k = (cost[order] + _CROSSED * crossed.any(axis=0)).argmin()
    return corners[order[k]], leaders[k] if np.hypot(*np.subtract(*leaders[k])) > _FAR else None
