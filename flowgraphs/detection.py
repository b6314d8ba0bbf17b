#!/usr/bin/env python3
"""The altimeter per frame: beside a textbook one where interference is strong, and where there is no return at all.

.venv/bin/python flowgraphs/detection.py  # both tables, all methods, into results/detection
.venv/bin/python flowgraphs/detection.py --frames 100 --null-frames 0 --noise-frames 0 --out results/first
.venv/bin/python flowgraphs/detection.py --publish docs  # then docs/detection.md and its rows
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

PROGRAM = "detection"
METHODS = "none,whitening,blanking,linear_prediction,nlms_predictor,nlms,lms_reference_input,ofdm_cancel,tcae"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add, count = parser.add_argument, number(int, 0, 10**7)
    # not lms: towards its reference every altitude is filtered to zero
    add("--methods", default=METHODS, help="methods with commas (default: %(default)s)")
    add("--frames", type=count, default=600, help="per case with a return (default: %(default)s)")
    add(
        "--null-frames", type=count, default=400, help="per case of interference alone (default: %(default)s)"
    )
    add("--noise-frames", type=count, default=10_000, help="of noise alone (default: %(default)s)")
    add("--seed", type=number(int, 0, MAX_SEED), default=2027, help="default: %(default)s")
    add_options(parser, out=f"results/{PROGRAM}", time_limit_s=3600.0, sampled=False)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and write; returns 0, or 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = options_of(args, parser, command=command_of(args, parser))

    from radalt.core.mitigation import METHODS as KNOWN
    from radalt.evaluation.engine.command import main as run
    from radalt.studies.detection.study import DetectionStudy

    methods = names_of(parser, "--methods", args.methods, KNOWN)
    if not (args.frames or args.null_frames or args.noise_frames):
        parser.error("--frames, --null-frames and --noise-frames are all 0; give one of them")
    study = DetectionStudy(methods, args.frames, args.null_frames, args.noise_frames, args.seed)
    return run(study, options, program=PROGRAM, dry_run=args.dry_run, describe=_describe)


def _describe(rows: Sequence[dict]) -> str:
    """A measured point in a line."""
    first = rows[0]
    if "rate" in first:
        rates = ", ".join(f"{r['rate']:.4f}" for r in rows)
        return f"{first['method']}, {first['scene']} INR {first['inr_db']:g} dB: false {rates}"
    found = ", ".join(f"{r['declared']:.3f}/{r['forced']:.3f}" for r in rows)
    return f"{first['method']}, {first['scene']} {first['sir_db']:g} dB: declared/forced {found}"


if __name__ == "__main__":
    raise SystemExit(main())
