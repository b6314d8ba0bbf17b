"""The page of cancellation: break-points, what happens above them, errors, and one frame looked into."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.interference.evm import EMITTERS
from ...core.mitigation import create
from ...core.mitigation.ofdm.acquisition import acquire, find_prefix
from ...core.mitigation.ofdm.demodulator import FIRST, demodulate
from ...core.mitigation.ofdm.lattice import DENSE
from ...core.mitigation.ofdm.numerology import SPACINGS_HZ, Numerology
from ...core.mitigation.ofdm.ridge import Ridge
from ...core.receiver.altimeter import Altimeter, AltimeterSettings
from ...evaluation.engine.study import Run
from ...evaluation.overlap.figures import series_style
from ...evaluation.results.break_point import break_point
from ...evaluation.results.chain import Chain
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_pages
from ...evaluation.results.score import pool, score_frames
from ...evaluation.results.table import number, table
from .cases import CASES, WAVEFORM, received
from .costs import costs
from .flights import tracked_table
from .known_symbols import (
    BLANKED_BURST,
    KNOWN,
    KNOWN_METHODS,
    misread_share,
    rmse_correct_m,
    weak_return_gain_db,
)
from .mixtures import MIXTURES
from .tracked import NR_MS

if TYPE_CHECKING:
    from .study import CancellationStudy

__all__ = ["write_report"]

Row = Mapping[str, Any]
_ERROR_SIR_DB = -40.0
_WITHIN = 3.0  # times the RMSE without interference
_CLEAN = 10  # times as many frames without interference: their error is the yardstick of all lines
_FRAME = ("nr10_64qam", -40.0)  # looked into


def write_report(
    folder: RunFolder, study: CancellationStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write ``report.md``, its figures and ``report.json``; returns the page."""
    found = rows["rows"]
    draw_pd(found, study.methods, folder.path / "pd.png")
    draw_frame(folder.path / "frame.png", study.seed)
    report = folder.head | {"run": run.as_dict()}
    tables = {
        "break_points": _break_points(found, study.methods),
        **_errors(found, study),
        **_mixtures(rows["mixtures"]),
        "known": _known(rows["known"]),
        "misread": _misread(),
        "gains": _gains(),
        "tracked": tracked_table(rows["tracked"]),
        "length_s": 1,
        "nr_ms": NR_MS,
        "sir_db": f"{_ERROR_SIR_DB:g}",
        "costs": costs(study.seed),
        "frame_samples": f"{WAVEFORM.samples_per_frame:,}",
    }
    page = write_pages(folder, Path(__file__).with_name("report.md.j2"), report | tables)
    folder.write_report(report | {name: list(table_rows) for name, table_rows in rows.items()})
    return page


def _of(rows: Sequence[Row], case: str, method: str) -> list[Row]:
    return sorted((r for r in rows if (r["case"], r["method"]) == (case, method)), key=lambda r: -r["sir_db"])


def _cases(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(r["case"] for r in rows))


def _made_for(case: str) -> str:
    """The method that reads a case's interference."""
    return "qpsk_cancel" if CASES[case].qpsk else "ofdm_cancel"


def _break_points(rows: Sequence[Row], methods: Sequence[str]) -> str:
    lines = []
    for case in _cases(rows):
        cells = []
        for method in methods:
            mine = _of(rows, case, method)
            cells.append(str(break_point([r["sir_db"] for r in mine], [r["pd"] for r in mine])))
        total = pool([r for r in rows if (r["case"], r["method"]) == (case, _made_for(case))])
        lines.append(
            [CASES[case].title, *cells, f"{total.wrong} of {total.trials} ({total.wrong_bound:.4f})"]
        )
    return table(["interference", *methods, "wrong and valid (bound)"], lines)


def _errors(rows: Sequence[Row], study: CancellationStudy) -> dict[str, object]:
    """Pd and RMSE at one SIR, in the first line without interference; and where the RMSE is hardly above that."""
    frames, altitude_m = received(
        CASES["nr10_64qam"], None, _CLEAN * study.frames, np.random.default_rng([study.seed, 9])
    )
    clean = []
    for method in ("none", *study.methods):
        results, _ = Chain(method, method).results(frames, WAVEFORM)
        error = {"rmse_correct_m": rmse_correct_m(results, altitude_m)}
        clean.append(score_frames(results, altitude_m).row() | error)
    limit_m = _WITHIN * clean[0]["rmse_detected_m"]
    lines, marks = [["no interference", *(_error(row) for row in clean[1:]), ""]], []
    for case in _cases(rows):
        at = {r["method"]: r for r in rows if (r["case"], r["sir_db"]) == (case, _ERROR_SIR_DB)}
        marks.append(_within(at.get(_made_for(case)), limit_m))
        cells = (_error(at[method]) if method in at else "given up" for method in study.methods)
        lines.append([CASES[case].title, *cells, marks[-1]])
    return {
        "errors": table(["interference", *study.methods, f"within {_WITHIN:g} times"], lines),
        "clean_frames": len(frames),
        "clean_rmse": number(clean[0]["rmse_detected_m"], 3),
        "within": marks.count("yes"),
        "case_count": len(marks),
    }


def _within(row: Row | None, limit_m: float) -> str:
    """Whether the RMSE of all altitudes is at most so much, or that of the frames that were changed."""
    if row is None:
        return ""
    every, cleaned = ((row[name] or np.inf) <= limit_m for name in ("rmse_detected_m", "rmse_cleaned_m"))
    of_cleaned = (
        f"{number(row['rmse_cleaned_m'], 3)} in the {row['frames_cleaned']} of {row['trials']} cleaned"
    )
    return "yes" if every else of_cleaned if cleaned else "no"


def _error(row: Row) -> str:
    return f"{row['pd']:.2f}, {number(row['rmse_detected_m'])}, {number(row['rmse_correct_m'])}"


def _mixtures(rows: Sequence[Row]) -> dict[str, str]:
    """Break-points of `hybrid` in mixtures, and Pd, wrong altitudes and error by SIR where nothing was removed."""
    if not rows:
        return {"mixtures": "", "mixtures_by_sir": ""}
    of = {name: [r for r in rows if r["mixture"] == name] for name in MIXTURES}
    lines = [
        [MIXTURES[name].title, str(break_point([r["sir_db"] for r in mine], [r["pd"] for r in mine]))]
        for name, mine in of.items()
    ]
    whole = [name for name in of if not MIXTURES[name].removed]
    by_sir = [
        [
            f"{at[0]['sir_db']:g}",
            *(
                f"{r['pd']:.2f}, {r['detections'] - r['correct']}, {number(r['rmse_correct_m'], 2)}"
                for r in at
            ),
        ]
        for at in zip(*(of[name] for name in whole), strict=True)
    ]
    return {
        "mixtures": table(["mixture", "break-point of hybrid in dB"], lines),
        "mixtures_by_sir": table(["SIR in dB", *(MIXTURES[name].title for name in whole)], by_sir),
    }


def _known(rows: Sequence[Row]) -> str:
    """Break-points and errors with all symbols known, beside those of the method; of bursts also with these blanked."""
    if not rows:
        return ""
    lines = []
    for kind in dict.fromkeys(r["kind"] for r in rows):
        points, errors = [], []
        for method in (*KNOWN_METHODS, BLANKED_BURST):
            mine = [r for r in rows if (r["kind"], r["method"]) == (kind, method)]
            if method in KNOWN_METHODS:
                points.append(str(break_point([r["sir_db"] for r in mine], [r["pd"] for r in mine])))
            at = [r["rmse_correct_m"] for r in mine if r["sir_db"] == _ERROR_SIR_DB]
            errors.append(number(at[0]) if at else "")
        lines.append([KNOWN[kind].title, *points, *errors[1:]])
    asked = (*KNOWN_METHODS[1:], BLANKED_BURST)
    return table(["interference", *KNOWN_METHODS, *(f"error, {method} (m)" for method in asked)], lines)


def _misread() -> str:
    """Share of wrong decisions by alphabet and noise."""
    lines = [
        [f"{snr_db:g}", *(number(misread_share(points, snr_db), 3) for points in (4, *DENSE))]
        for snr_db in (20.0, 15.0, 10.0, 8.0, 5.0)
    ]
    return table(["emitter over its noise, dB", "QPSK", *(f"{points}QAM" for points in DENSE)], lines)


def _gains() -> str:
    """Most that a weak return can gain, by alphabet and noise; a known signal leaves the noise alone."""
    lines = [
        [
            f"{snr_db:g}",
            *(number(weak_return_gain_db(points, snr_db), 1) for points in (4, *DENSE)),
            number(10 * np.log10(1 + 10 ** (snr_db / 10)), 1),
        ]
        for snr_db in (20.0, 15.0, 10.0, 8.0, 5.0)
    ]
    heads = ["emitter over its noise, dB", "QPSK", *(f"{points}QAM" for points in DENSE), "known"]
    return table(heads, lines)


def draw_pd(rows: Sequence[Row], methods: Sequence[str], path: Path) -> None:
    """Pd over SIR, a panel per case."""
    cases = _cases(rows)
    across = min(3, len(cases))
    down = -(-len(cases) // across)
    figure = new_figure(3.3 * across, 1.9 * down + 0.5, dpi=120)
    axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, case in zip(axes, cases, strict=False):
        for method in methods:
            mine = _of(rows, case, method)
            axis.plot(
                [r["sir_db"] for r in mine],
                [r["pd"] for r in mine],
                markersize=3.5,
                **series_style(method, methods),
            )
        axis.set_title(fill(CASES[case].title, 44), fontsize=7.5)
        axis.grid(alpha=0.3)
    for axis in axes[len(cases) :]:
        axis.set_axis_off()
    for axis in axes[max(0, len(cases) - across) : len(cases)]:
        axis.tick_params(labelbottom=True)  # also where the last line is not full
    axes[0].invert_xaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    title = f"{EMITTERS}, unless called ideal"
    figure.legend(handles, labels, loc="outside upper center", ncols=len(methods), fontsize=8, title=title)
    figure.supxlabel("SIR / dB", fontsize=9)
    figure.supylabel("Pd within 5 m", fontsize=9)
    save_figure(figure, path)


def draw_frame(path: Path, seed: int) -> None:
    """One frame before and after: spectrogram, constellation, beat spectrum."""
    case, sir_db = _FRAME
    frames, altitude_m = received(CASES[case], sir_db, 1, np.random.default_rng([seed, 7]))
    cleaned = create("ofdm_cancel", WAVEFORM).process(frames)
    figure = new_figure(9.5, 5.6, dpi=120)
    grid = figure.subplots(2, 3)
    for axis, frame, title in zip(grid[:, 0], (frames[0], cleaned[0]), ("received", "cleaned"), strict=True):
        image = _spectrogram(frame)
        drawn = axis.imshow(
            image, aspect="auto", origin="lower", extent=(0, 1e3 * WAVEFORM.sweep_s, -3.75, 3.75),
            vmin=image.max() - 50, vmax=image.max(), cmap="Greys",
        )  # fmt: skip
        axis.set(title=f"{title}, dB", xlabel="time / ms", ylabel="frequency / MHz")
        figure.colorbar(drawn, ax=axis)
    for axis, points, title in zip(
        grid[:, 1],
        _constellation(frames[0]),
        ("elements without the return", "elements with the return"),
        strict=True,
    ):
        axis.plot(points.real, points.imag, "k.", markersize=1)
        axis.set(title=title, xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), aspect="equal", xlabel="I", ylabel="Q")
    altimeter = Altimeter(WAVEFORM, AltimeterSettings())
    for axis, part, title in zip(grid[:, 2], (frames, cleaned), ("received", "cleaned"), strict=True):
        spectra = altimeter.spectra(part)
        for half, style in zip(spectra.power[0], ("k-", "k:"), strict=True):
            level_db = 10 * np.log10(np.maximum(half / spectra.power.max(), 1e-9))
            axis.plot(spectra.beat_hz / 1e3, level_db, style, lw=0.8)
        axis.axvline(
            WAVEFORM.slope_hz_per_s * 2 * altitude_m[0] / 299_792_458.0 / 1e3, color="#D55E00", lw=0.8
        )
        axis.set(title=f"beat spectra, {title}", xlabel="beat / kHz", ylabel="dB of the peak", ylim=(-60, 3))
    save_figure(figure, path)


def _spectrogram(frame: np.ndarray) -> np.ndarray:
    """(frequencies, times) dB, Hann windows of 128 samples."""
    windows = np.lib.stride_tricks.sliding_window_view(frame, 128)[::32] * np.hanning(128)
    power = np.abs(np.fft.fftshift(np.fft.fft(windows, axis=1), axes=1)) ** 2
    return 10 * np.log10(power.T + 1e-9)


def _constellation(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elements over the channel, of one frame on its own: those that no return can be in, and the others."""
    numerology = Numerology(WAVEFORM.rate_hz, SPACINGS_HZ[0])
    ridge = Ridge(WAVEFORM, numerology, 1500.0)
    prefix = find_prefix(frame, numerology)
    turn = np.exp(-2j * np.pi * prefix.carrier / numerology.useful * np.arange(frame.size))
    grid = acquire(
        (frame * turn).astype(np.complex64),
        prefix,
        numerology,
        lambda starts: ridge.clear(starts, prefix.carrier),
    )
    clear = ridge.clear(grid.starts, prefix.carrier)
    got = demodulate(grid, clear, numerology, FIRST)
    values = got.symbols / got.channel
    return values[clear & grid.used], values[~clear & grid.used]
