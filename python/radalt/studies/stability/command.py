"""Every method and precision on stiff, extreme and broken frames against float64, judged case by case.

    .venv/bin/python flowgraphs/stability.py  # all cases, some minutes, into results/stability
    .venv/bin/python flowgraphs/stability.py --methods none,whitening --groups numbers --out results/numbers
    .venv/bin/python flowgraphs/stability.py --publish docs  # then docs/stability.md, its figure and its rows

Exits with 1 if a case did not pass, after naming it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...evaluation.engine.options import Parser, names_of, path
from ...evaluation.engine.shell import StudyCommand, add_methods
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "stability", "stability"
METHODS = (
    "none,whitening,linear_prediction,blanking,nlms_predictor,nlms,"
    "lms_reference_input,lms,ofdm_cancel,qpsk_cancel,tcae,hybrid"
)
GROUPS = "stiff,scene,waveform,numbers,front_end"


def _arguments(parser: Parser) -> None:
    add_methods(parser, METHODS)
    parser.option("--models", "ONNX files of tcae (default: all of models/)", path, nargs="*")
    parser.option("--groups", "groups of cases", default=GROUPS)
    parser.flag("--no-checks", "leave out long runs, determinism and flowgraph")


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from ...core.parsing import check_file
    from ...core.paths import model_path
    from .study import StabilityStudy, compared_chains

    groups = names_of(parser, "--groups", args.groups, GROUPS.split(","))
    models = args.models or sorted(model_path("tcae.onnx").parent.glob("*.onnx"))
    for model in models:  # before an hour of cases of the other methods
        check_file(model, most_bytes=2 << 30, what="tcae model")
    checks = () if args.no_checks else args.methods
    return StabilityStudy(compared_chains(args.methods, models), groups, checks)


def _after(folder: Path, args: argparse.Namespace, study: Study) -> int:
    from ...evaluation.results.folder import read_report

    report = read_report(folder)
    print(f"{len(report['rows'])} rows, {len(report['failures'])} did not pass")
    for line in report["failures"]:
        print(f"  {line}")
    return 1 if report["failures"] else 0


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    first = rows[0]
    if "case" in first:
        chains = ", ".join(f"{r['chain']} {r['verdict']}" for r in rows)
        return f"{first['group']}: {first['case']}: {chains}"
    if "check" in first:
        return "; ".join(f"{r['check']}: {r['verdict']}" for r in rows)
    return f"LMS step limit at spread {first['spread']:.0e}: {first['verdict']}"


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, _after)
main, _parser = SHELL.main, SHELL.parser
