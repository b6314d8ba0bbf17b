"""First import of tools that use the package: puts ``flowgraphs/`` and ``python/`` on the path, as programs do."""

import sys
from pathlib import Path

FLOWGRAPHS = Path(__file__).resolve().parent.parent / "flowgraphs"
sys.path.insert(0, str(FLOWGRAPHS))

import _startup  # noqa: E402, F401 - found by the line above
