"""Flights of minutes without interference, over land or a point: attitude, climb and terrain wander; no mitigation."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.returns.terrain import (
    AircraftState,
    GaussianAntenna,
    GroundGrid,
    TerrainReturn,
    reflectivity,
    synthesise,
)
from ...core.returns.terrain.geodesy import SEMI_MAJOR_M
from .cases import ATTITUDES, BLOCK, LANDS, WAVEFORM, Case

LOWEST_M, HIGHEST_M = 30.0, 1300.0  # altitudes at which flights start, uniform in the logarithm
_SPEED_M_PER_S = 40.0, 100.0  # over ground
# Deviation and correlation time of bank and pitch, by hand in light turbulence, and of the climb; greatest bank; share
# of the altitude by which a flight leaves it at most, and the highest.
_WANDER_DEG, _WANDER_S, _MOST_DEG = 3.0, 4.0, 42.0
_CLIMB_M_PER_S, _CLIMB_S, _LEAVES, _TOP_M = 2.0, 10.0, 0.4, 1450.0
# Lengths of the terrain's waves in either direction, and the greatest slope of each; lower down it is flatter.
_WAVES_M, _SLOPE, _FLATTER_M = (400.0, 900.0, 2000.0), 0.03, 150.0
_BEAM_DB = 30.0  # the nearest ground in the beam: within that of its peak, both ways (docs/tracker.md)
# Least scatterers in the first resolution cell of flat ground, 2 pi h dR, and cells per radius of the footprint.
_SCATTERERS, _LEAST_CELLS = 16.0, 8
_LATITUDE, _LONGITUDE = 42.0, -88.0
# Share of the strongest scatterer's power below which one is left out: together they have a thousandth.
_WEAKEST = 1e-5
_HELD = 2  # blocks with the same scatterers and attitude
# frames' middles, from that of their block
TIMES_S = (np.arange(BLOCK) + 0.5 - 0.5 * BLOCK) * WAVEFORM.sweep_s


@dataclass(frozen=True)
class Scatterers:
    """Scatterers of a block, (n,) each: ranges at its middle, their rates, and accelerations."""

    amplitude: np.ndarray
    range_m: np.ndarray
    rate_m_per_s: np.ndarray
    bend_m_per_s2: np.ndarray
    nearest_m: np.ndarray
    """(40,) is the range of the nearest one in the beam; ``amplitude`` complex64, of unit power together."""


@dataclass(frozen=True)
class Waves:
    """Rolling terrain, a `TerrainModel`: heights in metres of (2, 3) waves with these phases in rad."""

    phases: np.ndarray
    slope: float

    def height_m(self, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
        """See `TerrainModel`."""
        return self.height_and_slope(latitude_deg, longitude_deg)[0]

    def height_and_slope(
        self, latitude_deg: np.ndarray, longitude_deg: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `TerrainModel`."""
        metres = np.radians(1.0) * SEMI_MAJOR_M
        along = (np.asarray(longitude_deg) - _LONGITUDE) * metres * np.cos(np.radians(_LATITUDE))
        across = (np.asarray(latitude_deg) - _LATITUDE) * metres
        k = 2.0 * np.pi / np.array(_WAVES_M)
        angles = [k * x[..., None] + phases for x, phases in zip((along, across), self.phases, strict=True)]
        height = sum((self.slope / k * np.sin(angle)).sum(axis=-1) for angle in angles)
        return height, *((self.slope * np.cos(angle)).sum(axis=-1) for angle in angles)


def _wander(rng: np.random.Generator, count: int, deviation: float, memory_s: float) -> np.ndarray:
    """(count,) Gauss-Markov process by block, of a deviation and a correlation time."""
    keep = np.exp(-BLOCK * WAVEFORM.sweep_s / memory_s)
    out = rng.standard_normal(count) * deviation
    for k in range(1, count):
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * out[k]
    return out


def _altitudes(rng: np.random.Generator, blocks: int) -> np.ndarray:
    """(blocks + 1,) altitudes at the ends of blocks, metres, about a start that is drawn."""
    start = float(np.exp(rng.uniform(np.log(LOWEST_M), np.log(HIGHEST_M))))
    risen = np.cumsum(np.r_[0.0, _wander(rng, blocks, _CLIMB_M_PER_S, _CLIMB_S) * BLOCK * WAVEFORM.sweep_s])
    return start + np.clip(risen, -_LEAVES * start, min(_LEAVES * start, _TOP_M - start))


class Point:
    """A flight over a point, with an echo of a level in dB, metres beyond it, that a case may have."""

    def __init__(self, case: Case, frames: int, rng: np.random.Generator) -> None:
        self._up, levels = _altitudes(rng, -(-frames // BLOCK)), [0.0]
        self._apart, phases = np.zeros(1), rng.random(2)
        if case.value:
            self._apart, levels = np.array([0.0, case.value]), [0.0, -case.sir_db]
        amplitude = 10.0 ** (np.array(levels) / 20.0) * np.exp(2j * np.pi * phases[: len(levels)])
        self._amplitude = amplitude.astype(np.complex64)

    def scatterers(self, block: int) -> Scatterers:
        """As `Land.scatterers`."""
        rate = (self._up[block + 1] - self._up[block]) / (BLOCK * WAVEFORM.sweep_s)
        middle = 0.5 * (self._up[block + 1] + self._up[block])
        rates = np.full(self._apart.size, rate)
        return Scatterers(
            self._amplitude, middle + self._apart, rates, np.zeros(rates.size), middle + rate * TIMES_S
        )


class Land:
    """A flight over the land and in the attitude that a case names, by blocks of 40 frames."""

    def __init__(self, case: Case, frames: int, rng: np.random.Generator) -> None:
        _, land, attitude = case.name.split("/")[:3]
        beam, pitch, bank = ATTITUDES[attitude]
        blocks = -(-frames // BLOCK)
        self._up = _altitudes(rng, blocks)
        height = float(self._up[0])
        phases = rng.uniform(0.0, 2.0 * np.pi, (2, len(_WAVES_M)))
        antenna = GaussianAntenna(beamwidth_deg=beam)
        radius_m = height * np.tan(min(antenna.footprint_rad(_BEAM_DB), np.radians(60.0)))
        cell_m = np.sqrt(2.0 * np.pi * height * WAVEFORM.range_resolution_m / _SCATTERERS)
        cells = max(_LEAST_CELLS, int(np.ceil(radius_m / cell_m)))
        self._radar = TerrainReturn(
            Waves(phases, _SLOPE * min(1.0, height / _FLATTER_M)),
            WAVEFORM,
            antenna=antenna,
            ground=reflectivity(*LANDS[land]),
            grid=GroundGrid(int(rng.integers(1 << 31)), cells),
        )
        self._speed = case.value or float(rng.uniform(*_SPEED_M_PER_S))
        self._roll = np.clip(bank + _wander(rng, blocks, _WANDER_DEG, _WANDER_S), -_MOST_DEG, _MOST_DEG)
        self._pitch = pitch + _wander(rng, blocks, _WANDER_DEG, _WANDER_S)
        self._held = (-1,)

    def scatterers(self, block: int) -> Scatterers:
        """Those of a block."""
        first, block_s = block - block % _HELD, BLOCK * WAVEFORM.sweep_s
        if self._held[0] != first:
            self._held = first, *self._at(first, min(_HELD, self._roll.size - first) * block_s)
        _, middle_s, amplitude, at, speed, bend, inside = self._held
        late = (block + 0.5) * block_s - middle_s
        at, speed = at + late * (speed + 0.5 * bend * late), speed + late * bend
        ranges = (x[inside, None] for x in (at, speed, bend))
        nearest = sum(x * TIMES_S**k / max(1, k) for k, x in enumerate(ranges)).min(axis=0)
        return Scatterers(amplitude, at, speed, bend, nearest)

    def _at(self, block: int, lasts_s: float) -> tuple[Any, ...]:
        """Middle of a time that begins with a block; amplitudes, ranges, rates, accelerations; mask of the beam."""
        block_s = BLOCK * WAVEFORM.sweep_s
        begin, end = self._up[block], self._up[block + round(lasts_s / block_s)]
        climb, time_s = float(end - begin) / lasts_s, block * block_s + 0.5 * lasts_s
        metres_per_deg = np.radians(1.0) * SEMI_MAJOR_M * np.cos(np.radians(_LATITUDE))
        state = AircraftState(
            time_s,
            _LATITUDE,
            _LONGITUDE + self._speed * time_s / metres_per_deg,
            0.5 * float(begin + end),
            (self._speed, 0.0, climb),
            90.0,
            float(self._pitch[block]),
            float(self._roll[block]),
        )
        facets, power = self._radar.facets(state)
        seen = power > _WEAKEST * power.max()
        amplitude = (np.sqrt(power / power.sum()) * facets.reflectivity)[seen].astype(np.complex64)
        at, speed = facets.range_m[seen], facets.range_rate_m_per_s[seen]
        off = np.arccos(np.clip(facets.direction[seen] @ state.body_axes()[2], -1.0, 1.0))
        inside = off <= self._radar.antenna.footprint_rad(_BEAM_DB)
        return time_s, amplitude, at, speed, (self._speed**2 + climb**2 - speed**2) / at, inside


def flight_of(case: Case, frames: int, rng: np.random.Generator) -> Land | Point:
    """The flight of a case of the kinds `land` and `point`."""
    return (Land if case.kind.startswith("land") else Point)(case, frames, rng)


def frames_of(s: Scatterers) -> np.ndarray:
    """(40, N) complex64 frames of a block's scatterers, at the full rate."""
    frames = [
        synthesise(
            WAVEFORM,
            s.amplitude,
            s.range_m + t * (s.rate_m_per_s + 0.5 * t * s.bend_m_per_s2),
            s.rate_m_per_s + t * s.bend_m_per_s2,
        )
        for t in TIMES_S
    ]
    return np.array(frames, dtype=np.complex64)
