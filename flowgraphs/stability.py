#!/usr/bin/env python3
"""Every method and precision on stiff, extreme and broken frames against float64, judged case by case.

    .venv/bin/python flowgraphs/stability.py  # all cases, some minutes, into results/stability
    .venv/bin/python flowgraphs/stability.py --methods none,whitening --groups numbers --out results/numbers
    .venv/bin/python flowgraphs/stability.py --publish docs  # then docs/stability.md, its figure and its rows

Exits with 1 if a case did not pass, after naming it.
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

from collections.abc import Sequence
from pathlib import Path

from radalt.evaluation.engine.options import (
    Parser,
    add_options,
    command,
    command_of,
    names_of,
    options_of,
    path,
)

PROGRAM = "stability"
METHODS = (
    "none,whitening,linear_prediction,blanking,nlms_predictor,nlms,"
    "lms_reference_input,lms,ofdm_cancel,qpsk_cancel,tcae,hybrid"
)
GROUPS = "stiff,scene,waveform,numbers"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--methods", default=METHODS, help="methods with commas (default: %(default)s)")
    add("--models", nargs="*", type=path, help="ONNX files of tcae (default: all of models/)")
    add("--groups", default=GROUPS, help="groups of cases (default: %(default)s)")
    add("--no-checks", action="store_true", help="leave out long runs, determinism and flowgraph")
    add_options(parser, out=f"results/{PROGRAM}", time_limit_s=600.0, sampled=False)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the cases and checks; returns 0, 1 where something did not pass, 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = options_of(args, parser, command=command_of(args, parser))

    from radalt.core.mitigation import METHODS as KNOWN
    from radalt.core.parsing import check_file
    from radalt.core.paths import model_path
    from radalt.evaluation.engine.command import main as run
    from radalt.evaluation.results.folder import read_report
    from radalt.studies.stability.study import StabilityStudy, compared_chains

    methods = names_of(parser, "--methods", args.methods, KNOWN)
    groups = names_of(parser, "--groups", args.groups, GROUPS.split(","))
    models = args.models or sorted(model_path("tcae.onnx").parent.glob("*.onnx"))
    for model in models:  # before an hour of cases of the other methods
        check_file(model, most_bytes=2 << 30, what="tcae model")

    def study() -> StabilityStudy:
        return StabilityStudy(compared_chains(methods, models), groups, () if args.no_checks else methods)

    def after(folder: Path) -> int:
        report = read_report(folder)
        print(f"{len(report['rows'])} rows, {len(report['failures'])} did not pass")
        for line in report["failures"]:
            print(f"  {line}")
        return 1 if report["failures"] else 0

    return run(study, options, program=PROGRAM, dry_run=args.dry_run, describe=_describe, after=after)


def _describe(rows: Sequence[dict]) -> str:
    """A measured point in a line."""
    first = rows[0]
    if "case" in first:
        return f"{first['group']}: {first['case']}: " + ", ".join(
            f"{r['chain']} {r['verdict']}" for r in rows
        )
    if "check" in first:
        return "; ".join(f"{r['check']}: {r['verdict']}" for r in rows)
    return f"LMS step limit at spread {first['spread']:.0e}: {first['verdict']}"


if __name__ == "__main__":
    raise SystemExit(main())
