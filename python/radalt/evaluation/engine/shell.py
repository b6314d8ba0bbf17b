"""Common parts of the studies' commands: parser, options of the engine, run, exit status.

A study's room holds one `command.py`, which the command ``radalt`` finds by scanning (`evaluation/programs.py`). This
module does not import NumPy, so that ``--help`` is fast.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .options import MAX_SEED, Parser, add_options, command, command_of, names_of, number, options_of
from .study import Study


def add_methods(parser: Parser, default: str) -> None:
    """``--methods``; `StudyCommand` converts it to a tuple of known names."""
    parser.option("--methods", "methods separated by commas", default=default)


def add_frames(parser: Parser, default: int, what: str, *, low: int = 1, high: int = 2_000_000) -> None:
    """``--frames``."""
    parser.option("--frames", what, number(int, low, high), default)


def add_seed(parser: Parser, default: int) -> None:
    """``--seed``."""
    parser.option("--seed", "", number(int, 0, MAX_SEED), default)


@dataclass(frozen=True)
class StudyCommand:
    """The command of a study."""

    program: str  # name of the entry in ``flowgraphs/``
    module: str  # ``__name__`` of the study's module, whose docstring has summary and examples
    arguments: Callable[[Parser], None]  # adds the options of the study
    # of arguments and parser: returns the study, or the exit status of options that run something else
    study: Callable[[argparse.Namespace, Parser], Study | int]
    # describes a measured point in a line
    describe: Callable[[Sequence[dict[str, Any]]], str]
    # of result folder, arguments and study: prints a summary, and may return an exit status other than 0
    after: Callable[[Path, argparse.Namespace, Any], int | None] = lambda folder, args, study: None
    out: str = ""  # default result folder; "" for ``results/PROGRAM``
    time_limit_s: float = 600.0  # default of ``--time-limit-s``

    def parser(self) -> Parser:
        """The command line."""
        parser = Parser(self.program, sys.modules[self.module].__doc__ or "")
        self.arguments(parser)
        out = self.out or f"results/{self.program}"
        add_options(parser, out=out, time_limit_s=self.time_limit_s)
        return parser

    def main(self, argv: Sequence[str] | None = None) -> int:
        """Run the study; returns 0, the status of ``after``, 2 after one line about an error, 130 when interrupted."""
        return command(self.program)(self._main)(argv)

    def _main(self, argv: Sequence[str] | None) -> int:
        parser = self.parser()
        args = parser.parse_args(argv)
        options = options_of(args, parser, command=command_of(args, parser))
        from .command import main as run

        if getattr(args, "methods", None) is not None:
            from ...core.mitigation import METHODS

            args.methods = names_of(parser, "--methods", args.methods, METHODS)
        study = self.study(args, parser)
        if isinstance(study, int):
            return study
        study.check()
        own = {"program": self.program, "dry_run": args.dry_run, "describe": self.describe}
        return run(study, options, **own, after=lambda folder: self.after(folder, args, study))
