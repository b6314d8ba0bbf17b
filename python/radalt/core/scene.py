"""Scenes: one YAML file into typed, validated, frozen dataclasses (DESIGN.md 7).

A wrong key, unit, range or type gives one line that names file, key, value and what is allowed.
"""

from __future__ import annotations

import dataclasses
import difflib
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .altimeter import AltimeterSettings
from .channel import ChannelSettings
from .interference import Interferer, QpskEmitter, ToneEmitter
from .paths import scene_path
from .programme import Programme
from .timing import SegmenterSettings
from .waveform import Waveform

__all__ = [
    "AltitudeSpec",
    "EMITTERS",
    "RadioSpec",
    "Scene",
    "SceneError",
    "SweepSpec",
    "load_scene",
    "parse_scene",
    "scene_to_mapping",
]

# emitter by its name in a scene
EMITTERS: dict[str, type] = {"qpsk": QpskEmitter, "tones": ToneEmitter}
_PLACEMENT = ("sir_db", "overlap", "start", "free_running")


class SceneError(ValueError):
    """A scene that cannot be used; the message is one line for the user."""


@dataclass(frozen=True)
class AltitudeSpec:
    """Which altitudes are flown, and how they are produced.

    Parameters
    ----------
    programme_m : tuple of float
        Altitudes from first to last.
    frames : int
        Frames at each altitude.
    mode : str
        ``"synthetic"`` shifts the beat in the source (works on the air), ``"true_delay"`` is played by the simulated
        channel.
    vertical_speed_m_per_s : float
        Range rate, for true delays.
    preamble_frames, sync_every_frames, sync_frames : int
        See `Programme`.
    """

    programme_m: tuple[float, ...] = (1500.0, 1200.0, 900.0, 600.0, 400.0, 250.0, 150.0, 75.0, 30.0, 10.0)
    frames: int = 15
    mode: str = "synthetic"
    vertical_speed_m_per_s: float = 0.0
    preamble_frames: int = 8
    sync_every_frames: int = 0
    sync_frames: int = 8

    def __post_init__(self) -> None:
        if self.mode not in ("synthetic", "true_delay"):
            raise ValueError(f"altitude.mode is {self.mode!r}; allowed: synthetic, true_delay")
        if self.vertical_speed_m_per_s and self.mode == "synthetic":
            raise ValueError(
                f"altitude.vertical_speed_m_per_s {self.vertical_speed_m_per_s:g} needs mode: true_delay; "
                "a beat shift has no Doppler"
            )

    @property
    def programme(self) -> Programme:
        """The frame-by-frame programme."""
        return Programme(
            altitudes_m=self.programme_m,
            frames_per_step=self.frames,
            preamble_frames=self.preamble_frames,
            sync_every_frames=self.sync_every_frames,
            sync_frames=self.sync_frames,
            vertical_speed_m_per_s=self.vertical_speed_m_per_s,
        )


@dataclass(frozen=True)
class SweepSpec:
    """Points of an evaluation: every overlap at every SIR (total over all interferers) at every SNR."""

    overlap: tuple[float, ...] = ()
    sir_db: tuple[float, ...] = ()
    snr_db: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for value in self.overlap:
            if not 0 <= value <= 1:
                raise ValueError(f"sweep.overlap holds {value:g}; overlaps have to be within 0..1")


@dataclass(frozen=True)
class RadioSpec:
    """The two B210s; nothing of it is used in simulation.

    Parameters
    ----------
    radar_serial, jammer_serial : str
        USB serial numbers (``uhd_find_devices``); empty takes the first device found.
    master_clock_hz : float
        30 MHz divides to 7.5 MS/s by four.
    lo_offset_hz : float
        LO offset out of the band, so that its leakage falls outside.
    radar_tx_gain_db, radar_rx_gain_db, jammer_tx_gain_db : float
        Gains, 0..89.75 dB (TX) and 0..76 dB (RX).
    enclosure : str
        ``"none"``, ``"cabled"`` or ``"shielded"``; without one nothing is transmitted.
    attenuation_db : float
        Attenuation in the cables between TX and RX.
    clock_source : str
        ``"internal"``, ``"external"`` or ``"gpsdo"``.
    """

    radar_serial: str = ""
    jammer_serial: str = ""
    master_clock_hz: float = 30e6
    lo_offset_hz: float = 6e6
    radar_tx_gain_db: float = 0.0
    radar_rx_gain_db: float = 20.0
    jammer_tx_gain_db: float = 0.0
    enclosure: str = "none"
    attenuation_db: float = 0.0
    clock_source: str = "internal"

    def __post_init__(self) -> None:
        if self.enclosure not in ("none", "cabled", "shielded"):
            raise ValueError(f"radio.enclosure is {self.enclosure!r}; allowed: none, cabled, shielded")
        if self.clock_source not in ("internal", "external", "gpsdo"):
            raise ValueError(
                f"radio.clock_source is {self.clock_source!r}; allowed: internal, external, gpsdo"
            )
        for name, top in (
            ("radar_tx_gain_db", 89.75),
            ("jammer_tx_gain_db", 89.75),
            ("radar_rx_gain_db", 76.0),
        ):
            if not 0 <= getattr(self, name) <= top:
                raise ValueError(f"radio.{name} is {getattr(self, name):g}; it has to be within 0..{top:g}")
        if self.attenuation_db < 0:
            raise ValueError(f"radio.attenuation_db is {self.attenuation_db:g}; it has to be 0 or above")


@dataclass(frozen=True)
class Scene:
    """Everything a run depends on."""

    name: str = "scene"
    description: str = ""
    waveform: Waveform = Waveform()
    altitude: AltitudeSpec = AltitudeSpec()
    interference: tuple[Interferer, ...] = ()
    total_sir_db: float | None = None
    channel: ChannelSettings = ChannelSettings()
    segmenter: SegmenterSettings = SegmenterSettings()
    altimeter: AltimeterSettings = AltimeterSettings()
    methods: tuple[str, ...] = ("none", "whitening")
    method_options: dict[str, dict[str, Any]] = field(default_factory=dict)
    sweep: SweepSpec = SweepSpec()
    radio: RadioSpec = RadioSpec()
    seed: int = 1

    def __post_init__(self) -> None:
        highest = max(self.altitude.programme_m, default=0.0)
        if highest > self.altimeter.max_altitude_m:
            raise ValueError(
                f"altitude.programme_m reaches {highest:g} m, above altimeter.max_altitude_m "
                f"{self.altimeter.max_altitude_m:g}; raise that limit or lower the altitude"
            )
        limit = self.waveform.max_unambiguous_altitude_m
        if self.altimeter.max_altitude_m > limit:
            raise ValueError(
                f"altimeter.max_altitude_m {self.altimeter.max_altitude_m:g} exceeds {limit:.6g} m, where the delay is "
                "half a half sweep; lengthen waveform.sweep_s or lower it"
            )

    @property
    def has_jammer(self) -> bool:
        """Whether a jammer chain (and a second B210) is needed at all."""
        return any(i.overlap > 0 for i in self.interference)

    def at(
        self,
        *,
        overlap: float | None = None,
        sir_db: float | None = None,
        snr_db: float | None = None,
        seed: int | None = None,
    ) -> Scene:
        """The same scene at one point of a sweep.

        Overlap and SIR apply to every interferer; with several, each keeps its SIR relative to the first and the sum
        meets ``sir_db``.
        """
        changes: dict[str, Any] = {}
        if self.interference:
            base = self.interference[0].sir_db
            changes["interference"] = tuple(
                dataclasses.replace(
                    i,
                    overlap=i.overlap if overlap is None else overlap,
                    sir_db=i.sir_db if sir_db is None else i.sir_db - base + sir_db,
                )
                for i in self.interference
            )
            if sir_db is not None:
                changes["total_sir_db"] = sir_db
        if snr_db is not None:
            changes["channel"] = dataclasses.replace(self.channel, snr_db=snr_db)
        if seed is not None:
            changes["seed"] = seed
        return dataclasses.replace(self, **changes)

    @property
    def interference_name(self) -> str:
        """Short label of the interference, for rows and figures."""
        if not self.interference:
            return "none"
        return "+".join(_emitter_label(i.emitter) for i in self.interference)


def _emitter_label(emitter: object) -> str:
    names = {cls: name for name, cls in EMITTERS.items()}
    label = names.get(type(emitter), type(emitter).__name__)
    return f"{label}_{emitter.pulse}" if isinstance(emitter, QpskEmitter) else label


def load_scene(name: str | Path) -> Scene:
    """Read and validate a scene by path, or by the name of a shipped one.

    Raises
    ------
    SceneError
        One line: file, key, value, what is allowed.
    """
    import yaml

    path = scene_path(name)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise SceneError(
            f"scene {path}: cannot be read ({reason}); give a YAML file or a shipped scene's name"
        ) from None
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        raise SceneError(f"scene {path}: not valid YAML{where}: {getattr(error, 'problem', error)}") from None
    return parse_scene(data if data is not None else {}, source=str(path))


def parse_scene(data: dict[str, Any], *, source: str = "scene") -> Scene:
    """A validated `Scene` from nested mappings as YAML gives them."""
    try:
        return _build(Scene, data, "")
    except ValueError as error:
        raise SceneError(f"{source}: {error}") from None


def _build(cls: type, data: Any, where: str) -> Any:
    """Dataclass from a mapping: unknown keys, types and ranges are checked, `__post_init__` has the last word."""
    if not isinstance(data, dict):
        raise ValueError(f"{where or 'the scene'} is {data!r}; expected a mapping of keys")
    hints = typing.get_type_hints(cls)
    fields = {f.name for f in dataclasses.fields(cls) if f.init}
    values = {}
    for key, value in data.items():
        path = f"{where}.{key}" if where else str(key)
        if key not in fields:
            close = difflib.get_close_matches(str(key), fields, 1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise ValueError(f"unknown key {path!r}; {hint}allowed: {', '.join(sorted(fields))}")
        if cls is Scene and key == "interference":
            values[key] = _interference(value, path)
        else:
            values[key] = _convert(hints[key], value, path)
    try:
        return cls(**values)
    except TypeError as error:
        raise ValueError(f"{where}: {error}") from None


def _interference(value: Any, where: str) -> tuple[Interferer, ...]:
    """``{kind: {...}}`` or a list of such mappings."""
    if value is None:
        return ()
    if isinstance(value, dict):
        value = [{kind: params} for kind, params in value.items()]
    if not isinstance(value, list):
        raise ValueError(f"{where} is {value!r}; expected a mapping 'kind: {{...}}' or a list of them")
    out = []
    for item in value:
        if not (isinstance(item, dict) and len(item) == 1):
            raise ValueError(f"{where} holds {item!r}; expected one 'kind: {{...}}' an entry")
        kind, params = next(iter(item.items()))
        path = f"{where}.{kind}"
        if kind not in EMITTERS:
            raise ValueError(f"unknown interferer {path!r}; allowed: {', '.join(sorted(EMITTERS))}")
        params = {} if params is None else params
        if not isinstance(params, dict):
            raise ValueError(f"{path} is {params!r}; expected a mapping of keys")
        hints = typing.get_type_hints(Interferer)
        placement = {k: _convert(hints[k], v, f"{path}.{k}") for k, v in params.items() if k in _PLACEMENT}
        emitter_params = {k: v for k, v in params.items() if k not in _PLACEMENT}
        try:
            emitter = _build(EMITTERS[kind], emitter_params, path)
            out.append(Interferer(emitter, **placement))
        except ValueError as error:
            text = str(error)
            raise ValueError(text if path in text else f"{path}: {text}") from None
    return tuple(out)


def _convert(hint: Any, value: Any, where: str) -> Any:
    """A YAML value as the annotated type, or one line about what is allowed."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        options = typing.get_args(hint)
        if value is None and type(None) in options:
            return None
        return _convert(next(o for o in options if o is not type(None)), value, where)
    if dataclasses.is_dataclass(hint):
        return _build(hint, {} if value is None else value, where)
    if origin is tuple:
        if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
            value = [value]
        inner = typing.get_args(hint)[0]
        return tuple(_convert(inner, v, f"{where}[{i}]") for i, v in enumerate(value))
    if origin is dict or hint is dict:
        if not isinstance(value, dict):
            raise ValueError(f"{where} is {value!r}; expected a mapping")
        return value
    return _scalar(hint, value, where)


def _scalar(hint: Any, value: Any, where: str) -> Any:
    if hint is float:
        # YAML 1.1 reads 7.5e6 (no sign in the exponent) as text; users mean the number
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise ValueError(
                    f"{where} is {value!r}; expected a number, in the unit its name states"
                ) from None
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise ValueError(f"{where} is {value!r}; expected a number, in the unit its name states")
        if not np.isfinite(value):
            raise ValueError(f"{where} is {value!r}; expected a finite number")
        return float(value)
    if hint is int:
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise ValueError(f"{where} is {value!r}; expected a whole number") from None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value != int(value):
            raise ValueError(f"{where} is {value!r}; expected a whole number")
        return int(value)
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{where} is {value!r}; expected true or false")
        return value
    if hint is str:
        if not isinstance(value, str):
            raise ValueError(f"{where} is {value!r}; expected text")
        return value
    return value


def scene_from_parameters(
    name: str | Path, overlap: float = -1.0, sir_db: float = 999.0, seed: int = -1
) -> Scene:
    """A scene as flowgraph parameters name it: overlap below 0, SIR above 900 and seed below 0 keep the scene's own."""
    return load_scene(name).at(
        overlap=None if overlap < 0 else overlap,
        sir_db=None if sir_db > 900 else sir_db,
        seed=None if seed < 0 else seed,
    )


def scene_to_mapping(scene: Scene) -> dict[str, Any]:
    """A scene as plain mappings, lists and numbers; `parse_scene` gives the same scene back."""
    mapping = {f.name: _plain(getattr(scene, f.name)) for f in dataclasses.fields(scene)}
    names = {cls: name for name, cls in EMITTERS.items()}
    mapping["interference"] = [
        {
            names[type(i.emitter)]: {
                **{key: _plain(getattr(i, key)) for key in _PLACEMENT},
                **{f.name: _plain(getattr(i.emitter, f.name)) for f in dataclasses.fields(i.emitter)},
            }
        }
        for i in scene.interference
    ]
    return mapping


def _plain(value: Any) -> Any:
    """Dataclasses as mappings, tuples as lists."""
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    return value
