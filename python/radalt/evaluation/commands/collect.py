"""Pool result folders of ota_eval into one report: Pd against overlap of all runs together.

    .venv/bin/python flowgraphs/collect.py results/bench_1 results/bench_2 other_lab/run3 --out results/all

Counts of runs with equal settings are added and their intervals recomputed; two methods are compared on the frames
that both have, those of equal seeds. Simulated runs and runs with radios are kept apart. Runs that are not comparable
(waveform, altimeter, SNR, model, ...) are refused with the reason; a run that occurs twice counts once. Needs no GNU
Radio.
"""

import time
from collections.abc import Sequence
from pathlib import Path

from ..engine.options import Parser, command, path
from ..overlap.pooling import collect

PROGRAM, COMMAND = "collect", "collect"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    parser.add_argument("folders", nargs="+", metavar="DIR", help="result folder of ota_eval")
    parser.option(
        "--against", "method to compare every other with (default: the best)", default="", metavar="METHOD"
    )
    parser.option("--out", "folder of the report (default: results/collected-DATE-TIME)", path)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Pool the folders; returns 0, or 2 after one line about what does not fit."""
    args = _parser().parse_args(argv)
    out = args.out or Path("results") / time.strftime("collected-%Y%m%d-%H%M%S")
    report, notes = collect(args.folders, out, method=args.against)
    for note in notes:
        print(f"collect: {note}")
    print(report)
    return 0
