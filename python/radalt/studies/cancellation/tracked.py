"""Flights below base stations that never stop: altitudes per frame, and what the tracker makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk import QpskEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.placement import Emitter, Interferer
from ...core.interference.stream import JammerStream
from ...core.mitigation import Mitigation
from ...core.receiver.altimeter import Spectra, shared_altimeter
from ...core.receiver.integrator import Integrator
from ...core.receiver.summed_block import Block
from ...core.receiver.tracker import AltitudeTracker, TrackerSettings
from ...core.returns.point import point_return
from ...evaluation.results.chain import Chain
from ...evaluation.results.integrity import COUNTS, Integrity, alert_limit_m, integrity, time_to_first_s
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import score_frames
from .cases import SNR_DB, SPEED_M_PER_S, WAVEFORM

__all__ = ["ALLOWED_M_PER_S", "CONFIRMING", "FLIGHTS", "FRAMES", "NR_MS", "TRACKED_COLUMNS", "Flight", "fly"]

_CHUNK = 40  # frames of an output
FRAMES = 25 * _CHUNK  # of a second
CONFIRMING = 2  # outputs that cannot be there yet: a track is confirmed by three
ALLOWED_M_PER_S = (10.0, 20.0, 150.0)  # by altimeter and tracker; flown are up to the first
TRACKED_COLUMNS = Columns(
    (
        "flight",
        "method",
        "allowed_m_per_s",
        "trials",
        "correct",
        "wrong_frames",
        "best_right",
        "first_s",
        *Integrity().row(),
    ),
    text=frozenset({"flight", "method"}),
    whole=frozenset({"trials", "correct", "wrong_frames", "best_right", *COUNTS}),
)


@dataclass(frozen=True)
class Flight:
    """Interference that goes on from frame to frame, parts of equal power, at one SIR; its data differ by flight."""

    title: str
    emitters: tuple[Emitter, ...]
    sir_db: float


NR_MS = 1000  # before a carrier repeats its data: a track without a return would live on what recurs earlier
_NR5 = NrEmitter(channel_bandwidth_hz=5e6, cell_id=402, evm=TYPICAL)
FLIGHTS = {
    "nr10": Flight(
        "10 MHz, 64QAM, SIR -48 dB",
        (NrEmitter(channel_bandwidth_hz=10e6, cell_id=211, evm=TYPICAL),),
        -48.0,
    ),
    "mixture": Flight(
        "three tones, QPSK, 5 MHz NR, SIR -43 dB", (ToneEmitter(3), QpskEmitter(), _NR5), -43.0
    ),
    "nr5": Flight("5 MHz, 64QAM, SIR -60 dB", (_NR5,), -60.0),
}


@lru_cache(maxsize=16)
def _method(name: str) -> Mitigation:
    return Chain(name, name).build(WAVEFORM)


def fly(name: str, methods: Sequence[str], rng: np.random.Generator, count: int) -> list[dict[str, Any]]:
    """One flight of ``count`` frames through ``FLIGHTS[name]``: a row per method and allowed speed.

    All see the same frames.
    """
    flight, n = FLIGHTS[name], WAVEFORM.samples_per_frame
    speed = rng.uniform(-SPEED_M_PER_S, SPEED_M_PER_S)
    altitude_m = rng.uniform(20.0, 1480.0) + speed * WAVEFORM.sweep_s * np.arange(count)
    each_db = flight.sir_db + 10.0 * np.log10(len(flight.emitters))
    carrier = {"seed": int(rng.integers(2**31)), "frame_count": -(-min(count, NR_MS) // 10)}
    emitters = (replace(e, **carrier) if isinstance(e, NrEmitter) else e for e in flight.emitters)
    parts = [Interferer(emitter, each_db) for emitter in emitters]
    stream = JammerStream(
        WAVEFORM, parts, seed=int(rng.integers(2**31)), free_running=True, total_sir_db=None
    )
    stream.next_frame()  # it begins within this one
    altimeter = shared_altimeter(WAVEFORM, Chain("none", "none").settings)
    trackers = {
        (method, speed): AltitudeTracker(altimeter, TrackerSettings(max_vertical_speed_m_per_s=speed))
        for method in methods
        for speed in ALLOWED_M_PER_S
    }
    results, outputs = {key: [] for key in trackers}, {key: [] for key in trackers}
    best_right = dict.fromkeys(trackers, 0)
    for method in methods:
        _method(method).reset()
    for first in range(0, count, _CHUNK):
        part = altitude_m[first : first + _CHUNK]
        noise = rng.standard_normal((len(part), n, 2)).view(np.complex128)[..., 0]
        frames = point_return(
            WAVEFORM,
            part,
            vertical_speed_m_per_s=np.full(len(part), speed),
            phase_cycles=rng.random(len(part)),
            dtype=np.complex128,
        )
        frames += np.sqrt(0.5 * 10.0 ** (-SNR_DB / 10.0)) * noise
        frames += np.stack([stream.next_frame() for _ in part])
        frames = frames.astype(np.complex64)
        received = altimeter.spectra(frames)
        for method in methods:
            spectra = altimeter.spectra(_method(method).process(frames))
            before = None if method == "none" else received
            for limit in ALLOWED_M_PER_S:
                key = method, limit
                results[key].append(altimeter.detect(spectra, vertical_speed_m_per_s=(-limit, limit)))
                outputs[key].append(trackers[key].process(spectra, received=before))
                best_right[key] += _best_is_right(trackers[key].integrator, spectra, part)
    return [
        _row(
            name,
            *key,
            np.concatenate(results[key]),
            np.concatenate(outputs[key]),
            altitude_m,
            best_right[key],
        )
        for key in trackers
    ]


def _best_is_right(integrator: Integrator, spectra: Spectra, altitude_m: np.ndarray) -> bool:
    """Whether a forced decision by these frames alone is right: the pair of most power, of those that stand out.

    It is what the tracker's measurement gives without a track, and without keeping doubtful altitudes back.
    """
    ratio = integrator.normalise(spectra)
    at = np.nonzero(~np.isnan(ratio[:, 0, 0]))[0]
    if 2 * at.size < len(ratio):
        return False
    block = Block(integrator, ratio[at], at.astype(float))
    found = block.best(block.prominent(np.ones(block.table.shape, dtype=bool)))
    return found is not None and abs(found.altitude_m - altitude_m.mean()) <= 5.0


def _row(
    name: str,
    method: str,
    allowed_m_per_s: float,
    results: np.ndarray,
    outputs: np.ndarray,
    altitude_m: np.ndarray,
    best_right: int,
) -> Mapping[str, Any]:
    """Per-frame score, and the tracker's, of one flight."""
    score = score_frames(results, altitude_m)
    truth_m = altitude_m[outputs["frame_index"]]
    judged = integrity(outputs, truth_m, alert_limit_m(truth_m)).row()
    frames = {
        "trials": score.trials,
        "correct": score.correct,
        "wrong_frames": score.wrong,
        "best_right": best_right,
    }
    first_s = time_to_first_s(outputs, WAVEFORM.sweep_s)
    where = {"flight": name, "method": method, "allowed_m_per_s": allowed_m_per_s, "first_s": first_s}
    return TRACKED_COLUMNS.row({**where, **frames, **judged})
