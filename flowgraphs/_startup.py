"""What every command-line program here does before it imports NumPy, GNU Radio or this package: ``import _startup``.

A script's own folder is the first that Python searches, in the source tree and where it is installed. Importing this
sets, unless the environment says otherwise, one core for every process that computes, the workers' too, and GNU Radio's
log to warnings, since it tells of every buffer size that is asked for. In the source tree it puts the package on the
path; installed, Python finds that itself.

`Parser` and `command` are how each of them ends: with a result, or with status 2 and one line.
"""

from __future__ import annotations

import sys


def _interrupted(kind: type, error: BaseException, trace: object) -> None:
    """Ctrl-C while something is imported: one line, as afterwards."""
    if issubclass(kind, KeyboardInterrupt):
        print(f"{sys.argv[0]}: stopped", file=sys.stderr)
        sys.exit(130)
    sys.__excepthook__(kind, error, trace)


sys.excepthook = _interrupted

import argparse  # noqa: E402 - after the hook
import functools  # noqa: E402
import os  # noqa: E402
from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import NoReturn  # noqa: E402

_MOST = 300  # characters of the one line
MOST_SEED = 2**63 - 1
MOST_JOBS = 256

for _name, _value in (
    ("OMP_NUM_THREADS", "1"),
    ("OPENBLAS_NUM_THREADS", "1"),
    ("GR_CONF_LOG_LOG_LEVEL", "warn"),
):
    os.environ.setdefault(_name, _value)

_PACKAGE = Path(__file__).resolve().parent.parent / "python"
if (_PACKAGE / "radalt").is_dir():
    sys.path.insert(0, str(_PACKAGE))


def complain(program: str, error: object) -> None:
    """One line of at most 300 characters to stderr; of a longer one the middle goes: the remedy stands last."""
    text = f"{program}: {' '.join(str(error).split()) or type(error).__name__}"
    text = "".join(c if c.isprintable() else "?" for c in text)
    if len(text) > _MOST:
        half = (_MOST - 5) // 2
        text = f"{text[:half]} ... {text[-half:]}"
    print(text, file=sys.stderr)


class Parser(argparse.ArgumentParser):
    """Errors in one line, without the usage text."""

    def error(self, message: str) -> NoReturn:
        complain(self.prog, f"{message}; --help lists the options")
        sys.exit(2)


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


def command(program: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """A ``main`` whose refusals are one line and status 2, and Ctrl-C 130, imports included.

    Caught is what this package and what it stands on raise for wrong input and failing machines; others keep their
    traceback. With ``RADALT_TRACEBACK`` in the environment all do.
    """

    def decorate(main: Callable[..., int]) -> Callable[..., int]:
        @functools.wraps(main)
        def guarded(*args: object, **options: object) -> int:
            try:
                return main(*args, **options)
            except (ValueError, RuntimeError, OSError, ImportError, MemoryError) as error:
                if "RADALT_TRACEBACK" in os.environ:
                    raise
                complain(program, error)
                return 2
            except KeyboardInterrupt:
                complain(program, "stopped")
                return 130

        return guarded

    return decorate
