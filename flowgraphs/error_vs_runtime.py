#!/usr/bin/env python3
"""Error of every method and model variant against its CPU time, on the same frames, in one process, by turns.

python flowgraphs/error_vs_runtime.py                         # some minutes, into results/error_vs_runtime
python flowgraphs/error_vs_runtime.py --frames 20 --rounds 3  # a quick look
python flowgraphs/error_vs_runtime.py --resume                # go on where a run was killed
python flowgraphs/error_vs_runtime.py --out docs              # docs/error_vs_runtime.md and its figure

Without --models every network of models/ is measured, as shipped. Variants in float16 and int8 are files of their own,
made by training/export.py --precision in the training environment (make train), since that needs the package onnx; name
them with --models to have them in the comparison:

    PYTHONPATH=python .venv-train/bin/python training/export.py compact --precision int8 --out variants/tcae_int8.onnx
    python flowgraphs/error_vs_runtime.py --models models/*.onnx variants/tcae_int8.onnx
"""

from __future__ import annotations

import _startup  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


@_startup.command("error_vs_runtime")
def main(argv: Sequence[str] | None = None) -> int:
    """Measure errors, times and memory and write the report; returns 0, or 2 after one line about what does not fit."""
    parser = _startup.Parser(
        prog="error_vs_runtime", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--models",
        nargs="*",
        type=_startup.path,
        help="ONNX files of tcae, float16 and int8 variants among them (default: all of models/)",
    )
    parser.add_argument(
        "--sir-db", default="-10:-50:-5", help="SIRs, list or start:stop:step (default: %(default)s)"
    )
    parser.add_argument(
        "--frames",
        type=_startup.number(int, 2, 2000000),
        default=100,
        help="frames a point (default: %(default)s)",
    )
    parser.add_argument(
        "--rounds",
        type=_startup.number(int, 2, 100000),
        default=20,
        help="rounds of timing (default: %(default)s)",
    )
    parser.add_argument(
        "--seed",
        type=_startup.number(int, 0, _startup.MOST_SEED),
        default=1,
        help="of the frames (default: %(default)s)",
    )
    parser.add_argument(
        "--out",
        type=_startup.path,
        default=Path("results/error_vs_runtime"),
        help="folder (default: %(default)s)",
    )
    parser.add_argument("--resume", action="store_true", help="complete the run that --out holds")
    args = parser.parse_args(argv)
    if args.frames < 2 or args.rounds < 2 or args.seed < 0:
        parser.error("--frames and --rounds have to be at least 2, --seed at least 0")

    from gnuradio.radalt.core.mitigation import MitigationError
    from gnuradio.radalt.core.paths import model_path
    from gnuradio.radalt.evaluation.overlap.points import parse_axis
    from gnuradio.radalt.evaluation.results.folder import versions
    from gnuradio.radalt.evaluation.results.journal import Journal, JournalError
    from gnuradio.radalt.evaluation.runtime import study as runtime
    from gnuradio.radalt.evaluation.runtime.report import write_runtime_report

    models = args.models if args.models is not None else sorted(model_path("tcae.onnx").parent.glob("*.onnx"))
    candidates = runtime.variants(models)

    def progress(text: str) -> None:
        print(text, flush=True)

    try:
        sirs = parse_axis(args.sir_db, "--sir-db")
        hashes = {v.label: getattr(v.build()[0], "sha256", None) for v in candidates}
        head = {
            "kind": "head",
            "frames": args.frames,
            "rounds": args.rounds,
            "seed": args.seed,
            "sirs_db": sirs,
        }
        head |= {"variants": hashes, "versions": versions(True)}
        journal = Journal(args.out / "error_vs_runtime.partial", head, resume=args.resume)
        study = runtime.run_study(candidates, sirs, args.frames, args.rounds, args.seed, journal, progress)
    except (MitigationError, JournalError, ValueError, OSError) as error:
        _startup.complain("error_vs_runtime", error)
        return 2
    except KeyboardInterrupt:
        print(f"error_vs_runtime: stopped; --resume --out {args.out} goes on", file=sys.stderr)
        return 130
    command = "python flowgraphs/error_vs_runtime.py"
    if journal.resumed:
        command += " --resume"
    defaults = parser.parse_args([])
    for name in ("sir_db", "frames", "rounds", "seed"):
        if getattr(args, name) != getattr(defaults, name):
            command += f" --{name.replace('_', '-')}={getattr(args, name)}"
    if args.models:
        command += " --models " + " ".join(m.name for m in args.models)
    print(write_runtime_report(args.out, *study, command))
    journal.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
