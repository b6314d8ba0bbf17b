"""Can the altitude be trusted: tracked outputs of every method over interference, faults and deception.

    .venv/bin/python flowgraphs/integrity.py  # one flight through each case: 1 s, or 2 min over land and points
    .venv/bin/python flowgraphs/integrity.py --groups=land,point --methods=none --hours=20 --resume  # about 7 h of CPU
    .venv/bin/python flowgraphs/integrity.py --replay jammed/nr5/1/-40dB/snr10:1:0  # one flight, output by output

Exits with 1 if an output was hazardous inside the claim: in no case at a limit that docs/tracker.md states.
"""

import argparse
import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...evaluation.engine.options import Parser, names_of, number
from ...evaluation.engine.shell import StudyCommand, add_frames, add_methods, add_seed

if TYPE_CHECKING:
    from .study import IntegrityStudy

PROGRAM, COMMAND = "integrity", "integrity"
METHODS = "none,whitening,tcae,hybrid"


def _arguments(parser: Parser) -> None:
    add_methods(parser, METHODS)
    parser.option("--groups", "kinds of cases with commas (default: all)", default="")
    words = "least flight hours in all (default: one flight of every case)"
    parser.option("--hours", words, number(float, 0.0, 10_000.0), 0.0)
    words = "frames of a flight, whole blocks of 40; over land and a point 120 times as many"
    add_frames(parser, 1000, words, low=40, high=100_000)
    words = "vertical speed that altimeter and tracker have to expect"
    parser.option("--allowed-m-per-s", words, number(float, 10.0, 150.0), 20.0)
    add_seed(parser, 1)
    parser.option("--pool", "rows.csv of earlier flights, with commas, for the rates per hour", default="")
    words = "fly once more and print every output; @SPEED: over land, at so many m/s over ground"
    parser.option("--replay", words, default="", metavar="CASE[@SPEED]:SEED[:BATCH]")


def _study(args: argparse.Namespace, parser: Parser) -> "IntegrityStudy | int":
    if args.frames % 40:
        parser.error(f"--frames is {args.frames}; it has to be a multiple of 40, the frames of one output")
    from .cases import KINDS
    from .study import IntegrityStudy

    kinds = names_of(parser, "--groups", args.groups, KINDS) if args.groups else tuple(KINDS)
    earlier = tuple(Path(name) for name in args.pool.split(",") if name)
    study = IntegrityStudy(
        args.methods, kinds, args.frames, args.hours, args.seed, args.allowed_m_per_s, earlier
    )
    study.earlier()  # a file that cannot be read ends here, not after the flights
    return _replay(study, args.replay, parser) if args.replay else study


def _after(folder: Path, args: argparse.Namespace, study: "IntegrityStudy") -> int:
    from ...evaluation.results.folder import read_report

    report = read_report(folder)
    said = report["headline"]["inside"]
    print(f"{said['hazardous']} of {said['outputs']} outputs hazardous inside the claim,", end=" ")
    print(f"below {said['bound']:.1e} per output, {said['flight_bound']:.1e} per flight (95 %)")
    return 1 if said["hazardous"] else 0


def _replay(study: "IntegrityStudy", text: str, parser: Parser) -> int:
    from .cases import case_of
    from .study import replay_lines

    found = re.fullmatch(
        r"([^:@]{1,200})(?:@([0-9]{1,9}(?:\.[0-9]{1,9})?))?:([0-9]{1,18})(?::([0-9]{1,9}))?", text
    )
    if not found:
        parser.error(f"--replay is {text[:60]!r}; write CASE:SEED or CASE:SEED:BATCH, as in events.csv")
    name, speed, seed, batch = found.groups()
    if speed and not (text.startswith("land/") and 0.1 <= float(speed) <= 999.0):
        parser.error(f"--replay has {speed} m/s over ground; only land/... has one, 0.1 to 999: write @60")
    study = dataclasses.replace(study, seed=int(seed))
    study.check()
    case = dataclasses.replace(case_of(name), value=float(speed)) if speed else case_of(name)
    print("\n".join(replay_lines(study, case, int(batch or 0))))
    return 0


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    return f"{rows[0]['case']}:{rows[0]['batch']}: " + ", ".join(
        f"{r['method']} {r['computed']}/{r['outputs']}"
        + (f", {r['hazardous']} HAZARDOUS" * bool(r["hazardous"]))
        for r in rows
    )


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, _after)
main, _parser = SHELL.main, SHELL.parser
