"""The first hour on two radios, step by step, each with a verdict; and one bundle that comes back.

    .venv/bin/python flowgraphs/first_light.py --sim  # the same steps on a simulated bench, seconds
    .venv/bin/python flowgraphs/first_light.py --transmit --scene my_bench.yaml
    .venv/bin/python flowgraphs/first_light.py --read first-light-20261128-090000.zip

Leads through cabling, receiver, radar, jammer, both, and ten minutes of endurance (docs/hardware.md), and goes on to
the end whatever fails. Nothing is transmitted unless the scene names the enclosure and --transmit is given. The bundle
first-light-DATE.zip holds report, rows, short SigMF captures and versions, at most 50 MB; --read shows one.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from ...core.interrupts import ctrl_c_waits
from ..engine.options import Parser, command, names_of, number, path

PROGRAM, COMMAND = "first_light", "first-light"
_SIMULATED_MINUTES = 0.02  # a simulated channel does not drift


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--sim", action="store_true", help="simulated channel in place of the radios")
    add(
        "--scene",
        help="YAML file of the bench; with --sim a shipped scene's name does, too (default: paper_qpsk)",
    )
    add("--transmit", action="store_true", help="allow transmission into the scene's enclosure")
    add("--yes", action="store_true", help="do not wait for Enter before the first step")
    add("--steps", metavar="LIST", help="these steps alone, with commas, and those that they need")
    add("--frames", type=number(int, 4, 200), default=15, help="at each altitude (default: %(default)s)")
    add(
        "--starts",
        type=number(int, 2, 100),
        default=10,
        help="whose latencies are compared (default: %(default)s)",
    )
    add("--minutes", type=number(float, 0.001, 30), help="of the last step (default: 10, with --sim 0.02)")
    add(
        "--out",
        type=path,
        help="result folder (default: first-light-DATE-TIME); with --read, where to unpack",
    )
    add("--no-serials", action="store_true", help="leave serial numbers out of the bundle")
    add("--read", type=path, metavar="BUNDLE", help="show a bundle and measure nothing")
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Lead through the bench; returns 0, 1 if a check failed, 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)

    from ..radios.first_light import CABLING, STEPS, Bench, Check, perform
    from ..radios.first_light_bundle import open_folder, read_bundle, verdict_of, write_bundle
    from ..radios.first_light_steps import MEASURES

    if args.read:
        print(read_bundle(args.read, args.out))
        return 0
    if not (args.sim or args.yes or (sys.stdin and sys.stdin.isatty())):
        parser.error("there is no terminal at which to wait for the cables; connect them and add --yes")
    if not (args.sim or args.scene):
        parser.error("give the bench's scene with --scene (docs/hardware.md), or --sim")

    from ...core.scene import load_scene

    wanted = tuple(MEASURES) if args.steps is None else names_of(parser, "--steps", args.steps, MEASURES)
    if any("needs" in STEPS[name] for name in wanted):
        wanted = ("receiver", "radar", *wanted)
    steps = {name: measure for name, measure in MEASURES.items() if name in wanted}
    out = args.out or Path(time.strftime("first-light-%Y%m%d-%H%M%S"))
    minutes = args.minutes or (_SIMULATED_MINUTES if args.sim else 10.0)
    bench = Bench(
        load_scene(args.scene or "paper_qpsk"),
        out,
        simulated=args.sim,
        transmit=args.transmit,
        frames=args.frames,
        starts=args.starts,
        minutes=minutes,
        log=lambda line: print(f"    {line}", file=sys.stderr),
    )
    print(CABLING)
    radio = bench.scene.radio
    print(
        f"A is {radio.attenuation_db:g} dB, enclosure: {radio.enclosure}. Nothing is transmitted before the step radar."
    )
    if not (args.sim or args.yes):
        try:
            input("Connect every cable of the drawing, then press Enter (Ctrl-C ends): ")
        except EOFError:
            parser.error("the terminal was closed before Enter; nothing was opened")
    with ctrl_c_waits():  # GNU Radio's import takes one for a missing package, and goes on
        folder = open_folder(bench)
    checks: list[Check] = []
    try:
        for check in perform(bench, steps):
            if not any(check.step == c.step for c in checks):
                print(f"\n{STEPS[check.step]['title']}")
            checks.append(check)
            why = "" if check.verdict == "pass" else f": {check.cause}"
            print(f"  {check.verdict:8}{check.what}: {check.shown} ({check.limit}){why}", flush=True)
    finally:  # an hour that is broken off leaves its bundle, whole
        with ctrl_c_waits():
            reached = {check.step for check in checks}
            checks += [
                Check(name, STEPS[name]["title"], None, cause="not reached: the hour was broken off")
                for name in steps
                if name not in reached
            ]
            serials = {radio.radar_serial, radio.jammer_serial, *bench.serials} if args.no_serials else ()
            source = "simulated channel" if args.sim else radio.limits.title
            bundle = write_bundle(folder, checks, f"{time.strftime('%Y-%m-%d')}, {source}", serials)
            folder.close()
            print(f"\n{verdict_of(checks)}\n{bundle}")
    return int(any(check.verdict == "fail" for check in checks))
