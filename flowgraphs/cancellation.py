#!/usr/bin/env python3
"""Cancellation of OFDM and QPSK: Pd, error and wrong altitudes over modulations, loads, channels and radios.

.venv/bin/python flowgraphs/cancellation.py                    # some minutes, into results/cancellation
.venv/bin/python flowgraphs/cancellation.py --publish docs     # then docs/cancellation.md
.venv/bin/python flowgraphs/cancellation.py --cases nr10_256qam --methods none,ofdm_cancel --frames 300
.venv/bin/python flowgraphs/cancellation.py --flights-only --methods whitening,tcae --flights 100 --flight-s 2
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

from collections.abc import Sequence

from radalt.evaluation.engine.options import (
    MAX_SEED,
    Parser,
    add_options,
    command,
    command_of,
    names_of,
    number,
    options_of,
)

PROGRAM = "cancellation"
METHODS = "none,whitening,tcae,ofdm_cancel,qpsk_cancel"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--methods", default=METHODS, help="methods with commas (default: %(default)s)")
    add("--cases", default="", help="cases with commas (default: all of studies/cancellation/cases.py)")
    add(
        "--frames",
        type=number(int, 1, 100_000),
        default=60,
        help="per case and SIR, three times as many where the limit was asked for (default: %(default)s)",
    )
    add(
        "--flights",
        type=number(int, 0, 1000),
        default=10,
        help="per kind of interference, behind the tracker; 0 for none (default: %(default)s)",
    )
    add("--flights-only", action="store_true", help="no cases: flights alone, behind --methods")
    add("--flight-s", type=number(int, 1, 1000), help="length of a flight with --flights-only (default: 1)")
    add("--seed", type=number(int, 0, MAX_SEED), default=271_828, help="default: %(default)s")
    add_options(parser, out=f"results/{PROGRAM}", time_limit_s=3600.0)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and write; returns 0, or 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = options_of(args, parser, command=command_of(args, parser))

    from radalt.core.mitigation import METHODS as KNOWN
    from radalt.evaluation.engine.command import main as run
    from radalt.studies.cancellation.cases import CASES
    from radalt.studies.cancellation.flights import FlightsStudy
    from radalt.studies.cancellation.study import CancellationStudy

    methods = names_of(parser, "--methods", args.methods, KNOWN)
    cases = names_of(parser, "--cases", args.cases, CASES) if args.cases else tuple(CASES)
    if not args.flights_only and args.flight_s is not None:
        parser.error(f"--flight-s {args.flight_s} needs --flights-only; beside the cases a flight lasts 1 s")
    if args.flights_only and (args.cases or not args.flights):
        parser.error(
            "--flights-only measures at least one flight and no case; leave out --cases, and --flights 0"
        )
    study = (
        FlightsStudy(methods, args.flights, args.flight_s or 1, args.seed)
        if args.flights_only
        else CancellationStudy(methods, cases, args.frames, args.flights, args.seed)
    )
    return run(study, options, program=PROGRAM, dry_run=args.dry_run, describe=_describe)


def _describe(rows: Sequence[dict]) -> str:
    """A measured point in a line."""
    if "flight" in rows[0]:
        names = "method", "allowed_m_per_s"
        last = [r for r in rows if all(r[name] == rows[-1][name] for name in names)]
        available = sum(r["availability"] for r in last) / len(last)
        where = f"{rows[0]['flight']}, tracked, {rows[-1]['method']}, {rows[-1]['allowed_m_per_s']:g} m/s"
        return f"{where}: available {available:.2f}"
    found = (f"{r['pd']:.2f}" for r in rows if r["method"] == rows[-1]["method"])
    row = rows[0]
    name = f"mixture {row['mixture']}" if "mixture" in row else row.get("kind") or row["case"]
    return f"{name}, {rows[-1]['method']}: Pd {' '.join(found)}"


if __name__ == "__main__":
    raise SystemExit(main())
