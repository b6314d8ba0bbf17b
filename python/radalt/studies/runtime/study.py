"""Error against run time: every method and model on the same frames, in one process, by turns."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import fft

from ...core.mitigation import Mitigation, create
from ...core.receiver.altimeter import Altimeter, AltimeterSettings, shared_altimeter
from ...evaluation.engine.study import Point, Run, Study
from ...evaluation.engine.task import peak_memory_bytes
from ...evaluation.results.chain import Chain, chains_with, model_files, seconds_per_frame
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import CORRECT_LIMIT_M, SCORE_COLUMNS, score_frames
from .cases import CLEAN, INTERFERERS, TRANSFORM, WAVEFORM, frames_of

__all__ = ["RuntimePoint", "RuntimeStudy", "compared_chains"]

_BATCHES = (1, 8)  # frames at once whose time is taken
_TIMED = 8  # frames of each interferer, and of none
_TIMED_SIR_DB = -30.0
_TRANSFORMS = 200
_FACTS_S = 1.0  # a process with NumPy and SciPy, for the memory
_SUMS = ("correct_even", "correct_odd", "squared_correct_m2")
_TABLES = {
    "facts": Columns(
        names=("chain", "precision", "model_bytes", "memory_bytes", "decimation", "fft_size"),
        text=frozenset({"chain", "precision"}),
        whole=frozenset({"model_bytes", "memory_bytes", "decimation", "fft_size"}),
        timing=frozenset({"memory_bytes"}),
    ),
    "rows": Columns(
        names=("interferer", "sir_db", "chain", *SCORE_COLUMNS, *_SUMS),
        text=frozenset({"interferer", "chain"}),
        whole=frozenset(
            {"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"} | {*_SUMS[:2]}
        ),
    ),
    "times": Columns(
        names=("chain", "interferer", "batch", "round", "ms_method", "ms_altimeter"),
        text=frozenset({"chain", "interferer"}),
        whole=frozenset({"batch", "round"}),
        timing=frozenset({"ms_method", "ms_altimeter"}),
    ),
}


def compared_chains(models: Sequence[Path]) -> tuple[Chain, ...]:
    """Methods, networks and choices of the altimeter that are compared."""

    def settings(**change: Any) -> AltimeterSettings:
        return AltimeterSettings(**{"max_altitude_m": 1500.0, "max_vertical_speed_m_per_s": 0.0} | change)

    altimeters = {
        "none, centroid": {"strategy": "centroid"},
        "none, leading edge": {"strategy": "leading_edge"},
        "none, Hann window": {"window": "hann"},
        "none, span 6 km": {"max_altitude_m": 6000.0},
        "none, span 37 km": {"max_altitude_m": 37_000.0},
        "none, Doppler to 150 m/s": {"max_vertical_speed_m_per_s": 150.0},
    }
    methods = (
        "none",
        "whitening",
        "linear_prediction",
        "blanking",
        "ofdm_cancel",
        "qpsk_cancel",
        "nlms_predictor",
        "nlms",
        "lms_reference_input",
        "lms",
    )
    # the networks themselves; the check would double the time of all but the default
    bare = {"options": (("shift_check", False),), "settings": settings()}
    return (
        *(Chain(method, method, settings=settings()) for method in methods),
        Chain("hybrid", "hybrid", settings=settings(), independent=True),
        *(Chain.of_model(model, **bare) for model in models),
        *(Chain(label, "none", settings=settings(**change)) for label, change in altimeters.items()),
    )


@dataclass(frozen=True)
class RuntimePoint(Point):
    """What its table is of: facts of a chain, errors at one interferer and SIR, or one round of times.

    Attributes
    ----------
    chain : str
        Label; facts only.
    interferer : str or None
        None for the scene without interference.
    sir_db : float
    round : int
        From 1; times only.
    """

    chain: str = ""
    interferer: str | None = None
    sir_db: float = 0.0
    round: int = 0


@dataclass(frozen=True)
class RuntimeStudy(Study):
    """Chains compared on the same frames.

    Attributes
    ----------
    chains : tuple of Chain
        The one labelled ``none`` is what gains are against.
    sirs_db : tuple of float
    frames : int
        Per interferer and SIR, >= 2.
    rounds : int
        Of timing, >= 2.
    seed : int
    interferers : tuple of str
        Of `INTERFERERS`.
    """

    chains: tuple[Chain, ...]
    sirs_db: tuple[float, ...]
    frames: int = 100
    rounds: int = 20
    seed: int = 1
    interferers: tuple[str, ...] = tuple(INTERFERERS)

    tables: ClassVar[Mapping[str, Columns]] = _TABLES
    max_jobs: ClassVar[int | None] = 1
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "error_vs_runtime.md",
        "figures/error_vs_runtime.png": "figures/error_vs_runtime.png",
    }

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a chain cannot be built."""
        self.head()

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return vars(self) | {"chains": {chain.label: chain.head(WAVEFORM) for chain in self.chains}}

    def points(self) -> Sequence[RuntimePoint]:
        """Facts of each chain, errors without and with interference, rounds of times."""
        jammed = [(name, sir_db) for name in self.interferers for sir_db in self.sirs_db]
        return (
            *(RuntimePoint(f"memory of {c.label}", 8, "facts", chain=c.label) for c in self.chains),
            RuntimePoint("clean", self.frames),
            *(
                RuntimePoint(f"{name}, SIR {sir:g} dB", self.frames, interferer=name, sir_db=sir)
                for name, sir in jammed
            ),
            *(
                RuntimePoint(
                    f"times, round {k}",
                    len(_BATCHES) * _TIMED * (1 + len(self.interferers)),
                    "times",
                    round=k,
                )
                for k in range(1, self.rounds + 1)
            ),
        )

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """See `Study`."""
        if point.table == "facts":
            return [_facts(next(c for c in self.chains if c.label == point.chain))]
        if point.table == "times":
            return list(_times(self.chains, self.interferers, point.round))
        frames, truth = frames_of(point.interferer, point.sir_db, self.frames, self.seed)
        where = {
            "interferer": point.interferer or CLEAN,
            "sir_db": point.sir_db if point.interferer else None,
        }
        return [
            where | {"chain": chain.label} | _scored(chain.results(frames, WAVEFORM)[0], truth)
            for chain in self.chains
        ]

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `report.write_report`."""
        from .report import write_report

        return write_report(folder, self, rows, run)

    def seconds(self, point: Point) -> float:
        """See `Study`."""
        if point.table == "facts":
            return _FACTS_S
        return point.frames * sum(
            seconds_per_frame(c.method, WAVEFORM, c.settings, c.options) for c in self.chains
        )

    def files(self) -> dict[str, Path]:
        """The networks."""
        return model_files(self.chains)

    def with_files(self, files: Mapping[str, Path]) -> RuntimeStudy:
        """See `Study`."""
        return dataclasses.replace(self, chains=chains_with(self.chains, files))

    @property
    def needs_network(self) -> bool:
        """See `Study`."""
        return any(chain.model for chain in self.chains)


def _scored(result: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    error = np.abs(result["altitude_m"] - truth)
    correct = result["valid"] & (error < CORRECT_LIMIT_M)
    return score_frames(result, truth).row() | {
        "correct_even": int(correct[0::2].sum()),
        "correct_odd": int(correct[1::2].sum()),
        "squared_correct_m2": float(np.sum(error[correct] ** 2)),
    }


@lru_cache(maxsize=1)
def _warmed_up(
    chains: tuple[Chain, ...], interferers: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], list[tuple[str, Mitigation, Altimeter]]]:
    """Frames to be timed by interferer, and every chain built; each has been run once, so that nothing is first."""
    names = (None, *interferers)
    frames = {name or CLEAN: frames_of(name, _TIMED_SIR_DB, _TIMED, 99)[0] for name in names}
    built = [(c.label, c.build(WAVEFORM), shared_altimeter(WAVEFORM, c.settings)) for c in chains]
    for _, method, altimeter in built:
        for batch in _BATCHES:
            list(_timed(method, altimeter, frames[CLEAN], batch))
    return frames, built


def _times(chains: tuple[Chain, ...], interferers: tuple[str, ...], number: int) -> Iterator[dict[str, Any]]:
    """One round: CPU milliseconds per frame of the calling thread, a row per batch, all chains by turns.

    The last row is that of a transform.
    """
    frames, built = _warmed_up(chains, interferers)
    for label, method, altimeter in built:
        for name, some in frames.items():
            for batch in _BATCHES:
                method.reset()
                where = {"chain": label, "interferer": name, "batch": batch, "round": number}
                for in_method, in_altimeter in _timed(method, altimeter, some, batch):
                    yield where | {"ms_method": in_method, "ms_altimeter": in_altimeter}
    begin = time.thread_time_ns()
    for _ in range(_TRANSFORMS):
        fft.fft(frames[CLEAN][0])
    each = (time.thread_time_ns() - begin) * 1e-6 / _TRANSFORMS
    where = {"chain": TRANSFORM, "interferer": CLEAN, "batch": 1, "round": number}
    yield where | {"ms_method": each, "ms_altimeter": 0.0}


def _timed(
    method: Mitigation, altimeter: Altimeter, frames: np.ndarray, batch: int
) -> Iterator[tuple[float, float]]:
    """Milliseconds per frame in method and in altimeter, of every batch."""
    for first in range(0, frames.shape[0] - batch + 1, batch):
        begin = time.thread_time_ns()
        cleaned = method.process(frames[first : first + batch])
        middle = time.thread_time_ns()
        altimeter.process(cleaned)
        end = time.thread_time_ns()
        yield (middle - begin) * 1e-6 / batch, (end - middle) * 1e-6 / batch


def _facts(chain: Chain) -> dict[str, Any]:
    """What does not depend on the frames: precision, bytes of model and memory, decimation and FFT size."""
    method, altimeter = chain.build(WAVEFORM), shared_altimeter(WAVEFORM, chain.settings)
    return {
        "chain": chain.label,
        "precision": getattr(method, "metadata", {}).get("radalt_precision", chain.precision),
        "model_bytes": chain.model.stat().st_size if chain.model else 0,
        "memory_bytes": _added_memory_bytes(chain, 8),
        "decimation": altimeter.decimation,
        "fft_size": altimeter.fft_size,
    }


def _added_memory_bytes(chain: Chain, batch: int) -> int:
    """Peak resident bytes that a method adds to a process that has only NumPy, SciPy and this module."""
    options = json.dumps([chain.method, dict(chain.options), batch])
    code = f"import json; from {__name__} import memory_in_process as growth; "
    code += f"print('BYTES', growth(*json.loads({options!r})))"
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True, timeout=120
    )
    return next(int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("BYTES "))


def memory_in_process(method: str, options: dict[str, Any], batch: int) -> int:
    """Growth of the peak resident memory by building a method and running a batch."""
    frames = np.tile(WAVEFORM.reference, (batch, 1))
    before = peak_memory_bytes()
    create(method, WAVEFORM, **options).process(frames)
    return peak_memory_bytes() - before
