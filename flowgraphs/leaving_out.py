#!/usr/bin/env python3
"""What leaving out saves: time and memory of scenes as planned against the same scenes with everything built.

python flowgraphs/leaving_out.py                    # some minutes, into results/leaving_out
python flowgraphs/leaving_out.py --out docs         # docs/leaving_out.md
"""

from __future__ import annotations

import _startup  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
import json
from collections.abc import Sequence
from pathlib import Path


@_startup.command("leaving_out")
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every scene of the table; returns 0, 1 if leaving out changed a result, 2 after one line."""
    parser = _startup.Parser(
        prog="leaving_out", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--frames",
        type=_startup.number(int, 1, 2000000),
        default=100,
        help="frames at each altitude (default: %(default)s)",
    )
    parser.add_argument(
        "--repeats",
        type=_startup.number(int, 1, 10000),
        default=3,
        help="runs of each (default: %(default)s)",
    )
    parser.add_argument(
        "--out", type=_startup.path, default=Path("results/leaving_out"), help="folder (default: %(default)s)"
    )
    args = parser.parse_args(argv)
    if args.frames < 1 or args.repeats < 1:
        parser.error("--frames and --repeats have to be at least 1")

    from gnuradio.radalt.evaluation.flowgraph.run import FlowgraphError
    from gnuradio.radalt.evaluation.leaving_out.study import SCENES, compare, compare_shared, markdown

    rows = []
    try:
        for row in compare(tuple(SCENES), args.frames, args.repeats):
            rows.append(row)
            print(
                f"{row['scene']}: CPU x{row['cpu_ratio']:.1f}, memory x{row['memory_ratio']:.2f} with all built; "
                f"results {'identical' if row['identical'] else 'DIFFER'}",
                flush=True,
            )
        shared = compare_shared(args.frames, args.repeats)
        print(
            f"{' and '.join(shared['methods'])}: {shared['shared_ms']:.2f} ms a frame sharing spectra, "
            f"{shared['apart_ms']:.2f} apart; results {'identical' if shared['identical'] else 'DIFFER'}",
            flush=True,
        )
    except FlowgraphError as error:
        _startup.complain("leaving_out", error)
        return 2
    args.out.mkdir(parents=True, exist_ok=True)
    page = markdown(rows, shared, "python flowgraphs/leaving_out.py", args.repeats)
    (args.out / "leaving_out.md").write_text(page, encoding="utf-8")
    (args.out / "leaving_out.json").write_text(
        json.dumps({"scenes": rows, "shared": shared}, indent=1) + "\n", encoding="utf-8"
    )
    return 0 if all(row["identical"] for row in (*rows, shared)) else 1


if __name__ == "__main__":
    raise SystemExit(main())
