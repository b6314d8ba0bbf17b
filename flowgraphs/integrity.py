#!/usr/bin/env python3
"""Can the altitude be trusted: tracked outputs of every method over interference, faults and deception.

    .venv/bin/python flowgraphs/integrity.py  # one flight of 2 s through each case, into results/integrity
    .venv/bin/python flowgraphs/integrity.py --outputs=100000 --resume  # hours; goes on with what is there
    .venv/bin/python flowgraphs/integrity.py --replay jammed/nr5/1/-40dB/snr10:1:0  # one flight, output by output
    .venv/bin/python flowgraphs/integrity.py --publish docs  # then docs/integrity.md, its figures and tables

Exits with 1 if an output was hazardous beyond the limits that docs/tracker.md states.
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

import re
from collections.abc import Sequence
from pathlib import Path

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

PROGRAM = "integrity"
METHODS = "none,whitening,tcae,hybrid"
_CAPTURES = 50


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--methods", default=METHODS, help="methods with commas (default: %(default)s)")
    add("--groups", default="", help="kinds of cases with commas (default: all)")
    add(
        "--outputs",
        type=number(int, 1, 100_000_000),
        default=1,
        help="least number of tracked outputs per method, 25 per second (default: one flight of every case)",
    )
    add(
        "--frames",
        type=number(int, 400, 100_000),
        default=2000,
        help="frames of one flight, whole blocks of 40 (default: %(default)s)",
    )
    add(
        "--allowed-m-per-s",
        type=number(float, 10.0, 150.0),
        default=20.0,
        help="vertical speed that altimeter and tracker have to expect (default: %(default)s)",
    )
    add("--seed", type=number(int, 0, MAX_SEED), default=1)
    add("--replay", default="", metavar="CASE:SEED[:BATCH]", help="fly once more and print every output")
    add(
        "--captures",
        action="store_true",
        help=f"keep the frames before hazardous outputs as SigMF recordings, of {_CAPTURES} flights at most",
    )
    add_options(parser, out=f"results/{PROGRAM}", time_limit_s=600.0, sampled=False)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaign; returns 0, 1 where it found a hazardous output, 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    if args.frames % 40:
        parser.error(f"--frames is {args.frames}; it has to be a multiple of 40, the frames of one output")
    options = options_of(args, parser, command=command_of(args, parser))

    from radalt.core.mitigation import METHODS as KNOWN
    from radalt.evaluation.engine.command import main as run
    from radalt.evaluation.results.folder import read_report
    from radalt.studies.integrity.cases import KINDS, cases
    from radalt.studies.integrity.study import IntegrityStudy

    methods = names_of(parser, "--methods", args.methods, KNOWN)
    kinds = names_of(parser, "--groups", args.groups, KINDS) if args.groups else tuple(KINDS)
    parts = -(-args.outputs // (len(cases(kinds)) * (args.frames // 40)))
    study = IntegrityStudy(methods, kinds, args.frames, parts, args.seed, args.allowed_m_per_s)
    if args.replay:
        return _replay(study, args.replay, parser)

    def after(folder: Path) -> int:
        report = read_report(folder)
        if args.captures:
            _keep(study, report["events"], folder)
        said = report["headline"]["open"]
        print(
            f"{said['hazardous']} of {said['outputs']} outputs hazardous beyond the stated limits,", end=" "
        )
        print(f"below {said['bound']:.1e} (95 %)")
        return 1 if said["hazardous"] else 0

    return run(study, options, program=PROGRAM, dry_run=args.dry_run, describe=_describe, after=after)


def _replay(study: object, text: str, parser: Parser) -> int:
    import dataclasses

    from radalt.studies.integrity.cases import case_of
    from radalt.studies.integrity.study import replay_lines

    found = re.fullmatch(r"([^:]{1,200}):(\d{1,18})(?::(\d{1,9}))?", text)
    if not found:
        parser.error(f"--replay is {text[:60]!r}; write CASE:SEED or CASE:SEED:BATCH, as in events.csv")
    name, seed, batch = found.groups()
    study = dataclasses.replace(study, seed=int(seed))
    study.check()
    print("\n".join(replay_lines(study, case_of(name), int(batch or 0))))
    return 0


def _keep(study: object, events: Sequence[dict], folder: Path) -> None:
    """A recording of every flight, up to its first hazardous output of any method."""
    from radalt.studies.integrity.captures import write_capture

    first: dict[str, dict] = {}
    for event in events:
        first.setdefault(event["replay"], event)
    for event in list(first.values())[:_CAPTURES]:
        print(write_capture(study, event, folder / "captures"))


def _describe(rows: Sequence[dict]) -> str:
    """A measured point in a line."""
    return f"{rows[0]['case']}:{rows[0]['batch']}: " + ", ".join(
        f"{r['method']} {r['computed']}/{r['outputs']}"
        + (f", {r['hazardous']} HAZARDOUS" * bool(r["hazardous"]))
        for r in rows
    )


if __name__ == "__main__":
    raise SystemExit(main())
