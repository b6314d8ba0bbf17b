#!/usr/bin/env python3
"""Pictures of the live view, made from runs of it: `make screenshot` writes docs/live_view*.png.

    .venv/bin/python tools/screenshot.py --show jammed --out docs/live_view_jammed.png

Generates ota_live.grc with the simulated channel, operates its controls, and saves the window at the end: after a
descent in steps under the scene's interference, after the first second, under a jammer too strong for the method, or
after a loss of timing. Needs no display.
"""

from __future__ import annotations

from _tool import FLOWGRAPHS  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

from radalt.evaluation.engine.options import Parser, command, complain, number, path

if not os.environ.get("DISPLAY"):
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

PROGRAM = "screenshot"

STEPS_M = (900.0, 750.0, 600.0, 450.0, 300.0)  # altitudes of the descent
FRAMES_A_STEP = 2100  # frames of a step; in all a little more than the 10 s of the altitude chart
LOST_S = 3.0  # time without frames before the picture of a lost timing
# controls of each step; reacquisition at an altitude above zero takes that for zero, as after a change of cable
SHOWS = {
    "descent": [{"altitude_m": altitude_m} for altitude_m in STEPS_M],
    "start": [{"altitude_m": 900.0}],
    "jammed": [{"altitude_m": 600.0}, {"sir_db": -60.0}],
    "lost": [{"altitude_m": 700.0, "tx_enable": 1}, {"frame_segmenter": "reacquire"}],
}


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--out", type=path, default=Path("docs/live_view.png"), help="PNG file (default: %(default)s)")
    add("--show", choices=sorted(SHOWS), default="descent", help="what happens (default: %(default)s)")
    add("--scene", default="paper_qpsk", help="a file or a shipped scene (default: %(default)s)")
    add("--sir-db", type=number(float, -200, 200), default=-32.0, help="SIR (default: %(default)g)")
    add("--overlap", type=number(float, 0, 1), default=1.0, help="of the sweep (default: %(default)g)")
    add("--method", default="whitening", help="chosen method (default: %(default)s)")
    add(
        "--frames",
        type=number(int, 0, 2000000),
        default=FRAMES_A_STEP,
        help="frames of each step (default: %(default)s)",
    )
    add(
        "--time-limit-s", type=number(float, 0, 1e7), default=600.0, help="longest run (default: %(default)g)"
    )
    return parser


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = _parser()
    args = parser.parse_args(argv)
    if not args.method.isidentifier():  # it becomes source code of the flowgraph
        parser.error(f"--method is {args.method!r}; name one of the chooser's methods")
    return args


def _build(args: argparse.Namespace, folder: Path) -> Any:
    """Top block of the simulated live view, its controls set by the command line."""
    from PyQt5 import Qt

    from radalt.core.scene import load_scene
    from radalt.evaluation.flowgraph.generate import Prepared, generate
    from radalt.evaluation.flowgraph.rewrite import load_grc, simulate
    from radalt.evaluation.flowgraph.run import load_class

    load_scene(args.scene)  # a wrong one is refused before seconds of generating
    data = simulate(load_grc(FLOWGRAPHS / "ota_live.grc"), "ota_live_sim")
    start = {"sir_db": args.sir_db, "overlap": args.overlap, "method": args.method}
    # controls display their start values, so they start at the values of the last step
    for step in SHOWS[args.show]:
        start |= {control: value for control, value in step.items() if control != "frame_segmenter"}
    for block in data["blocks"]:
        if block["name"] in start:
            block["parameters"]["value"] = str(start[block["name"]])
    prepared = Prepared(generate(data, folder))
    top = load_class(prepared)(scene_file=args.scene, drop_when_slow=0)
    # settings of its own: without the window size of an earlier run
    top.settings = Qt.QSettings(str(folder / "settings"), Qt.QSettings.IniFormat)
    sys.modules[type(top).__module__].snippets_main_after_init(top)
    top.set_sir_db(args.sir_db)
    return top


class _Steps:
    """Sets the controls of each step and waits for its frames."""

    def __init__(self, top: Any, steps: list[dict[str, Any]], frames: int) -> None:
        self._top, self._left, self._frames = top, list(steps), frames
        self._end_s = self._until = 0.0

    def over(self) -> bool:
        """Start the next step if the present one is over; returns whether the last is."""
        frames = self._top.altimeter_none.nitems_read(0)
        if frames < self._until and time.monotonic() < self._end_s:
            return False
        if not self._left:
            return True
        step = self._left.pop(0)
        for control, value in step.items():
            setter = getattr(self._top, f"set_{control}", None)
            setter(value) if setter else getattr(getattr(self._top, control), value)()
        self._until = frames + self._frames
        # without timing there are no frames
        self._end_s = time.monotonic() + LOST_S if "frame_segmenter" in step else float("inf")
        return False


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the view and save its picture; returns 0, or 2 after one line about an error."""
    args = _arguments(argv)
    from PyQt5 import Qt

    from radalt.evaluation.flowgraph.live import SIZE, StatusLine

    # nothing is dropped: how fast the signal is simulated says nothing about the view
    speed = mock.patch.object(StatusLine, "_speed", lambda _: "simulated")
    app = Qt.QApplication(sys.argv[:1])
    with speed, tempfile.TemporaryDirectory() as folder:
        top = _build(args, Path(folder))
        top.resize(*SIZE)  # the offscreen screen is small
        top.show()
        top.start()
        deadline = time.monotonic() + args.time_limit_s
        steps, over = _Steps(top, SHOWS[args.show], args.frames), False

        def step() -> None:
            nonlocal over
            over = steps.over()
            if over or time.monotonic() > deadline:
                app.quit()

        timer = Qt.QTimer()
        timer.timeout.connect(step)
        timer.start(20)
        app.exec_()
        top.status_timer.stop()
        top.stop()
        top.wait()
        app.processEvents()  # pending drawing
        picture = top.grab()
    if not over:
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
