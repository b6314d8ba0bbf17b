"""Error of every method, network and choice of the altimeter against its CPU time, on the same frames, by turns.

    .venv/bin/python flowgraphs/error_vs_runtime.py  # some minutes, into results/error_vs_runtime
    .venv/bin/python flowgraphs/error_vs_runtime.py --frames 20 --rounds 3  # a quick look
    .venv/bin/python flowgraphs/error_vs_runtime.py --resume  # completes a stopped run
    .venv/bin/python flowgraphs/error_vs_runtime.py --publish docs  # then docs/error_vs_runtime.md and its figure

Without --models every network of models/ is measured, as shipped. Networks in float16 and int8 are files of their own,
made by training/export.py --precision in the training environment (make train), since that needs the package onnx; name
them with --models to have them in the comparison:

    PYTHONPATH=python .venv-train/bin/python training/export.py compact --precision int8 --out variants/tcae_int8.onnx
    .venv/bin/python flowgraphs/error_vs_runtime.py --models models/*.onnx variants/tcae_int8.onnx
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, number, path
from ...evaluation.engine.shell import StudyCommand, add_frames, add_seed
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "error_vs_runtime", "error-vs-runtime"


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    add(
        "--models",
        nargs="*",
        type=path,
        help="ONNX files of tcae, float16 and int8 ones among them (default: all of models/)",
    )
    add("--interferers", nargs="+", metavar="NAME", help="some of those compared, as the report names them")
    add("--sir-db", default="-10:-50:-5", help="SIRs, list or start:stop:step (default: %(default)s)")
    add_frames(parser, 100, "frames per interferer and SIR", low=2)
    add("--rounds", type=number(int, 2, 100_000), default=20, help="rounds of timing (default: %(default)s)")
    add_seed(parser, 1)


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from ...core.paths import model_path
    from ...evaluation.overlap.points import parse_axis
    from .cases import INTERFERERS
    from .study import RuntimeStudy, compared_chains

    interferers = args.interferers or list(INTERFERERS)
    stray = [name for name in interferers if name not in INTERFERERS]
    if stray:
        parser.error(f"--interferers names {stray[0][:40]!r}; known: {'; '.join(INTERFERERS)}")
    if len(set(interferers)) < len(interferers):
        parser.error("--interferers names one more than once; leave one")
    models = args.models if args.models is not None else sorted(model_path("tcae.onnx").parent.glob("*.onnx"))
    try:
        sirs_db = parse_axis(args.sir_db, "--sir-db")
    except ValueError as error:
        parser.error(str(error))
    chains = compared_chains(models)
    return RuntimeStudy(chains, sirs_db, args.frames, args.rounds, args.seed, tuple(interferers))


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    first = rows[0]
    if "round" in first:
        return f"times, round {first['round']}"
    if "memory_bytes" in first:
        return f"memory of {first['chain']}: {first['memory_bytes'] / 2**20:.1f} MiB"
    where = first["interferer"] + ("" if first["sir_db"] is None else f" SIR {first['sir_db']:g} dB")
    return f"{where}: Pd " + ", ".join(f"{r['chain']} {r['pd']:.3g}" for r in rows)


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe)
main, _parser = SHELL.main, SHELL.parser
