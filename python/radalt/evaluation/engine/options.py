"""What every command line of the package has, and how each ends: with a result, or with status 2 and one line.

Nothing here needs NumPy, so that a wrong Python gets one line, too.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import os
import shlex
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from ...core.paths import no_gnu_radio
from ...core.text import one_line, said

__all__ = [
    "MAX_JOBS",
    "MAX_SEED",
    "Options",
    "Parser",
    "Terminated",
    "add_options",
    "command",
    "command_of",
    "complain",
    "duration",
    "expected_errors",
    "names_of",
    "number",
    "options_of",
    "path",
    "typed",
]

MAX_JOBS = 256
MAX_SEED = 2**63 - 1
_TRACEBACK = "RADALT_TRACEBACK"


def complain(program: str, error: object) -> None:
    """One line of at most 300 characters to stderr; of a longer one the middle goes: the remedy stands last.

    With ``RADALT_TRACEBACK`` in the environment an exception is raised again instead.
    """
    if isinstance(error, BaseException) and _TRACEBACK in os.environ:
        raise error
    text = said(error) if isinstance(error, BaseException) else str(error)
    if isinstance(error, ImportError) and (error.name or "").split(".")[0] in ("gnuradio", "pmt"):
        text = no_gnu_radio()
    print(one_line(f"{program}: {text}"), file=sys.stderr)


def number(kind: type, low: float, high: float) -> Callable[[str], float]:
    """For ``type=``: an int or float within ``low..high``, both allowed; anything else is one line."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            shown = text if len(text) <= 40 else f"{text[:37]}..."
            what = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"it is {shown!r}; it has to be {what} within {low:g}..{high:g}")
        return value

    return parse


def path(text: str) -> Path:
    """For ``type=``: a file or folder name that a system can have; an empty one would be the working directory."""
    if not text.strip() or "\0" in text or len(os.fsencode(text)) > 4000:
        raise argparse.ArgumentTypeError("it is empty, too long or holds a NUL; name a file or folder")
    return Path(text)


class Terminated(KeyboardInterrupt):
    """SIGTERM, as a batch system sends it: it ends a program as Ctrl-C does, with status 143."""


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """SIGTERM raises `Terminated` in this block; where somebody else handles it, or in a thread, nothing changes."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def end(number: int, frame: object) -> NoReturn:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the second would cut what the first puts in order
        raise Terminated

    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextlib.contextmanager
def a_home() -> Iterator[None]:
    """A home for a user without one (``nobody``, a container): GNU Radio and its compiler write there at each start."""
    home = os.path.expanduser("~")
    if os.access(home, os.W_OK | os.X_OK):
        yield
        return
    with tempfile.TemporaryDirectory(prefix="radalt_home_", ignore_cleanup_errors=True) as folder:
        os.environ["HOME"] = folder
        try:
            yield
        finally:
            os.environ["HOME"] = home


def command(program: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """A ``main`` whose refusals are one line and status 2, Ctrl-C 130 and SIGTERM 143, imports included.

    Caught is what this package and what it stands on raise for wrong input and failing machines; others keep their
    traceback. With ``RADALT_TRACEBACK`` in the environment all do.
    """

    def decorate(main: Callable[..., int]) -> Callable[..., int]:
        @functools.wraps(main)
        def guarded(*args: object, **options: object) -> int:
            for stream in (sys.stdout, sys.stderr):
                if hasattr(stream, "reconfigure"):  # a terminal of another encoding ends no run
                    stream.reconfigure(errors="backslashreplace")
            try:
                with terminable(), a_home():
                    return main(*args, **options)
            except (ValueError, RuntimeError, OSError, ImportError, MemoryError) as error:
                complain(program, error)
                return 2
            except Terminated:
                complain(program, "terminated")
                return 143
            except KeyboardInterrupt:
                complain(program, "stopped")
                return 130

        return guarded

    return decorate


@dataclass(frozen=True)
class Options:
    """How a study is run; nothing here changes a row, except how many batches ``precision`` asks for.

    Attributes
    ----------
    out : Path
        Result folder.
    resume : bool
        Complete the run that ``out`` holds.
    jobs : int
        Local worker processes; 0 measures in this process, one point after the other and without a time limit.
    scheduler : str
        Address or scheduler file of a Dask cluster; empty for local processes.
    time_limit_s : float
        Longest time for one batch of a point.
    precision : float or None
        Half width of the 95 % interval of Pd to be reached; None measures one batch of every point.
    command : str
        As in the report.
    publish : Path or None
        Folder that receives the study's page, figures and data under their stable names.
    """

    out: Path
    resume: bool = False
    jobs: int = 2
    scheduler: str = ""
    time_limit_s: float = 120.0
    precision: float | None = None
    command: str = ""
    publish: Path | None = None


def typed(program: str) -> str:
    """What a user types to run a program: ``radalt eval`` where that was typed, else its script."""
    called = sys.argv[0]  # see evaluation/programs.py
    if called.startswith("radalt "):
        return called
    if Path(called).resolve().parent.name == "tools":
        return f".venv/bin/python tools/{program}.py"
    if Path(called).resolve().parent.name == "training":
        return f"PYTHONPATH=python .venv/bin/python training/{program}.py"
    return f".venv/bin/python flowgraphs/{program}.py"


class Parser(argparse.ArgumentParser):
    """Description from a module's docstring; errors in one line, without the usage text."""

    def __init__(self, program: str, doc: str) -> None:
        summary, _, details = doc.partition("\n\n")
        self.program = program
        super().__init__(
            prog=typed(program),
            description=summary,
            epilog=details,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def error(self, message: str) -> NoReturn:
        """One line, status 2."""
        complain(self.program, f"{message}; --help lists the options")
        sys.exit(2)


def add_options(
    parser: argparse.ArgumentParser,
    *,
    out: str | None = None,
    time_limit_s: float = 120.0,
    sampled: bool = True,
) -> None:
    """``--out --resume --publish --jobs --scheduler --time-limit-s --precision --dry-run``, alike for every study.

    ``--seed`` is the study's own, since it belongs to what is measured.
    """
    add = parser.add_argument
    default = f" (default: {out})" if out else ""
    add("--out", type=path, default=out and Path(out), help=f"result folder{default}")
    add("--resume", action="store_true", help="complete the run that --out holds")
    add(
        "--publish",
        type=path,
        metavar="DIR",
        help="at the end, copy page, figures and data into DIR under the names that the documentation links to",
    )
    add(
        "--jobs",
        type=number(int, 1, MAX_JOBS),
        default=2,
        help="local worker processes (default: %(default)s); changes no row",
    )
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS|FILE",
        help="spread the points over a Dask cluster: tcp://host:8786, or its scheduler file; changes no row",
    )
    add(
        "--time-limit-s",
        type=number(float, 1e-3, 1e7),
        default=time_limit_s,
        help="longest time for one point (default: %(default)g)",
    )
    if sampled:
        add(
            "--precision",
            type=number(float, 0.001, 0.5),
            metavar="W",
            help="measure each point until the 95 %% half width of Pd is at most W, such as 0.02",
        )
    add(
        "--dry-run",
        action="store_true",
        help="print points, frames and the time they may take; measure nothing",
    )


def options_of(args: argparse.Namespace, parser: argparse.ArgumentParser, *, command: str = "") -> Options:
    """What `add_options` asked for; ends the program with one line where a value does not fit."""
    if args.resume and args.out is None:
        parser.error("--resume needs --out with the folder of the run to complete")
    return Options(
        out=args.out,
        resume=args.resume,
        jobs=args.jobs,
        scheduler=args.scheduler,
        time_limit_s=args.time_limit_s,
        precision=getattr(args, "precision", None),
        command=command,
        publish=args.publish,
    )


def names_of(parser: Parser, option: str, text: str, known: Collection[str]) -> tuple[str, ...]:
    """Names with commas, each known and there once; ends the program with one line where one is not.

    A name given twice would have its rows twice, of the same frames, and cost its time twice.
    """
    names = tuple(name.strip() for name in text.split(","))
    for k, name in enumerate(names):
        if name not in known:
            parser.error(f"{option} names {name[:40]!r}; known: {', '.join(known)}")
        if name in names[:k]:
            parser.error(f"{option} names {name!r} more than once; leave one")
    return names


# how a run is done, which changes none of its rows
_NO_ROW = frozenset(("out", "resume", "publish", "jobs", "scheduler", "time_limit_s", "dry_run"))


def command_of(args: argparse.Namespace, parser: Parser) -> str:
    """The command that makes the same rows: the options that differ from their defaults, files by name alone."""
    words = [typed(parser.program)]
    positional = {action.dest for action in parser._actions if not action.option_strings}
    for name, value in vars(args).items():
        if name in _NO_ROW or value == parser.get_default(name):
            continue
        if name in positional:
            words.append(shlex.quote(_word(value)))
            continue
        option = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(option)
        elif isinstance(value, list):
            words += [option, *(shlex.quote(_word(v)) for v in value)]
        else:
            words.append(f"{option}={shlex.quote(_word(value))}")
    return " ".join(words)


def _word(value: object) -> str:
    return value.name if isinstance(value, Path) else str(value)


def expected_errors() -> tuple[type[Exception], ...]:
    """What a user can mend: every error class of this package, and what the system says of files and memory."""
    from ...core.mitigation import MitigationError
    from ...core.parsing import InputError
    from ...core.radio.calibration import CalibrationError
    from ...core.radio.interlock import InterlockError
    from ...core.radio.recording import RecordingError
    from ...core.returns.terrain import TerrainError, TrajectoryError
    from ...core.scene import SceneError
    from ..flowgraph import FlowgraphError
    from ..results.folder import FolderError
    from .pool import WorkerError
    from .precision import PrecisionError

    own = (
        InputError,
        SceneError,
        MitigationError,
        CalibrationError,
        InterlockError,
        RecordingError,
        TerrainError,
    )
    return (
        *own,
        TrajectoryError,
        FlowgraphError,
        FolderError,
        WorkerError,
        PrecisionError,
        OSError,
        MemoryError,
    )


def duration(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
