#!/usr/bin/env python3
"""The landing study: altitude error of every method over an approach, and error against SINR.

    .venv/bin/python flowgraphs/landing_eval.py                                   # the shipped study, under 3 minutes
    .venv/bin/python flowgraphs/landing_eval.py --trajectory flight.csv --altitude-offset-m 34 --terrain n41.dt1 n42.dt1
    .venv/bin/python flowgraphs/landing_eval.py my_study.yaml --out results/mine --jobs 8

Writes tables, report.json, report.md, PNG figures and the study as used into one folder; with --resume a
stopped run goes on. No GNU Radio and no hardware is needed.
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PROGRAM = "landing_eval"

try:
    try:
        from radalt.evaluation.engine import command, options
        from radalt.studies.landing import config as landing
        from radalt.studies.landing.study import LandingStudy
    except ImportError:  # without GNU Radio the package is importable by its own name
        from radalt.evaluation.engine import command, options
        from radalt.studies.landing import config as landing
        from radalt.studies.landing.study import LandingStudy
except ImportError as error:
    print(f"{PROGRAM}: {sys.executable}: {error}; run 'make setup', then .venv/bin/python", file=sys.stderr)
    sys.exit(2)


def _parser() -> options.Parser:
    parser = options.Parser(PROGRAM, __doc__)
    add, number = parser.add_argument, options.number
    add("study", nargs="?", type=options.path, default=HERE / "landing" / "study.yaml", help="YAML file")
    options.add_options(parser, out="results/landing", time_limit_s=1800.0)
    add("--trajectory", type=options.path, help="CSV: a track, or ADS-B state vectors")
    add("--aircraft", help="icao24 or callsign to take from the trajectory file")
    add(
        "--altitude-offset-m",
        type=number(float, -1e5, 1e5),
        help="added to the trajectory's altitudes (datum)",
    )
    add("--max-gap-s", type=number(float, 0, 1e6), help="longest gap in the trajectory that is interpolated")
    add("--terrain", type=options.path, nargs="*", help="DTED files; none of them: flat earth at --flat-m")
    add("--void", choices=("error", "fill"), help="what to do about voids in the terrain")
    add("--flat-m", type=number(float, -1e4, 1e4), help="elevation of the flat earth")
    add("--sir-db", type=number(float, -200, 200), help="SIR of the approach and the sensitivity table")
    add("--methods", help="comma-separated, e.g. none,whitening,tcae")
    add("--frames", type=number(int, 0, 2_000_000), help="frames of the approach; 0 leaves it out")
    add("--trials", type=number(int, 0, 1_000_000), help="frames per point of the curves; 0 leaves them out")
    add(
        "--sensitivity-trials",
        type=number(int, 0, 1_000_000),
        help="frames per row of the sensitivity table; 0: no table",
    )
    add(
        "--seed",
        type=number(int, 0, options.MAX_SEED),
        help="of scatterers, noise and interference (default: the study's)",
    )
    return parser


def _config(args: argparse.Namespace) -> landing.LandingConfig:
    """The study file with the command line's changes; its file names are relative to where one is."""
    config = landing.load_config(args.study)

    def changed(part: object, **values: object) -> object:
        return dataclasses.replace(part, **{k: v for k, v in values.items() if v is not None})

    trajectory = changed(
        config.trajectory,
        file=str(args.trajectory.resolve()) if args.trajectory else None,
        aircraft=args.aircraft,
        altitude_offset_m=args.altitude_offset_m,
        max_gap_s=args.max_gap_s,
    )
    files = None if args.terrain is None else tuple(str(p.resolve()) for p in args.terrain)
    try:
        return changed(
            config,
            trajectory=trajectory,
            terrain=changed(config.terrain, files=files, void=args.void, flat_m=args.flat_m),
            approach=changed(config.approach, sir_db=args.sir_db, frames=args.frames),
            curve=changed(config.curve, trials=args.trials, sensitivity_trials=args.sensitivity_trials),
            methods=tuple(m.strip() for m in args.methods.split(",")) if args.methods is not None else None,
            seed=args.seed,
        )
    except ValueError as error:
        raise landing.StudyError(str(error)) from None


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    if "time_s" in rows[0]:
        return f"approach from {rows[0]['time_s']:.0f} to {rows[-1]['time_s']:.0f} s"
    sinr = rows[0].get("asked_sinr_db")
    level = "no interference" if sinr is None else f"overlap {rows[0]['overlap']:g}, SINR {sinr:g} dB"
    return f"{rows[0].get('assumption', level)}: Pd " + ", ".join(
        f"{r['method']} {r['pd']:.3g}" for r in rows
    )


@options.command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns 0, 2 after one line about what does not fit, 130 when interrupted."""
    parser = _parser()
    args = parser.parse_args(argv)
    how = options.options_of(args, parser)
    return command.main(
        lambda: LandingStudy(_config(args)), how, program=PROGRAM, dry_run=args.dry_run, describe=_describe
    )


if __name__ == "__main__":
    raise SystemExit(main())
