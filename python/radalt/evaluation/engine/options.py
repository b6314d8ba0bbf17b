"""Options that every study's command line has; nothing here needs NumPy, so that a wrong Python gets one line."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

__all__ = [
    "Options",
    "Parser",
    "add_options",
    "command_of",
    "duration",
    "expected_errors",
    "options_of",
    "out_folder",
]


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
        Local worker processes.
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


MAX_JOBS = 256


class Parser(argparse.ArgumentParser):
    """Description from a module's docstring; errors in one line, without the usage text."""

    def __init__(self, program: str, doc: str) -> None:
        summary, _, details = doc.partition("\n\n")
        super().__init__(
            prog=program,
            description=summary,
            epilog=details,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def error(self, message: str) -> NoReturn:
        """One line, status 2."""
        text = " ".join(message.split())
        self.exit(2, f"{self.prog}: {text if len(text) <= 280 else text[:277] + '...'}\n")


def out_folder(text: str) -> Path:
    """A result folder from the command line; an empty name would be the working directory."""
    if not text.strip() or "\0" in text:
        raise argparse.ArgumentTypeError(f"{text!r} names no folder; give one, such as results/mine")
    return Path(text)


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
    add("--out", type=out_folder, default=out and Path(out), help=f"result folder{default}")
    add("--resume", action="store_true", help="complete the run that --out holds")
    add(
        "--publish",
        type=out_folder,
        metavar="DIR",
        help="at the end, copy page, figures and data into DIR under the names that the documentation links to",
    )
    add("--jobs", type=int, default=2, help="local worker processes (default: %(default)s); changes no row")
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS|FILE",
        help="spread the points over a Dask cluster: tcp://host:8786, or its scheduler file; changes no row",
    )
    add(
        "--time-limit-s",
        type=float,
        default=time_limit_s,
        help="longest time for one point (default: %(default)g)",
    )
    if sampled:
        add(
            "--precision",
            type=float,
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
    if not 1 <= args.jobs <= MAX_JOBS:
        parser.error(f"--jobs is {args.jobs}; it has to be within 1..{MAX_JOBS}")
    if not 0 < args.time_limit_s < 1e7:
        parser.error(f"--time-limit-s is {args.time_limit_s:g}; it has to be above 0 and below 1e7")
    precision = getattr(args, "precision", None)
    if precision is not None and not 0.001 <= precision <= 0.5:
        parser.error(f"--precision is {precision:g}; it is half the width of an interval of Pd, 0.001..0.5")
    if args.resume and args.out is None:
        parser.error("--resume needs --out with the folder of the run to complete")
    return Options(
        out=args.out,
        resume=args.resume,
        jobs=args.jobs,
        scheduler=args.scheduler,
        time_limit_s=args.time_limit_s,
        precision=precision,
        command=command,
        publish=args.publish,
    )


# how a run is done, which changes none of its rows
_NO_ROW = frozenset(("out", "resume", "publish", "jobs", "scheduler", "time_limit_s", "dry_run"))


def command_of(args: argparse.Namespace, parser: argparse.ArgumentParser) -> str:
    """The command that makes the same rows: the options that differ from their defaults, files by name alone."""
    words = [f"python flowgraphs/{parser.prog}.py"]
    for name, value in vars(args).items():
        if name in _NO_ROW or value == parser.get_default(name):
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
    """What a user can mend: every error class of this package, and what the system says of files."""
    from ...core.mitigation import MitigationError
    from ...core.radio.calibration import CalibrationError
    from ...core.radio.interlock import InterlockError
    from ...core.radio.recording import RecordingError
    from ...core.returns.terrain import TerrainError, TrajectoryError
    from ...core.scene import SceneError
    from ..flowgraph import FlowgraphError
    from ..landing.config import StudyError
    from ..results.folder import FolderError
    from .pool import WorkerError
    from .precision import PrecisionError

    own = (SceneError, MitigationError, CalibrationError, InterlockError, RecordingError, TerrainError)
    return (
        *own,
        TrajectoryError,
        FlowgraphError,
        StudyError,
        FolderError,
        WorkerError,
        PrecisionError,
        OSError,
    )


def duration(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
