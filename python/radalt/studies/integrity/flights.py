"""Flights of the integrity campaign: the true altitude of every frame, a function of (case, seed, batch)."""

import zlib
from dataclasses import dataclass

import numpy as np

from .cases import BLOCK, SPAN_M, WAVEFORM, Case
from .long_flights import Land, flight_of

FASTEST_M_PER_S = 10.0  # largest vertical speed of a flight, up and down
_LOWEST_M, _HIGHEST_M = 5.0, 1400.0  # altitudes at which flights start
# frames of a block's last quarter, in which a step shows one output later (docs/tracker.md)
_LATE = BLOCK // 4
# kinds with a fault in mid-flight
_FAULTY = (
    "switched_on step missing slip nan clipped altimeter altimeter_alone spoofed pull_off frozen gear".split()
)


@dataclass(frozen=True)
class Flight:
    """A flight by frame.

    ``middle_m``, ``end_m``, ``speed_m_per_s`` (frames,) float: altitude at the middle and at the end of each frame,
    NaN without a return, and vertical speed.
    """

    middle_m: np.ndarray
    end_m: np.ndarray
    speed_m_per_s: np.ndarray
    fault_frame: int | None = None  # first frame of the fault, if there is one
    land: Land | None = None  # source of the echoes of land


def rng_of(case: Case, seed: int, batch: int, purpose: int) -> np.random.Generator:
    """Random generator of a flight: purpose 0 for the flight itself, 1 for its frames."""
    return np.random.default_rng([seed, zlib.crc32(case.name.encode()), batch, purpose])


def fly(case: Case, seed: int, batch: int, frames: int) -> Flight:
    """Draw a flight: a start at 5 to 1400 m, uniform in the logarithm, and a speed of up to 10 m/s."""
    rng, sweep_s = rng_of(case, seed, batch, 0), WAVEFORM.sweep_s
    begin = (2 * frames // 5, frames // 2)
    if case.kind == "pull_off":  # from a young track on; the copy has the rest of the flight to walk off
        begin = 4 * BLOCK, max(5 * BLOCK, frames // 5)
    fault = int(rng.integers(*begin)) if case.kind in _FAULTY else None
    if not case.ground:
        nothing = np.full(frames, np.nan)
        return Flight(nothing, nothing, np.zeros(frames))
    if case.kind == "land_jammed":
        land = flight_of(case, frames, rng)
        middle = np.concatenate([land.scatterers(block).nearest_m for block in range(frames // BLOCK)])
        step = np.gradient(middle)
        return Flight(middle, middle + 0.5 * step, step / sweep_s, land=land)
    start = float(np.exp(rng.uniform(np.log(_LOWEST_M), np.log(_HIGHEST_M))))
    speed = float(rng.uniform(-FASTEST_M_PER_S, FASTEST_M_PER_S))
    steps: list[tuple[int, float]] = []
    if case.kind == "landing":
        start, speed = rng.uniform(40.0, 250.0), -abs(speed)
        at = np.sort(rng.integers(BLOCK, frames, max(1, frames // 400)))
        at -= _LATE * (at % BLOCK >= BLOCK - _LATE)  # a step late in a block is outside the claim
        steps = [(int(k), float(rng.uniform(-15.0, 15.0))) for k in at]
    elif case.kind == "step":
        start = float(rng.uniform(max(50.0, 30.0 - case.value), 1000.0))
        place = fault % BLOCK
        fault += (BLOCK - _LATE + place % _LATE if case.known else place % (BLOCK - _LATE)) - place
        steps = [(fault, case.value)]
    elif case.kind.startswith("spoofed"):
        start = float(rng.uniform(450.0, 900.0))
    elif case.kind == "pull_off":  # aircraft and copy move apart
        start, speed = float(rng.uniform(150.0, 900.0)), -case.value * abs(speed)
    elif case.kind == "beyond":
        top_m = WAVEFORM.max_unambiguous_altitude_m
        start, speed = float(np.exp(rng.uniform(np.log(SPAN_M), np.log(top_m)))), abs(speed)
    if start + speed * frames * sweep_s < _LOWEST_M:
        speed = abs(speed)

    def at(time_s: np.ndarray) -> np.ndarray:
        # a step counts after the start of its frame: the output that ends there still belongs to the ground before it
        jumps = sum(((time_s > k * sweep_s) * height for k, height in steps), np.zeros(frames))
        return np.maximum(start + speed * time_s + jumps, _LOWEST_M)

    index = np.arange(frames)
    middle, end = at((index + 0.5) * sweep_s), at((index + 1) * sweep_s)
    return Flight(middle, end, np.full(frames, speed), fault)
