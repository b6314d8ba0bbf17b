"""The landing study on the sweep engine: rows of a point are a function of (config, point)."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...core.interference.placement import interference_frames
from ...core.returns.point import point_return
from ...core.returns.terrain import GroundReturn, TerrainReturn
from ...evaluation.engine.own import with_option_files
from ...evaluation.engine.study import Point, Study
from ...evaluation.overlap.study import check_methods, method_files
from ...evaluation.results.chain import Chain
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import SCORE_COLUMNS, accuracy_limit_m, score_frames
from .assumptions import ASSUMPTIONS
from .config import LandingConfig, check_config, config_dict

RESAMPLES = 400  # of the bootstrap
MEASURED = ("altitude_m", "forced_altitude_m", "vertical_speed_m_per_s", "peak_to_sidelobe_db")
_LEVELS = ("sinr_db", "sir_db", "snr_db")
_ACCURACY = ("in_band", "speed_bias_m_per_s", "speed_rmse_m_per_s")
_INTERVALS = tuple(f"rmse_{over}_{end}_m" for over in ("detected", "forced") for end in ("low", "high"))
_STATISTICS = (*_LEVELS, *SCORE_COLUMNS, *_INTERVALS, *_ACCURACY, "diverged_frames")
TABLES = {
    "approach": Columns(
        ("method", "overlap", *_LEVELS, "time_s", "height_m", "nearest_m", "climb_m_per_s")
        + ("valid", "reason", *MEASURED)
    ),
    "assumptions": Columns(("assumption", "method", "overlap", *_STATISTICS)),
}
"""Tables of the result: frames of the approach; rows of the sensitivity table."""


@dataclasses.dataclass(frozen=True)
class LandingPoint(Point):
    """A part of the approach from frame ``first`` on, or an assumption, by its ``table``."""

    first: int = 0
    assumption: str = ""


@dataclasses.dataclass(frozen=True)
class Truth:
    """Frames of unit expected power without noise or interference, and their truth.

    ``height_m``, ``nearest_m``, ``climb_m_per_s``, ``snr_db``, ``time_s`` (n,): truth at the middle of the looks.
    """

    frames: np.ndarray  # (n, looks, N) complex64: Consecutive frames for each of ``n`` altitudes
    height_m: np.ndarray
    nearest_m: np.ndarray
    climb_m_per_s: np.ndarray
    snr_db: np.ndarray
    time_s: np.ndarray


_ON_FRAMES = ("seed", "trajectory", "terrain", "antenna", "ground", "link", "waveform", "folder")
_ON_FRAMES += ("snr_db", "doppler", "point_target", "looks")


def _flown(config: LandingConfig) -> LandingConfig:
    """The study with only those settings on which frames without interference depend: a key of caches."""
    return LandingConfig(**{name: getattr(config, name) for name in _ON_FRAMES})


@lru_cache(maxsize=8)
def _radar(flown: LandingConfig) -> TerrainReturn:
    return flown.radar(flown.waveform, flown.seed)


def _returns(config: LandingConfig, times_s: np.ndarray) -> list[GroundReturn]:
    radar = _radar(_flown(config))
    results = []
    for state in config.states(times_s):
        result = radar(state)
        if config.point_target:
            # the phase of a point's echo, the level of the ground that it replaces
            echo = point_return(
                config.waveform,
                result.height_m,
                vertical_speed_m_per_s=result.climb_m_per_s if config.doppler else 0.0,
            )
            result = dataclasses.replace(result, frame=echo * np.sqrt(result.power_w))
        results.append(result)
    return results


@lru_cache(maxsize=8)
def _truth(config: LandingConfig, times: tuple[float, ...]) -> Truth:
    offsets = (np.arange(config.looks) - 0.5 * (config.looks - 1)) * config.waveform.sweep_s
    samples = config.waveform.samples_per_frame
    frames = np.empty((len(times), config.looks, samples), dtype=np.complex64)
    rows = []
    for k, time_s in enumerate(times):
        looks = _returns(config, time_s + offsets)
        frames[k] = [r.frame / np.sqrt(r.power_w) for r in looks]
        means = [np.mean([getattr(r, n) for r in looks]) for n in ("height_m", "nearest_m", "climb_m_per_s")]
        rows.append([*means, looks[0].snr_db if config.snr_db is None else config.snr_db])
    height, nearest, climb, snr = np.array(rows).reshape(-1, 4).T
    return Truth(frames, height, nearest, climb, snr, np.array(times))


def approach_frames(config: LandingConfig, first: int, count: int) -> Truth:
    """Returns of the ground for a part of figure 1."""
    return _truth(_flown(config), tuple(config.approach_times_s()[first : first + count].tolist()))


def trial_frames(config: LandingConfig, trials: int) -> Truth:
    """Returns of the ground for a point's trials."""
    return _truth(_flown(config), tuple(config.trial_times_s(trials).tolist()))


def impaired(
    config: LandingConfig,
    truth: Truth,
    rng: np.random.Generator,
    *,
    overlap: float = 0.0,
    sir_db: float | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames (n, looks, N) with noise and interference, and the SIR and SINR (n,) that they have.

    Powers are averaged over the whole frame and refer to the *expected* return (mean over speckle).
    """
    n, looks, samples = truth.frames.shape
    noise_w = 10.0 ** (-truth.snr_db / 10.0)
    jam_w = np.zeros(n)
    if sir_db is not None and config.interference and overlap > 0:
        jam_w[:] = 10.0 ** (-sir_db / 10.0)
    frames = truth.frames.copy()
    for k in range(n):
        noise = rng.standard_normal((looks, samples, 2), dtype=np.float32).view(np.complex64)[..., 0]
        frames[k] += noise * np.float32(np.sqrt(0.5 * noise_w[k]))
        if jam_w[k] > 0:
            placed = [dataclasses.replace(i, overlap=overlap) for i in config.interference]
            rate_hz, total_db = config.waveform.rate_hz, -10.0 * np.log10(jam_w[k])
            jam = interference_frames(placed, looks, samples, rate_hz, rng, total_sir_db=total_db)
            frames[k] += jam.astype(np.complex64)
    with np.errstate(divide="ignore"):
        return frames, -10.0 * np.log10(jam_w), -10.0 * np.log10(jam_w + noise_w)


def altitudes(config: LandingConfig, frames: np.ndarray, method: str) -> tuple[np.ndarray, int]:
    """Altimeter results of ``(n, looks, N)`` frames behind a method, and the number of frames in which it diverged."""
    options = tuple(config.method_options.get(method, {}).items())
    chain = Chain(method, method, options, settings=config.altimeter, looks=frames.shape[1])
    results, stage = chain.results(frames.reshape(-1, frames.shape[-1]), config.waveform)
    return results, stage.diverged_frames


def accuracy(results: np.ndarray, height_m: np.ndarray, climb_m_per_s: np.ndarray) -> dict[str, Any]:
    """The share within the accuracy band, and the error of vertical speed, which `Score` does not have.

    A frame without detection counts against ``in_band``, never against the speed.
    """
    valid = results["valid"]
    inside = np.abs(results["altitude_m"] - height_m)[valid] <= accuracy_limit_m(height_m)[valid]
    speed = (results["vertical_speed_m_per_s"] - climb_m_per_s)[valid]
    bias, mean_square = (speed.mean(), np.mean(speed**2)) if speed.size else (np.nan, np.nan)
    return dict(zip(_ACCURACY, (inside.sum() / valid.size, bias, np.sqrt(mean_square)), strict=True))


def statistics(results: np.ndarray, truth: Truth, seed: Sequence[int]) -> dict[str, Any]:
    """Score of one method over a point's trials, with bootstrap intervals (from ``seed``) of both errors."""
    row = score_frames(results, truth.height_m).row()
    row |= accuracy(results, truth.height_m, truth.climb_m_per_s)
    error = results["altitude_m"] - truth.height_m
    forced = results["forced_altitude_m"] - truth.height_m
    ends = (*_bootstrap(error[results["valid"]], seed), *_bootstrap(forced[np.isfinite(forced)], seed))
    return row | dict(zip(_INTERVALS, ends, strict=True))


def _bootstrap(errors: np.ndarray, seed: Sequence[int]) -> tuple[float, float]:
    """95 % interval of the root mean square over resampled trials."""
    if errors.size == 0:
        return np.nan, np.nan
    draws = np.random.default_rng(list(seed)).integers(0, errors.size, (RESAMPLES, errors.size))
    low, high = np.percentile(np.sqrt((errors**2)[draws].mean(axis=1)), [2.5, 97.5])
    return float(low), float(high)


def rng_of(config: LandingConfig, name: str) -> np.random.Generator:
    """Random generator of a point, by its name."""
    return np.random.default_rng(_seed(config, name))


def _seed(config: LandingConfig, name: str) -> list[int]:
    digest = hashlib.sha256(name.encode()).digest()
    return [config.seed, int.from_bytes(digest[:4], "big"), int.from_bytes(digest[4:8], "big")]


def _approach_rows(config: LandingConfig, point: LandingPoint) -> list[dict[str, Any]]:
    truth = approach_frames(config, point.first, point.frames)
    spec = config.approach
    rows = []
    for overlap, sir_db, methods in ((0.0, None, ("none",)), (spec.overlap, spec.sir_db, config.methods)):
        # one generator each, so that the noise is the same with and without interference
        rng = rng_of(config, point.name)
        frames, sir, sinr = impaired(config, truth, rng, overlap=overlap, sir_db=sir_db)
        known = {name: getattr(truth, name) for name in _TRUE} | {"sir_db": sir, "sinr_db": sinr}
        for method in methods:
            results, _ = altitudes(config, frames, method)
            found = known | {name: results[name] for name in ("valid", "reason", *MEASURED)}
            rows += [
                {"method": method, "overlap": overlap} | {name: v[k] for name, v in found.items()}
                for k in range(len(results))
            ]
    return rows


_TRUE = ("snr_db", "time_s", "height_m", "nearest_m", "climb_m_per_s")


def _assumption_rows(config: LandingConfig, point: LandingPoint) -> list[dict[str, Any]]:
    assumption = next(a for a in ASSUMPTIONS if a.name == point.assumption)
    changed = assumption.change(config)
    truth = trial_frames(changed, point.frames)
    # one seed for the whole table: rows differ by their assumption, not by their random numbers
    seed, overlap = _seed(config, "variant"), config.approach.overlap
    sir_db = config.approach.sir_db + assumption.shift_db
    frames, sir, sinr = impaired(changed, truth, np.random.default_rng(seed), overlap=overlap, sir_db=sir_db)
    where = {"assumption": point.assumption, "overlap": overlap if changed.interference else 0.0}
    where |= {"sir_db": np.median(sir), "snr_db": np.median(truth.snr_db), "sinr_db": np.median(sinr)}
    rows = []
    for method in ("none", "whitening", "tcae"):
        if method == "none" or method in config.methods:
            results, diverged = altitudes(changed, frames, method)
            row = {"method": method, "diverged_frames": diverged} | where
            rows.append(row | statistics(results, truth, seed))
    return rows


@dataclasses.dataclass(frozen=True)
class LandingStudy(Study):
    """Altitudes of all methods over an approach, and under other assumptions."""

    config: LandingConfig

    tables: ClassVar[Mapping[str, Columns]] = TABLES
    published: ClassVar[Mapping[str, str]] = {
        "figure_1_approach.png": "figures/landing_approach.png",
        "approach.csv": "data/landing_approach.csv",
    }

    @property
    def needs_network(self) -> bool:
        return "tcae" in self.config.methods

    def check(self) -> None:
        """See `Study`; raises `SceneError`, `MitigationError`, `TerrainError`, `TrajectoryError`, `InputError`."""
        check_methods(self.config)
        check_config(self.config)

    def head(self) -> dict[str, Any]:
        """The study's settings, and hashes of the files of its landing."""
        paths = self.config.files().values()
        return {
            "name": self.config.name,
            "seed": self.config.seed,
            "landing": config_dict(self.config),
            "inputs_sha256": {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in paths},
            "methods": check_methods(self.config),
        }

    def points(self) -> tuple[LandingPoint, ...]:
        """Every point, in report order."""
        approach, trials = self.config.approach, self.config.sensitivity_trials
        points = [
            LandingPoint(f"approach/{k:05d}", min(approach.chunk, approach.frames - k), "approach", first=k)
            for k in range(0, approach.frames, approach.chunk)
        ]
        named = [a.name for a in ASSUMPTIONS] if trials else []
        points += [LandingPoint(f"assumption/{a}", trials, "assumptions", assumption=a) for a in named]
        return tuple(dict.fromkeys(points))

    def measure(self, point: LandingPoint) -> list[dict[str, Any]]:
        return (_approach_rows if point.table == "approach" else _assumption_rows)(self.config, point)

    def files(self) -> dict[str, Path]:
        """Flight, terrain, antenna pattern, models and method files."""
        return self.config.files() | method_files(self.config)

    def with_files(self, files: Mapping[str, Path]) -> LandingStudy:
        config = self.config.with_files(files)
        options = with_option_files(config.method_options, files)
        return LandingStudy(dataclasses.replace(config, method_options=options))
