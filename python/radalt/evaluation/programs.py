"""The command ``radalt``: one sub-command per program of ``flowgraphs/``, the same code.

``radalt eval --sim`` is ``flowgraphs/ota_eval.py --sim`` as installed. ``radalt env`` prints what a shell has to know
so that Python and GNU Radio Companion find a module below an unusual prefix.
"""

from __future__ import annotations

import importlib
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from ..core.paths import share_dir

__all__ = ["PROGRAMS", "load", "main"]

PROGRAMS = {
    "eval": "ota_eval",
    "collect": "collect",
    "landing": "landing_eval",
    "integrity": "integrity",
    "detection": "detection",
    "stability": "stability",
    "cancellation": "cancellation",
    "error-vs-runtime": "error_vs_runtime",
    "leaving-out": "leaving_out",
    "benchmark": "realtime_benchmark",
    "remote": "ota_remote",
    "control": "control_client",
    "gallery": "gallery",
    "screenshot": "screenshot",
    "make-landing-data": "make_landing_data",
    "make-recording": "make_recording",
    "make-flowgraphs": "make_flowgraphs",
}


def load(name: str) -> ModuleType:
    """The program behind a sub-command, with a help text that shows what is typed here; sets ``sys.argv[0]`` to it."""
    share = share_dir()
    folder = str(share / "flowgraphs")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    sys.argv[0] = f"radalt {name}"
    importlib.import_module("_startup")  # as in each program, before NumPy
    program = importlib.import_module(PROGRAMS[name])
    text = program.__doc__ or ""
    for other, script in PROGRAMS.items():
        text = text.replace(f".venv/bin/python flowgraphs/{script}.py", f"radalt {other}")
    for part in ("flowgraphs", "models"):
        text = text.replace(f" {part}/", f" {share / part}/")
    program.__doc__ = text
    return program


def main(argv: Sequence[str] | None = None) -> int:
    """Hand the rest of the command line to a program; returns its status, 2 after one line where there is none."""
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
    if name not in PROGRAMS:
        known = ", ".join([*PROGRAMS, "env"])
        print(f"radalt: no command {name[:40]!r}; there are {known}", file=sys.stderr)
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
    return program.main(words[1:])


def summaries() -> dict[str, str]:
    """First line of every program's docstring, read without importing it."""
    import ast

    folder = share_dir() / "flowgraphs"
    texts = {name: (folder / f"{script}.py").read_text("utf-8") for name, script in PROGRAMS.items()}
    return {n: (ast.get_docstring(ast.parse(text)) or "").splitlines()[0] for n, text in texts.items()}


def _overview() -> str:
    lines = [f"  {name:18} {text}" for name, text in summaries().items()]
    env = f'  {"env":18} What a shell has to know to find this installation: eval "$(radalt env)"'
    first = "usage: radalt COMMAND [options]\n\nFMCW radar altimeters under interference. COMMAND is one of"
    return "\n".join([first, "", *lines, env, "", "radalt COMMAND --help lists the options of each."])


def _environment() -> str:
    """Shell lines; none for what is found without."""
    from .flowgraph.generate import grc_dirs

    package = Path(__file__).absolute().parent.parent
    lines = []
    for name, value in (("PYTHONPATH", str(package.parent)), ("GRC_BLOCKS_PATH", grc_dirs()[0])):
        text = shlex.quote(value)
        lines.append(f'export {name}={text}"${{{name}:+:${name}}}"')
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
