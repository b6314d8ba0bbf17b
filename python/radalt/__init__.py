"""FMCW radar altimeter blocks for GNU Radio: `from gnuradio import radalt`.

`radalt.<block>` is the class `<block>` of `blocks/<block>.py`, imported on first use, so that a flowgraph loads (and
needs) only what it contains. `dir(radalt)` lists the blocks. `radalt.core` and `radalt.evaluation` need no GNU Radio:
with this package's parent folder on the path, `import radalt.core` works under any Python.

Installed, Python packages lie in lib/gr-radalt of the same prefix. They come last on Python's path, so that GNU Radio
and other modules keep the NumPy they were built for.
"""

import importlib
import sys
from pathlib import Path

__version__ = "0.2.0"

_FOLDER = Path("lib/gr-radalt/lib", "python{}.{}".format(*sys.version_info), "site-packages")
for _prefix in Path(__file__).resolve().parents:
    if (_prefix / _FOLDER).is_dir() and str(_prefix / _FOLDER) not in sys.path:
        sys.path.append(str(_prefix / _FOLDER))

_SUBPACKAGES = ("blocks", "core", "evaluation")

# files whose name starts with an underscore are shared helpers, no blocks
__all__ = sorted(file.stem for file in (Path(__file__).parent / "blocks").glob("[!_]*.py"))


def __getattr__(name: str) -> object:
    """Import the block or subpackage `name` (PEP 562); raises AttributeError where there is none."""
    if name in _SUBPACKAGES:
        return importlib.import_module(f".{name}", __name__)
    if name not in __all__:
        raise AttributeError(f"gnuradio.radalt has no block {name!r}; it has: {', '.join(__all__) or 'none'}")
    block = getattr(importlib.import_module(f".blocks.{name}", __name__), name)
    globals()[name] = block
    return block


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBPACKAGES})
