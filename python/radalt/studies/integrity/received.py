"""Frames of a flight as methods get them: aligned already, or from the segmenter, with leakage and clocks apart."""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from ...core.returns.point import point_return
from ...core.timing.leakage import LeakageCalibration, LeakageCanceller
from ...core.timing.segmenter import FrameSegmenter
from .cases import BLOCK, DRIFT, WAVEFORM, Case
from .flights import Flight, rng_of
from .frames import frames_of, white_noise

_SEGMENTED = ("slip", "clock", "leakage", "gear")  # kinds received as a stream
_PREAMBLE = 8  # frames at altitude zero, on which the segmenter takes its timing
_LEAKAGE_M, _GEAR_M = 1.0, 4.5  # paths of leakage and landing gear, as in the scene `leakage`
_LEAKAGE_DB = 30.0  # leakage next to landing gear, over the return
_CABLES_M = 15.0  # longest cables to the antennas, as altitude
_CALIBRATION_FRAMES = 400  # docs/leakage.md


def received(case: Case, flight: Flight, seed: int, batch: int) -> Iterator[tuple[np.ndarray, ...]]:
    """(frame index, (n, N) complex64 frames, timing offset in s) of up to 40 frames at a time."""
    rng = rng_of(case, seed, batch, 1)
    if case.kind in _SEGMENTED:
        return _segmented(case, flight, rng)
    return ((index, frames, 0.0) for index, frames in frames_of(case, flight, rng) if index.size)


def _segmented(case: Case, flight: Flight, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, ...]]:
    """Frames from the segmenter, whose stream has leakage, clocks apart, or a loss of samples without a tag."""
    w, n = WAVEFORM, WAVEFORM.samples_per_frame
    total = flight.middle_m.size
    cut, lost = total * n, 0
    background, leakage, installation_m = np.zeros((2, n), np.complex64), None, 0.0
    if case.kind in ("leakage", "gear"):
        background, leakage, installation_m = _installed(case, rng)
    apart = DRIFT * case.value if case.kind == "clock" else 0.0
    begun_s = (np.arange(total) + 0.5) * w.sweep_s
    placed = dataclasses.replace(
        flight,
        middle_m=flight.middle_m + installation_m + apart * begun_s,
        speed_m_per_s=flight.speed_m_per_s + apart,
    )
    segmenter = FrameSegmenter(w, None, true_delay=True, leakage=leakage)

    def sent(index: int) -> tuple[float, float]:
        at = min(index - _PREAMBLE, total - 1)
        return (0.0, 0.0) if at < 0 else (float(flight.middle_m[at]), float(flight.speed_m_per_s[at]))

    segmenter.follow(sent)
    if case.kind == "slip":
        lost = int(rng.choice([rng.integers(1, 10), rng.integers(1, n), n * int(rng.integers(1, 4))]))
        cut = flight.fault_frame * n + int(rng.integers(0, n))
    first = background[0] if leakage is not None else point_return(w, np.zeros(_PREAMBLE))
    segmenter.push((first + np.float32(0.1) * white_noise(_PREAMBLE, rng)).ravel())
    tail = np.array([total]), white_noise(1, rng)  # the segmenter ends a frame some samples after its last
    for index, frames in itertools.chain(frames_of(case, placed, rng), [tail]):
        frames += background[(index >= (flight.fault_frame or 0)).astype(int)]
        position = int(index[0]) * n + np.arange(frames.size)
        found = segmenter.push(frames.ravel()[(position < cut) | (position >= cut + lost)])
        found = [f for f in found if 0 <= f.index - _PREAMBLE < total]
        if found:
            numbers = np.array([f.index - _PREAMBLE for f in found])
            yield numbers, np.stack([f.samples for f in found]), np.array([f.offset_s for f in found])


def _installed(case: Case, rng: np.random.Generator) -> tuple[np.ndarray, LeakageCanceller, float]:
    """(2, N) returns of the installation before and after a fault, its canceller, and the cables in metres."""

    def line(level_db: float, distance_m: float) -> np.ndarray:
        strength = np.float32(10.0 ** (level_db / 20.0))
        return point_return(WAVEFORM, distance_m, phase_cycles=rng.random()) * strength

    cables_m = float(rng.uniform(0.0, _CABLES_M))
    if case.kind == "leakage":
        stored = line(case.value, _LEAKAGE_M)
        left = 0.0 if case.sir_db is None else 10.0 ** ((-case.sir_db - case.value) / 20.0)
        before = after = stored * np.complex64(np.exp(2j * np.arcsin(0.5 * left)))
    else:
        leakage = line(_LEAKAGE_DB, _LEAKAGE_M)
        after = leakage + line(case.value, _GEAR_M)
        stored = before = after if case.sir_db is None else leakage
    noise = np.float32(10.0 ** (-case.snr_db / 20.0) / np.sqrt(2.0))
    parts = [
        LeakageCalibration.measured(WAVEFORM, stored + noise * white_noise(BLOCK, rng)).coefficients
        for _ in range(_CALIBRATION_FRAMES // BLOCK)
    ]
    found = LeakageCalibration(WAVEFORM, np.mean(parts, axis=0), cables_m - _LEAKAGE_M)
    return np.stack([before, after]), LeakageCanceller(found), cables_m
