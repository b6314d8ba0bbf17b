"""FMCW radar altimeters under interference: `import radalt` for Python, `from gnuradio import radalt` for flowgraphs.

`__all__` is what one calls from Python; it needs no GNU Radio (`radalt.api`). `radalt.<block>` is the class `<block>`
of `blocks/<block>.py`, a GNU Radio block. Each is imported on first use, so that a program loads, and needs, only what
it contains; `dir(radalt)` lists them where GNU Radio is.

Installed by CMake, Python packages lie in lib/gr-radalt of the same prefix. They come last on Python's path, so that
GNU Radio and other modules keep the NumPy they were built for.
"""

import contextlib
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import blocks as blocks
    from . import core as core
    from . import evaluation as evaluation
    from . import studies as studies
    from .api import Names, Report, evaluate, method, simulate
    from .core.altimeter.altimeter import Altimeter, AltimeterSettings
    from .core.mitigation import Mitigation
    from .core.scene import Scene, load_scene
    from .core.timing.auxiliary_cancel import AuxiliaryCancel
    from .core.tracker.tracker import AltitudeTracker, TrackerSettings
    from .core.waveform import Waveform

    methods: Names
    scenes: Names

__version__ = "0.3.0"

_FOLDER = Path("lib/gr-radalt/lib", "python{}.{}".format(*sys.version_info), "site-packages")
for _prefix in Path(__file__).resolve().parents:
    if (_prefix / _FOLDER).is_dir() and str(_prefix / _FOLDER) not in sys.path:
        sys.path.append(str(_prefix / _FOLDER))

_HOMES = {
    "Altimeter": "core.altimeter.altimeter",
    "AltimeterSettings": "core.altimeter.altimeter",
    "AltitudeTracker": "core.tracker.tracker",
    "TrackerSettings": "core.tracker.tracker",
    "AuxiliaryCancel": "core.timing.auxiliary_cancel",
    "Mitigation": "core.mitigation",
    "Report": "api",
    "Scene": "core.scene",
    "Waveform": "core.waveform",
    "evaluate": "api",
    "load_scene": "core.scene",
    "method": "api",
    "simulate": "api",
}
_LISTS = ("methods", "scenes")  # made anew each time: a plugin may have added to them
_SUBPACKAGES = ("blocks", "core", "evaluation", "studies")

__all__ = [
    "Altimeter",
    "AltimeterSettings",
    "AltitudeTracker",
    "AuxiliaryCancel",
    "Mitigation",
    "Report",
    "Scene",
    "TrackerSettings",
    "Waveform",
    "evaluate",
    "load_scene",
    "method",
    "methods",
    "scenes",
    "simulate",
]

# files whose name starts with an underscore are shared helpers, no blocks
_BLOCKS = sorted(file.stem for file in (Path(__file__).parent / "blocks").glob("[!_]*.py"))


def __getattr__(name: str) -> Any:
    """Import what is called `name` (PEP 562); raises AttributeError where there is nothing."""
    if name in _SUBPACKAGES:
        return importlib.import_module(f".{name}", __name__)
    if name in _LISTS:
        return getattr(importlib.import_module(".api", __name__), name)()
    home = _HOMES.get(name) or (f"blocks.{name}" if name in _BLOCKS else "")
    if not home:
        raise AttributeError(
            f"radalt has no {name!r}; it has: {', '.join(__all__)}; blocks: {', '.join(_BLOCKS) or 'none'}"
        )
    try:
        found = getattr(importlib.import_module(f".{home}", __name__), name)
    except ImportError as error:
        if (error.name or "").split(".")[0] not in ("gnuradio", "pmt"):
            raise
        raise ImportError(
            f"radalt.{name} is a GNU Radio block, and {sys.executable} has no GNU Radio; from Python alone use "
            f"{', '.join(_HOMES)}"
        ) from None
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    names = {*__all__, *(name for name in globals() if name.startswith("__"))}
    # a namespace package `gnuradio` with `radalt` only is no GNU Radio
    with contextlib.suppress(ImportError):
        names |= set(_BLOCKS) if importlib.util.find_spec("gnuradio.gr") else set()
    return sorted(names)
