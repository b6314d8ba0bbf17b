#!/usr/bin/env python3
"""The altimeter per frame: beside a textbook one where interference is strong, and where there is no return at all.

    python flowgraphs/detection.py                                # both tables, half an hour, into results/detection
    python flowgraphs/detection.py --frames 100 --null-frames 0   # the first alone, a minute
    python flowgraphs/detection.py --methods tcae,whitening --frames 0 --null-frames 1000

Writes rows.csv, null.csv and detection.md.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import _startup  # noqa: F401 - one core, a quiet log, the package on the path


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and write; returns 0, or 2 after one line about what does not fit."""
    parser = argparse.ArgumentParser(
        prog="detection", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", help="methods with commas (default: all but lms)")
    parser.add_argument("--frames", type=int, default=600, help="frames per case (default: %(default)s)")
    parser.add_argument(
        "--null-frames", type=int, default=400, help="frames per case without a return (default: %(default)s)"
    )
    parser.add_argument(
        "--noise-frames", type=int, default=10_000, help="in noise alone (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=2027, help="default: %(default)s")
    parser.add_argument("--out", type=Path, default=Path("results/detection"), help="default: %(default)s")
    args = parser.parse_args(argv)

    from radalt.core.mitigation import METHODS
    from radalt.evaluation.detection import study

    # towards the reference every altitude is filtered to zero
    methods = args.methods.split(",") if args.methods else [m for m in METHODS if m != "lms"]
    stray = [m for m in methods if m not in METHODS]
    if stray:
        print(f"detection: --methods names {stray[0]!r}; known: {', '.join(METHODS)}", file=sys.stderr)
        return 2
    for name in ("frames", "null_frames", "noise_frames", "seed"):
        if getattr(args, name) < 0:
            print(
                f"detection: --{name.replace('_', '-')} is {getattr(args, name)}; 0 or more", file=sys.stderr
            )
            return 2
    rows, null = [], []
    for case in study.CASES if args.frames else ():
        if case.method in methods:
            rows += study.measure(case, args.frames, args.seed)
            print(study.table(rows[-len(study.SPEEDS_M_PER_S) :]).split("\n", 2)[2], end="", flush=True)
    for method in methods:
        for case in study.null_cases(method):
            frames = args.noise_frames if case.scene == "none" else args.null_frames
            if frames:
                null += study.measure_null(case, frames, args.seed)
        if null:
            print(
                study.null_table(r for r in null if r["method"] == method).split("\n", 2)[2],
                end="",
                flush=True,
            )
    args.out.mkdir(parents=True, exist_ok=True)
    _write(args.out / "rows.csv", rows)
    _write(args.out / "null.csv", null)
    (args.out / "detection.md").write_text(
        "# The altimeter per frame\n\n"
        f"Frames per case: {args.frames}, seed {args.seed}; flown speeds to {study.FLOWN_M_PER_S:g} m/s.\n\n"
        f"{study.table(rows)}\n## Without a return\n\n{study.null_table(null)}",
        encoding="utf-8",
    )
    return 0


def _write(path: Path, rows: list[dict]) -> None:
    if not rows:
        return
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    sys.exit(main())
