"""FMCW radar altimeter blocks for GNU Radio: `from gnuradio import radalt`.

One file a block: `radalt.<block>` is the class `<block>` of `<block>.py` in this folder, imported on
first use, so that a flowgraph loads (and needs) only what it contains. `dir(radalt)` lists the blocks.
Files whose name starts with an underscore are shared helpers, no blocks. `radalt.core` and
`radalt.evaluation` need no GNU Radio: with this package's parent folder on the path, `import radalt.core`
works under any Python.
"""

import importlib
import sys
from pathlib import Path
from types import ModuleType

__version__ = "0.1.0"

_HERE = Path(__file__).parent
_SUBPACKAGES = ("core", "evaluation")

__all__ = sorted(file.stem for file in _HERE.glob("*.py") if not file.stem.startswith("_"))


class _BlockPackage(ModuleType):
    """This package: binds a block's class under its name, where Python's import would bind the module."""

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and name in __all__:
            value = getattr(value, name, value)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _BlockPackage


def __getattr__(name: str) -> object:
    """Import the block or subpackage `name` (PEP 562); raises AttributeError where there is none."""
    if name not in __all__ and name not in _SUBPACKAGES:
        raise AttributeError(f"gnuradio.radalt has no block {name!r}; it has: {', '.join(__all__) or 'none'}")
    importlib.import_module(f".{name}", __name__)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBPACKAGES})
