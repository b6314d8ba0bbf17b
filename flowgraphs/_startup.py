"""What every command-line program here does before it imports NumPy, GNU Radio or this package: ``import _startup``.

A script's own folder is the first that Python searches, in the source tree and where it is installed. Importing this
sets, unless the environment says otherwise, one core for every process that computes, the workers' too, and GNU Radio's
log to warnings, since it tells of every buffer size that is asked for. In the source tree it puts the package on the
path; installed, Python finds that itself, and a Python that does not gets one line. It comes before every other import,
since Ctrl-C gets its one line from here on; how a program ends once it runs is `engine.options.command`'s.
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

import importlib.util  # noqa: E402 - after the hook
import os  # noqa: E402
from pathlib import Path  # noqa: E402

for _name, _value in (
    ("OMP_NUM_THREADS", "1"),
    ("OPENBLAS_NUM_THREADS", "1"),
    ("GR_CONF_LOG_LOG_LEVEL", "warn"),
):
    os.environ.setdefault(_name, _value)

_PACKAGE = Path(__file__).resolve().parent.parent / "python"
if (_PACKAGE / "radalt").is_dir():
    sys.path.insert(0, str(_PACKAGE))
elif importlib.util.find_spec("radalt") is None:
    sys.stderr.write(f"{sys.executable} finds no radalt; use the Python it was installed for\n")
    sys.exit(2)
