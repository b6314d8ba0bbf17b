"""Figures of the integrity campaign; matplotlib is imported when one is drawn."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.results.figure import COLUMN_IN, new_figure, save_figure
from ...evaluation.results.integrity import Integrity
from ...evaluation.results.labels import name_curves
from ...evaluation.results.rows import grouped
from ...evaluation.results.score import Score
from ...evaluation.results.style import series_style
from .cases import ATTITUDES, LANDS
from .columns import EDGES, FRAMES

Row = Mapping[str, Any]
_OFTEN = 0.95  # share of the time, the target up to a bank of 30 degrees (docs/tracker.md)


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
    figure = new_figure(COLUMN_IN, 4.0)
    axis = figure.subplots()
    top = max(2, int(counts.max(initial=0)))
    shown, norm = np.ma.masked_equal(counts.T, 0), LogNorm(0.1, top)
    image = axis.pcolormesh(edges, edges, shown, cmap="Greys", norm=norm)
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
        axis.text(x, y, text, ha=at, va="center", fontsize=9, bbox=box)
    ends = edges[0], edges[-1]
    axis.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    axis.set(xlabel="error / alert limit (100: or no return)", ylabel="protection level / alert limit")
    figure.colorbar(image, label="outputs")
    save_figure(figure, path)


def draw_land(rows: Sequence[Row], path: Path) -> None:
    """Availability after the start over kinds of land and attitudes, with hazardous events; rows are pooled by case."""
    shares, events = np.full((2, len(LANDS), len(ATTITUDES)), np.nan)
    for row in rows:
        _, land, attitude = row["case"].split("/")
        at = list(LANDS).index(land), list(ATTITUDES).index(attitude)
        shares[at], events[at] = row["after_start"], row["hazardous_events"]
    figure = new_figure(COLUMN_IN, 4.2)
    axis = figure.subplots()
    image = axis.imshow(shares, cmap="cividis", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        if np.isfinite(share):
            count = events[row, column]
            text = f"{np.floor(100 * share) / 100:.2f}" + f"\n{count:g} !" * bool(count)
            color = "black" if share > 0.5 else "white"
            axis.text(column, row, text, ha="center", va="center", fontsize=9, color=color)
    axis.set_xticks(range(len(ATTITUDES)), list(ATTITUDES), rotation=30, ha="right")
    axis.set_yticks(range(len(LANDS)), list(LANDS))
    figure.colorbar(image, label="available after the start (!: hazardous events)")
    if rows:
        land, attitude = np.unravel_index(np.nanargmin(shares), shares.shape)
        flown, often = np.isfinite(shares).sum(), (shares >= _OFTEN).sum()
        least = f"least over {[*LANDS][land]}, {[*ATTITUDES][attitude]}"
        axis.set_title(f"Available {_OFTEN:g} or more in {often} of {flown} cells;\n{least}", fontsize=11)
    save_figure(figure, path)


def draw_sir(rows: Sequence[Row], path: Path) -> None:
    """Availability tracked, and wrong altitudes called valid, against SIR, over all cases of the kind `jammed`."""
    rows = [r for r in rows if r["kind"] == "jammed"]
    methods = list(dict.fromkeys(r["method"] for r in rows))
    figure = new_figure(COLUMN_IN, 4.6)
    top, bottom = figure.subplots(2, 1, sharex=True)
    bottom.set_yscale("log")
    for method in methods:
        mine = [r for r in rows if r["method"] == method]
        sirs = sorted({r["sir_db"] for r in mine})
        at = [[r for r in mine if r["sir_db"] == sir] for sir in sirs]
        style = series_style(method, methods)
        top.plot(sirs, [sum(map(Integrity.of_row, some), Integrity()).availability for some in at], **style)
        frames = [Score(**{name: sum(r[name] for r in some) for name in FRAMES}) for some in at]
        rates, bounds = (np.array([getattr(s, name) for s in frames]) for name in ("wrong", "wrong_bound"))
        rates = rates / [s.trials for s in frames]
        seen = rates > 0
        spread = np.array([np.zeros(seen.sum()), (bounds - rates)[seen]])
        bottom.errorbar(np.array(sirs)[seen], rates[seen], yerr=spread, elinewidth=0.8, capsize=2, **style)
    if rows:
        totals = [sum(map(Integrity.of_row, mine), Integrity()) for mine in grouped(rows, "method").values()]
        worst = max(totals, key=lambda one: one.bound("hazardous"))  # all methods fly the same flights
        bound = worst.bound("hazardous")
        bottom.axhline(bound, color="black", lw=1.5, ls=":")
        said = f"tracked, worst method: {worst.hazardous} of {worst.outputs:,}\nhazardous (95 % bound)"
        at = {"transform": bottom.get_yaxis_transform(), "ha": "right", "va": "top", "fontsize": 9}
        bottom.text(0.98, 0.8 * bound, said, **at)
        bottom.set_ylim(bottom=0.15 * bound)
        sirs = sorted({r["sir_db"] for r in rows})
        deep_db = sirs[max(0, len(sirs) // 2 - 1)]  # of the lower half
        deep = {m: [r for r in rows if r["method"] == m and r["sir_db"] <= deep_db] for m in methods}
        shares = {m: sum(map(Integrity.of_row, some), Integrity()).availability for m, some in deep.items()}
        named = sorted(shares, key=shares.__getitem__, reverse=True)
        each = ", ".join(f"{m} {shares[m]:.2f}" for m in named)
        figure.suptitle(f"Available at {deep_db:.0f} dB and less:\n{each}", fontsize=11)
    top.set(ylabel="available, tracked", ylim=(-0.02, 1.02))
    bottom.set(ylabel="wrong, per frame", xlabel="SIR, averaged over the frame / dB")
    for axis in (top, bottom):
        axis.grid(color="0.9")
    bottom.invert_xaxis()  # of both: interference grows to the right
    name_curves(figure, [top])
    save_figure(figure, path)
