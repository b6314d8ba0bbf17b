#!/usr/bin/env python3
"""The landing study: altitude error of every method over an approach, and error against SINR.

    python flowgraphs/landing_eval.py                                   # the shipped study, under 3 minutes
    python flowgraphs/landing_eval.py --trajectory flight.csv --altitude-offset-m 34 --terrain n41.dt1 n42.dt1
    python flowgraphs/landing_eval.py my_study.yaml --out results/mine --jobs 8

Writes rows.csv, report.json, report.md, PNG figures and the study as used into one folder; with --resume a
stopped run goes on. No GNU Radio and no hardware is needed.
"""

from __future__ import annotations

import _startup  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
import dataclasses
import os
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent

try:
    from tqdm import tqdm
except ImportError:
    print(
        "landing_eval: this Python lacks the module's packages; run 'make setup', then .venv/bin/python",
        file=sys.stderr,
    )
    sys.exit(2)

try:
    from gnuradio.radalt.evaluation.engine import workers
    from gnuradio.radalt.evaluation.landing import figures as landing_figures
    from gnuradio.radalt.evaluation.landing import points as landing_points
    from gnuradio.radalt.evaluation.landing import report as landing_report
    from gnuradio.radalt.evaluation.landing import rows as landing_rows
    from gnuradio.radalt.evaluation.landing import study as landing
except ImportError:  # without GNU Radio the package is importable by its own name
    from radalt.evaluation.engine import workers
    from radalt.evaluation.landing import figures as landing_figures
    from radalt.evaluation.landing import points as landing_points
    from radalt.evaluation.landing import report as landing_report
    from radalt.evaluation.landing import rows as landing_rows
    from radalt.evaluation.landing import study as landing

POINT_LIMIT_S = 1800.0  # a point takes seconds; on a slow machine with a slow network, minutes


def _parser() -> argparse.ArgumentParser:
    parser = _startup.Parser(prog="landing_eval", description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("study", nargs="?", type=_startup.path, default=HERE / "landing" / "study.yaml", help="YAML file")
    add("--out", type=_startup.path, default=Path("results/landing"), help="folder (default: %(default)s)")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    add("--resume", action="store_true", help="go on with the run that --out holds a part of")
    add("--trajectory", type=_startup.path, help="CSV: a track, or ADS-B state vectors")
    add("--aircraft", help="icao24 or callsign to take from the trajectory file")
    add(
        "--altitude-offset-m",
        type=_startup.number(float, -100000.0, 100000.0),
        help="added to the trajectory's altitudes (datum)",
    )
    add(
        "--max-gap-s",
        type=_startup.number(float, 0, 1000000.0),
        help="longest gap in the trajectory that is interpolated",
    )
    add("--terrain", type=_startup.path, nargs="*", help="DTED files; none of them: flat earth at --flat-m")
    add("--void", choices=("error", "fill"), help="what to do about voids in the terrain")
    add("--flat-m", type=_startup.number(float, -10000.0, 10000.0), help="elevation of the flat earth")
    add(
        "--sir-db",
        type=_startup.number(float, -200, 200),
        help="SIR of the approach and the sensitivity table",
    )
    add("--methods", help="comma-separated, e.g. none,whitening,tcae")
    add("--frames", type=_startup.number(int, 0, 2000000), help="frames of the approach; 0 leaves it out")
    add(
        "--trials",
        type=_startup.number(int, 0, 1000000),
        help="frames a point of the curves; 0 leaves them out",
    )
    add(
        "--sensitivity-trials",
        type=_startup.number(int, 0, 1000000),
        help="frames a row of the sensitivity table; 0: no table",
    )
    add(
        "--seed",
        type=_startup.number(int, 0, _startup.MOST_SEED),
        help="of scatterers, noise and interference (default: the study's)",
    )
    return parser


def _study(args: argparse.Namespace) -> landing.LandingStudy:
    """The study file with the command line's changes; its file names are relative to where one is."""
    study = landing.load_study(args.study)

    def changed(part: object, **values: object) -> object:
        return dataclasses.replace(part, **{k: v for k, v in values.items() if v is not None})

    trajectory = changed(
        study.trajectory,
        file=str(args.trajectory.resolve()) if args.trajectory else None,
        aircraft=args.aircraft,
        altitude_offset_m=args.altitude_offset_m,
        max_gap_s=args.max_gap_s,
    )
    files = None if args.terrain is None else tuple(str(p.resolve()) for p in args.terrain)
    try:
        return changed(
            study,
            trajectory=trajectory,
            terrain=changed(study.terrain, files=files, void=args.void, flat_m=args.flat_m),
            approach=changed(study.approach, sir_db=args.sir_db, frames=args.frames),
            curve=changed(study.curve, trials=args.trials, sensitivity_trials=args.sensitivity_trials),
            methods=tuple(m.strip() for m in args.methods.split(",")) if args.methods else None,
            seed=args.seed,
        )
    except ValueError as error:
        raise landing.StudyError(str(error)) from None


def _measure(task: tuple[landing.LandingStudy, landing.Point]) -> list[dict]:
    return landing_points.run_point(*task)


def _run(
    study: landing.LandingStudy, todo: list[landing.Point], rows: landing_rows.RowFile, jobs: int
) -> None:
    """Measure points, in several processes; whatever finishes is on disk at once."""
    tasks = [(study, point) for point in todo]
    if jobs == 1:
        results = ((k, _measure(task)) for k, task in enumerate(tasks))
    else:
        results = workers.run_tasks(
            _measure, tasks, jobs=jobs, time_limit_s=POINT_LIMIT_S, label=lambda task: task[1].name
        )
    for _, measured in tqdm(results, total=len(tasks), unit="point", disable=not sys.stderr.isatty()):
        rows.append(measured)


@_startup.command("landing_eval")
def main(argv: list[str] | None = None) -> int:
    """Run the study; returns 0, or 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    if not 1 <= args.jobs <= _startup.MOST_JOBS:
        parser.error(f"--jobs is {args.jobs}; it has to be at least 1 and at most {_startup.MOST_JOBS}")
    started = time.monotonic()
    try:
        study = _study(args)
        landing.check_study(study)
        head = landing_report.open_folder(args.out, study, resume=args.resume)
        rows = landing_rows.RowFile(args.out / "rows.csv")
        points = study.points()
        todo = [p for p in points if p.name not in rows.points]
        _run(study, todo, rows, args.jobs)
        rows.sort([p.name for p in points])
        figures = landing_figures.draw_figures(study, rows.rows, args.out)
        run = {"jobs": args.jobs, "points": len(points), "points_resumed": len(points) - len(todo)}
        run["wall_s"] = time.monotonic() - started
        landing_report.write_report(study, rows.rows, args.out, figures, head=head, run=run)
    except (*landing.EXPECTED_ERRORS, workers.WorkerError, OSError) as error:
        _startup.complain("landing_eval", error)
        return 2
    except KeyboardInterrupt:
        print(
            f"landing_eval: stopped; the same command with --resume goes on from {args.out}", file=sys.stderr
        )
        return 130
    print(f"{args.out / 'report.md'}  ({len(rows.rows)} rows, {time.monotonic() - started:.0f} s)")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
