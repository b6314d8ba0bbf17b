"""The radar return of terrain: radar equation over earth-fixed facets, as complex frames."""

from dataclasses import dataclass, field

import numpy as np
from scipy.constants import speed_of_light

from ...waveform import Waveform
from ..link import RadarLink
from .antenna import Antenna, GaussianAntenna
from .facets import Facets, GroundGrid
from .ground import Reflectivity, reflectivity
from .synthesis import synthesise
from .terrain import TerrainModel
from .trajectory import AircraftState

# largest angle off nadir at which facets are sampled: ground there is twice as far away
_MAX_OFF_NADIR_DEG = 60.0


@dataclass(frozen=True)
class GroundReturn:
    """One frame of the return, and its truth."""

    frame: np.ndarray  # (N,) complex128: received signal in square-root watts, without noise
    time_s: float  # instant of the frame's middle, to which every truth belongs
    height_m: float  # height of the antenna above the terrain vertically below it
    nearest_m: float  # range of the nearest visible facet; below ``height_m`` over sloping ground
    climb_m_per_s: float  # rate of ``height_m``: vertical speed less the terrain's rise along the track
    power_w: float  # expected received power, the mean over speckle
    noise_w: float  # thermal noise in the sample rate

    @property
    def snr_db(self) -> float:
        """Expected signal-to-noise ratio per sample."""
        return float(10.0 * np.log10(self.power_w / self.noise_w))


@dataclass(frozen=True)
class TerrainReturn:
    """Terrain return of one radar over one terrain: constructed once, called once per frame.

    Examples
    --------
    >>> from radalt.core.returns.terrain import FlatTerrain
    >>> scene = TerrainReturn(FlatTerrain(0.0), Waveform())
    >>> result = scene(AircraftState(0.0, 42.0, -87.9, 100.0, (70.0, 0.0, -3.7), 90.0))
    >>> result.frame.shape, result.height_m
    ((7500,), 100.0)
    """

    terrain: TerrainModel  # `Terrain` of DTED cells, or `FlatTerrain`
    # the sweep; its ``carrier_hz`` sets wavelength and Doppler
    waveform: Waveform = field(default_factory=Waveform)
    antenna: Antenna = field(default_factory=GaussianAntenna)  # one pattern for both directions
    ground: Reflectivity = field(default_factory=reflectivity)  # sigma0 by incidence
    link: RadarLink = field(default_factory=RadarLink)  # powers and losses
    grid: GroundGrid = field(default_factory=GroundGrid)  # earth-fixed scatterers and their seed
    footprint_db: float = 30.0
    """Facets are sampled out to the angle at which the two-way gain is this far below its peak."""
    tilt_deg: float = 0.0  # boresight tilt towards the nose, to level an antenna on a nose-up aircraft

    def facets(self, state: AircraftState) -> tuple[Facets, np.ndarray]:
        """Facets under a state and the (n,) expected power in watts of each.

        Radar equation ``P = P_t G^2 lambda^2 sigma0 A / ((4 pi)^3 R^4 L)``.
        """
        nose, wing, belly = _tilted(state.body_axes(), self.tilt_deg)
        lean = np.arccos(np.clip(-belly[2], -1.0, 1.0))
        limit = np.radians(_MAX_OFF_NADIR_DEG)
        beam = min(self.antenna.footprint_rad(self.footprint_db), limit)
        facets = self.grid.facets(state, self.terrain, min(beam + lean, limit), beam)
        off = np.arccos(np.clip(facets.direction @ belly, -1.0, 1.0))
        azimuth = np.arctan2(facets.direction @ wing, facets.direction @ nose)
        wavelength = speed_of_light / self.waveform.carrier_hz
        constant = (
            self.link.transmit_w * wavelength**2 / ((4.0 * np.pi) ** 3 * 10.0 ** (self.link.losses_db / 10.0))
        )
        gain = self.antenna.gain(off, azimuth)
        sigma = self.ground.sigma0(facets.incidence_rad, self.waveform.carrier_hz) * facets.area_m2
        return facets, constant * gain**2 * sigma / facets.range_m**4

    def __call__(self, state: AircraftState, *, frame_index: int = 0) -> GroundReturn:
        """Frame whose middle falls on the state's instant.

        ``state``: position, velocity, attitude; ``frame_index``: sweep number, see `synthesise`. Raises
        `TerrainError` if the aircraft is below ground, or terrain under the footprint is missing or void.
        """
        facets, power = self.facets(state)
        seen = power > 1e-7 * power.max()
        frame = synthesise(
            self.waveform,
            (np.sqrt(power) * facets.reflectivity)[seen],
            facets.range_m[seen],
            facets.range_rate_m_per_s[seen],
            frame_index=frame_index,
        )
        _, slope_e, slope_n = self.terrain.height_and_slope(state.latitude_deg, state.longitude_deg)
        east, north, up = state.velocity_m_per_s
        return GroundReturn(
            frame=frame,
            time_s=state.time_s,
            height_m=facets.height_m,
            nearest_m=float(facets.range_m[seen].min()),
            climb_m_per_s=float(up - east * slope_e - north * slope_n),
            power_w=float(power.sum()),
            noise_w=self.link.noise_w(self.waveform.rate_hz),
        )


def _tilted(axes: np.ndarray, tilt_deg: float) -> np.ndarray:
    """Body axes rotated about the wing so that the boresight moves ``tilt_deg`` towards the nose."""
    nose, wing, belly = axes
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    return np.stack([c * nose - s * belly, wing, c * belly + s * nose])
