"""Settings of a landing: trajectory, terrain, antenna, ground and link.

The terrain code is imported only when objects are created from the settings, so scenes without terrain never load it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..parsing import Settings, setting
from ..programme import Programme
from ..waveform import Waveform
from .link import RadarLink

if TYPE_CHECKING:
    from .terrain import Antenna, LandingProfile, TerrainModel, TerrainReturn, Trajectory


@dataclass(frozen=True)
class TrajectorySpec(Settings, where="trajectory"):
    """Trajectory of the aircraft."""

    file: str = "approach_kord_10c.csv"
    """CSV with a track, or with ADS-B state vectors."""
    aircraft: str | None = None
    """The icao24 address or callsign to take from a file of several."""
    altitude: str | None = None
    """Which of several altitudes: ``"geo"`` (GNSS) or ``"baro"`` (barometric); None: the plain one, or the first."""
    altitude_unit: str | None = None
    """``"m"`` or ``"ft"``, of a column that does not state it; None: metres, and an error in a flight log."""
    altitude_offset_m: float = 0.0
    """Added to the file's altitudes: minus the geoid undulation where they are above the ellipsoid."""
    angle_of_attack_deg: float = setting(5.0, -30.0, 30.0)
    """Pitch above the path angle."""
    max_gap_s: float = setting(15.0, 1e-3, 1e5)
    """Longest gap between two rows that is interpolated."""
    max_speed_m_per_s: float = setting(700.0, 1.0, 1e4)
    """Largest speed over ground from row to row."""
    max_vertical_speed_m_per_s: float = setting(60.0, 0.1, 1e4)
    """Largest vertical speed from row to row."""
    start_s: float | None = None
    """Start of the part of the flight in use, in the file's time; None: its first row."""
    end_s: float | None = None
    """End of that part; None: the last row."""


@dataclass(frozen=True)
class TerrainSpec:
    """Terrain model."""

    files: tuple[str, ...] = ("hilly_n41w089.dt0", "hilly_n41w088.dt0")
    """DTED files of all cells that the flight crosses; none for a flat earth."""
    void: str = "error"
    """Posts without a height: ``"error"`` refuses them, ``"fill"`` takes the nearest one's."""
    flat_m: float = 204.0
    """Elevation of the flat earth above mean sea level."""


@dataclass(frozen=True)
class AntennaSpec:
    """The altimeter's antenna: a Gaussian beam, or a pattern file."""

    beamwidth_deg: float = 40.0
    """Full width of the beam at half power."""
    gain_dbi: float = 10.0
    """Gain in the middle of the beam."""
    two_way: bool = False
    """The beamwidth is that of transmission and reception together."""
    pattern: str | None = None
    """File of a measured pattern, instead of the Gaussian beam."""
    tilt_deg: float = 0.0
    """Tilt of the antenna against the aircraft's vertical axis."""


@dataclass(frozen=True)
class GroundSpec:
    """Reflectivity of the ground."""

    model: str = "morchin"
    """Reflectivity against the angle of incidence."""
    land: str = "urban_low_relief"
    """Type of land."""
    level_db: float = 0.0
    """Added to the model's reflectivity."""


@dataclass(frozen=True)
class LandingSpec:
    """A landing: trajectory over terrain, with antenna, ground and link.

    Examples
    --------
    >>> from radalt.core.waveform import Waveform
    >>> profile = LandingSpec().profile(Waveform(), frames=100)
    >>> profile.altitude_m.shape, profile.frame(0).shape
    ((100,), (7500,))
    """

    trajectory: TrajectorySpec = TrajectorySpec()
    terrain: TerrainSpec = TerrainSpec()
    antenna: AntennaSpec = AntennaSpec()
    ground: GroundSpec = GroundSpec()
    link: RadarLink = RadarLink()
    folder: str = ""
    """Folder of the files. If empty, each is sought in ``flowgraphs/landing``, the shipped one, too."""

    def path(self, name: str) -> Path:
        """A file of the landing."""
        if self.folder:
            return Path(self.folder) / name
        from ..paths import share_dir

        return share_dir() / "flowgraphs" / "landing" / name

    def files(self) -> dict[str, Path]:
        """Its files: ``trajectory``, ``terrain 0`` and so on, ``antenna``."""
        named = {"trajectory": self.trajectory.file}
        named |= {f"terrain {k}": name for k, name in enumerate(self.terrain.files)}
        if self.antenna.pattern:
            named["antenna"] = self.antenna.pattern
        return {name: self.path(file) for name, file in named.items()}

    def with_files(self, files: Mapping[str, Path]) -> LandingSpec:
        """The same landing with its `files` at other paths; other names are left alone."""
        at = {name: str(Path(files[name]).absolute()) for name in self.files()}
        terrain = tuple(at[f"terrain {k}"] for k in range(len(self.terrain.files)))
        return replace(
            self,
            trajectory=replace(self.trajectory, file=at["trajectory"]),
            terrain=replace(self.terrain, files=terrain),
            antenna=replace(self.antenna, pattern=at.get("antenna")),
        )

    def flight(self) -> Trajectory:
        """The trajectory; raises `TrajectoryError`."""
        from .terrain import Trajectory

        given = vars(self.trajectory).copy()
        file, _, _ = (given.pop(name) for name in ("file", "start_s", "end_s"))
        return Trajectory.load(self.path(file), **given)

    def window_s(self, flight: Trajectory, margin_s: float) -> tuple[float, float]:
        """First and last instant in use, ``margin_s`` inside ``start_s..end_s``; raises `TrajectoryError`."""
        from .terrain import TrajectoryError

        spec = self.trajectory
        start = flight.start_s if spec.start_s is None else spec.start_s
        end = flight.end_s if spec.end_s is None else spec.end_s
        if not (flight.start_s <= start and end <= flight.end_s and end - start > 2 * margin_s):
            raise TrajectoryError(
                f"trajectory.start_s..end_s is {start:g}..{end:g} s; it has to lie within the flight, "
                f"{flight.start_s:g}..{flight.end_s:g} s, and last more than {2 * margin_s:g} s"
            )
        return start + margin_s, end - margin_s

    def ground_model(self) -> TerrainModel:
        """The terrain; raises `TerrainError`."""
        from .terrain import FlatTerrain, Terrain

        if not self.terrain.files:
            return FlatTerrain(self.terrain.flat_m)
        return Terrain.load([self.path(name) for name in self.terrain.files], void=self.terrain.void)

    def antenna_model(self) -> Antenna:
        """The antenna."""
        from .terrain import GaussianAntenna, TabulatedAntenna

        spec = self.antenna
        if spec.pattern:
            return TabulatedAntenna.load(self.path(spec.pattern))
        return GaussianAntenna(spec.beamwidth_deg, spec.gain_dbi, spec.two_way)

    def radar(self, waveform: Waveform, seed: int = 1) -> TerrainReturn:
        """The return of the ground, its scatterers drawn from a seed."""
        from .terrain import GroundGrid, TerrainReturn, reflectivity

        return TerrainReturn(
            self.ground_model(),
            waveform,
            self.antenna_model(),
            reflectivity(self.ground.model, self.ground.land, level_db=self.ground.level_db),
            self.link,
            GroundGrid(seed),
            tilt_deg=self.antenna.tilt_deg,
        )

    def profile(self, waveform: Waveform, frames: int, seed: int = 1) -> LandingProfile:
        """The flight in a number of frames, for the live path: altitudes, rates and echoes by frame index."""
        from .terrain import LandingProfile

        flight = self.flight()
        start, end = self.window_s(flight, waveform.sweep_s)
        return LandingProfile(self.radar(waveform, seed), flight, frames, start, end)


class TerrainPlayer:
    """Terrain return by frame index, in place of a point return.

    ``programme``: programme whose altitudes are those of the landing, one per frame; ``waveform``, ``seed``: those of
    the scene. Raises `ValueError` if the altitudes are not those of the landing.
    """

    def __init__(self, landing: LandingSpec, programme: Programme, waveform: Waveform, seed: int) -> None:
        self._programme = programme
        self._profile = landing.profile(waveform, len(programme.altitudes_m), seed)
        apart = np.max(np.abs(np.maximum(self._profile.altitude_m, 0.0) - programme.altitudes_m))
        if apart > 0.5:
            raise ValueError(
                f"return: terrain plays the landing, but altitude.programme_m is up to {apart:.1f} m off it; leave "
                "programme_m out"
            )
        index = np.arange(programme.total_frames)
        self._trial = np.cumsum(programme.is_trial(index)) - 1

    def echo(self, frame_index: int, transmitted: np.ndarray) -> np.ndarray:
        """(N,) return of sweep ``frame_index``; outside the trials the sweep itself, at altitude zero."""
        if not self._programme.is_trial(frame_index):
            return transmitted
        return self._profile.frame(int(self._trial[frame_index]))
