"""The command ``radalt``: one sub-command per study and per program of the bench, found by a scan of their modules.

``radalt eval --sim`` is the installed form of ``flowgraphs/ota_eval.py --sim``. A command is a module
`evaluation/commands/X.py`, `bench/command.py` or `studies/X/command.py` with a docstring, a ``main``, a ``_parser``
and its names: ``PROGRAM, COMMAND = "script", "word"``. ``radalt env`` prints the shell variables by which Python and
GNU Radio Companion find a module below an unusual prefix.
"""

import ast
import importlib
import re
import shlex
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from ..core.paths import share_dir

_PACKAGE = Path(__file__).resolve().parents[1]
_NAMES = re.compile(r'^PROGRAM, COMMAND = "(\w+)", "([\w-]+)"$', re.MULTILINE)
# commands until 0.3.0, and what measures the same
_MOVED = {
    "cancellation": "radalt bench evm",
    "detection": "radalt bench detection, and radalt bench null without a return",
    "error-vs-runtime": "radalt bench runtime",
}


class Program(NamedTuple):
    """A command."""

    script: str  # entry in ``flowgraphs/``
    file: Path  # file of the module


@lru_cache(maxsize=1)
def programs() -> dict[str, Program]:
    """Every command by its word: the bench's, then the studies', each in alphabetical order."""
    found = {}
    for pattern in ("evaluation/commands/[!_]*.py", "bench/command.py", "studies/*/command.py"):
        for file in sorted(_PACKAGE.glob(pattern)):
            names = _NAMES.search(file.read_text(encoding="utf-8"))
            if names is not None:
                found[names[2]] = Program(names[1], file)
    return found


def load(name: str) -> ModuleType:
    """Module of a sub-command; sets ``sys.argv[0]`` to ``radalt WORD``, as shown in its help text."""
    sys.argv[0] = f"radalt {name}"
    importlib.import_module(".startup", __package__)  # before NumPy
    module = ".".join(programs()[name].file.relative_to(_PACKAGE).with_suffix("").parts)
    program = importlib.import_module(f"..{module}", __package__)
    text = program.__doc__ or ""
    for other, found in programs().items():
        text = text.replace(f".venv/bin/python flowgraphs/{found.script}.py", f"radalt {other}")
    for part in ("flowgraphs", "models"):
        text = text.replace(f" {part}/", f" {share_dir() / part}/")
    program.__doc__ = text
    return program


def main(argv: Sequence[str] | None = None) -> int:
    """Run a program with the rest of the command line; returns its status, 2 after one line for an unknown one."""
    words = list(sys.argv[1:] if argv is None else argv)
    name = words[0] if words else "--help"
    if name in ("-h", "--help"):
        print(_overview())
        return 0
    if name == "--version":
        from .. import __version__

        print(f"radalt {__version__}")
        return 0
    if name == "env":
        print(_environment())
        return 0
    if name in _MOVED:
        return moved(name)
    if name not in programs():
        from ..core.parsing.messages import allowed  # NumPy comes with it

        print(f"radalt: no command {name[:40]!r}; {allowed(name, [*programs(), 'env'])}", file=sys.stderr)
        return 2
    try:
        program = load(name)
    except (ImportError, OSError) as error:
        print(f"radalt {name}: {sys.executable}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"radalt {name}: stopped", file=sys.stderr)
        return 130
    sys.argv = [f"radalt {name}", *words[1:]]
    status: int = program.main(words[1:])
    return status


def moved(name: str) -> int:
    """Say which command has taken the place of a former one; returns 2."""
    print(f"radalt: {name} is a list of the bench: {_MOVED[name]}", file=sys.stderr)
    return 2


def summaries() -> dict[str, str]:
    """First line of every program's docstring, read without importing it."""
    texts = {name: program.file.read_text("utf-8") for name, program in programs().items()}
    return {name: (ast.get_docstring(ast.parse(text)) or "").splitlines()[0] for name, text in texts.items()}


def _overview() -> str:
    lines = [f"  {name:18} {text}" for name, text in summaries().items()]
    env = f'  {"env":18} What a shell has to know to find this installation: eval "$(radalt env)"'
    first = "usage: radalt COMMAND [options]\n\nFMCW radar altimeters under interference. COMMAND is one of"
    return "\n".join([first, "", *lines, env, "", "radalt COMMAND --help lists the options of each."])


def _environment() -> str:
    """Shell lines for the variables that are needed."""
    from .flowgraph.generate import grc_dirs

    wanted = [("PYTHONPATH", _PACKAGE.parent), ("GRC_BLOCKS_PATH", Path(grc_dirs()[0]))]
    prefix = share_dir().parent.parent  # the installation's
    if (prefix / "bin" / "radalt").is_file():
        wanted += [("PATH", prefix / "bin"), ("MANPATH", prefix / "share" / "man")]
    lines = []
    for name, value in wanted:
        # an empty MANPATH entry stands for the system's pages
        rest = '":${MANPATH:-}"' if name == "MANPATH" else f'"${{{name}:+:${name}}}"'
        lines.append(f"export {name}={shlex.quote(str(value))}{rest}")
    return "\n".join(lines)
