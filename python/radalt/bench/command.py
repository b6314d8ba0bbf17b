"""The bench: methods, and your own, on a list of cases; and where yours stands.

.venv/bin/python flowgraphs/bench.py standard --methods none,whitening,tcae  # into results/bench
.venv/bin/python flowgraphs/bench.py standard --method-file mine=mymethod.py  # and where yours stands
.venv/bin/python flowgraphs/bench.py mycases.yaml --model net=mynet.onnx --methods none,net --frames 40
.venv/bin/python flowgraphs/bench.py standard --method-file mine=mymethod.py --confirm  # on new seeds
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..evaluation.engine.options import Parser, number, path
from ..evaluation.engine.own import add_own, option_files, own_methods
from ..evaluation.engine.shell import StudyCommand
from ..evaluation.engine.study import Study

PROGRAM, COMMAND = "bench", "bench"


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    add("list", help="a shipped list (bench/*.yaml), or a YAML file of cases")
    parser.option(
        "--methods",
        "shipped methods, entries of the list and yours, with commas (default: the list's; none, and yours)",
        default="",
        dest="entries",
    )
    add_own(parser)
    parser.option(
        "--via",
        "through GNU Radio's flowgraph: the same rows to the bit, in more time (default: direct)",
        default="direct",
        choices=("direct", "flowgraph"),
    )
    parser.option("--cases", "these cases alone, with commas", default="")
    parser.option("--frames", "per level, in place of the list's", number(int, 1, 100_000))
    parser.option(
        "--against", "stored rows to compare with (default: the list's, if shipped)", path, metavar="ROWS.csv"
    )
    parser.flag("--confirm", "draw every seed from the list and your files; runs the best shipped, too")
    parser.flag("--stored", "the report of the stored rows; measures nothing")
    parser.flag("--plan", "print the cases and their levels, and run nothing")


def _study(args: argparse.Namespace, parser: Parser) -> Study | int:
    from ..core.mitigation import METHODS
    from ..core.parsing import allowed
    from .board import stored_rows
    from .entry import Entry
    from .lists import find_list, load_list
    from .rows import read_rows
    from .study import BenchStudy

    own = own_methods(args)
    only = tuple(case.strip() for case in args.cases.split(",") if case.strip())
    salt = _salt(args.list, own) if args.confirm else ""
    cases = load_list(args.list, frames=args.frames, only=only, salt=salt)
    listed = {name: Entry.of(name, keys, f"{args.list}: entries") for name, keys in cases.entries.items()}
    if own and set(own) & set(listed):
        parser.error(f"{min(set(own) & set(listed))!r} is an entry of the list; give yours another name")
    names = [name.strip() for name in args.entries.split(",") if name.strip()]
    if args.stored and (own or args.confirm or args.via != "direct"):
        parser.error("--stored measures nothing; leave it out, or your own methods, --confirm and --via")
    if args.against or args.stored or (own and not args.confirm):  # before anything is measured
        args.against = args.against or stored_rows(cases.name)
        rows = read_rows(args.against)
        if {row["digest"] for row in rows} != {cases.digest}:
            parser.error(
                f"{args.against}: rows of another list, or of other --frames or seeds; run the methods on it first"
            )
        names = names or [row["entry"] for row in rows if args.stored]
    names = names or (["none", *own] if own or not listed else list(listed))
    if args.confirm:
        names = list(dict.fromkeys(["none", *names, *CONFIRM]))
    known = list(dict.fromkeys([*METHODS, *listed, *own]))
    unknown = [name for name in names if name not in known]
    if unknown:
        parser.error(f"--methods names {unknown[0]!r}; {allowed(unknown[0], known)}")
    args.own = tuple(own)
    entries = tuple(
        listed.get(name) or Entry(name, name, tuple(own.get(name, {}).items()))
        for name in dict.fromkeys(names)
    )
    stored = args.against if args.stored else None
    study = BenchStudy(find_list(args.list), entries, args.frames, only, salt, args.via, stored)
    if args.plan:
        study.check()
        for case in cases.cases:
            levels = case.levels_db
            span = "no interference"
            if levels[0] is not None:
                name = case.grid.axis.removesuffix("_db").upper()
                span = f"{name} {levels[0]:g} dB"
                if len(levels) > 1:
                    span = f"{name} {levels[0]:g} to {levels[-1]:g} dB, {len(levels)} levels"
            print(
                f"{case.name:20} overlap {case.overlap:<4g} {span}, {case.trials} frames each: {case.title}"
            )
    return 0 if args.plan else study


# Shipped methods that a confirmation runs again: each leads under some interferer (docs/methods.md)
CONFIRM = ("blanking", "time_frequency", "tcae", "hybrid")


def _salt(name: str, own: dict[str, dict[str, str]]) -> str:
    """Seeds of a confirmation: of the list's content and the files of the entries."""
    import hashlib

    from ..core.mitigation.trial_run import MOST_BYTES
    from ..core.parsing import read_bytes
    from .lists import load_list

    digest = hashlib.sha256(load_list(name).digest.encode())
    for file in option_files(own).values():
        digest.update(read_bytes(file, most_bytes=max(MOST_BYTES.values()), what="--method-file or --model"))
    return digest.hexdigest()


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured case in a line."""
    from .paired import level_db

    names = list(dict.fromkeys(row["entry"] for row in rows))
    last = {name: next(r for r in reversed(rows) if r["entry"] == name) for name in names}
    if "pd" not in rows[0]:
        return ", ".join(f"{name} {row['ffts']:.0f} FFTs" for name, row in last.items())
    found = ", ".join(f"{name} {row['pd']:.2f} at {level_db(row):g}" for name, row in last.items())
    return f"{rows[0]['case']}, overlap {rows[0]['overlap']:g}: {found}"


def _after(folder: Path, args: argparse.Namespace, study: Any) -> None:
    """The verdict on each of the user's entries."""
    from .board import check_rows, verdict
    from .rows import read_rows

    for name in args.own:
        rows = read_rows(folder / "rows.csv")
        stored = [r for r in rows if r["entry"] != name] if args.confirm else read_rows(args.against)
        check_rows(rows, stored)
        print(f"\n{verdict(rows, stored, name)}")


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, _after, time_limit_s=3600.0)
main, _parser = SHELL.main, SHELL.parser
