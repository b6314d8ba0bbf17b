"""Figures of the landing study; matplotlib is imported when one is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.mitigation import create
from ...core.receiver.altimeter import Altimeter
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.score import CORRECT_LIMIT_M, accuracy_limit_m
from ...evaluation.results.style import series_style
from .config import LandingConfig
from .points import approach_frames, impaired, rng_of

__all__ = ["condition", "curve_of", "draw_figures"]

IMAGE_FRAMES = 300  # columns of the range-time image, about one per pixel
_DPI, _ACROSS = 130, 4  # resolution of all figures; conditions side by side in the first


def condition(row: dict[str, Any]) -> str:
    """Label of a frame of the approach: its method, or ``no interference``."""
    return "no interference" if row["overlap"] == 0 else row["method"]


def curve_of(rows: Sequence[dict[str, Any]], overlap: float, method: str) -> list[dict[str, Any]]:
    """One curve of figure 2, by rising nominal SINR (that of a point is limited by its SNR)."""
    wanted = [r for r in rows if (r["overlap"], r["method"]) == (overlap, method)]
    return sorted((r for r in wanted if r["asked_sinr_db"] is not None), key=lambda r: r["asked_sinr_db"])


def draw_figures(
    config: LandingConfig, rows: Mapping[str, Sequence[dict[str, Any]]], folder: Path
) -> list[str]:
    """Draw the figures of the tables that have rows; returns the file names, in report order."""
    names = []
    if rows["approach"]:
        names.append(_approach(config, rows["approach"], folder))
        names.append(_range_time(config, folder))
    if rows["curve"]:
        names.append(_error_against_sinr(config, rows["curve"], folder))
    return names


def _approach(config: LandingConfig, rows: Sequence[dict[str, Any]], folder: Path) -> str:
    """Altitude and error over time, per condition."""
    labels = list(dict.fromkeys(condition(r) for r in rows))
    across = min(len(labels), _ACROSS)
    down = -(-len(labels) // across)
    figure = new_figure(2.6 * across + 1, 4.6 * down + 0.7, dpi=_DPI)
    parts, bottoms = np.atleast_1d(figure.subfigures(down, 1)), []
    for part, first in zip(parts, range(0, len(labels), across), strict=True):
        axes = part.subplots(2, across, sharex=True, sharey="row", squeeze=False)
        for axis in axes[:, len(labels) - first :].ravel():
            axis.set_axis_off()
        for (top, bottom), label in zip(axes.T, labels[first : first + across], strict=False):
            _approach_of(config, [r for r in rows if condition(r) == label], top, bottom)
            top.set_title(label, fontsize=10)
            bottoms.append(bottom)
        axes[0, 0].set_ylabel("altitude / m")
        axes[1, 0].set_ylabel("error / m (linear to 10 m)")
    ends = np.array([axis.get_ylim() for axis in bottoms])
    for axis in bottoms:
        axis.set_ylim(ends[:, 0].min(), ends[:, 1].max())
    handles = [pair for axis in axes[:, 0] for pair in zip(*axis.get_legend_handles_labels(), strict=True)]
    parts[-1].legend(
        *zip(*handles, strict=True), loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )
    parts[0].suptitle(
        f"{_sent(config)}\n"
        f"SIR {config.approach.sir_db:g} dB, overlap {config.approach.overlap:g}; dots: declared altitudes"
    )
    return _save(figure, folder, "figure_1_approach.png")


def _sent(config: LandingConfig) -> str:
    """The interference in words."""
    return " + ".join(i.emitter.title(config.waveform.bandwidth_hz) for i in config.interference) or "none"


def _approach_of(config: LandingConfig, rows: Sequence[dict[str, Any]], top: Any, bottom: Any) -> None:
    mine = sorted(rows, key=lambda r: r["time_s"])
    t = np.array([r["time_s"] for r in mine])
    height = np.array([r["height_m"] for r in mine])
    measured = np.array([np.nan if r["altitude_m"] is None else r["altitude_m"] for r in mine])
    colour = series_style(mine[0]["method"], config.methods)["color"]
    top.plot(t, height, color="#999999", lw=2, label="height above ground")
    top.plot(t, measured, ".", ms=2.5, color=colour, label="measured")
    limit = accuracy_limit_m(height)
    bottom.fill_between(t, -limit, limit, color="#56B4E9", alpha=0.3, label="accuracy band")
    for sign in (-1, 1):
        bottom.axhline(
            sign * CORRECT_LIMIT_M,
            color="#999999",
            lw=0.8,
            ls="--",
            label=f"{CORRECT_LIMIT_M:g} m, limit of Pd" if sign > 0 else None,
        )
    bottom.plot(t, measured - height, ".", ms=2.5, color=colour)
    bottom.set_yscale("symlog", linthresh=10.0)
    bottom.set_xlabel("time / s")


def _range_time(config: LandingConfig, folder: Path) -> str:
    """Beat power over range and time: without interference, with it, after whitening or the last method."""
    step = max(1, config.approach.frames // IMAGE_FRAMES)
    times = config.approach_times_s()[::step]
    after = "whitening" if "whitening" in config.methods else config.methods[-1]
    panels = {"no interference": [], "with interference": [], f"after {after}": []}
    altimeter, stage = (
        Altimeter(config.waveform, config.altimeter),
        create(after, config.waveform, **config.method_options.get(after, {})),
    )
    rng = rng_of(config, "range-time")
    for first in range(0, config.approach.frames, step):
        truth = approach_frames(config, first, 1)
        clean, _, _ = impaired(config, truth, rng)
        hit, _, _ = impaired(
            config, truth, rng, overlap=config.approach.overlap, sir_db=config.approach.sir_db
        )
        for name, frame in zip(panels, (clean[:, 0], hit[:, 0], stage.process(hit[:, 0])), strict=True):
            spectra = altimeter.spectra(frame)
            panels[name].append(spectra.power[0].mean(axis=0) / spectra.power[0].max())
    metres = spectra.beat_hz / config.waveform.altitude_to_beat_hz(1.0)
    starts = range(0, config.approach.frames, step)
    heights = np.array([approach_frames(config, k, 1).height_m[0] for k in starts])
    shown = (metres >= 0) & (metres <= min(1.3 * heights.max() + 50, metres.max()))
    figure = new_figure(13, 4.2, dpi=_DPI)
    axes = figure.subplots(1, 3, sharey=True)
    for axis, (name, lines) in zip(axes, panels.items(), strict=True):
        with np.errstate(divide="ignore"):
            image = 10.0 * np.log10(np.maximum(np.array(lines)[:, shown].T, 1e-9))
        picture = axis.pcolormesh(
            times, metres[shown], image, vmin=-40, vmax=0, cmap="cividis", shading="nearest", rasterized=True
        )
        axis.plot(times, heights, color="white", lw=0.7, ls="--")
        axis.set(title=name, xlabel="time / s")
    figure.suptitle(_sent(config), fontsize=9)
    axes[0].set_ylabel("range / m")
    figure.colorbar(picture, ax=axes, label="power of both half sweeps / dB of the frame's peak")
    return _save(figure, folder, "figure_1_range_time.png")


def _error_against_sinr(config: LandingConfig, rows: Sequence[dict[str, Any]], folder: Path) -> str:
    """Error over all frames and Pd against SINR, a row per overlap; errors of detections only are in curve.csv."""
    overlaps = config.curve.overlap
    figure = new_figure(6.2, 2.1 * len(overlaps) + 1.4, dpi=_DPI)
    axes = figure.subplots(len(overlaps), 2, sharex=True, sharey="col", squeeze=False)
    columns = (
        ("rmse_forced_m", "rmse_forced_low_m", "rmse_forced_high_m", "RMSE, all frames / m"),
        ("pd", "pd_low", "pd_high", "Pd (|error| < 5 m)"),
    )
    ceiling = next((r for r in rows if r["asked_sinr_db"] is None and r["method"] == "none"), None)
    for pair, overlap in zip(axes, overlaps, strict=True):
        for axis, (value, low, high, label) in zip(pair, columns, strict=True):
            if ceiling and ceiling[value] is not None:
                axis.axhline(ceiling[value], color="#999999", lw=1.5)
                axis.axhspan(ceiling[low], ceiling[high], color="#999999", alpha=0.25)
            for method in config.methods:
                mine = curve_of(rows, overlap, method)
                x = [r["asked_sinr_db"] for r in mine]
                y, bottom, top = (
                    np.array([np.nan if r[c] is None else r[c] for r in mine], dtype=float)
                    for c in (value, low, high)
                )
                style = series_style(method, config.methods)
                axis.plot(x, y, ms=4, **style)
                axis.fill_between(x, bottom, top, color=style["color"], alpha=0.15)
            axis.set_ylabel(label)
            axis.set_title(f"overlap {overlap:g}" + (" (noise alone)" if overlap == 0 else ""), fontsize=10)
            axis.grid(alpha=0.3)
        pair[0].set_yscale("log")
    for axis in axes[-1]:
        axis.set_xlabel("SINR / dB")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    figure.suptitle(
        f"grey: no interference, no mitigation; bands: 95 % intervals\n{_sent(config)}", fontsize=9
    )
    return _save(figure, folder, "figure_2_error_against_sinr.png")


def _save(figure: Any, folder: Path, name: str) -> str:
    save_figure(figure, folder / name)
    return name
