#!/usr/bin/env python3
"""Write the landing scenario's data: a synthetic approach as CSV, and synthetic terrain as DTED files.

Without arguments it rewrites the shipped files in ``flowgraphs/landing/``, byte for byte: the approach to the geometry
of O'Hare runway 10C, and the two one-degree cells below it, flat and hilly, as DTED level 0. Finer levels (level 1:
2.9 MB per cell, level 2: 26 MB) are made by an option:

    .venv/bin/python tools/make_landing_data.py --level 1 --terrain hilly --out my_landing
"""

from __future__ import annotations

from _tool import FLOWGRAPHS  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

from pathlib import Path

import numpy as np
from _landing_scenario import Approach, cell_posts, intervals_s, synthetic_elevation_m

from radalt.core.returns.terrain import VOID_M, TerrainError
from radalt.evaluation.engine.options import Parser, command, number, path

CELLS = ((41, -89), (41, -88))  # south-west corners of the cells under the approach


# -- DTED (MIL-PRF-89020B): header records, sign-magnitude posts, checksums; no maintained library writes it ---------

MAX_ELEVATION_M = 32766


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
    lon_s, lat_s = intervals_s(level, lat)
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
        -32766..32766, or `VOID_M` for no data.
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


# -- the scenario ---------------------------------------------------------------------------------------------------


def approach_csv(approach: Approach, step_s: float) -> str:
    """Text of the trajectory file."""
    lines = [
        f"# SYNTHETIC approach to the geometry of {approach.runway.name}; no flight was recorded for it.",
        f"# {approach.glide_deg:g} degree glide path from {approach.start_height_m:g} m, flare, touchdown.",
        "# Altitude: altimeter antenna above mean sea level. Written by tools/make_landing_data.py",
        "time_s,latitude_deg,longitude_deg,altitude_m",
    ]
    lines += [f"{t:.3f},{lat:.8f},{lon:.8f},{alt:.3f}" for t, lat, lon, alt in approach.points(step_s)]
    return "\n".join(lines) + "\n"


def _parser() -> Parser:
    parser = Parser("make_landing_data", __doc__)
    add = parser.add_argument
    add("--out", type=path, default=FLOWGRAPHS / "landing", help="folder (default: %(default)s)")
    add("--level", type=int, default=0, choices=(0, 1, 2), help="DTED level (default: 0)")
    add("--terrain", choices=("flat", "hilly", "both"), default="both")
    add("--glide-deg", type=number(float, 1, 10), default=3.0, help="glide path angle (default: %(default)s)")
    add(
        "--start-height-m",
        type=number(float, 50, 2000),
        default=600.0,
        help="height at the start (default: 600)",
    )
    add("--speed-m-per-s", type=number(float, 20, 120), default=72.0, help="ground speed (default: 72)")
    add(
        "--step-s",
        type=number(float, 0.01, 2),
        default=0.5,
        help="step of the trajectory file (default: 0.5)",
    )
    return parser


@command("make_landing_data")
def main(argv: list[str] | None = None) -> int:
    """Write the files; returns 0, or 2 after a line about what does not fit."""
    args = _parser().parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    approach = Approach(
        glide_deg=args.glide_deg, start_height_m=args.start_height_m, speed_m_per_s=args.speed_m_per_s
    )
    file = args.out / "approach_kord_10c.csv"
    file.write_text(approach_csv(approach, args.step_s))
    print(file)
    for kind in ("flat", "hilly") if args.terrain == "both" else (args.terrain,):
        for lat, lon in CELLS:
            elevation = synthetic_elevation_m(kind, args.level, lat, lon)
            file = args.out / f"{kind}_n{lat}w{-lon:03d}.dt{args.level}"
            reference = f"SYNTH-{kind.upper()}"
            print(write_dted(file, elevation, lat, lon, args.level, reference=reference))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
