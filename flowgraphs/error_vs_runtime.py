#!/usr/bin/env python3
"""Error of every method, network and choice of the altimeter against its CPU time, on the same frames, by turns.

    .venv/bin/python flowgraphs/error_vs_runtime.py  # some minutes, into results/error_vs_runtime
    .venv/bin/python flowgraphs/error_vs_runtime.py --frames 20 --rounds 3  # a quick look
    .venv/bin/python flowgraphs/error_vs_runtime.py --resume  # go on where a run was killed
    .venv/bin/python flowgraphs/error_vs_runtime.py --publish docs  # then docs/error_vs_runtime.md and its figure

Without --models every network of models/ is measured, as shipped. Networks in float16 and int8 are files of their own,
made by training/export.py --precision in the training environment (make train), since that needs the package onnx; name
them with --models to have them in the comparison:

    PYTHONPATH=python .venv-train/bin/python training/export.py compact --precision int8 --out variants/tcae_int8.onnx
    .venv/bin/python flowgraphs/error_vs_runtime.py --models models/*.onnx variants/tcae_int8.onnx
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
    number,
    options_of,
    path,
)

PROGRAM = "error_vs_runtime"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add(
        "--models",
        nargs="*",
        type=path,
        help="ONNX files of tcae, float16 and int8 ones among them (default: all of models/)",
    )
    add("--interferers", nargs="+", metavar="NAME", help="some of those compared, as the report names them")
    add("--sir-db", default="-10:-50:-5", help="SIRs, list or start:stop:step (default: %(default)s)")
    add(
        "--frames",
        type=number(int, 2, 2_000_000),
        default=100,
        help="frames per interferer and SIR (default: %(default)s)",
    )
    add("--rounds", type=number(int, 2, 100_000), default=20, help="rounds of timing (default: %(default)s)")
    add("--seed", type=number(int, 0, MAX_SEED), default=1, help="of the frames (default: %(default)s)")
    add_options(parser, out=f"results/{PROGRAM}", time_limit_s=600.0)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure errors, times and memory and write the report; returns 0, or 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = options_of(args, parser, command=command_of(args, parser))

    from radalt.core.paths import model_path
    from radalt.evaluation.engine.command import main as run
    from radalt.evaluation.overlap.points import parse_axis
    from radalt.studies.runtime.study import INTERFERERS, RuntimeStudy, compared_chains

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

    def study() -> RuntimeStudy:
        chains = compared_chains(models)
        return RuntimeStudy(chains, sirs_db, args.frames, args.rounds, args.seed, tuple(interferers))

    return run(study, options, program=PROGRAM, dry_run=args.dry_run, describe=_describe)


def _describe(rows: Sequence[dict]) -> str:
    """A measured point in a line."""
    first = rows[0]
    if "round" in first:
        return f"times, round {first['round']}"
    if "memory_bytes" in first:
        return f"memory of {first['chain']}: {first['memory_bytes'] / 2**20:.1f} MiB"
    where = first["interferer"] + ("" if first["sir_db"] is None else f" SIR {first['sir_db']:g} dB")
    return f"{where}: Pd " + ", ".join(f"{r['chain']} {r['pd']:.3g}" for r in rows)


if __name__ == "__main__":
    raise SystemExit(main())
