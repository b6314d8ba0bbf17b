"""Flights of minutes without interference, over land or a point: attitude, climb and terrain wander; no mitigation."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...core.altimeter.altimeter import Spectra
from ...core.returns.terrain import (
    AircraftState,
    GaussianAntenna,
    GroundGrid,
    TerrainReturn,
    reflectivity,
    synthesise,
)
from ...core.returns.terrain.geodesy import SEMI_MAJOR_M
from .beats import Beats
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
_LOW_M, _COARSE, _FINE = 200.0, 8, 16  # cells per radius of the footprint, below that altitude and above
_LATITUDE, _LONGITUDE = 42.0, -88.0


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
        self._amplitude = 10.0 ** (np.array(levels) / 20.0) * np.exp(2j * np.pi * phases[: len(levels)])

    def scatterers(self, block: int) -> tuple[np.ndarray, ...]:
        """As `Land.scatterers`."""
        climb = (self._up[block + 1] - self._up[block]) / BLOCK
        ranges = (self._up[block] + climb * (np.arange(BLOCK) + 0.5))[:, None] + self._apart
        speeds = np.full(ranges.shape, climb / WAVEFORM.sweep_s)
        return self._amplitude, ranges, speeds, ranges[:, 0]


class Land:
    """A flight over the land and in the attitude that a case names, by blocks of 40 frames."""

    def __init__(self, name: str, frames: int, rng: np.random.Generator) -> None:
        _, land, attitude = name.split("/")[:3]
        beam, pitch, bank = ATTITUDES[attitude]
        blocks = -(-frames // BLOCK)
        self._up = _altitudes(rng, blocks)
        height = float(self._up[0])
        phases = rng.uniform(0.0, 2.0 * np.pi, (2, len(_WAVES_M)))
        self._radar = TerrainReturn(
            Waves(phases, _SLOPE * min(1.0, height / _FLATTER_M)),
            WAVEFORM,
            antenna=GaussianAntenna(beamwidth_deg=beam),
            ground=reflectivity(*LANDS[land]),
            grid=GroundGrid(int(rng.integers(1 << 31)), _COARSE if height < _LOW_M else _FINE),
        )
        self._speed = float(rng.uniform(*_SPEED_M_PER_S))
        self._roll = np.clip(bank + _wander(rng, blocks, _WANDER_DEG, _WANDER_S), -_MOST_DEG, _MOST_DEG)
        self._pitch = pitch + _wander(rng, blocks, _WANDER_DEG, _WANDER_S)

    def scatterers(self, block: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(n,) amplitudes of unit power together, (40, n) ranges and their rates, and (40,) range of the nearest."""
        sweep_s = WAVEFORM.sweep_s
        block_s = BLOCK * sweep_s
        climb = (self._up[block + 1] - self._up[block]) / block_s
        metres_per_deg = np.radians(1.0) * SEMI_MAJOR_M * np.cos(np.radians(_LATITUDE))
        state = AircraftState(
            (block + 0.5) * block_s,
            _LATITUDE,
            _LONGITUDE + self._speed * (block + 0.5) * block_s / metres_per_deg,
            0.5 * float(self._up[block] + self._up[block + 1]),
            (self._speed, 0.0, float(climb)),
            90.0,
            float(self._pitch[block]),
            float(self._roll[block]),
        )
        facets, power = self._radar.facets(state)
        seen = power > 1e-7 * power.max()  # as TerrainReturn
        amplitude = (np.sqrt(power / power.sum()) * facets.reflectivity)[seen]
        at, speed = facets.range_m[seen], facets.range_rate_m_per_s[seen]
        bend = (self._speed**2 + climb**2 - speed**2) / at
        time_s = ((np.arange(BLOCK) + 0.5) * sweep_s - 0.5 * block_s)[:, None]
        ranges = at + speed * time_s + 0.5 * bend * time_s**2
        belly = state.body_axes()[2]
        off = np.arccos(np.clip(facets.direction[seen] @ belly, -1.0, 1.0))
        inside = off <= self._radar.antenna.footprint_rad(_BEAM_DB)
        return amplitude, ranges, speed + bend * time_s, ranges[:, inside].min(axis=1)


def flight_of(case: Case, frames: int, rng: np.random.Generator) -> Land | Point:
    """The flight of a case of the kinds `land` and `point`."""
    return Land(case.name, frames, rng) if case.kind.startswith("land") else Point(case, frames, rng)


def frames_of(scatterers: tuple[np.ndarray, ...]) -> np.ndarray:
    """(40, N) complex64 frames of a block's scatterers, at the full rate."""
    amplitude, ranges, rates, _ = scatterers
    frames = [synthesise(WAVEFORM, amplitude, at, rate) for at, rate in zip(ranges, rates, strict=True)]
    return np.array(frames, dtype=np.complex64)


def spectra_of(
    case: Case, flight: Land | Point, frames: int, beats: Beats, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, Spectra, np.ndarray]]:
    """(frame index, spectra, true altitude at the frames' middles) by block, made at the decimated rate."""
    level = np.float32(10.0 ** (-case.snr_db / 20.0) / np.sqrt(2.0))
    for block in range(frames // BLOCK):
        amplitude, ranges, rates, nearest = flight.scatterers(block)
        low = beats.returns(amplitude, ranges, rates) + level * beats.noise(BLOCK, rng)
        yield block * BLOCK + np.arange(BLOCK), beats.altimeter.of_beats(low), nearest
