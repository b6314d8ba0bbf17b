"""The first hour on two radios, step by step, each with a verdict.

    .venv/bin/python flowgraphs/first_light.py --sim  # the same steps on a simulated bench, seconds
    .venv/bin/python flowgraphs/first_light.py --transmit --scene my_bench.yaml

Leads through receiver, radar, jammer, both, and ten minutes of endurance (docs/first-light.md), and goes on to the end
whatever fails. Nothing is transmitted unless the scene names the enclosure and --transmit is given.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from ..engine.options import Parser, command, names_of, number, path

PROGRAM, COMMAND = "first_light", "first-light"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    parser.flag("--sim", "simulated channel in place of the radios")
    parser.option(
        "--scene", "YAML file of the bench; with --sim a shipped scene's name does, too (default: paper_qpsk)"
    )
    parser.flag("--transmit", "allow transmission into the scene's enclosure")
    parser.option("--steps", "these steps alone, with commas, and those that they need", metavar="LIST")
    parser.option("--frames", "at each altitude", number(int, 4, 200), 15)
    parser.option("--starts", "whose latencies are compared", number(int, 2, 100), 10)
    parser.option("--minutes", "of the last step (default: 10, with --sim 0.02)", number(float, 0.001, 30))
    parser.option("--out", "result folder (default: results/first-light-DATE-TIME)", path)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Lead through the bench; returns 0, 1 if a check failed, 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)

    from ...core.interrupts import ctrl_c_waits
    from ...core.scene import load_scene
    from ..radios.first_light import CABLING, STEPS, Bench, Check, open_folder, perform, report

    if not (args.sim or args.scene):
        parser.error("give the bench's scene with --scene (docs/hardware.md), or --sim")
    wanted = tuple(STEPS) if args.steps is None else names_of(parser, "--steps", args.steps, STEPS)
    if any(STEPS[name].needs for name in wanted):
        wanted = ("receiver", "radar", *wanted)
    bench = Bench(
        load_scene(args.scene or "paper_qpsk"),
        args.out or Path("results", time.strftime("first-light-%Y%m%d-%H%M%S")),
        simulated=args.sim,
        transmit=args.transmit,
        frames=args.frames,
        starts=args.starts,
        minutes=args.minutes or (0.02 if args.sim else 10.0),  # a simulated channel does not drift
        log=lambda line: print(f"    {line}", file=sys.stderr),
    )
    radio = bench.scene.radio
    print(f"{CABLING}A is {radio.attenuation_db:g} dB, enclosure: {radio.enclosure}.")
    with ctrl_c_waits():  # GNU Radio's import takes one for a missing package, and goes on
        folder = open_folder(bench)
    checks: list[Check] = []
    try:
        for check in perform(bench, [name for name in STEPS if name in wanted]):
            if not any(check.step == c.step for c in checks):
                print(f"\n{STEPS[check.step].title}")
            checks.append(check)
            why = "" if check.verdict == "pass" else f": {check.cause}"
            print(f"  {check.verdict:8}{check.what}: {check.shown} ({check.limit}){why}", flush=True)
    finally:  # an hour that is broken off leaves its report, whole
        with ctrl_c_waits():
            print(f"\n{report(folder, checks)}")
    return int(any(check.verdict == "fail" for check in checks))
