"""What every program here imports first: the package on Python's path, and `radalt.evaluation.startup`.

In the source tree the package lies next to this folder; installed, Python finds it itself, and a Python that does not
gets one line.
"""

import sys


def _stopped(kind: type, error: BaseException, trace: object) -> None:
    """Ctrl-C from the first line on."""
    if issubclass(kind, KeyboardInterrupt):
        print(f"{sys.argv[0]}: stopped", file=sys.stderr)
        sys.exit(130)
    sys.__excepthook__(kind, error, trace)


sys.excepthook = _stopped

import importlib.util  # noqa: E402 - after the hook
from pathlib import Path  # noqa: E402

_PACKAGE = Path(__file__).resolve().parent.parent / "python"
if (_PACKAGE / "radalt").is_dir():
    sys.path.insert(0, str(_PACKAGE))
elif importlib.util.find_spec("radalt") is None:
    sys.stderr.write(f"{sys.executable} finds no radalt; use the Python it was installed for\n")
    sys.exit(2)

import radalt.evaluation.startup  # noqa: E402, F401 - once the package is found
