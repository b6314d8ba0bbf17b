"""Writing Digital Terrain Elevation Data (MIL-PRF-89020B): header records, sign-magnitude posts, checksums.

No well-kept library writes DTED; reading is `dted.Tile`'s and stays there (`terrain.Terrain.load`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .errors import TerrainError

__all__ = ["VOID_M", "cell_posts", "encode_dted", "write_dted"]

VOID_M = -32767
"""Elevation that marks a post without data (MIL-PRF-89020B, 3.11.2)."""

MAX_ELEVATION_M = 32766
LATITUDE_INTERVAL_S = {0: 30, 1: 3, 2: 1}  # Table I, seconds of arc between posts of a meridian
ZONE_LIMITS_DEG = (50, 70, 75, 80, 90)  # Table I, zones I-V
ZONE_FACTORS = (1, 2, 3, 4, 6)


def _intervals_s(level: int, latitude_deg: int) -> tuple[int, int]:
    """Post spacing (longitude, latitude) in seconds of arc of the cell with this south edge."""
    if level not in LATITUDE_INTERVAL_S:
        raise TerrainError(f"DTED level is {level!r}; allowed: 0, 1, 2")
    # the zone of a cell is that of its edge nearest to the equator
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
    lon_s, lat_s = _intervals_s(level, latitude_deg)
    lat = latitude_deg + np.arange(3600 // lat_s + 1) * (lat_s / 3600.0)
    lon = longitude_deg + np.arange(3600 // lon_s + 1) * (lon_s / 3600.0)
    return lat, lon


def _dms(value: int, digits: int, positive: str, negative: str, decimals: bool = False) -> bytes:
    seconds = "00.0" if decimals else "00"
    return f"{abs(value):0{digits}d}00{seconds}{positive if value >= 0 else negative}".encode()


def _fixed(*fields: tuple[bytes | str, int], size: int) -> bytes:
    """Concatenate left-justified, space-filled fields and check the record's length."""
    out = b"".join((f.encode() if isinstance(f, str) else f).ljust(width) for f, width in fields)
    if len(out) != size:
        raise TerrainError(f"DTED header record came to {len(out)} bytes; it has to be {size}")
    return out


def _headers(level: int, lat: int, lon: int, shape: tuple[int, int], reference: str, void: bool) -> bytes:
    """User header label (80 bytes), data set identification (648), accuracy (2700): Tables II-IV."""
    n_lon, n_lat = shape
    lon_s, lat_s = _intervals_s(level, lat)
    intervals = f"{lon_s * 10:04d}{lat_s * 10:04d}"
    uhl = _fixed(
        (b"UHL1", 4), (_dms(lon, 3, "E", "W"), 8), (_dms(lat, 3, "N", "S"), 8), (intervals, 8), ("NA", 4),
        ("U", 3), (reference[:12], 12), (f"{n_lon:04d}{n_lat:04d}0", 9), ("", 24), size=80,
    )  # fmt: skip
    corners = [(lat, lon), (lat + 1, lon), (lat + 1, lon + 1), (lat, lon + 1)]
    dsi = _fixed(
        (b"DSI", 3), ("U", 1), ("", 55), (f"DTED{level}", 5), (reference[:15], 15), ("", 8), ("01A", 3),
        ("000000000000", 12), ("SYNTHTIC", 8), ("", 16), ("PRF89020B00", 11), ("0005", 4),
        ("MSL", 3), ("WGS84", 5), ("SYNTHETIC", 10), ("0000", 4), ("", 22), (_dms(lat, 2, "N", "S", True), 9),
        (_dms(lon, 3, "E", "W", True), 10),
        *[(_dms(a, 2, "N", "S") + _dms(b, 3, "E", "W"), 15) for a, b in corners],
        ("0000000.0", 9), (f"{lat_s * 10:04d}{lon_s * 10:04d}", 8), (f"{n_lat:04d}{n_lon:04d}", 8),
        ("99" if void else "00", 2), ("", 357), size=648,
    )  # fmt: skip
    acc = _fixed(
        (b"ACC", 3), ("NA", 4), ("NA", 4), ("NA", 4), ("NA", 4), ("", 36), ("00", 2), ("", 2643), size=2700
    )
    return uhl + dsi + acc


def encode_dted(
    elevation_m: np.ndarray,
    latitude_deg: int,
    longitude_deg: int,
    level: int,
    *,
    reference: str = "SYNTHETIC",
) -> bytes:
    """Bytes of a DTED file of one whole one-degree cell.

    Parameters
    ----------
    elevation_m : (n_lon, n_lat) integer array
        Elevations above mean sea level on `cell_posts`, west to east, each profile south to north;
        -32766..32766, or `VOID_M` where there is no data.
    latitude_deg, longitude_deg, level : int
        As in `cell_posts`.
    reference : str
        Unique reference of the producer; ASCII, cut to 12 and 15 characters.

    Raises
    ------
    TerrainError
        If the shape, the type or a value does not fit the level.
    """
    lat, lon = cell_posts(level, latitude_deg, longitude_deg)
    elevation = np.asarray(elevation_m)
    if elevation.shape != (lon.size, lat.size):
        raise TerrainError(
            f"elevations have shape {elevation.shape}; a level {level} cell at {latitude_deg} deg needs "
            f"({lon.size}, {lat.size}), longitude first"
        )
    if not np.issubdtype(elevation.dtype, np.integer):
        raise TerrainError(
            f"elevations are {elevation.dtype}; DTED holds whole metres: round them to integers"
        )
    void = elevation == VOID_M
    if np.any(np.abs(elevation.astype(np.int64)[~void]) > MAX_ELEVATION_M):
        raise TerrainError(f"an elevation lies beyond +/-{MAX_ELEVATION_M} m, the limit of DTED")
    magnitude = np.abs(elevation.astype(np.int32)).astype(np.uint16)
    posts = np.where(elevation < 0, magnitude | 0x8000, magnitude).astype(">u2")
    records = []
    for column, profile in enumerate(posts):
        # sentinel 252 octal, three-byte block count, longitude count, latitude count (Table V)
        body = b"\xaa" + column.to_bytes(3, "big") + column.to_bytes(2, "big") + b"\0\0" + profile.tobytes()
        records.append(body + (sum(body) & 0xFFFFFFFF).to_bytes(4, "big"))
    headers = _headers(level, latitude_deg, longitude_deg, elevation.shape, reference, bool(void.any()))
    return headers + b"".join(records)


def write_dted(
    path: Path | str,
    elevation_m: np.ndarray,
    latitude_deg: int,
    longitude_deg: int,
    level: int,
    **options: str,
) -> Path:
    """Write `encode_dted` to ``path`` (usual suffixes ``.dt0``, ``.dt1``, ``.dt2``); returns the path."""
    path = Path(path)
    path.write_bytes(encode_dted(elevation_m, latitude_deg, longitude_deg, level, **options))
    return path
