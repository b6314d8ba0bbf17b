"""Rows of the landing study: one point at a time, from (study, point) alone."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ...core.interference.placement import interference_frames
from ...core.mitigation import create
from ...core.receiver.altimeter import Altimeter, Spectra
from ...core.returns.point import point_return
from ...core.returns.terrain import GroundReturn
from ..results.score import CORRECT_LIMIT_M, wilson_interval
from .study import LandingStudy, Point, accuracy_limit_m
from .variants import VARIANTS

__all__ = ["COLUMNS", "Truth", "approach_frames", "impaired", "measure", "run_point", "statistics"]

COLUMNS = (
    "point", "rows", "kind", "method", "overlap", "sinr_db", "sir_db", "snr_db", "variant",
    "time_s", "height_m", "nearest_m", "climb_m_per_s",
    "valid", "reason", "altitude_m", "forced_altitude_m", "vertical_speed_m_per_s",
    "trials", "detections", "correct", "pd", "pd_low", "pd_high", "in_band",
    "rmse_m", "rmse_low_m", "rmse_high_m", "bias_m",
    "forced_trials", "forced_rmse_m", "forced_rmse_low_m", "forced_rmse_high_m",
    "speed_bias_m_per_s", "speed_rmse_m_per_s", "diverged_frames",
)  # fmt: skip
"""Columns of rows.csv; a row of one kind leaves those of the other empty."""

RESAMPLES = 400


@dataclasses.dataclass(frozen=True)
class Truth:
    """Frames without noise or interference, unit expected power, with what is true of them.

    Parameters
    ----------
    frames : (n, looks, N) complex64 array
        Consecutive frames of each of ``n`` altitudes.
    height_m, nearest_m, climb_m_per_s, snr_db, time_s : (n,) arrays
        Truth at the middle of the looks.
    """

    frames: np.ndarray
    height_m: np.ndarray
    nearest_m: np.ndarray
    climb_m_per_s: np.ndarray
    snr_db: np.ndarray
    time_s: np.ndarray


def _returns(study: LandingStudy, times_s: np.ndarray) -> list[GroundReturn]:
    radar = _radar(_key(study))
    results = []
    for state in study.states(times_s):
        result = radar(state)
        if study.point_target:
            # the phase is the echo's own; its level is that of the ground it stands for
            echo = point_return(
                study.waveform,
                result.height_m,
                vertical_speed_m_per_s=result.climb_m_per_s if study.doppler else 0.0,
            )
            result = dataclasses.replace(result, frame=echo * np.sqrt(result.power_w))
        results.append(result)
    return results


@lru_cache(maxsize=8)
def _truth(key: str, times: tuple[float, ...]) -> Truth:
    study = _STUDIES[key]
    offsets = (np.arange(study.looks) - 0.5 * (study.looks - 1)) * study.waveform.sweep_s
    samples = study.waveform.samples_per_frame
    frames = np.empty((len(times), study.looks, samples), dtype=np.complex64)
    rows = []
    for k, time_s in enumerate(times):
        looks = _returns(study, time_s + offsets)
        frames[k] = [r.frame / np.sqrt(r.power_w) for r in looks]
        rows.append(
            [np.mean([getattr(r, n) for r in looks]) for n in ("height_m", "nearest_m", "climb_m_per_s")]
        )
        rows[-1].append(looks[0].snr_db if study.snr_db is None else study.snr_db)
    height, nearest, climb, snr = np.array(rows).reshape(-1, 4).T
    return Truth(frames, height, nearest, climb, snr, np.array(times))


# studies hold dictionaries and are not hashable; caches are keyed by their digest instead
_STUDIES: dict[str, LandingStudy] = {}


def _key(study: LandingStudy) -> str:
    """Digest of what the frames without interference depend on."""
    parts = (study.trajectory, study.terrain, study.antenna, study.ground, study.link, study.waveform)
    more = (study.seed, study.snr_db, study.doppler, study.point_target, study.looks, study.folder)
    key = hashlib.sha256(repr((parts, more)).encode()).hexdigest()
    _STUDIES.setdefault(key, study)
    return key


@lru_cache(maxsize=8)
def _radar(key: str):  # noqa: ANN202 - TerrainReturn
    return _STUDIES[key].radar()


@lru_cache(maxsize=8)
def _altimeter(waveform, settings) -> Altimeter:  # noqa: ANN001
    return Altimeter(waveform, settings)


def approach_frames(study: LandingStudy, first: int, count: int) -> Truth:
    """Frames of a part of figure 1."""
    return _truth(_key(study), tuple(study.approach_times_s()[first : first + count].tolist()))


def impaired(
    study: LandingStudy,
    truth: Truth,
    rng: np.random.Generator,
    *,
    overlap: float = 0.0,
    sir_db: float | None = None,
    sinr_db: float | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames with noise and interference, and the SIR and SINR they have.

    Powers are averaged over the whole frame and refer to the *expected* return (mean over speckle). Given an
    SIR, the interference has it; given a SINR, the interference makes up what the noise leaves, and with
    overlap 0 the noise itself is raised to it. A SINR above the SNR cannot be had: the frame keeps its SNR.

    Returns
    -------
    frames : (n, looks, N) complex64 array
    sir_db, sinr_db : (n,) arrays; the SIR is infinite without interference.
    """
    n, looks, samples = truth.frames.shape
    noise_w = 10.0 ** (-truth.snr_db / 10.0)
    jam_w = np.zeros(n)
    jammed = bool(study.interference) and overlap > 0
    if sir_db is not None and jammed:
        jam_w[:] = 10.0 ** (-sir_db / 10.0)
    elif sinr_db is not None and jammed:
        jam_w = np.maximum(10.0 ** (-sinr_db / 10.0) - noise_w, 0.0)
    elif sinr_db is not None:
        noise_w = np.maximum(noise_w, 10.0 ** (-sinr_db / 10.0))
    frames = truth.frames.copy()
    for k in range(n):
        noise = rng.standard_normal((looks, samples, 2), dtype=np.float32).view(np.complex64)[..., 0]
        frames[k] += noise * np.float32(np.sqrt(0.5 * noise_w[k]))
        if jam_w[k] > 0:
            placed = [dataclasses.replace(i, overlap=overlap) for i in study.interference]
            jam = interference_frames(
                placed, looks, samples, study.waveform.rate_hz, rng, total_sir_db=-10.0 * np.log10(jam_w[k])
            )
            frames[k] += jam.astype(np.complex64)
    with np.errstate(divide="ignore"):
        return frames, -10.0 * np.log10(jam_w), -10.0 * np.log10(jam_w + noise_w)


def measure(study: LandingStudy, frames: np.ndarray, method: str) -> tuple[np.ndarray, int]:
    """Altimeter results of ``(n, looks, N)`` frames after a method, and the frames in which it diverged."""
    n, looks, samples = frames.shape
    stage = create(method, study.waveform, **study.method_options.get(method, {}))
    altimeter = _altimeter(study.waveform, study.altimeter)
    spectra = altimeter.spectra(stage.process(frames.reshape(n * looks, samples)))
    if looks > 1:
        spectra = _averaged(spectra, looks)
    return altimeter.detect(spectra), stage.diverged_frames


def _averaged(spectra: Spectra, looks: int) -> Spectra:
    """Mean power spectra of groups of looks; the CFAR keeps its one-look threshold: the safe side."""
    # spectra come scaled to unit peak; undo that, so that looks weigh by their power
    power = spectra.power * (spectra.scale**2)[:, None, None]
    power = power.reshape(-1, looks, *power.shape[1:]).mean(axis=1)
    scale = np.sqrt(power.max(axis=(1, 2)))
    power = (power / np.where(scale > 0, scale, 1.0)[:, None, None] ** 2).astype(np.float32)
    support = spectra.support.reshape(-1, looks, 2).mean(axis=1)
    return Spectra(power, support, spectra.beat_hz, scale)


def _rmse(errors: np.ndarray, seed: Sequence[int]) -> tuple[float, float, float]:
    """Root mean square with a 95 % bootstrap interval over trials."""
    if errors.size == 0:
        return np.nan, np.nan, np.nan
    square = errors**2
    draws = np.random.default_rng(list(seed)).integers(0, errors.size, (RESAMPLES, errors.size))
    low, high = np.percentile(np.sqrt(square[draws].mean(axis=1)), [2.5, 97.5])
    return float(np.sqrt(square.mean())), float(low), float(high)


def statistics(results: np.ndarray, truth: Truth, seed: Sequence[int]) -> dict[str, Any]:
    """Detection and error statistics of one method over a point's trials.

    A frame without detection counts against ``pd``; ``rmse_m`` is over detections, ``forced_rmse_m`` over
    every frame with its best pair of cells taken whether declared or not.
    """
    valid = results["valid"]
    error = results["altitude_m"] - truth.height_m
    with np.errstate(invalid="ignore"):
        correct = valid & (np.abs(error) < CORRECT_LIMIT_M)
        in_band = valid & (np.abs(error) <= accuracy_limit_m(truth.height_m))
    forced = (results["forced_altitude_m"] - truth.height_m)[np.isfinite(results["forced_altitude_m"])]
    speed = (results["vertical_speed_m_per_s"] - truth.climb_m_per_s)[valid]
    found = error[valid]
    rmse, forced_rmse = _rmse(found, seed), _rmse(forced, seed)
    pd_low, pd_high = wilson_interval(int(correct.sum()), valid.size)
    return {
        "trials": valid.size,
        "detections": int(valid.sum()),
        "correct": int(correct.sum()),
        "pd": correct.mean(),
        "pd_low": pd_low,
        "pd_high": pd_high,
        "in_band": in_band.mean(),
        "rmse_m": rmse[0],
        "rmse_low_m": rmse[1],
        "rmse_high_m": rmse[2],
        "bias_m": found.mean() if found.size else np.nan,
        "forced_trials": forced.size,
        "forced_rmse_m": forced_rmse[0],
        "forced_rmse_low_m": forced_rmse[1],
        "forced_rmse_high_m": forced_rmse[2],
        "speed_bias_m_per_s": speed.mean() if speed.size else np.nan,
        "speed_rmse_m_per_s": np.sqrt(np.mean(speed**2)) if speed.size else np.nan,
    }


def _seed(study: LandingStudy, name: str) -> list[int]:
    digest = hashlib.sha256(name.encode()).digest()
    return [study.seed, int.from_bytes(digest[:4], "big"), int.from_bytes(digest[4:8], "big")]


def run_point(study: LandingStudy, point: Point) -> list[dict[str, Any]]:
    """All rows of a point."""
    rows = {"approach": _approach_rows, "curve": _curve_rows, "variant": _variant_rows}[point.kind](
        study, point
    )
    for row in rows:
        row.update(point=point.name, rows=len(rows), kind=point.kind)
    return rows


def _approach_rows(study: LandingStudy, point: Point) -> list[dict[str, Any]]:
    truth = approach_frames(study, point.first, study.approach.chunk)
    spec = study.approach
    rows = []
    for hit, methods in ((False, ("none",)), (True, study.methods)):
        # the same noise with and without interference
        rng = np.random.default_rng(_seed(study, point.name))
        overlap = spec.overlap if hit else 0.0
        frames, sir, sinr = impaired(study, truth, rng, overlap=overlap, sir_db=spec.sir_db if hit else None)
        for method in methods:
            results, _ = measure(study, frames, method)
            rows += [
                {
                    "method": method,
                    "overlap": overlap,
                    "sinr_db": sinr[k],
                    "sir_db": sir[k],
                    "snr_db": truth.snr_db[k],
                    "time_s": truth.time_s[k],
                    "height_m": truth.height_m[k],
                    "nearest_m": truth.nearest_m[k],
                    "climb_m_per_s": truth.climb_m_per_s[k],
                    "valid": int(result["valid"]),
                    "reason": int(result["reason"]),
                    "altitude_m": result["altitude_m"],
                    "forced_altitude_m": result["forced_altitude_m"],
                    "vertical_speed_m_per_s": result["vertical_speed_m_per_s"],
                }
                for k, result in enumerate(results)
            ]
    return rows


def _summary_rows(
    study: LandingStudy, name: str, truth: Truth, methods: Sequence[str], level: dict[str, Any]
) -> list[dict[str, Any]]:
    frames, sir, sinr = impaired(study, truth, np.random.default_rng(_seed(study, name)), **level)
    rows = []
    for method in methods:
        results, diverged = measure(study, frames, method)
        row = {"method": method, "diverged_frames": diverged}
        row.update(statistics(results, truth, _seed(study, name)))
        row.update(sir_db=np.median(sir), snr_db=np.median(truth.snr_db), sinr_db=np.median(sinr))
        rows.append(row)
    return rows


def _trial_truth(study: LandingStudy, trials: int) -> Truth:
    return _truth(_key(study), tuple(study.trial_times_s(trials).tolist()))


def _curve_rows(study: LandingStudy, point: Point) -> list[dict[str, Any]]:
    truth = _trial_truth(study, study.curve.trials)
    level = {} if point.sinr_db is None else {"overlap": point.overlap, "sinr_db": point.sinr_db}
    rows = _summary_rows(study, point.name, truth, study.methods, level)
    for row in rows:
        row["overlap"] = point.overlap
    return rows


def _variant_rows(study: LandingStudy, point: Point) -> list[dict[str, Any]]:
    variant = next(v for v in VARIANTS if v.name == point.variant)
    changed = variant.change(study)
    truth = _trial_truth(changed, study.curve.sensitivity_trials)
    level = {"overlap": study.approach.overlap, "sir_db": study.approach.sir_db + variant.shift_db}
    # one random stream for the whole table: variants differ by their assumption, not by their draws
    methods = [m for m in ("none", "whitening", "tcae") if m == "none" or m in study.methods]
    rows = _summary_rows(changed, "variant", truth, methods, level)
    for row in rows:
        row.update(variant=variant.name, overlap=study.approach.overlap if changed.interference else 0.0)
    return rows
