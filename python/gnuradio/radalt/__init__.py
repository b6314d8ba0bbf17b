"""`gnuradio.radalt`, the name by which GNU Radio's flowgraphs import the package `radalt`: the same module objects.

Two names of one file would load it twice: two `Scene` classes, two registries of methods. So this module replaces
itself by `radalt`, and a finder in front of Python's own gives `radalt.X` where `gnuradio.radalt.X` is imported. An
entry of `sys.modules` for the root alone would not do: Python would find its submodules by path and load them again.
"""

import importlib
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType

import radalt
from radalt.core.paths import say_other_installation


class _SameModules(MetaPathFinder, Loader):
    """Finds and loads `gnuradio.radalt.X` as the module `radalt.X`."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        return spec_from_loader(name, self) if name.startswith(f"{__name__}.") else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(spec.name.removeprefix("gnuradio."))
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = module.__spec__.loader_state  # importlib has just written the other name's there


sys.meta_path.insert(0, _SameModules())
sys.modules[__name__] = radalt
say_other_installation()
