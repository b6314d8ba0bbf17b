"""Common options of all command lines, and their exit: with a result, or with status 2 and one line.

This module does not import NumPy, so that an unsuitable Python gets one line as well.
"""

import argparse
import atexit
import contextlib
import functools
import os
import shlex
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NoReturn

from ...core.parsing.messages import MINUS, did_you_mean
from ...core.paths import no_gnu_radio
from ...core.text import MOST, one_line, said, showable

MAX_JOBS = 256  # most local workers: more than any machine's cores
MAX_SEED = 2**63 - 1  # largest seed: int64
_HEAD_BYTES = 1 << 16  # part of a file that may be overwritten in which its mark is, bytes
# errors that users can correct, the bases of all of this package: wrong input, failing machines, missing packages
EXPECTED = (ValueError, RuntimeError, OSError, ImportError, MemoryError)
_TRACEBACK = "RADALT_TRACEBACK"  # environment variable that keeps tracebacks


def complain(program: str, error: object) -> None:
    """Print one line of at most 300 characters to stderr; a longer one loses its middle, since the remedy is last.

    With ``RADALT_TRACEBACK`` in the environment an exception is raised again instead.
    """
    if isinstance(error, BaseException) and _TRACEBACK in os.environ:
        raise error
    text = said(error) if isinstance(error, BaseException) else str(error)
    if isinstance(error, ImportError) and (error.name or "").split(".")[0] in ("gnuradio", "pmt"):
        text = no_gnu_radio()
    print(one_line(f"{named(program)}: {text}"), file=sys.stderr)


def number(kind: type, low: float, high: float) -> Callable[[str], float]:
    """Argument ``type=`` for an int or float within ``low..high``, both included; one line for other text."""

    def parse(text: str) -> float:
        try:
            value = kind(text.replace(MINUS, "-"))
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            shown = text if len(text) <= 40 else f"{text[:37]}..."
            what = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"it is {shown!r}; it has to be {what} within {low:g}..{high:g}")
        return value

    return parse


def path(text: str) -> Path:
    """Argument ``type=`` for a valid file or folder name; not empty, which would be the working directory."""
    if not text.strip() or "\0" in text or len(os.fsencode(text)) > 4000:
        raise argparse.ArgumentTypeError("it is empty, too long or holds a NUL; name a file or folder")
    return Path(text)


def words(text: str) -> str:
    """Argument ``type=`` for a text in a page."""
    if not showable(text):
        raise argparse.ArgumentTypeError(
            f"it has to be printable, at most {MOST} characters, without < > | and links"
        )
    return text


def check_ours(file: Path, mark: str) -> None:
    """Refuse to overwrite what this program has not written: a link, a folder, a file without ``mark`` in its head.

    Raises FileExistsError, one line: file and remedy.
    """
    if not os.path.lexists(file):
        return
    if not file.is_symlink() and file.is_file():
        with file.open("rb") as held:
            if mark.encode() in held.read(_HEAD_BYTES):
                return
    raise FileExistsError(
        f"{file} exists, and this program has not written it; move it away, or name another --out"
    )


class Terminated(KeyboardInterrupt):
    """SIGTERM, as sent by batch systems: ends a program like Ctrl-C, with status 143."""


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """SIGTERM raises `Terminated` in this block, except in threads and under another handler."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def end(number: int, frame: object) -> NoReturn:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second signal must not interrupt the clean-up
        raise Terminated

    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def find_home() -> None:
    """Set HOME for a user without one (``nobody``, a container): GNU Radio and its compiler write there at start."""
    if not os.access(os.path.expanduser("~"), os.W_OK | os.X_OK):
        folder = tempfile.TemporaryDirectory(prefix="radalt_home_", ignore_cleanup_errors=True)
        atexit.register(folder.cleanup)
        os.environ["HOME"] = folder.name


def command(program: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Decorator of a ``main``: expected errors become one line and status 2, Ctrl-C 130, SIGTERM 143, imports included.

    A closed standard output, as of ``| head``, ends it in silence with status 141.

    Other errors keep their traceback. With ``RADALT_TRACEBACK`` in the environment all do.
    """

    def decorate(main: Callable[..., int]) -> Callable[..., int]:
        @functools.wraps(main)
        def guarded(*args: object, **options: object) -> int:
            for stream in (sys.stdout, sys.stderr):
                if hasattr(stream, "reconfigure"):  # characters outside the terminal's encoding are no error
                    stream.reconfigure(errors="backslashreplace")
            try:
                find_home()
                with terminable():
                    status = main(*args, **options)
                    print(end="", flush=True)
                    return status
            except BrokenPipeError:  # the reader has closed the pipe: | head
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for Python's last flush
                return 141
            except EXPECTED as error:
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
    """Options of a run; no row depends on them."""

    out: Path  # result folder
    resume: bool = False  # complete the run in ``out``
    # local worker processes; 0 measures in this process, point by point and without a time limit
    jobs: int = 2
    scheduler: str = ""  # address or scheduler file of a Dask cluster; empty for local processes
    time_limit_s: float = 120.0  # longest time for one point
    command: str = ""  # command line for the report
    by: str = ""  # who measures and where, for the report
    publish: Path | None = None  # folder for the study's page, figures and data under their stable names


def named(program: str) -> str:
    """Name of a program in its messages: ``radalt eval`` if called so (evaluation/programs.py), else its script's."""
    return sys.argv[0] if sys.argv[0].startswith("radalt ") else program


def typed(program: str) -> str:
    """Command of a program for the user: ``radalt eval`` if called so, else its script."""
    if named(program) != program:
        return named(program)
    folder = Path(sys.argv[0]).resolve().parent.name
    folder = folder if folder in ("tools", "training") else "flowgraphs"
    return f"{'PYTHONPATH=python ' * (folder == 'training')}.venv/bin/python {folder}/{program}.py"


class Parser(argparse.ArgumentParser):
    """Argument parser with the description of a module's docstring and errors of one line, without the usage text."""

    def __init__(self, program: str, doc: str | None) -> None:
        summary, _, details = (doc or "").partition("\n\n")  # none under python -OO
        self.program = program
        super().__init__(
            prog=typed(program),
            description=summary,
            epilog=details,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def option(
        self, name: str, help: str, kind: Callable[[str], object] = str, default: object = None, **more: Any
    ) -> None:
        """An option with a value; its help text ends with the default, unless it says that itself."""
        if default not in (None, "") and "default" not in help:
            help = f"{help} (default: %(default)s)".lstrip()
        self.add_argument(name, type=kind, default=default, help=help, **more)

    def flag(self, name: str, help: str) -> None:
        """An option without a value."""
        self.add_argument(name, action="store_true", help=help)

    def error(self, message: str) -> NoReturn:
        """One line, status 2."""
        strange = message.removeprefix("unrecognized arguments: ").split()[0].partition("=")[0]
        known = self._option_string_actions
        near = did_you_mean(strange[2:], [name.lstrip("-") for name in known]).replace("'", "'--", 1)
        near = near if strange.startswith("--") and strange not in known else ""
        complain(self.program, f"{message}; {near}--help lists the options")
        sys.exit(2)


def add_options(
    parser: argparse.ArgumentParser, *, out: str | None = None, time_limit_s: float = 120.0
) -> None:
    """``--out --resume --by --publish --jobs --scheduler --time-limit-s --dry-run``, equal for every study.

    ``--seed`` is an option of the study, since rows depend on it.
    """
    default = f" (default: {out})" if out else ""
    parser.option("--out", f"result folder{default}", path, out and Path(out))
    parser.flag("--resume", "complete the run in --out")
    parser.option("--by", "who measures and where, for the report and for collect", words, "", metavar="TEXT")
    parser.option(
        "--publish",
        "at the end, copy page, figures and data to DIR under the names that the documentation links to",
        path,
        metavar="DIR",
    )
    parser.option("--jobs", "local worker processes; rows do not depend on it", number(int, 1, MAX_JOBS), 2)
    parser.option(
        "--scheduler",
        "run the points on a Dask cluster: tcp://host:8786, or its scheduler file; rows do not depend on it",
        default="",
        metavar="ADDRESS|FILE",
    )
    parser.option("--time-limit-s", "longest time for one point", number(float, 1e-3, 1e7), time_limit_s)
    parser.flag("--dry-run", "print points and frames; measure nothing")


def options_of(args: argparse.Namespace, parser: argparse.ArgumentParser, *, command: str = "") -> Options:
    """`Options` from the arguments of `add_options`; ends the program with one line for a wrong value."""
    if args.resume and args.out is None:
        parser.error("--resume needs --out with the folder of the run to complete")
    given = {f.name: getattr(args, f.name) for f in fields(Options) if f.name != "command"}
    return Options(**given, command=command)


def names_of(parser: Parser, option: str, text: str, known: Collection[str]) -> tuple[str, ...]:
    """Names separated by commas, each known and unique; ends the program with one line otherwise.

    A repeated name would double its rows and its time.
    """
    names = tuple(name.strip() for name in text.split(","))
    for k, name in enumerate(names):
        if name not in known:
            parser.error(f"{option} names {name[:40]!r}; known: {', '.join(known)}")
        if name in names[:k]:
            parser.error(f"{option} names {name!r} more than once; leave one")
    return names


# options on which no row depends
_NO_ROW = frozenset(("out", "resume", "by", "publish", "jobs", "scheduler", "time_limit_s", "dry_run"))


def command_of(args: argparse.Namespace, parser: Parser) -> str:
    """Command that reproduces the rows: options that differ from their defaults, files by name only."""
    words = [typed(parser.program)]
    for action in parser._actions:
        default = parser.get_default(action.dest)
        value = vars(args).get(action.dest, default)  # none of --help
        if action.dest in _NO_ROW or value == default:
            continue
        option, values = (*action.option_strings, "")[0], value if isinstance(value, list) else [value]
        quoted = [shlex.quote(_word(one)) for one in values]
        if value is True:
            words.append(option)
        elif not option or action.nargs:
            words += [option, *quoted] if option else quoted
        else:
            words += [f"{option}={one}" for one in quoted]
    return " ".join(words)


def _word(value: object) -> str:
    if isinstance(value, tuple):
        return ",".join(map(_word, value))
    return value.name if isinstance(value, Path) else str(value)


def duration(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
