"""A scene as typed, validated, frozen dataclasses (docs/design.md)."""

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

from ..altimeter.altimeter import AltimeterSettings
from ..channel.auxiliary import AuxiliarySettings
from ..channel.settings import ChannelSettings
from ..interference.placement import Interferer
from ..parsing import allowed, shown
from ..returns.landing import LandingSpec
from ..timing.auxiliary_cancel import CancelSettings
from ..timing.leakage import FITTED_ABOVE_M
from ..timing.leakage_file import UNCALIBRATED
from ..timing.segmenter import SegmenterSettings
from ..tracker.tracker_settings import TrackerSettings
from ..waveform import Waveform
from .sections import AltitudeSpec, RadioSpec, SweepSpec

if TYPE_CHECKING:
    from ..interference.emitters import NamedEmitter

_MOST_SAMPLES = 1 << 20  # longest frame in a flowgraph, samples: 8 MB, 140 default frames
_FRAMES_HELD = 128  # frames in the buffers of a flowgraph with a few methods, for the error on memory


def check_options(method_options: dict[str, Any]) -> None:
    """Raise ValueError unless options of methods are mappings by name, without what the scene gives."""
    for name, options in method_options.items():
        if options is not None and not isinstance(options, dict):
            raise ValueError(f"method_options.{name} is {shown(options)}; expected a mapping of its options")
        stray = [key for key in options or {} if not isinstance(key, str)]
        if stray:
            raise ValueError(f"method_options.{name} has the key {shown(stray[0])}; options have names")
        fixed = [key for key in ("waveform", "name", "max_altitude_m") if key in (options or {})]
        if fixed:
            raise ValueError(
                f"method_options.{name} has the key {fixed[0]!r}, which the scene itself gives; remove it"
            )


@dataclass(frozen=True)
class Scene:
    """Everything on which a run depends."""

    name: str = "scene"
    """Name in reports."""
    description: str = ""
    """Description in reports."""
    waveform: Waveform = Waveform()
    altitude: AltitudeSpec = AltitudeSpec()
    landing: LandingSpec | None = None
    """An approach over terrain; it gives the altitudes, unless ``altitude.programme_m`` does."""
    return_model: str = "point"
    """Key ``return`` in a file: ``point``, ``terrain`` for the extended ground return of the landing, or ``none``:
    the radar is silent in trials, and every declared altitude is false."""
    interference: tuple[Interferer, ...] = ()
    total_sir_db: float | None = None
    channel: ChannelSettings = ChannelSettings()
    auxiliary: AuxiliarySettings | None = None
    """A second receive channel, by which `AuxiliaryCancel` cleans frames before every method."""
    auxiliary_cancel: CancelSettings = CancelSettings()
    """Settings of that canceller."""
    segmenter: SegmenterSettings = SegmenterSettings()
    altimeter: AltimeterSettings = AltimeterSettings()
    tracker: TrackerSettings = TrackerSettings()
    methods: tuple[str, ...] = ("none", "whitening")
    """Mitigation methods that are compared on the same frames."""
    method_options: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Options by method, such as ``tcae: {model: my.onnx}``."""
    sweep: SweepSpec = SweepSpec()
    radio: RadioSpec = RadioSpec()
    seed: int = 1
    """Seed of everything random."""

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed is {shown(self.seed)}; it has to be 0 or above and of at most 18 digits")
        self._check_frames()
        self._check_methods()
        self._check_leakage()
        self._check_auxiliary()
        top = self.altimeter_settings.max_altitude_m
        assert top is not None  # resolved
        highest = max(self.altitude.programme.altitudes_m)
        if self.return_model not in ("point", "terrain", "none"):
            raise ValueError(f"return is {self.return_model!r}; allowed: point, terrain, none")
        if self.return_model == "none" and self.altitude.mode != "synthetic":
            raise ValueError("return: none needs altitude.mode: synthetic; the source is silent in trials")
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

    def _check_frames(self) -> None:
        """Check that a flowgraph's buffers hold the frames, and that the sweep is a triangle (it has a beat shift)."""
        w = self.waveform
        if w.samples_per_frame > _MOST_SAMPLES:
            raise ValueError(
                f"waveform.sweep_s {w.sweep_s:g} at rate_hz {w.rate_hz:g} makes frames of {w.samples_per_frame} "
                f"samples, {w.samples_per_frame * 8 * _FRAMES_HELD / 1e9:.3g} GB in a flowgraph's buffers; at most "
                f"{_MOST_SAMPLES} samples"
            )
        if not w.separates_doppler:
            raise ValueError(
                f"waveform.shape is {w.shape!r}; a scene plays a triangle, `radalt tolerance` a sawtooth, too"
            )

    def _check_leakage(self) -> None:
        """Leakage needs true delays: a beat shift moves it with the return, and 0 m is the return of the preamble."""
        stated = {
            "channel.leakage_db": self.channel.leakage_db is not None,
            "segmenter.leakage_calibration": bool(self.segmenter.leakage_calibration),
        }
        plays = self.altitude.mode == "true_delay" and self.return_model == "point"
        wrong = next((key for key, given in stated.items() if given), None)
        if wrong and not plays:
            raise ValueError(
                f"{wrong} needs altitude.mode: true_delay and return: point; a beat shift moves the leakage with the "
                "return, and the line at 0 m is then the return of the preamble"
            )
        least = FITTED_ABOVE_M
        if self.segmenter.leakage_calibration == UNCALIBRATED and self.altimeter.min_altitude_m < least:
            raise ValueError(
                f"segmenter.leakage_calibration: {UNCALIBRATED} needs altimeter.min_altitude_m of {least:g} or more "
                f"(it is {self.altimeter.min_altitude_m:g}): without a calibration nothing is known below"
            )

    def _check_auxiliary(self) -> None:
        """Check that every interferer has its direction, and that one converter is stated."""
        given = 1 if self.auxiliary is None else len(self.auxiliary.directions)
        if given not in (1, len(self.interference)):
            raise ValueError(
                f"auxiliary.directions has {given} entries for {len(self.interference)} interferers; give one for all, "
                "or one each"
            )
        if self.auxiliary is not None and self.auxiliary.adc_bits and self.channel.adc_bits:
            raise ValueError(
                "auxiliary.adc_bits and channel.adc_bits would convert twice; set one of them to 0"
            )

    def _check_methods(self) -> None:
        from ..mitigation import CUSTOM, METHODS

        self._name_methods()
        known = (*METHODS, CUSTOM)
        for key in ("methods", "method_options"):
            unknown = [m for m in getattr(self, key) if m not in known]
            if unknown:
                raise ValueError(f"{key} names {shown(unknown[0])}; {allowed(unknown[0], known)}")
        check_options(self.method_options)

    def _name_methods(self) -> None:
        """Register methods under the user's names: ``method_options: {mine: {method: tcae, model: my.onnx}}``."""
        from ..mitigation import name_method

        for name, options in self.method_options.items():
            if isinstance(options, dict) and "method" in options and isinstance(name, str):
                name_method(name, options["method"])

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Register the user's method names in the process that unpickles the scene."""
        self.__dict__.update(state)
        self._name_methods()

    @property
    def reach_m(self) -> float:
        """Farthest ground: the highest altitude; of terrain half as far again, beyond its nearest point."""
        return max(self.altitude.programme.altitudes_m) * (1.5 if self.return_model == "terrain" else 1.0)

    @cached_property
    def altimeter_settings(self) -> AltimeterSettings:
        """Settings of the altimeter; an open search span is taken from the scene's altitudes."""
        # the range rate of terrain differs from the aircraft's
        speed = None if self.return_model == "terrain" else self.altitude.fastest_m_per_s
        reach: dict[str, Any] = {"highest_altitude_m": self.reach_m, "vertical_speed_m_per_s": speed}
        return self.altimeter.resolved(self.waveform, **reach)

    @property
    def tracker_settings(self) -> TrackerSettings:
        """Settings of the tracker, with Doppler where the scene has it: a beat shift has none.

        A track may start at any altitude, unless the scene has leakage that the receiver does not know.
        """
        plays = self.altitude.mode == "true_delay" or self.return_model == "terrain"
        uncalibrated = self.segmenter.leakage_calibration in ("", UNCALIBRATED)
        known = self.channel.leakage_db is None or not uncalibrated
        taken: dict[str, Any] = {"doppler": plays, "leakage_m": 0.0 if known else None}
        taken = {name: value for name, value in taken.items() if getattr(self.tracker, name) is None}
        return dataclasses.replace(self.tracker, **taken)

    @property
    def has_noise(self) -> bool:
        """Whether received frames contain noise: two equal frames then mean a frozen receiver."""
        return self.channel.snr_db is not None

    @property
    def independent_frames(self) -> bool:
        """Whether interference is drawn anew in every frame, so that no method may know it from the frame before."""
        playing = [i for i in self.interference if i.overlap > 0]
        return bool(playing) and not any(i.free_running for i in playing)

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
    ) -> "Scene":
        """The scene at one point of a sweep over overlap, SIR and SNR.

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
        """SIR of all interference together, averaged over the frame; infinite without any."""
        if not self.interference:
            return float("inf")
        if self.total_sir_db is not None:
            return self.total_sir_db
        return -10.0 * math.log10(sum(10.0 ** (-i.sir_db / 10.0) for i in self.interference))

    @property
    def burst_db(self) -> float:
        """Power of all bursts while they last, over the return's, in decibels."""
        return burst_db(self.sir_db, max((i.overlap for i in self.interference), default=0.0))

    @property
    def interference_name(self) -> str:
        """Short label of the interference, for rows and figures."""
        if not self.interference:
            return "none"
        return "+".join(cast("NamedEmitter", i.emitter).label for i in self.interference)


def burst_db(sir_db: float, overlap: float) -> float:
    """Power of a burst over the return's, in decibels, from the frame's SIR and the overlap."""
    return -sir_db - 10.0 * math.log10(max(overlap, 1e-6))
