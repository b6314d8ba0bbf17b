"""Error against run time: every method and model on the same frames, in one process, by turns."""

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
from ...evaluation.engine.apart import call_apart
from ...evaluation.engine.chain_study import ChainStudy
from ...evaluation.engine.study import Point
from ...evaluation.engine.task import peak_memory_bytes
from ...evaluation.results.chain import Chain
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import CORRECT_LIMIT_M, SCORE_COLUMNS, score_frames
from .cases import CLEAN, INTERFERERS, TRANSFORM, WAVEFORM, frames_of

_BATCHES = (1, 8)  # frames per call that are timed: as they arrive, and as many as a network's batch
_TIMED = 8  # timed frames per interferer, and without: one batch of the larger size
_TIMED_SIR_DB = -30.0  # below the break-point without mitigation (-25 dB): every method has to work
_FFTS = 200  # timed per round, one after the other: 10 ms
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
    """Facts of a chain, errors under one interferer at one SIR, or a round of timing, by its ``table``.

    Attributes
    ----------
    chain : str
        Label; only for facts.
    interferer : str or None
        None without interference.
    sir_db : float
    round : int
        From 1; only for times.
    """

    chain: str = ""
    interferer: str | None = None
    sir_db: float = 0.0
    round: int = 0


@dataclass(frozen=True)
class RuntimeStudy(ChainStudy):
    """Chains compared on the same frames.

    Attributes
    ----------
    chains : tuple of Chain
        Protection gains are against the one labelled ``none``.
    sirs_db : tuple of float
    frames : int
        Frames per interferer and SIR, >= 2.
    rounds : int
        Rounds of timing, >= 2.
    seed : int
    interferers : tuple of str
        Names in `INTERFERERS`.
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
    """Frames for the timing by interferer, and the chains, each built and run once, so that no call is the first."""
    names = (None, *interferers)
    frames = {name or CLEAN: frames_of(name, _TIMED_SIR_DB, _TIMED, 99)[0] for name in names}
    built = [(c.label, c.build(WAVEFORM), shared_altimeter(WAVEFORM, c.settings)) for c in chains]
    for _, method, altimeter in built:
        for batch in _BATCHES:
            list(_timed(method, altimeter, frames[CLEAN], batch))
    return frames, built


def _times(chains: tuple[Chain, ...], interferers: tuple[str, ...], number: int) -> Iterator[dict[str, Any]]:
    """One round of all chains: a row per batch, with CPU milliseconds per frame of the calling thread.

    The last row is the time of one FFT.
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
    for _ in range(_FFTS):
        fft.fft(frames[CLEAN][0])
    each = (time.thread_time_ns() - begin) * 1e-6 / _FFTS
    where = {"chain": TRANSFORM, "interferer": CLEAN, "batch": 1, "round": number}
    yield where | {"ms_method": each, "ms_altimeter": 0.0}


def _timed(
    method: Mitigation, altimeter: Altimeter, frames: np.ndarray, batch: int
) -> Iterator[tuple[float, float]]:
    """CPU milliseconds per frame in the method and in the altimeter, for each batch."""
    for first in range(0, frames.shape[0] - batch + 1, batch):
        begin = time.thread_time_ns()
        cleaned = method.process(frames[first : first + batch])
        middle = time.thread_time_ns()
        altimeter.process(cleaned)
        end = time.thread_time_ns()
        yield (middle - begin) * 1e-6 / batch, (end - middle) * 1e-6 / batch


def _facts(chain: Chain) -> dict[str, Any]:
    """What does not depend on frames: precision, bytes of the model and of memory, decimation, FFT size."""
    method, altimeter = chain.build(WAVEFORM), shared_altimeter(WAVEFORM, chain.settings)
    return {
        "chain": chain.label,
        "precision": getattr(method, "metadata", {}).get("radalt_precision", chain.precision),
        "model_bytes": chain.model.stat().st_size if chain.model else 0,
        "memory_bytes": call_apart(
            __name__, "added_memory_bytes", chain.method, dict(chain.options), _BATCHES[-1]
        ),
        "decimation": altimeter.decimation,
        "fft_size": altimeter.fft_size,
    }


def added_memory_bytes(method: str, options: dict[str, Any], batch: int) -> int:
    """Growth of this process' peak resident memory as a method is built and processes a batch."""
    frames = np.tile(WAVEFORM.reference, (batch, 1))
    before = peak_memory_bytes()
    create(method, WAVEFORM, **options).process(frames)
    return peak_memory_bytes() - before
