"""Flights below base stations that transmit continuously: altitudes per frame and tracked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk import QpskEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.placement import Emitter, Interferer
from ...core.interference.stream import JammerStream
from ...core.receiver.altimeter import Spectra, shared_altimeter
from ...core.receiver.integrator import Integrator
from ...core.receiver.summed_block import Block
from ...core.receiver.tracker import AltitudeTracker, TrackerSettings
from ...core.returns.point import point_return
from ...core.waveform import Waveform
from ...evaluation.results.chain import Chain, method_of
from ...evaluation.results.integrity import COUNTS, Integrity, alert_limit_m, integrity, time_to_first_s
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import score_frames

WAVEFORM = Waveform()
SNR_DB = 10.0  # as in the lists of the bench
SPEED_M_PER_S = 10.0  # largest vertical speed, up and down
_BLOCK = 40  # frames of an output
FRAMES = 25 * _BLOCK  # frames per second
CONFIRMING = 2  # outputs at the start of a flight that cannot have an altitude: three confirm a track
ALLOWED_M_PER_S = (10.0, 20.0, 150.0)  # speeds that altimeter and tracker allow; flown are up to the first
_FRAME_COUNTS = ("trials", "correct", "wrong_frames", "best_right")
TRACKED_COLUMNS = Columns(
    ("flight", "method", "allowed_m_per_s", *_FRAME_COUNTS, "first_s", *Integrity().row()),
    text=frozenset({"flight", "method"}),
    whole=frozenset({*_FRAME_COUNTS, *COUNTS}),
)


@dataclass(frozen=True)
class Flight:
    """Continuous interference of emitters of equal power at one SIR; their data differ from flight to flight."""

    title: str
    emitters: tuple[Emitter, ...]
    sir_db: float


NR_MS = 1000  # period of a carrier's data: a track without a return would persist on data that recur earlier
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


def fly(name: str, methods: Sequence[str], rng: np.random.Generator, count: int) -> list[dict[str, Any]]:
    """One flight of ``count`` frames through ``FLIGHTS[name]``: a row per method and allowed speed."""
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
    stream.next_frame()  # the emitters start within this frame
    altimeter = shared_altimeter(WAVEFORM, Chain("none", "none").settings)
    trackers = {
        (method, speed): AltitudeTracker(altimeter, TrackerSettings(max_vertical_speed_m_per_s=speed))
        for method in methods
        for speed in ALLOWED_M_PER_S
    }
    built = {method: method_of(Chain(method, method), WAVEFORM) for method in methods}
    results, outputs = {key: [] for key in trackers}, {key: [] for key in trackers}
    best_right = dict.fromkeys(trackers, 0)
    for method in methods:
        built[method].reset()
    for first in range(0, count, _BLOCK):
        part = altitude_m[first : first + _BLOCK]
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
            spectra = altimeter.spectra(built[method].process(frames))
            before = None if method == "none" else received
            for limit in ALLOWED_M_PER_S:
                key = method, limit
                results[key].append(altimeter.detect(spectra, vertical_speed_m_per_s=(-limit, limit)))
                outputs[key].append(trackers[key].process(spectra, received=before))
                best_right[key] += _best_is_right(trackers[key].integrator, spectra, part)
    return [
        _row(name, *key, np.concatenate(results[key]), np.concatenate(outputs[key]), altitude_m)
        | {"best_right": best_right[key]}
        for key in trackers
    ]


def _best_is_right(integrator: Integrator, spectra: Spectra, altitude_m: np.ndarray) -> bool:
    """Whether a forced decision from these frames alone is right: the pair of most power among the prominent ones.

    This is the tracker's measurement without a track, doubtful altitudes included.
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
) -> dict[str, Any]:
    """Scores of one flight per frame and tracked."""
    score = score_frames(results, altitude_m)
    truth_m = altitude_m[outputs["frame_index"]]
    return {
        "flight": name,
        "method": method,
        "allowed_m_per_s": allowed_m_per_s,
        "trials": score.trials,
        "correct": score.correct,
        "wrong_frames": score.wrong,
        "first_s": time_to_first_s(outputs, WAVEFORM.sweep_s),
        **integrity(outputs, truth_m, alert_limit_m(truth_m)).row(),
    }
