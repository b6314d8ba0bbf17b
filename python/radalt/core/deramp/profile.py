"""An altimeter as data: every number with its source and its provenance, from a YAML file.

A profile lies in ``flowgraphs/altimeters/``. Its numbers are lists ``[value, provenance, source]``; the provenance is

- ``read in source``: the number was read in the source that is named;
- ``secondary``: another document quotes that source;
- ``assumed``: an assumption of this project, and the source says why.
"""

from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import Boltzmann, foot

from ..altimeter.altimeter import Altimeter, AltimeterSettings
from ..parsing import InputError, Settings, build, load_yaml, setting
from ..paths import share_dir
from ..returns.link_budget import diffuse_loop_loss_db
from ..returns.terrain.antenna import GaussianAntenna
from ..returns.terrain.ground import Reflectivity, reflectivity
from ..tracker.summed_detector import CounterDetector, SummedDetector
from ..tracker.tracker import AltitudeTracker
from ..tracker.tracker_settings import TrackerSettings
from ..waveform import SHAPES
from .front_end import Amplifier, Converter
from .if_waveform import IfWaveform

PROVENANCES = ("read in source", "secondary", "assumed")
_TEMPERATURE_K = 290.0
_ACROSS = 64  # frequencies across a carrier of 100 MHz on the preselector's skirt: within 0.01 dB
_BAND_HZ = (4.2e9, 4.4e9)  # radio altimeters, ITU Radio Regulations
number = partial(setting, MISSING)  # a field of a profile: lowest, highest


@dataclass(frozen=True)
class Profile(Settings, where="altimeter"):
    """A deramping altimeter on an aircraft. The *port* is the receiver's input, behind the receive cable.

    - ``carrier_hz``, ``bandwidth_hz``, ``period_s``: centre, width and one whole period of the sweep: up and down of
      a triangle, one ramp of a sawtooth
    - ``transmit_w``, ``gain_dbi``, ``beamwidth_deg``, ``cable_db``: power; gain and -3 dB width of each antenna
      (Gaussian pattern); loss of each cable
    - ``noise_figure_db``, ``if_rate_hz``, ``if_pass_hz``: receiver noise figure; rate of the IF samples; flat part of
      the IF filter, which is the channel filter
    - ``preselector_hz``, ``preselector_order``: 3 dB width about the carrier and order (Butterworth) of the filter
      before the amplifier
    - ``p1db_dbm``, ``iip3_dbm``, ``iip2_dbm``, ``isolation_db``: `Amplifier` and `rectified`, referred to the
      amplifier's input; isolation from the transmitter's output to the port. The IF's high-pass removes the static
      leakage, but not its modulation by a strong envelope.
    - ``lo_noise_dbc_per_hz``, ``lo_far_noise_dbc_per_hz``: broadband phase noise of the transmitter, which is the
      local oscillator, within the sweep's band and outside it: it mixes whatever is there into the IF
    - ``converter_bits``, ``headroom_db``: `Converter`
    - ``sweeps_per_output``, ``pfa``, ``max_altitude_ft``, ``max_vertical_speed_m_per_s``: frames (two ramps each) per
      output, false alarms per output in noise, span, fastest climb
    - ``other_altimeters``, ``other_coupling_db``: further altimeters of this kind on the aircraft, and the loss from
      their transmitters to the port
    """

    name: str
    about: str
    sweep: str = setting(MISSING, among=SHAPES)
    carrier_hz: float = number(*_BAND_HZ)
    bandwidth_hz: float = number(1e6, 200e6)
    period_s: float = number(0.2e-3, 20e-3)
    transmit_w: float = number(1e-3, 1e3)
    gain_dbi: float = number(-20.0, 40.0)
    beamwidth_deg: float = number(1.0, 120.0)
    cable_db: float = number(0.0, 30.0)
    installation_delay_ft: float = number(0.0, 200.0)  # that the altimeter subtracts
    noise_figure_db: float = number(0.0, 30.0)
    if_rate_hz: float = number(1e4, 1e8)
    if_pass_hz: float = number(1e3, 5e7)
    preselector_hz: float = number(1e6, 1e9)
    preselector_order: int = number(1, 20)
    p1db_dbm: float = number(-80.0, 100.0)
    iip3_dbm: float = number(-70.0, 120.0)
    iip2_dbm: float = number(-60.0, 200.0)
    isolation_db: float = number(20.0, 200.0)
    lo_noise_dbc_per_hz: float = number(-200.0, -60.0)
    lo_far_noise_dbc_per_hz: float = number(-200.0, -60.0)
    recovery_s: float = number(0.0, 1.0)  # time constant with which the gain comes back after a burst
    converter_bits: int = number(4, 24)
    headroom_db: float = number(0.0, 60.0)
    sweeps_per_output: int = number(1, 1000)
    pfa: float = number(1e-12, 0.5)
    unlock_loss_db: float = number(60.0, 200.0)  # transmitter to port: beyond, no computed data
    max_altitude_ft: float = number(100.0, 20_000.0)
    max_vertical_speed_m_per_s: float = number(0.0, 300.0)
    sigma0_db: float = number(-60.0, 40.0)
    """Reflectivity of diffuse ground at nadir, for the loop loss; falls with incidence as `Morchin`'s built-up
    land."""
    other_altimeters: int = number(0, 8)
    other_coupling_db: float = number(20.0, 150.0)
    detector: str = setting("fft", among=("fft", "counter", "tracker"))
    """``fft`` (`SummedDetector`), ``counter`` (`CounterDetector`), ``tracker`` (`AltitudeTracker`)."""
    strategy: str = setting("strongest", among=("strongest", "leading_edge"))
    provenance: dict[str, tuple[str, str]] = field(default_factory=dict)  # by name: (provenance, source)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.detector == "tracker" and self.sweeps_per_output < 8:
            raise ValueError(f"sweeps_per_output is {self.sweeps_per_output}; the tracker needs at least 8")
        if self.detector == "tracker" and self.unlock_loss_db < 200:
            raise ValueError(
                f"unlock_loss_db is {self.unlock_loss_db:g}; the tracker has no threshold on power: 200"
            )
        low_hz, high_hz = (self.carrier_hz + side * 0.5 * self.bandwidth_hz for side in (-1, 1))
        if low_hz < _BAND_HZ[0] or high_hz > _BAND_HZ[1]:
            raise ValueError(
                f"the sweep covers {low_hz / 1e6:g} to {high_hz / 1e6:g} MHz; it has to stay within 4200 to 4400: move "
                "carrier_hz, its centre, or lower bandwidth_hz"
            )
        if self.preselector_hz < self.bandwidth_hz:
            raise ValueError(
                f"preselector_hz is {self.preselector_hz:g}, less than bandwidth_hz {self.bandwidth_hz:g}; it has to "
                "pass the sweep: widen it"
            )
        beat_hz = self.waveform.altitude_to_beat_hz(self.max_range_m)
        if not beat_hz <= self.if_pass_hz:
            raise ValueError(
                f"if_pass_hz is {self.if_pass_hz:g}; the beat of max_altitude_ft and the installation delay is "
                f"{beat_hz:.4g} Hz: raise it or lower max_altitude_ft"
            )
        _ = self.amplifier  # raises where its numbers do not fit
        leakage_dbm = self.transmit_dbm - self.isolation_db
        if leakage_dbm > self.p1db_dbm:
            raise ValueError(
                f"p1db_dbm is {self.p1db_dbm:g}; the leakage of {leakage_dbm:.1f} dBm compresses the amplifier: raise "
                "it or isolation_db"
            )

    @cached_property
    def waveform(self) -> IfWaveform:
        """The sweep at the IF; a frame is one period of a triangle, two of a sawtooth."""
        return IfWaveform(
            bandwidth_hz=self.bandwidth_hz,
            sweep_s=self.period_s * (1 if self.sweep == "triangle" else 2),
            rate_hz=self.if_rate_hz,
            carrier_hz=self.carrier_hz,
            shape=self.sweep,
            pass_hz=self.if_pass_hz,
        )

    # -- levels -----------------------------------------------------------------------------------------------------

    @property
    def max_range_m(self) -> float:
        """Range of the highest altitude, the installation delay included."""
        return (self.max_altitude_ft + self.installation_delay_ft) * foot

    @property
    def transmit_dbm(self) -> float:
        """Transmit power."""
        return float(10 * np.log10(self.transmit_w) + 30)

    @property
    def noise_mw_per_hz(self) -> float:
        """``k T0 F`` at the port."""
        return Boltzmann * _TEMPERATURE_K * 1e3 * 10 ** (self.noise_figure_db / 10)

    @property
    def antenna(self) -> GaussianAntenna:
        """Either antenna."""
        return GaussianAntenna(self.beamwidth_deg, self.gain_dbi)

    @property
    def ground(self) -> Reflectivity:
        """Diffuse ground of the stated reflectivity at nadir."""
        nadir = float(reflectivity().sigma0(np.array(0.0), self.carrier_hz))
        return reflectivity(level_db=self.sigma0_db - 10 * np.log10(nadir))

    def loop_loss_db(self, altitude_ft: float) -> float:
        """Loss from transmitter to port over diffuse ground, cables included."""
        way = {"antenna": self.antenna, "ground": self.ground, "carrier_hz": self.carrier_hz}
        return diffuse_loop_loss_db(altitude_ft * foot, **way, losses_db=2 * self.cable_db)

    # -- receiver ---------------------------------------------------------------------------------------------------

    @cached_property
    def amplifier(self) -> Amplifier:
        """Amplifier and mixer."""
        return Amplifier(self.p1db_dbm, self.iip3_dbm)

    @property
    def converter(self) -> Converter:
        """Gain control and converter."""
        return Converter(self.converter_bits, self.headroom_db)

    @property
    def noise_bandwidth_hz(self) -> float:
        """Noise bandwidth of the preselector: the integral of its Butterworth response."""
        x = np.pi / (2 * self.preselector_order)
        return self.preselector_hz * x / np.sin(x)

    def preselector_loss_db(self, frequency_hz: float, bandwidth_hz: float = 0.0) -> float:
        """Attenuation by the preselector of a carrier, of the mean power of one that is flat over a bandwidth."""
        at_hz = frequency_hz + bandwidth_hz * (np.arange(_ACROSS) + 0.5 - 0.5 * _ACROSS) / _ACROSS
        offset = 2 * np.abs(at_hz - self.carrier_hz) / self.preselector_hz
        return float(-10 * np.log10(np.mean(1 / (1 + offset ** (2 * self.preselector_order)))))

    @property
    def output_s(self) -> float:
        """Time between outputs; it follows the sweep."""
        return self.sweeps_per_output * self.waveform.sweep_s

    def make_detector(self) -> Any:
        """Callable: (n, N) IF frames of whole outputs -> (status, altitude in metres), installation delay included."""
        w, top_m = self.waveform, self.max_range_m
        speed = self.max_vertical_speed_m_per_s
        least_mw = 10 ** ((self.transmit_dbm - self.unlock_loss_db) / 10)
        search = {"max_altitude_m": top_m, "max_vertical_speed_m_per_s": speed, "strategy": self.strategy}
        if self.detector == "counter":
            return CounterDetector(w, self.sweeps_per_output, max_altitude_m=top_m, least_power=least_mw)
        if self.detector == "tracker":
            settings = AltimeterSettings(**search)
            tracked = TrackerSettings(self.output_s, max_vertical_speed_m_per_s=speed)
            return _Tracked(Altimeter(w, settings), tracked)
        return SummedDetector(w, self.sweeps_per_output, pfa=self.pfa, least_power=least_mw, **search)


class _Tracked:
    """The bench's own tracker, reset with every call."""

    def __init__(self, altimeter: Altimeter, settings: TrackerSettings) -> None:
        self._altimeter, self._settings = altimeter, settings

    def __call__(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = AltitudeTracker(self._altimeter, self._settings).process(self._altimeter.spectra(frames))
        return out["status"], out["altitude_m"]


def profile_names() -> list[str]:
    """The shipped profiles."""
    return sorted(file.stem for file in (share_dir() / "flowgraphs" / "altimeters").glob("*.yaml"))


def load_profile(name: str | Path) -> Profile:
    """A profile by path, or by the bare name of a shipped one.

    Raises `InputError`: file, key, value, what is allowed.
    """
    path = Path(name)
    if path.suffix not in (".yaml", ".yml"):
        path = _shipped(str(name))
    try:
        return _built(_merged(path))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"altimeter {path.name}: {error}") from None


def _shipped(name: str) -> Path:
    """File of a shipped profile."""
    path = share_dir() / "flowgraphs" / "altimeters" / f"{name}.yaml"
    if not path.is_file():
        raise InputError(f"there is no altimeter {name!r}; there are {', '.join(profile_names())}")
    return path


def _merged(path: Path, depth: int = 0) -> dict[str, Any]:
    """A file's keys over those of its ``base``: a file next to it, else a shipped profile."""
    data = load_yaml(path, what="altimeter")
    if not isinstance(data, dict) or not all(
        isinstance(data.get(k, {}), dict) for k in ("numbers", "sources")
    ):
        raise ValueError("expected a mapping with the mappings numbers and sources")
    base = data.pop("base", None)
    if base is None:
        return data
    if depth > 3 or not isinstance(base, str):
        raise ValueError(f"base is {base!r}; name a shipped profile or one next to this, four deep at most")
    sibling = path.parent / f"{base}.yaml"
    below = _merged(sibling if sibling.is_file() else _shipped(base), depth + 1)
    for key in ("numbers", "sources"):
        data[key] = below.get(key, {}) | data.get(key, {})
    return below | data


def _built(data: dict[str, Any]) -> Profile:
    """Every number unpacked, its provenance kept."""
    numbers, sources = data.pop("numbers", {}), data.pop("sources", {})
    provenance: dict[str, tuple[str, str]] = {}
    values = dict(data)
    needed = {f.name for f in fields(Profile) if f.metadata.get("limits")}
    outside = sorted(needed & set(data))
    if outside:
        raise ValueError(f"{outside[0]} stands outside numbers; give it there as [value, provenance, source]")
    for name, entry in numbers.items():
        if not (isinstance(entry, list) and len(entry) == 3):
            raise ValueError(f"numbers.{name} is {entry!r}; expected [value, provenance, source]")
        value, level, source = entry
        if level not in PROVENANCES:
            raise ValueError(
                f"numbers.{name} has the provenance {level!r}; allowed: {', '.join(PROVENANCES)}"
            )
        if not (isinstance(source, str) and source.strip()):
            raise ValueError(
                f"numbers.{name} has the source {source!r}; expected words: a source, or a reason"
            )
        if level != "assumed" and source not in sources:
            raise ValueError(f"numbers.{name} names the source {source!r}; sources has {', '.join(sources)}")
        provenance[name] = level, str(sources.get(source, source))
        values[name] = value
    absent = sorted(needed - set(numbers))
    if absent:
        raise ValueError(
            f"numbers.{absent[0]} is missing; every number is given as [value, provenance, source]"
        )
    if "provenance" in values:
        raise ValueError("unknown key 'provenance'; it stands next to each number")
    return build(Profile, values | {"provenance": provenance}, "")
