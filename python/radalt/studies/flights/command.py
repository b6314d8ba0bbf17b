"""Flights below base stations: how often the tracker has an altitude, and whether it can be trusted.

.venv/bin/python flowgraphs/flights.py --methods whitening,tcae --flights 10
.venv/bin/python flowgraphs/flights.py --methods whitening,tcae --flights 100 --flight-s 2 --publish docs
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, number
from ...evaluation.engine.shell import StudyCommand, add_methods, add_seed
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "flights", "flights"


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    add_methods(parser, "whitening,tcae")
    what = "per kind of interference (default: %(default)s)"
    add("--flights", type=number(int, 1, 1000), default=10, help=what)
    add("--flight-s", type=number(int, 1, 1000), default=1, help="length of each (default: %(default)s)")
    add_seed(parser, 271_828)


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from .study import FlightsStudy

    return FlightsStudy(args.methods, args.flights, args.flight_s, args.seed)


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    names = "method", "allowed_m_per_s"
    last = [r for r in rows if all(r[name] == rows[-1][name] for name in names)]
    available = sum(r["availability"] for r in last) / len(last)
    where = f"{rows[0]['flight']}, tracked, {rows[-1]['method']}, {rows[-1]['allowed_m_per_s']:g} m/s"
    return f"{where}: available {available:.2f}"


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, time_limit_s=3600.0)
main, _parser = SHELL.main, SHELL.parser
