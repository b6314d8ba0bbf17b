"""Figures of the landing study; matplotlib is imported when one is drawn."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.altimeter.altimeter import Altimeter
from ...core.mitigation import create
from ...evaluation.results.figure import COLUMN_IN, new_figure, save_figure
from ...evaluation.results.labels import name_curves
from ...evaluation.results.score import CORRECT_LIMIT_M, accuracy_limit_m
from ...evaluation.results.style import series_style
from ...evaluation.results.table import said
from .config import LandingConfig
from .study import approach_frames, impaired, rng_of

Row = dict[str, Any]
IMAGE_FRAMES = 300  # columns of the range-time image, about one per pixel


def condition(row: Row) -> str:
    """Label of a frame of the approach: its method, or ``no interference``."""
    return "no interference" if row["overlap"] == 0 else row["method"]


def draw_figures(
    config: LandingConfig, rows: Mapping[str, Sequence[Row]], whole: Sequence[Row], folder: Path
) -> list[str]:
    """Draw the figures of the tables that have rows; returns the file names, in report order.

    ``whole`` are the entries of `report.approach_table` for the whole approach.
    """
    if not rows["approach"]:
        return []
    return [_approach(config, rows["approach"], whole, folder), _range_time(config, folder)]


def _approach(config: LandingConfig, rows: Sequence[Row], whole: Sequence[Row], folder: Path) -> str:
    """Error over height of the first condition, and the Pd of all over the whole approach."""
    labels, methods = [e["condition"] for e in whole], {condition(r): r["method"] for r in rows}
    figure = new_figure(COLUMN_IN, 3.2 + 0.2 * len(whole))
    top, bottom = figure.subplots(2, 1, height_ratios=(2.2, 0.2 * (len(whole) + 1)))
    _error_over_height([r for r in rows if condition(r) == labels[0]], top)
    top.set_title(labels[0], fontsize=10)
    for place, (entry, label) in enumerate(zip(whole, labels, strict=True)):
        spread = [[entry["pd"] - entry["pd_low"]], [entry["pd_high"] - entry["pd"]]]
        style = {"fmt": "o", "color": series_style(methods[label], config.methods)["color"]}
        bottom.errorbar(entry["pd"], place, xerr=np.maximum(spread, 0.0), ms=5, capsize=3, **style)
    bottom.set_yticks(range(len(whole)), labels)
    bottom.set_ylim(len(whole) - 0.5, -0.5)
    bottom.set(xlabel=f"Pd: share within {CORRECT_LIMIT_M:g} m, 95 % interval", xlim=(-0.02, 1.02))
    bottom.set_title(f"SIR {config.approach.sir_db:g} dB, overlap {config.approach.overlap:g}", fontsize=10)
    bottom.grid(color="0.9")
    jammed = [e for e, label in zip(whole, labels, strict=True) if label in config.methods]
    best = max(jammed, key=lambda e: e["pd"], default=None)
    if best is not None:  # those with it whose intervals reach its own
        level = [e for e in jammed if e["pd_high"] >= best["pd_low"]]
        ends = dict.fromkeys(f"{end(e['pd'] for e in level):.2f}" for end in (min, max))
        head = said([e["condition"] for e in level], "is right most often", "are right most often, and level")
        figure.suptitle(textwrap.fill(f"{head}: Pd {' to '.join(ends)}", 46), fontsize=10.5)
    name_curves(figure, [top], size=9)
    save_figure(figure, folder / "figure_1_approach.png")
    return "figure_1_approach.png"


def _error_over_height(rows: Sequence[Row], axis: Any) -> None:
    mine = sorted(rows, key=lambda r: r["height_m"])
    height = np.array([r["height_m"] for r in mine])
    measured = np.array([r["altitude_m"] for r in mine], dtype=float)  # None is NaN
    limit = accuracy_limit_m(height)
    axis.fill_between(height, -limit, limit, color="#56B4E9", alpha=0.3)
    axis.plot(height, -limit, color="#56B4E9", lw=1.0, label="DO-155")
    for sign, label in ((1, None), (-1, f"{CORRECT_LIMIT_M:g} m")):
        axis.axhline(sign * CORRECT_LIMIT_M, color="black", lw=1.0, ls="--", label=label)
    axis.plot(height, measured - height, ".", ms=3, color="black")
    axis.set(xlabel="height above ground / m", ylabel="error of each frame / m", xlim=(height[-1], 0.0))


def _sent(config: LandingConfig) -> str:
    """The interference in words."""
    return " + ".join(i.emitter.title(config.waveform.bandwidth_hz) for i in config.interference) or "none"


def _range_time(config: LandingConfig, folder: Path) -> str:
    """Beat power over range and time: without interference, with it, after whitening or the last method."""
    step = max(1, config.approach.frames // IMAGE_FRAMES)
    times = config.approach_times_s()[::step]
    after = "whitening" if "whitening" in config.methods else config.methods[-1]
    panels = {"without\ninterference": [], "under\ninterference": [], f"behind\n{after}": []}
    altimeter = Altimeter(config.waveform, config.altimeter)
    stage = create(after, config.waveform, **config.method_options.get(after, {}))
    rng = rng_of(config, "range-time")
    levels = {"overlap": config.approach.overlap, "sir_db": config.approach.sir_db}
    for first in range(0, config.approach.frames, step):
        truth = approach_frames(config, first, 1)
        clean, _, _ = impaired(config, truth, rng)
        hit, _, _ = impaired(config, truth, rng, **levels)
        for name, frame in zip(panels, (clean[:, 0], hit[:, 0], stage.process(hit[:, 0])), strict=True):
            spectra = altimeter.spectra(frame)
            panels[name].append(spectra.power[0].mean(axis=0) / spectra.power[0].max())
    metres = spectra.beat_hz / config.waveform.altitude_to_beat_hz(1.0)
    starts = range(0, config.approach.frames, step)
    heights = np.array([approach_frames(config, k, 1).height_m[0] for k in starts])
    shown = (metres >= 0) & (metres <= min(1.3 * heights.max() + 50, metres.max()))
    figure = new_figure(5.0, 2.8)  # its type is legible at 400 px
    axes = figure.subplots(1, 3, sharey=True)
    for axis, (name, lines) in zip(axes, panels.items(), strict=True):
        with np.errstate(divide="ignore"):
            image = 10.0 * np.log10(np.maximum(np.array(lines)[:, shown].T, 1e-9))
        style = {"vmin": -40, "vmax": 0, "cmap": "cividis", "shading": "nearest", "rasterized": True}
        picture = axis.pcolormesh(times, metres[shown], image, **style)
        axis.set_title(name, fontsize=10)
    figure.suptitle(_sent(config), fontsize=9)
    axes[0].set_ylabel("range / m")
    figure.supxlabel("time / s", fontsize=10)
    figure.colorbar(picture, ax=axes, label="power / dB of the peak")
    save_figure(figure, folder / "figure_1_range_time.png")
    return "figure_1_range_time.png"
