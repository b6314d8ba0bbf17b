"""Probability of correct altitude against temporal overlap, for every mitigation method, through GNU Radio.

    .venv/bin/python flowgraphs/ota_eval.py --sim  # the paper's case, about a minute
    .venv/bin/python flowgraphs/ota_eval.py --sim --methods none,whitening --overlap 0:1:0.25 --sir-db=-28
    .venv/bin/python flowgraphs/ota_eval.py --sim --out results/mine --resume  # complete an interrupted run
    .venv/bin/python flowgraphs/ota_eval.py --sim --method-file flowgraphs/own_method.py  # your method

Runs ota_b210.grc once per point of the scene's sweep, with --sim by a simulated channel instead of radios, and writes
report.md, report.html, report.json, rows.csv, altitudes.csv, figures and the scene with all changes into one folder.
Options change the scene; lists are numbers with commas (0,0.3,1) or start:stop:step (0:1:0.1); write --sir-db=-10 with
"=" before a minus.
"""

import argparse
import contextlib
import dataclasses
import importlib.util
import io
import re
import sys
import time
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from ...core.interrupts import ctrl_c_waits
from ...core.paths import no_gnu_radio, remedy
from ..engine.options import Options, Parser, add_options, command, named, number, options_of, path
from ..engine.own import add_own, own_methods

PROGRAM, COMMAND = "ota_eval", "eval"
DEFAULT_SCENE = "paper_qpsk"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    parser.flag("--sim", "simulated channel in place of the two B210s")
    parser.option("--scene", f"YAML file, or the name of a shipped scene (default: {DEFAULT_SCENE})")
    parser.option("--methods", "mitigation methods separated by commas, e.g. none,whitening,tcae")
    parser.option("--overlap", "overlaps, 0..1", metavar="LIST")
    parser.option("--sir-db", "signal-to-interference ratios, averaged over the sweep", metavar="LIST")
    parser.option("--snr-db", "signal-to-noise ratios (simulated channel)", metavar="LIST")
    parser.option("--altitudes", "altitudes in metres, in the order of the run", metavar="LIST")
    parser.option("--frames", "frames at each altitude", int)
    parser.flag(
        "--tracked",
        "also run every point with altitudes that last for a tracker, and score it (simulated channel)",
    )
    parser.option("--seed", "seed of everything random", int)
    add_own(parser)
    add_options(parser)
    parser.flag("--plan", "print the parts of the run and those left out, with reasons; run nothing")
    parser.flag("--transmit", "with radios: allow transmission into the scene's enclosure")
    parser.flag("--check", "print the settings of the radios, and transmit nothing")
    parser.flag("--calibrate", "measure and store the radios' latency over a cable")
    parser.flag("--capture", "record the received samples, as SigMF below OUT/captures")
    parser.option("--replay", "score every method on a SigMF recording", path, metavar="FILE")
    parser.option(
        "--reference-m",
        "with --replay of another program's recording: altitude at its beginning",
        number(float, 0, 1e6),
        metavar="M",
    )
    return parser


def _check_python() -> None:
    """Raise RuntimeError or ImportError where this Python cannot run the program."""
    try:
        # a namespace package `gnuradio` with `gnuradio.radalt` only is no GNU Radio
        if importlib.util.find_spec("gnuradio") is None or importlib.util.find_spec("gnuradio.gr") is None:
            raise RuntimeError(no_gnu_radio())
        # checked here, since the report would need them only at the end
        missing = [
            name
            for name in ("scipy", "yaml", "matplotlib", "tqdm", "pebble", "jinja2")
            if importlib.util.find_spec(name) is None
        ]
        if missing:
            raise RuntimeError(f"{sys.executable} lacks {', '.join(missing)}; {remedy(*missing)}")
        # NumPy prints 50 lines of its own before the error where GNU Radio was built for another one
        with ctrl_c_waits(), contextlib.redirect_stderr(io.StringIO()):
            from gnuradio import gr  # noqa: F401

            from ...core import scene  # noqa: F401
    except (ImportError, SystemError) as error:
        if (getattr(error, "name", "") or "").split(".")[0] in ("gnuradio", "pmt"):
            raise
        found = f"{str(error).splitlines()[0]}; was GNU Radio built for NumPy {metadata.version('numpy')}?"
        raise RuntimeError(f"{sys.executable} cannot run gr-radalt ({found}); {remedy('numpy')}") from None


def _scene(args: argparse.Namespace) -> Any:
    """The scene with the command line's changes; raises SceneError."""
    from ...core.scene import SceneError, load_scene
    from ..overlap.points import changed, parse_axis

    scene = load_scene(DEFAULT_SCENE if args.scene is None else args.scene)
    own = own_methods(args)  # first: --methods may name them
    for option, name, given, parse in (
        ("--method-file or --model", "own", own or None, lambda own, _: own),
        ("--methods", "methods", args.methods, lambda text, _: list(dict.fromkeys([*_names(text), *own]))),
        ("--overlap", "overlap", args.overlap, parse_axis),
        ("--sir-db", "sir_db", args.sir_db, parse_axis),
        ("--snr-db", "snr_db", args.snr_db, parse_axis),
        ("--altitudes", "altitudes_m", args.altitudes, parse_axis),
        ("--frames", "frames", args.frames, lambda frames, _: frames),
        ("--seed", "seed", args.seed, lambda seed, _: seed),
    ):
        try:
            scene = scene if given is None else changed(scene, **{name: parse(given, option)})
        except ValueError as error:
            text = str(error)
            raise SceneError(text if option in text else f"{option}: {text}") from None
    return scene


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _require_radios(scene: Any, needed: int) -> None:
    """Raise SceneError unless enough of the scene's radios are connected."""
    from gnuradio import uhd

    from ...core.scene import SceneError

    limits = scene.radio.limits
    found = len(uhd.find(uhd.device_addr(f"type={limits.uhd_type}")))
    if found < needed:
        raise SceneError(
            f"{found} of {needed} {limits.title}s found; connect them (uhd_find_devices lists what is there), "
            "or add --sim for the simulated channel"
        )


def _print_verdict(out: Path) -> None:
    """Print the report's first paragraph."""
    verdict = (out / "report.md").read_text(encoding="utf-8").split("\n\n")[1]
    print(f"\n{verdict.replace('**', '').replace('`', '')}")


def _check(args: argparse.Namespace) -> int:
    """Print the plan of the run, or of the radios; returns 2 if the interlock does not allow the latter, else 0."""
    from ..flowgraph.plan import make_plan
    from ..overlap.study import check_scene
    from ..radios.settings import describe

    scene, allowed = _scene(args), True
    check_scene(scene)
    if args.plan:
        lines = [make_plan(scene, scene.methods, simulated=args.sim).text()]
    else:
        lines, allowed = describe(scene)
    print("\n".join(lines))
    return 0 if allowed else 2


def _calibrate(args: argparse.Namespace) -> int:
    from ..radios.hardware import calibrate

    scene = _scene(args)
    _require_radios(scene, 1)
    latency, path = calibrate(scene, transmit=args.transmit)
    print(f"{named(PROGRAM)}: latency {latency:.3f} samples -> {path}")
    return 0


def _replay(args: argparse.Namespace) -> int:
    """Score a recording; prints one line per method."""
    from ..flowgraph.replay import score_recording

    out = args.out or Path("results") / f"replay-{args.replay.stem}-{time.strftime('%Y%m%d-%H%M%S')}"
    rows = score_recording(
        args.replay,
        out,
        scene=_scene(args) if args.scene else None,
        methods=_names(args.methods) if args.methods else None,
        own=own_methods(args),
        reference_m=args.reference_m,
    )
    for row in rows:
        if "pd" in row:
            pd = "-" if row["pd"] is None else f"{row['pd']:.3f}"
            print(f"  {row['method']:20} Pd {pd} of {row['trials']} frames")
        else:
            print(
                f"  {row['method']:20} found in {row['found']} of {row['frames']} frames, "
                f"median {row['altitude_median_m']:.1f} m"
            )
    print(f"\n{out}")
    return 0


def _run(args: argparse.Namespace, options: Options) -> int:
    from ..engine.command import main as run
    from ..overlap.study import OverlapStudy, describe_rows

    scene = _scene(args)
    hardware = None if args.sim else {"transmit": args.transmit}
    study = OverlapStudy(scene, hardware, args.capture, args.tracked)
    study.check()
    if not (args.sim or args.dry_run):
        _require_radios(scene, 2 if scene.has_jammer else 1)
    if options.out is None:
        stamp = time.strftime("%Y%m%d-%H%M%S")
        name = re.sub(r"[^\w.-]+", "_", scene.name)[:60]  # a scene's name must not leave results/
        options = dataclasses.replace(options, out=Path("results") / f"{name}-{stamp}")
    print(f"{named(PROGRAM)}: {scene.name}, {', '.join(scene.methods)}, seed {scene.seed}", flush=True)
    return run(
        study, options, program=PROGRAM, dry_run=args.dry_run, describe=describe_rows, after=_print_verdict
    )


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the evaluation; returns 0, 2 after one line about an error, 130 when interrupted."""
    parser = _parser()
    args = parser.parse_args(argv)
    options = options_of(args, parser)
    if args.tracked and not args.sim:
        parser.error("--tracked needs --sim: on the air, the block altitude_tracker says what it tracks")
    _check_python()
    if args.plan or args.check:
        return _check(args)
    if args.calibrate:
        return _calibrate(args)
    return _replay(args) if args.replay else _run(args, options)
