"""Aligned frames of a flight: returns, interference and noise, with the receiver's faults."""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from ...core.interference import interference_frames
from ...core.returns.point import point_return
from ...core.waveform import Waveform, altitude_to_delay_s, exp_cycles
from .cases import BLOCK, DRIFT, SPAN_M, WAVEFORM, Case
from .emitters import interferers_of
from .flights import FASTEST_M_PER_S, Flight
from .long_flights import frames_of as land_frames

_SAWTOOTH = Waveform(shape="sawtooth_up")  # of the slope of our rising half sweeps
# Blades that pass per second (four, 300 revolutions per minute), and share of the time in which one covers the beam.
_BLADES_HZ, _BLADE = 20.0, 0.1
Source = Callable[[np.ndarray], np.ndarray]  # frames by their index


def white_noise(frames: int, rng: np.random.Generator) -> np.ndarray:
    """(frames, N) complex64 with unit power in each rail."""
    shape = frames, WAVEFORM.samples_per_frame, 2
    return rng.standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]


def frames_of(
    case: Case, flight: Flight, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(frame index, (n, N) complex64 frames) of up to 40 frames at a time, without those that are missing."""
    total = flight.middle_m.size
    if case.kind == "drawn":
        overlap, levels = float(rng.choice((0.3, 0.6, 1.0))), rng.uniform((-62.0, -10.0), (-20.0, 15.0))
        case = dataclasses.replace(case, overlap=overlap, sir_db=float(levels[0]), snr_db=float(levels[1]))
    sources = _sources(case, flight, rng)
    out = _spoilt(case, flight, rng) if case.kind in ("missing", "nan") else np.zeros(total, dtype=bool)
    level, rail, held = np.float32(10.0 ** (-case.snr_db / 20.0) / np.sqrt(2.0)), None, []
    for first in range(0, total, BLOCK):
        index = np.arange(first, min(first + BLOCK, total))
        frames = white_noise(index.size, rng) * level
        for source, begin in sources:
            on = index >= begin
            if on.any():
                frames[on] += source(index[on])
        rails = frames.view(np.float32)
        if case.kind == "clipped":
            rail = case.value * float(np.std(rails)) if rail is None else rail  # the gain is set once
            np.clip(rails, -rail, rail, out=rails)
        if case.kind == "frozen":
            for k, frame in zip(index, frames, strict=True):
                if k >= flight.fault_frame + case.value:
                    frame[:] = held[(k - flight.fault_frame) % len(held)]
                elif k >= flight.fault_frame:
                    held.append(frame.copy())
        bad = out[index]
        if case.kind == "nan":
            rails[bad] = np.nan
        elif case.kind == "missing":
            index, frames = index[~bad], frames[~bad]
        yield index, frames


def _spoilt(case: Case, flight: Flight, rng: np.random.Generator) -> np.ndarray:
    """(frames,) bool: a random share of all frames, and a hundred in a row from the fault on."""
    index = np.arange(flight.middle_m.size)
    burst = (index >= flight.fault_frame) & (index < flight.fault_frame + 100)
    return burst | (rng.random(index.size) < case.value)


def _sources(case: Case, flight: Flight, rng: np.random.Generator) -> list[tuple[Source, int]]:
    """Sources besides noise, each with the frame from which on it is received."""
    w, sources = WAVEFORM, []
    fault = flight.fault_frame or 0
    phase = rng.random(2)
    ground = flight.middle_m, flight.speed_m_per_s
    if flight.land is not None:  # sources are asked for whole blocks
        sources.append((lambda k: land_frames(flight.land.scatterers(k[0] // BLOCK)), 0))
    elif case.kind == "nonlinear":
        sources.append((_bent(case.value, _point(*ground, phase[0]), flight.middle_m, rng), 0))
    elif case.ground:
        point = _point(*ground, phase[0])
        sources.append((_chopped(case.value, point, phase[1]) if case.kind == "rotor" else point, 0))
    for where, speed, level_db, begin in _others(case, flight, rng):
        sent = _SAWTOOTH if case.kind == "sawtooth" else WAVEFORM
        sources.append((_point(where, speed, phase[1], level_db, sent), begin))
    if case.scene or case.kind == "drawn":
        interferers, total_sir_db = interferers_of(case, rng)
        shape = w.samples_per_frame, w.rate_hz, rng

        def interference(index: np.ndarray) -> np.ndarray:
            out = np.empty((index.size, w.samples_per_frame), np.complex64)
            return interference_frames(interferers, index.size, *shape, total_sir_db=total_sir_db, out=out)

        sources.append((interference, fault if case.kind == "switched_on" else 0))
    return sources


def _point(
    altitude_m: np.ndarray, speed: np.ndarray, phase: float, level_db: float = 0.0, sent: Waveform = WAVEFORM
) -> Source:
    strength = np.float32(10.0 ** (level_db / 20.0))
    return lambda k: (
        point_return(sent, altitude_m[k], vertical_speed_m_per_s=speed[k], phase_cycles=phase) * strength
    )


def _chopped(share: float, source: Source, start: float) -> Source:
    """A return of which rotor blades take a share of the amplitude as they pass."""

    def frames(index: np.ndarray) -> np.ndarray:
        passed = _BLADES_HZ * (index[:, None] * WAVEFORM.sweep_s + WAVEFORM.sample_times_s) + start
        left = np.float32(1.0 - share)
        return source(index) * np.where(np.mod(passed, 1.0) < _BLADE, left, np.float32(1.0))

    return frames


def _others(
    case: Case, flight: Flight, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray, float, int]]:
    """Returns next to the ground's: altitudes, speeds, level over the ground's in dB, frame from which on."""
    ground, speed, fault = flight.middle_m, flight.speed_m_per_s, flight.fault_frame or 0
    time_s = (np.arange(ground.size) + 0.5) * WAVEFORM.sweep_s
    if case.kind == "drawn" and rng.random() < 0.5:
        apart = rng.uniform(5.0, 120.0)
        yield ground + apart, speed, rng.uniform(-25.0, -6.0), 0
    elif case.kind.startswith("altimeter") or case.kind == "sawtooth":
        drift = DRIFT * case.value * float(rng.choice((-1.0, 1.0)))
        where = rng.uniform(0.0, SPAN_M) + drift * (time_s - 0.4 * ground.size * WAVEFORM.sweep_s)
        yield where, np.full(ground.size, drift), -case.sir_db, 0
    elif case.kind.startswith("spoofed"):
        apart = case.value * float(rng.uniform(60.0, 400.0))
        yield ground + apart, speed, -case.sir_db, fault
    elif case.kind == "pull_off":
        copy = case.value * float(rng.uniform(FASTEST_M_PER_S, 2.0 * FASTEST_M_PER_S))
        apart = (copy - speed) * np.maximum(time_s - fault * WAVEFORM.sweep_s, 0.0)
        yield ground + apart, np.full(ground.size, copy), -case.sir_db, fault
    elif case.kind == "two_grounds":
        yield ground + case.value, speed, 0.0 if case.scene else -case.sir_db, 0
    elif case.kind == "bounce":
        yield 2.0 * ground, 2.0 * speed, case.value, 0
        yield 3.0 * ground, 3.0 * speed, 2.0 * case.value, 0


def _bent(share: float, source: Source, altitude_m: np.ndarray, rng: np.random.Generator) -> Source:
    """A return whose sweep is off the line, as its oscillator's frequency is, by at most ``share`` of its bandwidth."""
    w, waves, start = WAVEFORM, int(rng.integers(1, 4)), rng.random()
    scale = share * w.bandwidth_hz * w.half_sweep_s / (2.0 * np.pi * waves)

    def frames(index: np.ndarray) -> np.ndarray:
        delayed = w.sample_times_s - np.asarray(altitude_to_delay_s(altitude_m[index]))[:, None]
        half = np.mod(delayed, w.sweep_s) / w.half_sweep_s
        band = np.where(half < 1.0, half, 2.0 - half)
        wave = np.sin(2.0 * np.pi * (waves * band + start)) - np.sin(2.0 * np.pi * start)
        return source(index) * exp_cycles(np.where(half < 1.0, scale, -scale) * wave)

    return frames
