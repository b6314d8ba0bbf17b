"""Flights below base stations that never stop: altitudes per frame, and what the tracker makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk import QpskEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.placement import Emitter, Interferer
from ...core.interference.stream import JammerStream
from ...core.mitigation import Mitigation
from ...core.receiver.altimeter import shared_altimeter
from ...core.receiver.tracker import AltitudeTracker
from ...core.returns.point import point_return
from ..results.chain import Chain
from ..results.integrity import COUNTS, Integrity, alert_limit_m, integrity
from ..results.rows import Columns
from ..results.score import score_frames
from .cases import SNR_DB, SPEED_M_PER_S, WAVEFORM

__all__ = ["CONFIRMING", "FLIGHTS", "FRAMES", "TRACKED_COLUMNS", "Flight", "fly"]

_CHUNK = 40  # frames of an output
FRAMES = 10 * _CHUNK  # of a flight
CONFIRMING = 0.2  # of its outputs cannot be there yet: a track is confirmed by three
TRACKED_COLUMNS = Columns(
    ("flight", "method", "trials", "correct", "wrong_frames", *Integrity().row()),
    text=frozenset({"flight", "method"}),
    whole=frozenset({"trials", "correct", "wrong_frames", *COUNTS}),
)


@dataclass(frozen=True)
class Flight:
    """Interference that goes on from frame to frame, its parts of equal power, at one SIR."""

    title: str
    emitters: tuple[Emitter, ...]
    sir_db: float


_NR5 = NrEmitter(channel_bandwidth_hz=5e6, cell_id=402, frame_count=2, seed=43)
FLIGHTS = {
    "nr10": Flight(
        "10 MHz, 64QAM, SIR -48 dB",
        (NrEmitter(channel_bandwidth_hz=10e6, cell_id=211, frame_count=2, seed=41),),
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


def fly(name: str, methods: Sequence[str], rng: np.random.Generator) -> list[dict[str, Any]]:
    """One flight of `FRAMES` frames through ``FLIGHTS[name]``: a row per method, all of the same frames."""
    flight, n = FLIGHTS[name], WAVEFORM.samples_per_frame
    speed = rng.uniform(-SPEED_M_PER_S, SPEED_M_PER_S)
    altitude_m = rng.uniform(20.0, 1480.0) + speed * WAVEFORM.sweep_s * np.arange(FRAMES)
    each_db = flight.sir_db + 10.0 * np.log10(len(flight.emitters))
    parts = [Interferer(emitter, each_db) for emitter in flight.emitters]
    stream = JammerStream(
        WAVEFORM, parts, seed=int(rng.integers(2**31)), free_running=True, total_sir_db=None
    )
    stream.next_frame()  # it begins within this one
    altimeter = shared_altimeter(WAVEFORM, Chain("none", "none").settings)
    trackers = {method: AltitudeTracker(altimeter) for method in methods}
    results, outputs = {m: [] for m in methods}, {m: [] for m in methods}
    for method in methods:
        _method(method).reset()
    for first in range(0, FRAMES, _CHUNK):
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
            results[method].append(altimeter.detect(spectra))
            outputs[method].append(trackers[method].process(spectra, received=before))
    return [
        _row(name, m, np.concatenate(results[m]), np.concatenate(outputs[m]), altitude_m) for m in methods
    ]


def _row(
    name: str, method: str, results: np.ndarray, outputs: np.ndarray, altitude_m: np.ndarray
) -> Mapping[str, Any]:
    """Per-frame score, and the tracker's, of one flight."""
    score = score_frames(results, altitude_m)
    truth_m = altitude_m[outputs["frame_index"]]
    judged = integrity(outputs, truth_m, alert_limit_m(truth_m)).row()
    frames = {"trials": score.trials, "correct": score.correct, "wrong_frames": score.wrong}
    return TRACKED_COLUMNS.row({"flight": name, "method": method, **frames, **judged})
