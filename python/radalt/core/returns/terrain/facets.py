"""Ground facets under an antenna: where they lie, how fast they recede, and how strongly they reflect.

The ground is divided into cells that are fixed to the earth: integer indices of latitude and longitude, not
of the aircraft. Each cell holds one scatterer at a random place in it, with a complex Gaussian reflectivity;
both are hashed from (seed, cell). Whatever flies over the same ground therefore meets the same scatterers,
and the sum decorrelates along the path exactly as its changing geometry makes it: that is speckle with the
right coherence.
"""

from dataclasses import dataclass

import numpy as np

from ...parsing import Settings, setting
from .geodesy import SEMI_MAJOR_M, curvature_radii_m, enu_axes, geodetic_to_ecef
from .terrain import TerrainError, TerrainModel
from .trajectory import AircraftState

# Least simulated height of the antenna above ground, metres: below it lies the antenna's near field.
MIN_HEIGHT_M = 0.5
# latitude at which cells are square, that of the shipped landing; to 2 % within a degree of it
_SQUARE_AT_DEG = 42.0


@dataclass(frozen=True)
class Facets:
    """Facets seen from one aircraft state; all arrays (n,)."""

    range_m: np.ndarray  # slant range at the instant of the state
    range_rate_m_per_s: np.ndarray  # its rate, positive receding
    incidence_rad: np.ndarray
    """Angle between the line of sight and the facet's normal; beyond pi/2 the facet faces away."""
    direction: np.ndarray  # (n, 3): unit vectors from the aircraft, in its local east, north, up
    area_m2: np.ndarray  # surface area of the facet, on its slope
    reflectivity: np.ndarray  # unit-variance complex Gaussian scattering amplitude, fixed to the ground
    height_m: float  # height of the antenna above the terrain vertically below it


@dataclass(frozen=True)
class GroundGrid(Settings, where="ground"):
    """The earth-fixed cells."""

    seed: int = setting(1, 0, 2**63 - 1)  # seed of the scatterers' positions and amplitudes
    cells_per_radius: int = setting(16, 4, 256)
    """Cell size is the power of two (metres) that puts between this many and twice as many cells into the radius of
    the footprint. The size steps with height, and with it the speckle is drawn anew at each octave."""

    def facets(
        self, state: AircraftState, terrain: TerrainModel, off_nadir_rad: float, beam_rad: float | None = None
    ) -> Facets:
        """Facets of a cone around nadir, ``off_nadir_rad`` (below 80 degrees) its half angle.

        ``beam_rad``, the half angle that sets the cell size, is given apart, so that the size does not change with the
        attitude of the aircraft. Raises `TerrainError` if the aircraft is lower than `MIN_HEIGHT_M`, or terrain is
        missing.
        """
        ground_m = float(terrain.height_m(state.latitude_deg, state.longitude_deg))
        height = state.altitude_m - ground_m
        if not height >= MIN_HEIGHT_M:
            raise TerrainError(
                f"aircraft at t = {state.time_s:g} s is {height:.2f} m above ground (altitude "
                f"{state.altitude_m:.2f} m, terrain {ground_m:.2f} m); at least {MIN_HEIGHT_M} m is needed:"
                " check datum and altitude offset"
            )
        radius_m = height * np.tan(off_nadir_rad if beam_rad is None else beam_rad)
        cell = float(2.0 ** np.floor(np.log2(radius_m / self.cells_per_radius)))
        lat, lon, area, amplitude = self._scatterers(state, cell, height * np.tan(off_nadir_rad))
        elevation, slope_e, slope_n = terrain.height_and_slope(lat, lon)
        place = geodetic_to_ecef(state.latitude_deg, state.longitude_deg, state.altitude_m)
        offset = geodetic_to_ecef(lat, lon, elevation) - place
        local = offset @ enu_axes(state.latitude_deg, state.longitude_deg).T
        distance = np.sqrt(np.einsum("ij,ij->i", local, local))
        direction = local / distance[:, None]
        secant = np.sqrt(1.0 + slope_e**2 + slope_n**2)
        # facet normal (-dz/de, -dz/dn, 1) / secant against the direction back to the aircraft; the up vectors
        # at facet and aircraft differ by the arc between them, below 2e-4 rad in any footprint
        cosine = (direction[:, 0] * slope_e + direction[:, 1] * slope_n - direction[:, 2]) / secant
        return Facets(
            range_m=distance,
            range_rate_m_per_s=-(direction @ np.asarray(state.velocity_m_per_s)),
            incidence_rad=np.arccos(np.clip(cosine, -1.0, 1.0)),
            direction=direction,
            area_m2=area * secant,
            reflectivity=amplitude,
            height_m=height,
        )

    def _scatterers(self, state: AircraftState, cell_m: float, radius_m: float) -> tuple[np.ndarray, ...]:
        """Latitude, longitude (degrees), horizontal area and amplitude of the scatterers within a radius."""
        north_deg = np.degrees(cell_m / SEMI_MAJOR_M)
        east_deg = north_deg / np.cos(np.radians(_SQUARE_AT_DEG))
        meridian, prime = curvature_radii_m(state.latitude_deg)
        size_n = np.radians(north_deg) * meridian
        size_e = np.radians(east_deg) * prime * np.cos(np.radians(state.latitude_deg))
        y0, x0 = state.latitude_deg / north_deg, state.longitude_deg / east_deg
        reach_y, reach_x = radius_m / size_n + 1.0, radius_m / size_e + 1.0
        iy = np.arange(int(np.floor(y0 - reach_y)), int(np.ceil(y0 + reach_y)) + 1)
        ix = np.arange(int(np.floor(x0 - reach_x)), int(np.ceil(x0 + reach_x)) + 1)
        # whole cells whose centre is inside the circle: their union has the circle's area without a ragged
        # bias
        dy, dx = (iy + 0.5 - y0) * size_n, (ix + 0.5 - x0) * size_e
        row, col = np.nonzero(dy[:, None] ** 2 + dx[None, :] ** 2 <= radius_m**2)
        iy, ix = iy[row], ix[col]
        key = _cell_hash(iy, ix, round(np.log2(cell_m)), self.seed)
        place_x, place_y, power, phase = (_uniform(key, k) for k in range(4))
        amplitude = np.sqrt(-np.log(power)) * np.exp(2j * np.pi * phase)
        return (iy + place_y) * north_deg, (ix + place_x) * east_deg, size_n * size_e, amplitude


GOLDEN = 0x9E3779B97F4A7C15  # increment of SplitMix64: odd, from the golden ratio


def _mix(x: np.ndarray) -> np.ndarray:
    """Finaliser of SplitMix64 (G. L. Steele et al., OOPSLA 2014), a bijection of 64-bit words."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _cell_hash(iy: np.ndarray, ix: np.ndarray, octave: int, seed: int) -> np.ndarray:
    """(n,) uint64 keys of cells."""
    base = _mix(np.array([(seed * GOLDEN + octave + 4096) % 2**64], dtype=np.uint64))
    return _mix(_mix(base ^ iy.astype(np.int64).view(np.uint64)) + ix.astype(np.int64).view(np.uint64))


def _uniform(key: np.ndarray, stream: int) -> np.ndarray:
    """(n,) uniform numbers in (0, 1] of one of several independent streams."""
    word = _mix(key + np.uint64(GOLDEN * (stream + 1) % 2**64))
    return ((word >> np.uint64(11)).astype(float) + 1.0) * 2.0**-53
