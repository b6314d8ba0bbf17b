#!/usr/bin/env python3
"""What leaving out saves: time and memory of scenes as planned against the same scenes with everything built.

    .venv/bin/python flowgraphs/leaving_out.py                    # some minutes, into results/leaving_out
    .venv/bin/python flowgraphs/leaving_out.py --publish docs     # then docs/leaving_out.md

Exits with 1 if leaving out changed a result.
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
    number,
    options_of,
)

PROGRAM = "leaving_out"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add(
        "--frames",
        type=number(int, 1, 2_000_000),
        default=100,
        help="frames at each altitude (default: %(default)s)",
    )
    add("--repeats", type=number(int, 1, 10_000), default=3, help="runs of each (default: %(default)s)")
    add_options(parser, out=f"results/{PROGRAM}", time_limit_s=1800.0, sampled=False)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every scene of the table; returns 0, 1 if leaving out changed a result, 2 after one line."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = options_of(args, parser, command=command_of(args, parser))

    from radalt.evaluation.engine.command import main as run
    from radalt.evaluation.results.folder import read_report
    from radalt.studies.leaving_out.study import LeavingOutStudy

    def after(folder: Path) -> int:
        summary = read_report(folder)["summary"]
        for s in summary:
            print(
                f"{s['scene']}: CPU x{s['cpu_ratio']:.1f}, memory x{s['memory_ratio']:.2f} with all built; "
                f"results {'identical' if s['identical'] else 'DIFFER'}"
            )
        return 0 if all(s["identical"] for s in summary) else 1

    study = LeavingOutStudy(args.frames, args.repeats)
    return run(study, options, program=PROGRAM, dry_run=args.dry_run, describe=_describe, after=after)


def _describe(rows: Sequence[dict]) -> str:
    """A measured point in a line."""
    return f"{rows[0]['scene']}: " + ", ".join(f"{r['built']} {r['cpu_s']:.2f} s" for r in rows)


if __name__ == "__main__":
    raise SystemExit(main())
