#!/usr/bin/env python3
"""Write the landing scenario's data: a synthetic approach as CSV, and synthetic terrain as DTED files.

Without arguments it rewrites what is shipped in ``landing/`` beside this file, byte for byte: the approach to
O'Hare runway 10C geometry, and the two one-degree cells under it, flat and hilly, as DTED level 0. Finer
levels are made the same way where they are wanted (level 1: 2.9 MB a cell, level 2: 26 MB):

    .venv/bin/python flowgraphs/make_landing_data.py --level 1 --terrain hilly --out my_landing
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

from pathlib import Path

HERE = Path(__file__).resolve().parent

try:
    from radalt.core.returns import terrain
    from radalt.evaluation.engine.options import Parser, command, number, path
except ImportError:  # without GNU Radio the package is importable by its own name
    from radalt.core.returns import terrain
    from radalt.evaluation.engine.options import Parser, command, number, path

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


def _parser() -> Parser:
    parser = Parser("make_landing_data", __doc__)
    add = parser.add_argument
    add("--out", type=path, default=HERE / "landing", help="folder (default: %(default)s)")
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
    approach = terrain.Approach(
        glide_deg=args.glide_deg, start_height_m=args.start_height_m, speed_m_per_s=args.speed_m_per_s
    )
    file = args.out / "approach_kord_10c.csv"
    file.write_text(approach_csv(approach, args.step_s))
    print(file)
    for kind in ("flat", "hilly") if args.terrain == "both" else (args.terrain,):
        for lat, lon in CELLS:
            elevation = terrain.synthetic_elevation_m(kind, args.level, lat, lon)
            file = args.out / f"{kind}_n{lat}w{-lon:03d}.dt{args.level}"
            reference = f"SYNTH-{kind.upper()}"
            print(terrain.write_dted(file, elevation, lat, lon, args.level, reference=reference))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
