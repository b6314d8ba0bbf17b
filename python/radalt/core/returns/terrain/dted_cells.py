"""Posts of the one-degree cells of Digital Terrain Elevation Data (MIL-PRF-89020B).

Reading a file is `dted.Tile`'s (`terrain.Terrain.load`); `tools/dted_write.py` writes one.
"""

from __future__ import annotations

import numpy as np

from .errors import TerrainError

__all__ = ["VOID_M", "cell_posts", "intervals_s"]

VOID_M = -32767
"""Elevation that marks a post without data (MIL-PRF-89020B, 3.11.2)."""

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
