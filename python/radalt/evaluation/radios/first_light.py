"""The first hour on two radios: the bench, and the order of its steps with a verdict and a likely cause for each check.

`Bench.fly` flies a short programme by `run_hardware`, with its interlock and gates before every transmitter, or in
simulation. Titles, limits and causes are in first_light.yaml, measurements in `first_light_steps`.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.channel.settings import ChannelSettings
from ...core.parsing import load_yaml
from ...core.radio.interlock import require_enclosure
from ...core.radio.levels import drive
from ...core.radio.recording import Stretch, open_capture, write_metadata
from ...core.scene import Scene
from ...core.text import said
from ..engine.options import EXPECTED
from ..flowgraph.rewrite import RADAR_GATE
from ..results.folder import writing
from ..simulation import TAIL_FRAMES, PointResult, found_latency, received, run_chain

_DATA = load_yaml(Path(__file__).with_suffix(".yaml"), what="steps")
STEPS: dict[str, dict[str, Any]] = _DATA["steps"]
CABLING: str = _DATA["cabling"]
_LATENCY = 150.3  # samples, of the simulated bench: with a fraction, as on a real one


@dataclass(frozen=True)
class Check:
    """One measured value with its limits and the likely cause of one beyond them; without a value it was skipped."""

    step: str
    what: str
    value: float | None
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    cause: str = ""

    @property
    def verdict(self) -> str:
        """``pass``, ``fail`` or ``skipped``; a value that is not a number fails."""
        if self.value is None:
            return "skipped"
        return "pass" if self.low <= self.value <= self.high else "fail"

    @property
    def limit(self) -> str:
        """The limits in words."""
        parts = (("at least", self.low), ("at most", self.high))
        return ", ".join(f"{word} {value:.4g}" for word, value in parts if math.isfinite(value)) or "none"

    @property
    def shown(self) -> str:
        """The value with its unit; a dash without one."""
        return "-" if self.value is None else f"{self.value:.4g} {self.unit}".strip()


class Measured(NamedTuple):
    """What a step yields: a check's key in first_light.yaml, its value, and what is not in that file."""

    key: str
    value: float | None
    detail: str = ""
    cause: str = ""
    low: float | None = None


Measure = Callable[["Bench"], Iterable[Measured]]


@dataclass(frozen=True)
class Flight:
    """A programme that was flown: (n,) complex64 ``samples`` by the sample counter, full scale 1, NaN where lost."""

    scene: Scene
    result: PointResult
    samples: np.ndarray
    latency: float  # samples; NaN where the sweep was not found

    def frames(self, first: int, last: int, latency: float | None = None) -> np.ndarray:
        """(last - first, N) samples of sweeps ``first..last-1``, from the whole sample before each begins."""
        n = self.scene.waveform.samples_per_frame
        start = first * n + math.floor(self.latency if latency is None else latency)
        return self.samples[start : start + (last - first) * n].reshape(-1, n)


@dataclass
class Bench:
    """Two radios and what is between them, or their simulation; recordings go below ``folder``.

    ``frames`` at each altitude, ``starts`` whose latencies are compared, ``minutes`` of the last step. Found by steps:
    ``known``, powers ``noise`` and ``level`` (full scale 1) and ``latency`` in samples; ``serials`` of radios.
    """

    scene: Scene
    folder: Path
    simulated: bool = False
    transmit: bool = False
    frames: int = 15
    starts: int = 10
    minutes: float = 10.0
    log: Callable[[str], None] = print
    sleep: Callable[[float], None] = time.sleep
    known: dict[str, float] = field(default_factory=dict)
    serials: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        require_enclosure(self.scene, self.transmit, radios=not self.simulated)
        if self.simulated:
            # 18 dB above the shortest burst of the steps, but the return stays well above a 12-bit step
            rail = min(90.0, 8.0 * 10.0 ** (max(0.0, 6.0 - self.scene.sir_db) / 20.0))
            path = {"snr_db": 30.0, "start_offset_samples": _LATENCY, "dc_offset": 1e-3, "iq_gain_db": 0.05}
            channel = ChannelSettings(adc_bits=12, full_scale=rail, **path)
            self.scene = dataclasses.replace(self.scene, channel=channel)

    def programme(self, *altitudes_m: float, jammer: bool = False, frames: int = 0, **changes: Any) -> Scene:
        """The scene with these altitudes, `frames` at each, and without interference unless ``jammer``."""
        flown = {"programme_m": altitudes_m, "frames": frames or self.frames, "mode": "synthetic"}
        if not jammer:
            changes |= {"interference": (), "total_sir_db": None}
        altitude = dataclasses.replace(self.scene.altitude, **flown)
        return dataclasses.replace(self.scene, altitude=altitude, **changes)

    def drive_db(self, scene: Scene) -> float:
        """Level of the radar by its digital drive (``fullscale``) in a scene."""
        return 0.0 if self.simulated else -20.0 * math.log10(drive(scene).radar_full_scale)

    def fly(
        self,
        scene: Scene,
        methods: Sequence[str] = ("none",),
        *,
        capture: str = "",
        silent: Collection[str] = (),
        time_limit_s: float = 300.0,
    ) -> Flight:
        """Fly a programme once. ``capture`` names the recording that is kept; ``silent`` gates send zeros."""
        samples = np.empty(0, np.complex64)
        if self.simulated:
            sends = RADAR_GATE not in silent
            result = run_chain(scene, methods if sends else ())
            latency = found_latency(scene) if sends else math.nan
            samples = simulated_samples(scene, radar_sends=sends) if capture else samples
        else:
            from .hardware import run_hardware

            file = self._file(capture) if capture else None
            own = {"transmit": self.transmit, "log": self.log, "sleep": self.sleep, "use_calibration": False}
            own |= {"capture": file, "silent": tuple(silent), "time_limit_s": time_limit_s}
            result = run_hardware(scene, methods, **own)
            latency = float(result.segmenter["latency_samples"])
            if file is not None:
                samples = _heard(file, scene)
        if capture:
            self._save(capture, scene, samples, latency)
        return Flight(scene, result, samples / np.float32(self._full_scale), latency)

    @property
    def lo_centred(self) -> dict[str, Any]:
        """Changes of a scene that put the LO in the middle of the band: DC and the IQ image are seen there alone."""
        return {"radio": dataclasses.replace(self.scene.radio, lo_offset_hz=0.0)}

    def listen(self, frames: int) -> np.ndarray:
        """(frames, N) samples with every transmitter off: none is opened; the LO is in the middle of the band."""
        scene = self.programme(0.0, frames=frames, **self.lo_centred)
        count = frames * scene.waveform.samples_per_frame
        if self.simulated:
            heard = simulated_samples(scene, radar_sends=False)[:count]
        else:
            from .hardware import receive_alone

            heard = receive_alone(scene, count, sleep=self.sleep, log=self.log)
        self._save("receiver", scene, heard, 0.0)
        return (heard / np.float32(self._full_scale)).reshape(frames, -1)

    @property
    def _full_scale(self) -> float:
        return self.scene.channel.full_scale if self.simulated else 1.0

    def _file(self, name: str) -> Path:
        (self.folder / "captures").mkdir(parents=True, exist_ok=True)
        return self.folder / "captures" / name

    def _save(self, name: str, scene: Scene, samples: np.ndarray, latency: float) -> None:
        """Keep samples as SigMF: a capture for each stretch without loss."""
        there = np.isfinite(samples)
        edges = np.flatnonzero(np.diff(np.r_[False, there, False])).reshape(-1, 2)
        starts = np.cumsum([0, *np.diff(edges, axis=1)[:, 0]])
        data = self._file(f"{name}.sigmf-data")
        with writing(data):
            data.write_bytes(samples[there].tobytes())
        stretches = [Stretch(int(s), int(a), int(b - a)) for s, (a, b) in zip(starts, edges, strict=False)]
        own = {"latency_samples": np.nan_to_num(latency), "radio": {"full_scale": self._full_scale}}
        write_metadata(data, scene, stretches, recorder="radalt first-light", **own)


def _heard(file: Path, scene: Scene) -> np.ndarray:
    """A radio's recording by the sample counter, up to the programme's end; NaN where samples are missing."""
    w, frames = scene.waveform, scene.altitude.programme.total_frames + TAIL_FRAMES
    samples = np.full(frames * w.samples_per_frame, np.nan, np.complex64)
    recording = open_capture(file.with_name(f"{file.name}.sigmf-meta"))
    for counter, block in recording.blocks(w.rate_hz):
        end = min(samples.size, counter + block.size)
        samples[counter:end] = block[: max(0, end - counter)]
    return samples


def simulated_samples(scene: Scene, *, radar_sends: bool) -> np.ndarray:
    """What the simulated channel gives over a programme."""
    frames = scene.altitude.programme.total_frames + TAIL_FRAMES
    return np.concatenate([samples for _, samples in received(scene, frames, radar_sends=radar_sends)])


def perform(bench: Bench, steps: Mapping[str, Measure]) -> Iterator[Check]:
    """The checks of every step in order, to the end whatever fails.

    What the set-up or UHD refuses is a failed check: a device that is not there, a value that a step cannot use.
    """
    for name, measure in steps.items():
        step = STEPS[name]
        why = "the scene has no interference" if step.get("jammer") and not bench.scene.has_jammer else ""
        if step.get("needs", "") not in ("", *bench.known):
            why = why or f"needs the {step['needs']} that an earlier step did not find"
        if why:
            yield Check(name, step["title"], None, cause=why)
            continue
        try:
            for key, value, detail, cause, low in measure(bench):
                given = {"what": key, **step["checks"][key]} | ({} if low is None else {"low": low})
                given |= {"what": given["what"].format(detail=detail)} | ({"cause": cause} if cause else {})
                yield Check(name, value=value, **given)
        except EXPECTED as error:
            yield Check(name, "run", math.nan, cause=" ".join(said(error).split())[:300])
