#!/usr/bin/env python3
"""Write the landing scenario's data: a synthetic approach as CSV, and synthetic terrain as DTED files.

Without arguments it rewrites what is shipped in ``landing/`` beside this file, byte for byte: the approach to
O'Hare runway 10C geometry, and the two one-degree cells under it, flat and hilly, as DTED level 0. Finer
levels are made the same way where they are wanted (level 1: 2.9 MB a cell, level 2: 26 MB):

    python flowgraphs/make_landing_data.py --level 1 --terrain hilly --out my_landing
"""

from __future__ import annotations

import _startup  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

from pathlib import Path

HERE = Path(__file__).resolve().parent

try:
    from gnuradio.radalt.core.returns import terrain
except ImportError:  # without GNU Radio the package is importable by its own name
    from radalt.core.returns import terrain

CELLS = ((41, -89), (41, -88))  # south-west corners of the cells under the approach


def approach_csv(approach: terrain.Approach, step_s: float) -> str:
    """Text of the trajectory file."""
    lines = [
        f"# SYNTHETIC approach to the geometry of {approach.runway.name}; no flight was recorded for it.",
        f"# {approach.glide_deg:g} degree glide path from {approach.start_height_m:g} m, flare, touchdown.",
        "# Altitude: altimeter antenna above mean sea level. Written by flowgraphs/make_landing_data.py",
        "time_s,latitude_deg,longitude_deg,altitude_m",
    ]
    lines += [f"{t:.3f},{lat:.8f},{lon:.8f},{alt:.3f}" for t, lat, lon, alt in approach.points(step_s)]
    return "\n".join(lines) + "\n"


@_startup.command("make_landing_data")
def main(argv: list[str] | None = None) -> int:
    """Write the files; returns 0, or 2 after a line about what does not fit."""
    parser = _startup.Parser(prog="make_landing_data", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=_startup.path, default=HERE / "landing", help="folder (default: %(default)s)"
    )
    parser.add_argument("--level", type=int, default=0, choices=(0, 1, 2), help="DTED level (default: 0)")
    parser.add_argument("--terrain", choices=("flat", "hilly", "both"), default="both")
    parser.add_argument(
        "--glide-deg", type=float, default=3.0, help="glide path angle (default: %(default)s)"
    )
    parser.add_argument(
        "--start-height-m", type=float, default=600.0, help="height at the start (default: 600)"
    )
    parser.add_argument("--speed-m-per-s", type=float, default=72.0, help="ground speed (default: 72)")
    parser.add_argument(
        "--step-s", type=float, default=0.5, help="step of the trajectory file (default: 0.5)"
    )
    args = parser.parse_args(argv)
    ranges = {
        "glide_deg": (1, 10),
        "start_height_m": (50, 2000),
        "speed_m_per_s": (20, 120),
        "step_s": (0.01, 2),
    }
    for name, (low, high) in ranges.items():
        if not low <= getattr(args, name) <= high:
            parser.error(
                f"--{name.replace('_', '-')} is {getattr(args, name):g}; it has to be within {low}..{high}"
            )
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        approach = terrain.Approach(
            glide_deg=args.glide_deg, start_height_m=args.start_height_m, speed_m_per_s=args.speed_m_per_s
        )
        path = args.out / "approach_kord_10c.csv"
        path.write_text(approach_csv(approach, args.step_s))
        print(path)
        for kind in ("flat", "hilly") if args.terrain == "both" else (args.terrain,):
            for lat, lon in CELLS:
                elevation = terrain.synthetic_elevation_m(kind, args.level, lat, lon)
                path = args.out / f"{kind}_n{lat}w{-lon:03d}.dt{args.level}"
                print(
                    terrain.write_dted(
                        path, elevation, lat, lon, args.level, reference=f"SYNTH-{kind.upper()}"
                    )
                )
    except OSError as error:
        _startup.complain("make_landing_data", error)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
