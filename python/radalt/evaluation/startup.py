"""Start of every command, before the import of NumPy and GNU Radio.

Its import sets, unless the environment does, one thread for the numerical libraries of this process and its workers,
and GNU Radio's log to warnings, since it logs every requested buffer size. Afterwards Ctrl-C and a missing package get
one line each; `engine.options.command` handles the end of a running program.
"""

import os
import sys
from types import TracebackType

from ..core.paths import say_other_installation

for _name, _value in (
    ("OMP_NUM_THREADS", "1"),
    ("OPENBLAS_NUM_THREADS", "1"),
    ("GR_CONF_LOG_LOG_LEVEL", "warn"),
):
    os.environ.setdefault(_name, _value)


def _one_line(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print one line for Ctrl-C during an import, and for a failed import."""
    if issubclass(kind, KeyboardInterrupt):
        print(f"{sys.argv[0]}: stopped", file=sys.stderr)
        sys.exit(130)
    if issubclass(kind, ImportError) and "RADALT_TRACEBACK" not in os.environ:
        hint = "run 'make setup', then .venv/bin/python; installed, use the Python it was installed for"
        print(f"{sys.argv[0]}: {sys.executable} cannot run it ({error}); {hint}", file=sys.stderr)
        sys.exit(2)
    sys.__excepthook__(kind, error, trace)


sys.excepthook = _one_line
say_other_installation()
