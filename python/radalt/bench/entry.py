"""One chain from frames to altitudes: reset rule, method, altimeter, and what both cost."""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import fft

from ..core.altimeter.altimeter import AltimeterSettings
from ..core.mitigation import METHODS, Mitigation, create, name_method
from ..core.parsing import InputError, build, shown
from ..core.paths import model_path
from ..core.scene import Scene
from ..core.waveform import Waveform
from ..evaluation.results.score import trials_of
from ..evaluation.simulation import MethodPath
from .frames import Frames
from .textbook import textbook_results

_TIMED = 8  # frames whose cost is taken, one per call
_KEYS = ("method", "options", "altimeter", "detector")
_Pairs = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Entry:
    """A method under the name that rows have for it."""

    name: str
    method: str
    options: _Pairs = ()  # of the method
    altimeter: _Pairs = ()  # settings of the altimeter that differ from the case's
    detector: str = ""
    """``"textbook"`` for the reference altimeter (`textbook`), which shares no code with ours; else empty."""

    @classmethod
    def of(cls, name: str, keys: Mapping[str, Any], where: str) -> "Entry":
        """An entry of a list; a model is a file, or the name of a shipped one. Raises ValueError, one line."""
        unknown = [key for key in keys if key not in _KEYS]
        if unknown:
            raise InputError(f"{where}.{name}: unknown key {shown(unknown[0])}; allowed: {', '.join(_KEYS)}")
        method = str(keys.get("method", name))
        if method not in METHODS:
            raise InputError(f"{where}.{name}: no method {shown(method)}; there are {', '.join(METHODS)}")
        if keys.get("detector", "") not in ("", "textbook"):
            raise InputError(f"{where}.{name}.detector is {shown(keys['detector'])}; allowed: textbook")
        wrong = [key for key in ("options", "altimeter") if not isinstance(keys.get(key) or {}, dict)]
        if wrong:
            raise InputError(f"{where}.{name}.{wrong[0]} is {shown(keys[wrong[0]])}; give a mapping of keys")
        options, altimeter = (dict(keys.get(key) or {}) for key in ("options", "altimeter"))
        build(AltimeterSettings, altimeter, f"{where}.{name}.altimeter")
        model = options.get("model")
        if model is not None and not Path(model).is_file():
            options["model"] = str(model_path(str(model)))
        pairs = (tuple(options.items()), tuple(altimeter.items()))
        return cls(name, method, *pairs, str(keys.get("detector", "")))

    def register(self) -> None:
        """Make a name of the user's own known to this process; a worker has not seen it."""
        if "method" in dict(self.options):
            name_method(self.method, dict(self.options)["method"])

    def build(self, waveform: Waveform) -> Mitigation:
        """The method alone; raises `MitigationError` where it does not fit."""
        self.register()
        return create(self.method, waveform, **dict(self.options))

    def path(self, scene: Scene) -> MethodPath:
        """Method and altimeter as a scene needs them."""
        settings = dataclasses.replace(scene.altimeter_settings, **dict(self.altimeter))
        return MethodPath(scene, self.method, dict(self.options), settings)


@dataclass(frozen=True, eq=False)
class Outcome:
    """(trials,) altimeter's results, counters of the method, and cost per frame in milliseconds and FFTs."""

    results: np.ndarray
    diverged: int
    ms: float
    ffts: float


def run(entry: Entry, frames: Frames) -> Outcome:
    """Results of an entry on the frames of a level, equal to the flowgraph's rows to the bit.

    The cost is CPU time of method and altimeter for frames one at a time, over an FFT of the frame in the same thread.
    """
    path = entry.path(frames.scene)
    quality = None if "max_altitude_m" in dict(entry.altimeter) else frames.quality  # of the case's span
    if entry.detector:
        cleaned, settings = path.clean(frames.samples, quality), path.altimeter.settings
        results = textbook_results(cleaned, frames.scene.waveform, settings, frames.offset_s, frames.index)
    else:
        path.take(frames.samples, quality, frames.index, frames.offset_s)
        results = path.results()
    diverged = 0 if path.method is None else path.method.diverged_frames
    # a reference has no cost to compare
    some = frames.samples[frames.trial][-_TIMED:] if not entry.detector else ()
    ms, unit = np.median(list(costs(path, some)) or [(np.nan, 1.0)], axis=0)
    return Outcome(results[frames.trial], diverged, float(ms), float(ms / unit))


def flowgraph_of(entry: Entry, scene: Scene, folder: Path) -> Callable[[Scene], np.ndarray]:
    """The generated flowgraph of an entry: from a level's scene to (trials,) altimeter's results.

    Raises InputError for the textbook's altimeter, which is no block.
    """
    from ..evaluation.flowgraph.generate import prepare
    from ..evaluation.flowgraph.run import run_point

    if entry.detector:
        raise InputError(
            f"{entry.name}: the textbook's altimeter is no block; leave it out of --methods, or run it --via direct"
        )
    prepared = prepare(scene, (entry.method,), folder)

    def played(scene: Scene) -> np.ndarray:
        options = {**scene.method_options, entry.method: dict(entry.options)}
        altimeter = dataclasses.replace(scene.altimeter, **dict(entry.altimeter))
        own = dataclasses.replace(scene, methods=(entry.method,), method_options=options, altimeter=altimeter)
        return trials_of(run_point(prepared, own).results[entry.method], own.altitude.programme)[0]

    return played


def costs(path: MethodPath, frames: np.ndarray) -> Iterator[tuple[float, float]]:
    """CPU milliseconds of method and altimeter for each frame, called one at a time, and of an FFT of it."""
    for frame in frames:
        begin = time.thread_time_ns()
        path.altimeter.process(frame[None] if path.method is None else path.method.process(frame[None]))
        middle = time.thread_time_ns()
        fft.fft(frame)
        end = time.thread_time_ns()
        yield 1e-6 * (middle - begin), 1e-6 * max(end - middle, 1)
