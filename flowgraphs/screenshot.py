#!/usr/bin/env python3
"""Picture of the live view, made from a run of it: `make screenshot` writes docs/live_view.png.

    .venv/bin/python flowgraphs/screenshot.py --out docs/live_view.png

Generates ota_live.grc with the simulated channel, flies a descent in steps under the scene's interference, and saves
what the window shows at the end. Needs no display.
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gnuradio.radalt.evaluation.engine.options import Parser, command, complain, number, path

if not os.environ.get("DISPLAY"):
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

PROGRAM = "screenshot"
HERE = Path(__file__).resolve().parent

STEPS_M = (900.0, 750.0, 600.0, 450.0, 300.0)  # altitudes of the descent, one after the other
SIZE = (1680, 1000)
FRAMES_A_STEP = 2100  # a little more in all than the 10 s that the altitude chart is wide


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add(
        "--out",
        type=path,
        default=Path("docs/live_view.png"),
        help="PNG file (default: %(default)s)",
    )
    add(
        "--scene",
        default="paper_qpsk",
        help="YAML file, or the name of a shipped scene (default: %(default)s)",
    )
    add(
        "--sir-db",
        type=number(float, -200, 200),
        default=-32.0,
        help="signal-to-interference ratio (default: %(default)g)",
    )
    add(
        "--overlap",
        type=number(float, 0, 1),
        default=1.0,
        help="active fraction of the sweep (default: %(default)g)",
    )
    add("--method", default="whitening", help="the method that is chosen (default: %(default)s)")
    add(
        "--frames",
        type=number(int, 0, 2000000),
        default=FRAMES_A_STEP,
        help="frames at each altitude (default: %(default)s)",
    )
    add(
        "--time-limit-s",
        type=number(float, 0, 10000000.0),
        default=600.0,
        help="give up after this long (default: %(default)g)",
    )
    return parser


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = _parser()
    args = parser.parse_args(argv)
    if not args.method.isidentifier():  # it is written into the flowgraph as source
        parser.error(f"--method is {args.method!r}; name one of the chooser's methods")
    return args


def _build(args: argparse.Namespace, folder: Path) -> Any:
    """The top block of the simulated live view, with the controls where the command line wants them."""
    from gnuradio.radalt.evaluation.flowgraph.generate import Prepared, generate
    from gnuradio.radalt.evaluation.flowgraph.rewrite import load_grc, simulate
    from gnuradio.radalt.evaluation.flowgraph.run import load_class

    data = simulate(load_grc(HERE / "ota_live.grc"), "ota_live_sim")
    start = {"altitude_m": STEPS_M[-1], "sir_db": args.sir_db, "overlap": args.overlap, "method": args.method}
    for block in data["blocks"]:
        if block["name"] in start:  # the controls show what they start with
            block["parameters"]["value"] = str(start[block["name"]])
    prepared = Prepared(generate(data, folder), "ota_live_sim", (), ())
    top = load_class(prepared)(scene_file=args.scene, drop_when_slow=0)
    sys.modules[type(top).__module__].snippets_main_after_init(top)
    top.set_altitude_m(STEPS_M[0])
    return top


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the view, save its picture; returns 0, or 2 after one line about what went wrong."""
    args = _arguments(argv)
    from PyQt5 import Qt

    app = Qt.QApplication(sys.argv[:1])
    with tempfile.TemporaryDirectory() as folder:
        top = _build(args, Path(folder))
        top.resize(*SIZE)
        top.show()
        top.start()
        deadline = time.monotonic() + args.time_limit_s
        done = 0

        def step() -> None:
            nonlocal done
            done = top.altimeter_none.nitems_read(0) // args.frames
            if done >= len(STEPS_M) or time.monotonic() > deadline:
                app.quit()
            elif top.altitude_m != STEPS_M[done]:
                top.set_altitude_m(STEPS_M[done])

        timer = Qt.QTimer()
        timer.timeout.connect(step)
        timer.start(20)
        app.exec_()
        picture = top.grab()
        top.stop()
        top.wait()
    if done < len(STEPS_M):
        complain(PROGRAM, f"not done within {args.time_limit_s:g} s; raise --time-limit-s")
        return 2
    args.out.parent.mkdir(parents=True, exist_ok=True)
    if not picture.save(str(args.out)):
        complain(PROGRAM, f"{args.out} cannot be written")
        return 2
    print(args.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
