#!/usr/bin/env python3
"""Every method and precision on stiff, extreme and broken frames against float64, judged case by case.

    python flowgraphs/stability.py                                # all cases, some minutes, into results/stability
    python flowgraphs/stability.py --methods none,whitening --groups numbers --out results/numbers
    python flowgraphs/stability.py --out docs                     # docs/stability.md and docs/figures/stability.png

Exits with 1 if a case did not pass, after naming it.
"""

from __future__ import annotations

import _startup  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
from collections.abc import Sequence
from pathlib import Path

METHODS = "none,whitening,blanking,nlms,lms_reference_input,lms,tcae"
GROUPS = ("stiff", "scene", "waveform", "numbers")


@_startup.command("stability")
def main(argv: Sequence[str] | None = None) -> int:
    """Run the cases and checks; returns 0, 1 where something did not pass, 2 after one line about what does not fit."""
    parser = _startup.Parser(
        prog="stability", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", default=METHODS, help="methods with commas (default: %(default)s)")
    parser.add_argument(
        "--models", nargs="*", type=_startup.path, help="ONNX files of tcae (default: all of models/)"
    )
    parser.add_argument("--groups", default=",".join(GROUPS), help="groups of cases (default: %(default)s)")
    parser.add_argument(
        "--no-checks", action="store_true", help="leave out long runs, determinism and flowgraph"
    )
    parser.add_argument(
        "--out", type=_startup.path, default=Path("results/stability"), help="folder (default: %(default)s)"
    )
    args = parser.parse_args(argv)

    from gnuradio.radalt.core.mitigation import METHODS as KNOWN
    from gnuradio.radalt.core.parsing import check_file
    from gnuradio.radalt.core.paths import model_path
    from gnuradio.radalt.evaluation.stability import checks as stability_checks
    from gnuradio.radalt.evaluation.stability.cases import all_cases
    from gnuradio.radalt.evaluation.stability.report import failures, write_stability_report
    from gnuradio.radalt.evaluation.stability.study import run_cases, subjects

    methods = tuple(args.methods.split(","))
    groups = args.groups.split(",")
    for name, value, known in (("--methods", methods, KNOWN), ("--groups", groups, GROUPS)):
        stray = [v for v in value if v not in known]
        if stray:
            parser.error(f"{name} names {stray[0][:40]!r}; known: {', '.join(known)}")
    models = args.models or sorted(model_path("tcae.onnx").parent.glob("*.onnx"))
    for model in models:  # before an hour of cases of the other methods
        check_file(model, most_bytes=2 << 30, what="tcae model")
    rows = []
    for row in run_cases((c for c in all_cases() if c.group in groups), subjects(methods, models)):
        rows.append(row)
        print(f"{row['verdict']:8}{row['group']:10}{row['method']:22}{row['case']}", flush=True)
    steps, checks = [], []
    if not args.no_checks:
        steps = list(stability_checks.step_limit_rows()) if "lms" in methods else []
        for title, check in stability_checks.CHECKS.items():
            for row in check(methods):
                checks.append(row)
                print(f"{row['verdict']:8}{title:12}{row['check']}", flush=True)
    report = write_stability_report(args.out, rows, steps, checks, command="python flowgraphs/stability.py")
    bad = failures(report)
    print(f"{args.out / 'stability.md'}: {len(rows)} rows, {len(bad)} did not pass")
    for line in bad:
        print(f"  {line}")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
