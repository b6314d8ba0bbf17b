"""The landing study: altitude error of every method over an approach, and under other assumptions.

    .venv/bin/python flowgraphs/landing_eval.py                                   # the shipped study, under 3 minutes
    .venv/bin/python flowgraphs/landing_eval.py --trajectory flight.csv --altitude-offset-m 34 --terrain n41.dt1 n42.dt1
    .venv/bin/python flowgraphs/landing_eval.py my_study.yaml --out results/mine --jobs 8

Writes tables, report.json, report.md, PNG figures and the study as used into one folder; with --resume a
stopped run is completed. Needs neither GNU Radio nor hardware.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ...core.paths import share_dir
from ...evaluation.engine.options import Parser, number, path
from ...evaluation.engine.shell import StudyCommand

if TYPE_CHECKING:
    from .config import LandingConfig
    from .study import LandingStudy

PROGRAM, COMMAND = "landing_eval", "landing"


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    default = share_dir() / "flowgraphs" / "landing" / "study.yaml"
    add("study", nargs="?", type=path, default=default, help="YAML file")
    parser.option("--trajectory", "CSV: a track, or ADS-B state vectors", path)
    parser.option("--aircraft", "icao24 or callsign to take from the trajectory file")
    words = "added to the trajectory's altitudes (datum)"
    parser.option("--altitude-offset-m", words, number(float, -1e5, 1e5))
    parser.option("--altitude-unit", "of an altitude column that does not state it", choices=("m", "ft"))
    parser.option("--max-gap-s", "longest gap in the trajectory that is interpolated", number(float, 0, 1e6))
    parser.option("--terrain", "DTED files; none of them: flat earth at --flat-m", path, nargs="*")
    parser.option("--void", "what to do about voids in the terrain", choices=("error", "fill"))
    parser.option("--flat-m", "elevation of the flat earth", number(float, -1e4, 1e4))
    parser.option("--sir-db", "SIR of the approach and the sensitivity table", number(float, -200, 20))
    parser.option("--methods", "comma-separated, e.g. none,whitening,tcae")
    parser.option("--frames", "frames of the approach; 0 leaves it out", number(int, 0, 2_000_000))
    words = "frames per row of the sensitivity table; 0: no table"
    parser.option("--sensitivity-trials", words, number(int, 0, 1_000_000))
    what = "of scatterers, noise and interference (default: the study's)"
    parser.option("--seed", what, number(int, 0, 2**31 - 1))


def _study(args: argparse.Namespace, parser: Parser) -> "LandingStudy":
    from .study import LandingStudy

    return LandingStudy(_config(args))


def _config(args: argparse.Namespace) -> "LandingConfig":
    """The study file with the command line's changes; its file names are relative to where one is."""
    from .config import load_config

    config = load_config(args.study)

    def changed(part: object, **values: object) -> object:
        return dataclasses.replace(part, **{k: v for k, v in values.items() if v is not None})

    trajectory = changed(
        config.trajectory,
        file=str(args.trajectory.resolve()) if args.trajectory else None,
        aircraft=args.aircraft,
        altitude_offset_m=args.altitude_offset_m,
        altitude_unit=args.altitude_unit,
        max_gap_s=args.max_gap_s,
    )
    files = None if args.terrain is None else tuple(str(p.resolve()) for p in args.terrain)
    return changed(
        config,
        trajectory=trajectory,
        terrain=changed(config.terrain, files=files, void=args.void, flat_m=args.flat_m),
        approach=changed(config.approach, sir_db=args.sir_db, frames=args.frames),
        sensitivity_trials=args.sensitivity_trials,
        methods=args.methods,
        seed=args.seed,
    )


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    if "time_s" in rows[0]:
        return f"approach from {rows[0]['time_s']:.0f} to {rows[-1]['time_s']:.0f} s"
    return f"{rows[0]['assumption']}: Pd " + ", ".join(f"{r['method']} {r['pd']:.3g}" for r in rows)


SHELL = StudyCommand(
    PROGRAM, __name__, _arguments, _study, _describe, out="results/landing", time_limit_s=1800.0
)
main, _parser = SHELL.main, SHELL.parser
