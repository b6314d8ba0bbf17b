"""A landing by frame index, for flowgraphs: altitude profile and ground return of each frame."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .radar_return import GroundReturn, TerrainReturn
from .trajectory import AircraftState, Trajectory


@dataclass(frozen=True)
class LandingProfile:
    """A flight sampled in a number of frames, evenly in time from the middle of the first to that of the last.

    With fewer frames than the flight has sweeps it is a time lapse: each frame is exact in itself (delay, Doppler,
    speckle), and frames that are more than ``sweep_s`` of flight apart are not coherent with each other.
    """

    radar: TerrainReturn  # antenna, ground and link over terrain
    flight: Trajectory  # the aircraft
    frames: int  # frames from ``start_s`` to ``end_s``, at least 2
    start_s: float
    end_s: float

    def __post_init__(self) -> None:
        if self.frames < 2:
            raise ValueError(f"landing.frames is {self.frames}; it has to be at least 2")

    @cached_property
    def states(self) -> list[AircraftState]:
        """Aircraft states, one per frame."""
        return self.flight.states(np.linspace(self.start_s, self.end_s, self.frames))

    @cached_property
    def altitude_m(self) -> np.ndarray:
        """(frames,) heights of the antenna above the ground below it."""
        places = [(s.latitude_deg, s.longitude_deg, s.altitude_m) for s in self.states]
        lat, lon, altitude = np.array(places).T
        return altitude - self.radar.terrain.height_m(lat, lon)

    @cached_property
    def vertical_speed_m_per_s(self) -> np.ndarray:
        """(frames,) rates of `altitude_m` in flight time, positive climbing."""
        lat, lon = np.array([(s.latitude_deg, s.longitude_deg) for s in self.states]).T
        _, slope_e, slope_n = self.radar.terrain.height_and_slope(lat, lon)
        east, north, up = np.array([s.velocity_m_per_s for s in self.states]).T
        return up - east * slope_e - north * slope_n

    def check(self) -> None:
        """Form the ground's facets at up to 64 instants; raises `TerrainError` as `TerrainReturn` does."""
        for index in np.unique(np.linspace(0, self.frames - 1, 64).astype(int)):
            self.radar.facets(self.states[index])

    def ground_return(self, index: int) -> GroundReturn:
        """Echo and truth of a frame, in watts."""
        return self.radar(self.states[index], frame_index=index)

    def frame(self, index: int) -> np.ndarray:
        """(N,) complex64 echo of a frame, scaled to an *expected* power of 1; speckle makes it fade around that."""
        result = self.ground_return(index)
        return (result.frame / np.sqrt(result.power_w)).astype(np.complex64)
