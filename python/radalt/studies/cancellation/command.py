"""Cancellation of OFDM and QPSK: Pd, wrong altitudes and costs over EVM, constellations, layers, channels and radios.

.venv/bin/python flowgraphs/cancellation.py                    # half an hour, into results/cancellation
.venv/bin/python flowgraphs/cancellation.py --publish docs     # then docs/cancellation.md
.venv/bin/python flowgraphs/cancellation.py --cases evm_8 --methods none,ofdm_cancel,hybrid --frames 300
.venv/bin/python flowgraphs/cancellation.py --flights-only --methods whitening,tcae --flights 100 --flight-s 2
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, names_of, number
from ...evaluation.engine.shell import StudyCommand, add_frames, add_methods, add_seed
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "cancellation", "cancellation"
METHODS = "none,ofdm_cancel,qpsk_cancel"


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    add_methods(parser, METHODS)
    add("--cases", default="", help="cases with commas (default: all of studies/cancellation/cases.py)")
    add_frames(parser, 100, "per case and SIR", high=100_000)
    add(
        "--flights",
        type=number(int, 1, 1000),
        default=10,
        help="per kind of interference, behind the tracker, with --flights-only (default: %(default)s)",
    )
    add("--flights-only", action="store_true", help="no cases: flights alone, behind --methods")
    add("--flight-s", type=number(int, 1, 1000), help="length of a flight with --flights-only (default: 1)")
    add_seed(parser, 271_828)


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from .cases import CASES
    from .flights import FlightsStudy
    from .study import CancellationStudy

    cases = names_of(parser, "--cases", args.cases, CASES) if args.cases else tuple(CASES)
    if not args.flights_only and args.flight_s is not None:
        parser.error(f"--flight-s {args.flight_s} needs --flights-only")
    if args.flights_only and args.cases:
        parser.error("--flights-only measures no case; leave out --cases")
    if args.flights_only:
        return FlightsStudy(args.methods, args.flights, args.flight_s or 1, args.seed)
    return CancellationStudy(args.methods, cases, args.frames, args.seed)


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    if "flight" in rows[0]:
        names = "method", "allowed_m_per_s"
        last = [r for r in rows if all(r[name] == rows[-1][name] for name in names)]
        available = sum(r["availability"] for r in last) / len(last)
        where = f"{rows[0]['flight']}, tracked, {rows[-1]['method']}, {rows[-1]['allowed_m_per_s']:g} m/s"
        return f"{where}: available {available:.2f}"
    found = (f"{r['pd']:.2f}" for r in rows if r["method"] == rows[-1]["method"])
    return f"{rows[0]['case']}, {rows[-1]['method']}: Pd {' '.join(found)}"


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, time_limit_s=3600.0)
main, _parser = SHELL.main, SHELL.parser
