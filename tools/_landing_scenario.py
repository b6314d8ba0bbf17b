"""The shipped landing scenario: a synthetic instrument approach with flare, and synthetic terrain around it.

Everything here is synthetic. The runway's place, direction and elevation are those of O'Hare 10C to about 100
m and 1 m (airport diagram, rounded); no flight and no terrain survey was used. `make_landing_data.py` writes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radalt.core.returns.terrain import TerrainError
from radalt.core.returns.terrain.geodesy import curvature_radii_m

# -- posts of the one-degree cells of Digital Terrain Elevation Data (MIL-PRF-89020B) -------------------------------

LATITUDE_INTERVAL_S = {0: 30, 1: 3, 2: 1}  # Table I, seconds of arc between posts of a meridian
ZONE_LIMITS_DEG = (50, 70, 75, 80, 90)  # Table I, zones I-V
ZONE_FACTORS = (1, 2, 3, 4, 6)  # Table I, longitude interval over latitude interval by zone


def intervals_s(level: int, latitude_deg: int) -> tuple[int, int]:
    """Post spacing (longitude, latitude) in seconds of arc of the cell with this south edge."""
    if level not in LATITUDE_INTERVAL_S:
        raise TerrainError(f"DTED level is {level!r}; allowed: 0, 1, 2")
    # a cell belongs to the zone of its edge nearest to the equator
    edge = latitude_deg if latitude_deg >= 0 else -(latitude_deg + 1)
    zone = next(i for i, limit in enumerate(ZONE_LIMITS_DEG) if edge < limit)
    return LATITUDE_INTERVAL_S[level] * ZONE_FACTORS[zone], LATITUDE_INTERVAL_S[level]


def cell_posts(level: int, latitude_deg: int, longitude_deg: int) -> tuple[np.ndarray, np.ndarray]:
    """Latitudes and longitudes of the posts of a one-degree cell.

    Parameters
    ----------
    level : int
        0 (30 arc seconds), 1 (3) or 2 (1); longitudes widen with the zone of latitude.
    latitude_deg, longitude_deg : int
        South-west corner, -90..89 and -180..179.

    Returns
    -------
    (n_lat,) and (n_lon,) float64 arrays in degrees, both edges included.
    """
    if not -90 <= latitude_deg <= 89 or not -180 <= longitude_deg <= 179:
        raise TerrainError(f"cell corner {latitude_deg}, {longitude_deg} deg is outside -90..89, -180..179")
    lon_s, lat_s = intervals_s(level, latitude_deg)
    lat = latitude_deg + np.arange(3600 // lat_s + 1) * (lat_s / 3600.0)
    lon = longitude_deg + np.arange(3600 // lon_s + 1) * (lon_s / 3600.0)
    return lat, lon


# -- the approach and the ground --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Runway:
    """Landing threshold, direction and elevation of a runway (degrees true, metres above mean sea level)."""

    name: str
    latitude_deg: float
    longitude_deg: float
    bearing_deg: float
    elevation_m: float
    length_m: float


OHARE_10C = Runway("KORD 10C", 41.9657, -87.9316, 90.1, 204.0, 3292.0)


@dataclass(frozen=True)
class Approach:
    """A straight approach on a glide path, then an exponential flare to touchdown.

    Parameters
    ----------
    glide_deg : float
        Glide path angle.
    start_height_m : float
        Height of the antenna above the runway at the start.
    speed_m_per_s : float
        Speed along the glide path; it falls by a tenth in the flare.
    crossing_height_m : float
        Height of the glide path over the threshold (50 ft).
    flare_s : float
        Time constant of the flare: the sink rate falls as ``exp(-t / flare_s)``.
    touchdown_sink_m_per_s : float
        Sink rate at touchdown.
    antenna_height_m : float
        Height of the antenna above the runway at touchdown.
    """

    runway: Runway = OHARE_10C
    glide_deg: float = 3.0
    start_height_m: float = 600.0
    speed_m_per_s: float = 72.0
    crossing_height_m: float = 15.24
    flare_s: float = 4.5
    touchdown_sink_m_per_s: float = 0.6
    antenna_height_m: float = 2.0

    def points(self, step_s: float = 0.5) -> np.ndarray:
        """(n, 4) time in seconds, latitude, longitude in degrees, altitude above mean sea level in metres."""
        sink = self.speed_m_per_s * np.sin(np.radians(self.glide_deg))
        forward = self.speed_m_per_s * np.cos(np.radians(self.glide_deg))
        # flare: h' = -sink exp(-t / T), so that it starts tangent to the glide path and ends at the touchdown
        # sink
        flare_end = self.flare_s * np.log(sink / self.touchdown_sink_m_per_s)
        flare_height = self.antenna_height_m + self.flare_s * (sink - self.touchdown_sink_m_per_s)
        glide_end = (self.start_height_m - flare_height) / sink
        time = np.append(np.arange(0.0, glide_end + flare_end, step_s), glide_end + flare_end)
        into = np.clip(time - glide_end, 0.0, None)
        height = np.where(
            into > 0,
            flare_height - sink * self.flare_s * (1.0 - np.exp(-into / self.flare_s)),
            self.start_height_m - sink * time,
        )
        start = -(self.start_height_m - self.crossing_height_m) / np.tan(np.radians(self.glide_deg))
        along = start + forward * time - 0.05 * forward * into**2 / flare_end
        latitude, longitude = _along_track(self.runway, along)
        return np.stack([time, latitude, longitude, self.runway.elevation_m + height], axis=1)


def _along_track(runway: Runway, along_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points at a distance past the threshold on the rhumb line of the runway's bearing (midpoint rule)."""
    bearing = np.radians(runway.bearing_deg)
    meridian, _ = curvature_radii_m(runway.latitude_deg)
    latitude = runway.latitude_deg + np.degrees(along_m * np.cos(bearing) / meridian)
    middle = 0.5 * (latitude + runway.latitude_deg)
    _, prime = curvature_radii_m(middle)
    longitude = runway.longitude_deg + np.degrees(
        along_m * np.sin(bearing) / (prime * np.cos(np.radians(middle)))
    )
    return latitude, longitude


def synthetic_elevation_m(
    kind: str,
    level: int,
    latitude_deg: int,
    longitude_deg: int,
    *,
    runway: Runway = OHARE_10C,
    relief_m: float = 25.0,
) -> np.ndarray:
    """(n_lon, n_lat) int16 elevations of a one-degree cell around a runway.

    Parameters
    ----------
    kind : str
        ``"flat"``: the runway's elevation everywhere. ``"hilly"``: smooth hills of wavelengths 3.1 to 7.7 km,
        up to ``+/- 2 relief_m``, rising from nothing 1.5 km around the runway to full height 5 km from it.
    level, latitude_deg, longitude_deg
        As in `cell_posts`.

    Raises
    ------
    ValueError
        If the kind is unknown.
    """
    lat, lon = cell_posts(level, latitude_deg, longitude_deg)
    if kind not in ("flat", "hilly"):
        raise ValueError(f"terrain kind is {kind!r}; allowed: flat, hilly")
    if kind == "flat":
        return np.full((lon.size, lat.size), round(runway.elevation_m), dtype=np.int16)
    meridian, prime = curvature_radii_m(runway.latitude_deg)
    north = np.radians(lat - runway.latitude_deg)[None, :] * meridian
    east = np.radians(lon - runway.longitude_deg)[:, None] * prime * np.cos(np.radians(runway.latitude_deg))
    bearing = np.radians(runway.bearing_deg)
    along = np.clip(east * np.sin(bearing) + north * np.cos(bearing), 0.0, runway.length_m)
    distance = np.hypot(east - along * np.sin(bearing), north - along * np.cos(bearing))
    ramp = np.clip((distance - 1500.0) / 3500.0, 0.0, 1.0)
    hills = (
        np.sin(2 * np.pi * (east / 7700.0 + 0.13)) * np.cos(2 * np.pi * (north / 6100.0 + 0.31))
        + 0.6 * np.sin(2 * np.pi * (0.8 * east + 0.6 * north) / 4700.0)
        + 0.4 * np.cos(2 * np.pi * (0.6 * east - 0.8 * north) / 3100.0)
    )
    return np.rint(runway.elevation_m + relief_m * ramp**2 * (3.0 - 2.0 * ramp) * hills).astype(np.int16)
