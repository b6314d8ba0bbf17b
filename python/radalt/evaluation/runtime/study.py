"""Error against run time: every method and model variant on the same frames, in one process, by turns."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from ...core.interference.nr import NrEmitter
from ...core.interference.placement import Interferer, QpskEmitter, ToneEmitter, interference_frames
from ...core.mitigation import Mitigation, create
from ...core.receiver.altimeter import Altimeter, AltimeterSettings
from ...core.returns.point import point_return
from ...core.waveform import Waveform
from ..results.journal import Journal
from ..results.score import CORRECT_LIMIT_M, wilson_interval

__all__ = [
    "INTERFERERS",
    "Variant",
    "break_point_db",
    "error_points",
    "measure_errors",
    "measure_memory",
    "measure_times",
    "pareto",
    "run_study",
    "summarise_times",
    "variants",
]

BREAK_PD = 0.9  # DESIGN.md 4
_SNR_DB = 10.0
_CHUNK = 20  # frames processed at once where only the error counts
# name -> (emitter, overlap)
INTERFERERS: dict[str, tuple[Any, float]] = {
    "QPSK shaped, all": (QpskEmitter(pulse="rrc"), 1.0),
    "QPSK rectangular, all": (QpskEmitter(), 1.0),
    "QPSK rectangular, 30 %": (QpskEmitter(), 0.3),
    "5 tones, all": (ToneEmitter(5), 1.0),
    "NR 5 MHz, all": (NrEmitter(channel_bandwidth_hz=5e6), 1.0),
    "NR 10 MHz, all": (NrEmitter(channel_bandwidth_hz=10e6), 1.0),
}


@dataclass(frozen=True)
class Variant:
    """One way from a frame to an altitude.

    Attributes
    ----------
    label, method, precision : str
    options : mapping as pairs
        Of the method.
    settings : AltimeterSettings
        Of the altimeter behind it.
    """

    label: str
    method: str
    precision: str = "float32"
    options: tuple[tuple[str, Any], ...] = ()
    settings: AltimeterSettings = field(
        default_factory=lambda: AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=0.0)
    )

    def build(self) -> tuple[Mitigation, Altimeter]:
        """A fresh method and its altimeter."""
        waveform = Waveform()
        return create(self.method, waveform, **dict(self.options)), Altimeter(waveform, self.settings)

    @property
    def model_bytes(self) -> int:
        """Size of the network's file; 0 for the classical methods."""
        model = dict(self.options).get("model")
        return Path(model).stat().st_size if model else 0


def variants(models: Sequence[Path]) -> list[Variant]:
    """Methods, models and choices of the altimeter that are compared."""
    plain = AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=0.0)

    def altimeter(label: str, **change: Any) -> Variant:
        return Variant(
            label,
            "none",
            settings=AltimeterSettings(
                **{"max_altitude_m": 1500.0, "max_vertical_speed_m_per_s": 0.0} | change
            ),
        )

    out = [
        Variant(m, m, settings=plain)
        for m in ("none", "whitening", "blanking", "nlms", "lms_reference_input", "lms")
    ]
    for model in models:
        precision = next((p for p in ("int8", "fp16") if p in model.stem), "float32")
        # the networks themselves; the check would double the time of all but the default
        out.append(
            Variant(
                f"tcae {model.stem}",
                "tcae",
                precision,
                (("model", str(model)), ("shift_check", False)),
                plain,
            )
        )
    return out + [
        altimeter("none, centroid", strategy="centroid"),
        altimeter("none, leading edge", strategy="leading_edge"),
        altimeter("none, Hann window", window="hann"),
        altimeter("none, span 6 km", max_altitude_m=6000.0),
        altimeter("none, span 37 km", max_altitude_m=37_000.0),
        altimeter("none, Doppler to 150 m/s", max_vertical_speed_m_per_s=150.0),
    ]


def frames_of(name: str | None, sir_db: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(count, N) frames with one interferer (None: without) and their altitudes, 10..1450 m."""
    w = Waveform()
    rng = np.random.default_rng(
        [seed, 0 if name is None else 1 + list(INTERFERERS).index(name), round(-sir_db)]
    )
    truth = rng.uniform(10.0, 1450.0, count)
    noise = rng.standard_normal((count, w.samples_per_frame, 2)) @ np.array([1.0, 1.0j]) / np.sqrt(2.0)
    frames = point_return(w, truth) + noise * 10.0 ** (-_SNR_DB / 20.0)
    if name is not None:
        emitter, overlap = INTERFERERS[name]
        jam = Interferer(emitter, sir_db, overlap)
        frames = frames + interference_frames([jam], count, w.samples_per_frame, w.rate_hz, rng)
    return frames.astype(np.complex64), truth


def error_points(sirs_db: Sequence[float]) -> list[tuple[str | None, float]]:
    """(interferer, SIR) of every point: the clean scene (None, 0) first."""
    return [(None, 0.0), *((name, sir_db) for name in INTERFERERS for sir_db in sirs_db)]


def measure_errors(
    candidates: Sequence[Variant],
    points: Sequence[tuple[str | None, float]],
    count: int,
    seed: int,
    progress: Callable[[str], None],
) -> Iterator[list[dict[str, Any]]]:
    """The rows of one point after the other, one row a variant; the same frames for all."""
    built = [v.build() for v in candidates]
    for name, sir_db in points:
        frames, truth = frames_of(name, sir_db, count, seed)
        progress(f"{name or 'clean'} {sir_db if name else ''}")
        rows = []
        for variant, (method, altimeter) in zip(candidates, built, strict=True):
            method.reset()
            result = np.concatenate(
                [altimeter.process(method.process(frames[k : k + _CHUNK])) for k in range(0, count, _CHUNK)]
            )
            point = {"interferer": name or "clean", "sir_db": sir_db if name else None}
            rows.append(point | {"variant": variant.label} | _scored(result, truth))
        yield rows


def _scored(result: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    valid = result["valid"]
    error = result["altitude_m"] - truth
    correct = int((np.abs(error[valid]) < CORRECT_LIMIT_M).sum())
    forced = (result["forced_altitude_m"] - truth)[np.isfinite(result["forced_altitude_m"])]
    low, high = wilson_interval(correct, len(truth))
    halves = [valid[h] & (np.abs(error[h]) < CORRECT_LIMIT_M) for h in (slice(0, None, 2), slice(1, None, 2))]
    return {
        "trials": len(truth),
        "detections": int(valid.sum()),
        "correct": correct,
        "pd": correct / len(truth),
        "pd_low": low,
        "pd_high": high,
        "correct_even": int(halves[0].sum()),
        "correct_odd": int(halves[1].sum()),
        "squared_detected_m2": float(error[valid] @ error[valid]),
        "squared_correct_m2": float(np.sum(error[valid & (np.abs(error) < CORRECT_LIMIT_M)] ** 2)),
        "forced": int(forced.size),
        "squared_forced_m2": float(forced @ forced),
    }


def break_point_db(rows: Sequence[dict[str, Any]]) -> float | None:
    """Lowest SIR of one variant and interferer down to which Pd is at least 0.9 throughout; None if nowhere."""
    lowest = None
    for row in sorted(rows, key=lambda r: -r["sir_db"]):
        if row["pd"] < BREAK_PD:
            break
        lowest = row["sir_db"]
    return lowest


def measure_times(
    candidates: Sequence[Variant], batches: Sequence[int], rounds: int, progress: Callable[[str], None]
) -> Iterator[list[dict[str, Any]]]:
    """CPU milliseconds a frame of the calling thread, method and altimeter apart, round by round.

    All variants take their turn in each round; a round before the first warms up and is not given.
    """
    frames, _ = frames_of("QPSK rectangular, 30 %", -20.0, max(batches) * 2, 99)
    built = [v.build() for v in candidates]
    for turn in range(rounds + 1 if rounds else 0):
        progress(f"times, round {turn} of {rounds}" if turn else "times, warming up")
        taken = [
            {"variant": variant.label, "batch": batch, "ms": _timed(*parts, frames, batch)}
            for variant, parts in zip(candidates, built, strict=True)
            for batch in batches
        ]
        if turn:
            yield taken


def _timed(method: Mitigation, altimeter: Altimeter, frames: np.ndarray, batch: int) -> list[list[float]]:
    """[method, altimeter] milliseconds a frame of every batch."""
    taken = []
    for first in range(0, frames.shape[0] - batch + 1, batch):
        begin = time.thread_time_ns()
        cleaned = method.process(frames[first : first + batch])
        middle = time.thread_time_ns()
        altimeter.process(cleaned)
        end = time.thread_time_ns()
        taken.append([(middle - begin) * 1e-6 / batch, (end - middle) * 1e-6 / batch])
    return taken


def summarise_times(rounds: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
    """One row a variant and batch from the rounds of `measure_times`."""
    samples: dict[tuple[str, int], list[list[float]]] = {}
    for taken in rounds:
        for one in taken:
            samples.setdefault((one["variant"], one["batch"]), []).extend(one["ms"])
    return [_times(label, batch, np.array(ms)) for (label, batch), ms in samples.items()]


def run_study(
    candidates: Sequence[Variant],
    sirs_db: Sequence[float],
    count: int,
    rounds: int,
    seed: int,
    journal: Journal,
    progress: Callable[[str], None],
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], dict[str, Any]]:
    """Measure what the journal lacks: facts of each variant, errors point by point, rounds of times.

    Returns
    -------
    list, list, dict
        Rows of errors, rows of times, and facts by variant, in the same order however often it was resumed.
    """
    known = {entry["variant"] for entry in journal.of("facts")}
    for variant in candidates:
        if variant.label not in known:
            progress(f"memory of {variant.label}")
            journal.add({"kind": "facts", "variant": variant.label, "facts": facts_of(variant)})
    done = {(entry["interferer"], entry["sir_db"]) for entry in journal.of("errors")}
    points = [point for point in error_points(sirs_db) if point not in done]
    for point, rows in zip(points, measure_errors(candidates, points, count, seed, progress), strict=True):
        journal.add({"kind": "errors", "interferer": point[0], "sir_db": point[1], "rows": rows})
    missing = rounds - len(journal.of("times"))
    for taken in measure_times(candidates, (1, 8), max(0, missing), progress):
        journal.add({"kind": "times", "taken": taken})
    facts = {entry["variant"]: entry["facts"] for entry in journal.of("facts")}
    rows = {(entry["interferer"], entry["sir_db"]): entry["rows"] for entry in journal.of("errors")}
    times = summarise_times([entry["taken"] for entry in journal.of("times")])
    return [row for point in error_points(sirs_db) for row in rows[point]], times, facts


def facts_of(variant: Variant) -> dict[str, Any]:
    """What does not depend on the frames: precision, bytes of model and memory, decimation and FFT size."""
    method, altimeter = variant.build()
    return {
        "precision": getattr(method, "metadata", {}).get("radalt_precision", variant.precision),
        "model_bytes": variant.model_bytes,
        "memory_bytes": measure_memory(variant, 8),
        "decimation": altimeter.decimation,
        "fft_size": altimeter.fft_size,
    }


def _times(label: str, batch: int, taken: np.ndarray) -> dict[str, Any]:
    total = taken.sum(axis=1)
    half = len(total) // 2
    return {
        "variant": label,
        "batch": batch,
        "ms_method": float(np.median(taken[:, 0])),
        "ms_altimeter": float(np.median(taken[:, 1])),
        "ms_median": float(np.median(total)),
        "ms_p99": float(np.percentile(total, 99)),
        "ms_first_half": float(np.median(total[:half])),
        "ms_second_half": float(np.median(total[half:])),
    }


def agreement(one: Sequence[float], other: Sequence[float]) -> float:
    """Kendall's tau of two rankings of the same variants, ties allowed."""
    return float(kendalltau(one, other).statistic)


def measure_memory(variant: Variant, batch: int) -> int:
    """Peak resident bytes that a variant adds to a process that has only NumPy, SciPy and this module."""
    options = json.dumps([variant.method, dict(variant.options), batch])
    code = f"import json; from {__name__} import memory_in_process as measure; "
    code += f"print('BYTES', measure(*json.loads({options!r})))"
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True, timeout=120
    )
    return next(int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("BYTES "))


def memory_in_process(method: str, options: dict[str, Any], batch: int) -> int:
    """Growth of the peak resident memory by building a method and running a batch."""
    from ..leaving_out.study import peak_memory_bytes

    waveform = Waveform()
    frames = np.tile(waveform.reference, (batch, 1))
    before = peak_memory_bytes()
    create(method, waveform, **options).process(frames)
    return peak_memory_bytes() - before


def pareto(points: dict[str, tuple[float, float]]) -> list[str]:
    """Labels on the front of (cost, loss), both smaller is better, in the order of cost."""
    front, best = [], float("inf")
    for label, (_, loss) in sorted(points.items(), key=lambda item: item[1]):
        if loss < best:
            front.append(label)
            best = loss
    return front
