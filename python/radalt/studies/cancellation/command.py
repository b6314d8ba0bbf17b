"""Cancellation of OFDM and QPSK: Pd, wrong altitudes and costs over EVM, constellations, layers, channels and radios.

.venv/bin/python flowgraphs/cancellation.py                    # half an hour, into results/cancellation
.venv/bin/python flowgraphs/cancellation.py --publish docs     # then docs/cancellation.md
.venv/bin/python flowgraphs/cancellation.py --cases evm_8 --methods none,ofdm_cancel,hybrid --frames 300
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, names_of
from ...evaluation.engine.shell import StudyCommand, add_frames, add_methods, add_seed
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "cancellation", "cancellation"
METHODS = "none,ofdm_cancel,qpsk_cancel"


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    add_methods(parser, METHODS)
    add("--cases", default="", help="cases with commas (default: all of studies/cancellation/cases.py)")
    add_frames(parser, 100, "per case and SIR", high=100_000)
    add_seed(parser, 271_828)


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from .cases import CASES
    from .study import CancellationStudy

    cases = names_of(parser, "--cases", args.cases, CASES) if args.cases else tuple(CASES)
    return CancellationStudy(args.methods, cases, args.frames, args.seed)


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    found = (f"{r['pd']:.2f}" for r in rows if r["method"] == rows[-1]["method"])
    return f"{rows[0]['case']}, {rows[-1]['method']}: Pd {' '.join(found)}"


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, time_limit_s=3600.0)
main, _parser = SHELL.main, SHELL.parser
