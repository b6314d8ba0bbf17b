"""Emitters by their name in a scene: one file each, named as in a scene and imported on first use.

A new emitter is a file here, or a class anywhere that is passed to `register` (docs/design.md, "Add an interferer").
"""

import importlib
import pkgutil
from typing import ClassVar, TypeVar

import numpy as np

from ...parsing import Settings
from ...plugins import load_plugins

__all__ = ["NamedEmitter", "emitter_class", "emitter_names", "register"]


class NamedEmitter(Settings):
    """Base of an emitter that a scene can name: a frozen dataclass whose fields are its keys in the scene.

    It adds the emitter's names to what placement needs (`radalt.core.interference.placement.Emitter`). A class
    defines ``begin(rate_hz, rng)``, which draws a transmission and returns its samples as a function of ``(first,
    count)``; or ``samples``, if windows of it have nothing to do with each other.

    ``scene_name``: key in a scene's ``interference``; for an emitter in this folder also the name of its file.
    """

    scene_name: ClassVar[str] = ""

    @property
    def label(self) -> str:
        """Short name in rows and figures, without blanks; the emitter's parameters may be part of it."""
        return self.scene_name

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 samples of a transmission that begins anew; see `Emitter`."""
        return self.begin(rate_hz, rng)(0, count)

    def title(self, band_hz: float) -> str:
        """The emitter in words, for headings; ``band_hz`` is the radar's bandwidth."""
        return self.scene_name.replace("_", " ")

    @property
    def stated_sir_db(self) -> float | None:
        """SIR by the emitter's link budget, in decibels; None leaves it to the scene."""
        return None

    def notes(self, rate_hz: float) -> tuple[str, ...]:
        """Lines for the report; ``rate_hz`` is the radar's sample rate."""
        return ()


_Class = TypeVar("_Class", bound=type[NamedEmitter])
_CLASSES: dict[str, type[NamedEmitter]] = {}
_FILES = tuple(file.name for file in pkgutil.iter_modules(__path__) if not file.name.startswith("_"))


def register(cls: _Class) -> _Class:
    """Class decorator: makes an emitter known to scenes by its ``scene_name``.

    Raises `ValueError` if the name is empty, or another class has it.
    """
    name = cls.scene_name
    if not name.isidentifier():
        raise ValueError(f"{cls.__name__}.scene_name is {name!r}; give it letters, digits and underscores")
    here = cls.__module__ == f"{__name__}.{name}"
    other = _CLASSES.get(name)
    taken = other is not None and (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__)
    if taken or (name in _FILES and not here):
        raise ValueError(f"{cls.__name__}.scene_name {name!r} is taken; choose another")
    _CLASSES[name] = cls
    return cls


def emitter_names() -> tuple[str, ...]:
    """Names that a scene can use: the files of this folder, then registered emitters."""
    return (*_FILES, *(name for name in _CLASSES if name not in _FILES))


def emitter_class(name: str) -> type[NamedEmitter]:
    """Emitter dataclass by its name in a scene; imports its file on first use. KeyError where there is none."""
    if name not in _CLASSES and name in _FILES:
        importlib.import_module(f".{name}", __name__)
    return _CLASSES[name]


load_plugins()
