"""The altimeter frame by frame: beside a textbook one under strong interference, and without a return.

.venv/bin/python flowgraphs/detection.py  # both tables, all methods, into results/detection
.venv/bin/python flowgraphs/detection.py --frames 100 --null-frames 0 --noise-frames 0 --out results/first
.venv/bin/python flowgraphs/detection.py --publish docs  # then docs/detection.md and its rows
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, number
from ...evaluation.engine.shell import StudyCommand, add_frames, add_methods, add_seed
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "detection", "detection"
# without lms: filtered towards the reference, every altitude becomes zero
METHODS = "none,whitening,blanking,linear_prediction,nlms_predictor,nlms,lms_reference_input,ofdm_cancel,tcae"


def _arguments(parser: Parser) -> None:
    add, count = parser.add_argument, number(int, 0, 10**7)
    add_methods(parser, METHODS)
    add_frames(parser, 600, "per case with a return", low=0, high=10**7)
    add(
        "--null-frames", type=count, default=400, help="per case of interference alone (default: %(default)s)"
    )
    add("--noise-frames", type=count, default=10_000, help="of noise alone (default: %(default)s)")
    add_seed(parser, 2027)


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from .study import DetectionStudy

    if not (args.frames or args.null_frames or args.noise_frames):
        parser.error("--frames, --null-frames and --noise-frames are all 0; give one of them")
    return DetectionStudy(args.methods, args.frames, args.null_frames, args.noise_frames, args.seed)


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    first = rows[0]
    if "rate" in first:
        rates = ", ".join(f"{r['rate']:.4f}" for r in rows)
        return f"{first['method']}, {first['scene']} INR {first['inr_db']:g} dB: false {rates}"
    found = ", ".join(f"{r['declared']:.3f}/{r['forced']:.3f}" for r in rows)
    return f"{first['method']}, {first['scene']} {first['sir_db']:g} dB: declared/forced {found}"


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, time_limit_s=3600.0)
main, _parser = SHELL.main, SHELL.parser
