"""What leaving out saves: time and memory of scenes as planned against the same scenes with everything built.

    .venv/bin/python flowgraphs/leaving_out.py                    # some minutes, into results/leaving_out
    .venv/bin/python flowgraphs/leaving_out.py --publish docs     # then docs/leaving_out.md

Exits with 1 if leaving out changed a result.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...evaluation.engine.options import Parser, number
from ...evaluation.engine.shell import StudyCommand, add_frames
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "leaving_out", "leaving-out"


def _arguments(parser: Parser) -> None:
    add_frames(parser, 100, "frames at each altitude")
    what = "runs of each (default: %(default)s)"
    parser.option("--repeats", what, number(int, 1, 10_000), 3)


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from .study import LeavingOutStudy

    return LeavingOutStudy(args.frames, args.repeats)


def _after(folder: Path, args: argparse.Namespace, study: Study) -> int:
    from ...evaluation.results.folder import read_report

    summary = read_report(folder)["summary"]
    for s in summary:
        print(
            f"{s['scene']}: CPU x{s['cpu_ratio']:.1f}, memory x{s['memory_ratio']:.2f} with all built; "
            f"results {'identical' if s['identical'] else 'DIFFER'}"
        )
    return 0 if all(s["identical"] for s in summary) else 1


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    return f"{rows[0]['scene']}: " + ", ".join(f"{r['built']} {r['cpu_s']:.2f} s" for r in rows)


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, _after, time_limit_s=1800.0)
main, _parser = SHELL.main, SHELL.parser
