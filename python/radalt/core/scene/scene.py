"""Scenes: one YAML file into typed, validated, frozen dataclasses (docs/design.md).

A wrong key, unit, range or type gives one line that names file, key, value and what is allowed.
"""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..channel.simulated import ChannelSettings
from ..interference.emitters import emitter_class, emitter_names
from ..interference.multipath import faded, unfaded
from ..interference.placement import Interferer
from ..parsing import InputError, build, convert, load_yaml, plain, shown
from ..paths import scene_path
from ..programme import Programme
from ..radio.device import Device, device
from ..receiver.altimeter import AltimeterSettings
from ..receiver.segmenter import SegmenterSettings
from ..receiver.tracker_settings import TrackerSettings
from ..returns.landing import LandingSpec
from ..text import one_line
from ..waveform import Waveform

__all__ = [
    "AltitudeSpec",
    "RadioSpec",
    "Scene",
    "SceneError",
    "SweepSpec",
    "interference_from_yaml",
    "interferer_to_mapping",
    "load_scene",
    "parse_scene",
    "scene_to_mapping",
]

_SERIAL = re.compile("[A-Za-z0-9]{0,32}")
_MOST_SIR_DB = 200.0
_MOST_ATTENUATION_DB = 150.0  # of a bench: beyond it nothing is left above the noise
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
    hold_last : bool
        Stay at the last altitude for ever; for altitudes set by hand.
    landing_frames : int
        Frames over which the scene's ``landing`` is flown, if it has one (a time lapse of the approach).
    """

    programme_m: tuple[float, ...] = (1500.0, 1200.0, 900.0, 600.0, 400.0, 250.0, 150.0, 75.0, 30.0, 10.0)
    frames: int = 15
    mode: str = "synthetic"
    vertical_speed_m_per_s: float = 0.0
    preamble_frames: int = 8
    sync_every_frames: int = 0
    sync_frames: int = 8
    hold_last: bool = False
    landing_frames: int = 200

    def __post_init__(self) -> None:
        if not 2 <= self.landing_frames <= 100_000:
            raise ValueError(
                f"altitude.landing_frames is {self.landing_frames}; it has to be within 2..100000"
            )
        if self.mode not in ("synthetic", "true_delay"):
            raise ValueError(f"altitude.mode is {self.mode!r}; allowed: synthetic, true_delay")
        if self.vertical_speed_m_per_s and self.mode == "synthetic":
            raise ValueError(
                f"altitude.vertical_speed_m_per_s {self.vertical_speed_m_per_s:g} needs mode: true_delay; "
                "a beat shift has no Doppler"
            )
        self.programme  # noqa: B018 - checks its numbers when it is made

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
            hold_last=self.hold_last,
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
    """The two radios; nothing of it is used in simulation.

    Parameters
    ----------
    device : str
        Type of both: a name in `radalt.core.radio.device.DEVICES`.
    radar_serial, jammer_serial : str
        USB serial numbers (``uhd_find_devices``), letters and digits; empty takes the first device found, which the
        interlock allows without a jammer only.
    master_clock_hz : float
        Within the device's range, for the air a multiple of the rate: 30 MHz divides to 7.5 MS/s by four.
    lo_offset_hz : float
        LO offset out of the band, so that its leakage falls outside; at most half the device's highest clock.
    radar_tx_gain_db, radar_rx_gain_db, jammer_tx_gain_db : float
        Gains, within the device's ranges: 0..89.75 dB (TX) and 0..76 dB (RX) for a B210.
    enclosure : str
        ``"none"``, ``"cabled"`` or ``"shielded"``; without one nothing is transmitted.
    attenuation_db : float
        Attenuation in the cables between TX and RX, 0..150 dB.
    clock_source : str
        ``"internal"``, ``"external"`` or ``"gpsdo"``.
    """

    device: str = "b210"
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
        for name, (low, high) in self._ranges().items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(
                    f"radio.{name} is {getattr(self, name):g}; it has to be within {low:g}..{high:g}"
                )
        for name in ("radar_serial", "jammer_serial"):
            if not _SERIAL.fullmatch(getattr(self, name)):
                # it becomes part of a device address, in which a comma would begin another argument
                raise ValueError(
                    f"radio.{name} is {shown(getattr(self, name))}; a serial is at most 32 letters and digits"
                )

    def _ranges(self) -> dict[str, tuple[float, float]]:
        limits = self.limits
        most_offset_hz = limits.master_clock_hz[1] / 2
        return {
            "radar_tx_gain_db": limits.tx_gain_db,
            "jammer_tx_gain_db": limits.tx_gain_db,
            "radar_rx_gain_db": limits.rx_gain_db,
            "attenuation_db": (0.0, _MOST_ATTENUATION_DB),
            "master_clock_hz": limits.master_clock_hz,
            "lo_offset_hz": (-most_offset_hz, most_offset_hz),
        }

    @property
    def limits(self) -> Device:
        """What the radios can do and stand."""
        return device(self.device)


@dataclass(frozen=True)
class Scene:
    """Everything a run depends on.

    Parameters
    ----------
    name, description : str
        For reports.
    landing : LandingSpec or None
        An approach over terrain; it gives the altitudes, unless ``altitude.programme_m`` does.
    return_model : str
        ``return`` in a file: ``point``, or ``terrain`` for the extended return of the ground under the landing.
    methods : tuple of str
        Mitigation methods that are compared on the same frames.
    method_options : dict
        Options by method, such as ``tcae: {model: my.onnx}``.
    seed : int
        Everything random follows from it.
    """

    name: str = "scene"
    description: str = ""
    waveform: Waveform = Waveform()
    altitude: AltitudeSpec = AltitudeSpec()
    landing: LandingSpec | None = None
    return_model: str = "point"
    interference: tuple[Interferer, ...] = ()
    total_sir_db: float | None = None
    channel: ChannelSettings = ChannelSettings()
    segmenter: SegmenterSettings = SegmenterSettings()
    altimeter: AltimeterSettings = AltimeterSettings()
    tracker: TrackerSettings = TrackerSettings()
    methods: tuple[str, ...] = ("none", "whitening")
    method_options: dict[str, dict[str, Any]] = field(default_factory=dict)
    sweep: SweepSpec = SweepSpec()
    radio: RadioSpec = RadioSpec()
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed is {shown(self.seed)}; it has to be 0 or above and of at most 18 digits")
        self._check_methods()
        top = self.altimeter_settings.max_altitude_m
        highest = max(self.altitude.programme_m, default=0.0)
        if self.return_model not in ("point", "terrain"):
            raise ValueError(f"return is {self.return_model!r}; allowed: point, terrain")
        if self.return_model == "terrain" and (self.landing is None or self.altitude.frames != 1):
            raise ValueError(
                f"return: terrain needs a landing and altitude.frames 1 (it is {self.altitude.frames}): every "
                "frame has its own place on the ground; set altitude.landing_frames instead"
            )
        limit = self.waveform.max_unambiguous_altitude_m
        if max(top, highest) > limit:
            name = "altimeter.max_altitude_m" if top > limit else "altitude.programme_m: an altitude of"
            raise ValueError(
                f"{name} {max(top, highest):g} exceeds {limit:.6g} m, where the delay is half a half sweep; lengthen "
                "waveform.sweep_s or lower it"
            )
        if highest > top:
            raise ValueError(
                f"altitude.programme_m reaches {highest:g} m, above altimeter.max_altitude_m {top:g}; raise that limit "
                "or lower the altitude"
            )

    def _check_methods(self) -> None:
        from ..mitigation import CUSTOM, METHODS

        known = (*METHODS, CUSTOM)
        for key in ("methods", "method_options"):
            unknown = [m for m in getattr(self, key) if m not in known]
            if unknown:
                raise ValueError(f"{key} names {shown(unknown[0])}; allowed: {', '.join(known)}")

        for name, options in self.method_options.items():
            if options is not None and not isinstance(options, dict):
                raise ValueError(
                    f"method_options.{name} is {shown(options)}; expected a mapping of its options"
                )
            stray = [key for key in options or {} if not isinstance(key, str)]
            if stray:
                raise ValueError(f"method_options.{name} has the key {shown(stray[0])}; options have names")

    @property
    def altimeter_settings(self) -> AltimeterSettings:
        """The altimeter's settings with the search span that the scene leaves open taken from what it flies."""
        highest = max(self.altitude.programme_m, default=0.0)
        # the ground lies beyond its nearest point, and closes at its own rate
        if self.return_model == "terrain":
            return self.altimeter.resolved(self.waveform, highest_altitude_m=1.5 * highest)
        return self.altimeter.resolved(
            self.waveform,
            highest_altitude_m=highest,
            vertical_speed_m_per_s=self.altitude.vertical_speed_m_per_s,
        )

    @property
    def tracker_settings(self) -> TrackerSettings:
        """The tracker's settings, with Doppler where the scene plays it: a beat shift has none."""
        if self.tracker.doppler is not None:
            return self.tracker
        plays = self.altitude.mode == "true_delay" or self.return_model == "terrain"
        return dataclasses.replace(self.tracker, doppler=plays)

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
    def sir_db(self) -> float:
        """SIR of all interference together, over the whole frame; infinite without any."""
        if not self.interference:
            return float("inf")
        if self.total_sir_db is not None:
            return self.total_sir_db
        return -10.0 * math.log10(sum(10.0 ** (-i.sir_db / 10.0) for i in self.interference))

    @property
    def burst_db(self) -> float:
        """Power of the interference while it lasts over the return's, in decibels, all bursts at once."""
        return burst_db(self.sir_db, max((i.overlap for i in self.interference), default=0.0))

    @property
    def interference_name(self) -> str:
        """Short label of the interference, for rows and figures."""
        if not self.interference:
            return "none"
        return "+".join(i.emitter.label for i in self.interference)


def burst_db(sir_db: float, overlap: float) -> float:
    """Power of a burst over the return's, in decibels, from the SIR of the whole frame and the burst's share of it."""
    return -sir_db - 10.0 * math.log10(max(overlap, 1e-6))


def load_scene(name: str | Path) -> Scene:
    """Read and validate a scene by path, or by the name of a shipped one.

    Raises
    ------
    SceneError
        One line: file, key, value, what is allowed.
    """
    try:
        path = scene_path(name)
        data = load_yaml(path, what="scene", remedy="give a YAML file or a shipped scene's name")
    except (OSError, ValueError) as error:  # InputError, a NUL or thousands of letters in the name
        text = str(error) if isinstance(error, InputError) else f"scene {shown(str(name))}: {error}"
        raise SceneError(text) from None
    return parse_scene(data if data is not None else {}, source=str(path))


def parse_scene(data: dict[str, Any], *, source: str = "scene") -> Scene:
    """A validated `Scene` from nested mappings as YAML gives them."""
    if isinstance(data, dict) and "return" in data:  # a word that Python keeps for itself
        data = {("return_model" if key == "return" else key): value for key, value in data.items()}
    try:
        scene = build(Scene, data, "", {"interference": interference_from_yaml})
        if scene.landing is not None and "programme_m" not in (data.get("altitude") or {}):
            scene = _with_landing(scene)
        return scene
    except (ValueError, OSError) as error:
        raise SceneError(one_line(f"{source}: {error}")) from None


def _with_landing(scene: Scene) -> Scene:
    """The altitudes of the scene's landing, one per frame, from first to last."""
    profile = scene.landing.profile(scene.waveform, scene.altitude.landing_frames, scene.seed)
    altitudes = tuple(float(max(0.0, a)) for a in profile.altitude_m)
    return dataclasses.replace(scene, altitude=dataclasses.replace(scene.altitude, programme_m=altitudes))


def interference_from_yaml(value: Any, where: str) -> tuple[Interferer, ...]:
    """``{kind: {...}}`` or a list of such mappings."""
    if value is None:
        return ()
    if isinstance(value, dict):
        value = [{kind: params} for kind, params in value.items()]
    if not isinstance(value, list):
        raise ValueError(f"{where} is {shown(value)}; expected a mapping 'kind: {{...}}' or a list of them")
    return tuple(_interferer(item, where) for item in value)


def _interferer(item: Any, where: str) -> Interferer:
    """One ``{kind: {emitter and placement keys}}``."""
    if not (isinstance(item, dict) and len(item) == 1):
        raise ValueError(f"{where} holds {shown(item)}; expected one 'kind: {{...}}' an entry")
    kind, params = next(iter(item.items()))
    path = f"{where}.{kind}"
    if kind not in emitter_names():
        raise ValueError(f"unknown interferer {shown(path)}; allowed: {', '.join(emitter_names())}")
    params = {} if params is None else params
    if not isinstance(params, dict):
        raise ValueError(f"{path} is {shown(params)}; expected a mapping of keys")
    hints = typing.get_type_hints(Interferer)
    placement = {k: convert(hints[k], v, f"{path}.{k}") for k, v in params.items() if k in _PLACEMENT}
    own = {k: v for k, v in params.items() if k not in (*_PLACEMENT, "multipath")}
    emitter = build(emitter_class(kind), own, path)
    if params.get("multipath") is not None:
        emitter = faded(emitter, params["multipath"], f"{path}.multipath")
    if "sir_db" not in placement and emitter.stated_sir_db is not None:
        placement["sir_db"] = emitter.stated_sir_db
    try:
        return Interferer(emitter, **placement)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def scene_from_parameters(
    name: str | Path,
    overlap: float | str | None = None,
    sir_db: float | str | None = None,
    seed: int | str | None = None,
) -> Scene:
    """A scene as flowgraph parameters name it: numbers, as such or as text; None or ``"scene"`` keeps the scene's own.

    Raises
    ------
    SceneError
        One line: parameter, value, what is allowed.
    """
    given = {"overlap": overlap, "sir_db": sir_db, "seed": seed}
    changes: dict[str, Any] = {}
    for key, value in given.items():
        if value in (None, "scene"):
            continue
        try:
            changes[key] = int(value) if key == "seed" else float(value)
        except ValueError:
            raise SceneError(
                f"{key} is {shown(value)}; give a number, or scene for the scene's own"
            ) from None
    if not abs(changes.get("sir_db", 0.0)) <= _MOST_SIR_DB:
        raise SceneError(
            f"sir_db is {sir_db}; it has to be within -{_MOST_SIR_DB:g}..{_MOST_SIR_DB:g}, or scene for the scene's own"
        )
    scene = load_scene(name)
    try:
        return scene.at(**changes)
    except ValueError as error:
        raise SceneError(one_line(f"{name}: {error}")) from None


def scene_to_mapping(scene: Scene) -> dict[str, Any]:
    """A scene as plain mappings, lists and numbers; `parse_scene` gives the same scene back."""
    mapping = {f.name: plain(getattr(scene, f.name)) for f in dataclasses.fields(scene)}
    mapping["return"] = mapping.pop("return_model")
    mapping["interference"] = [interferer_to_mapping(i) for i in scene.interference]
    return mapping


def interferer_to_mapping(interferer: Interferer) -> dict[str, Any]:
    """``{kind: {emitter and placement keys}}`` of one interferer."""
    emitter, channel = unfaded(interferer.emitter)
    keys = {key: plain(getattr(interferer, key)) for key in _PLACEMENT} | plain(emitter)
    return {emitter.scene_name: keys if channel is None else keys | {"multipath": plain(channel)}}
