"""Settings of the landing study, from one YAML file (`load_config`); rows depend on nothing else."""

import dataclasses
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...core.altimeter.altimeter import AltimeterSettings
from ...core.interference import Interferer, QpskEmitter, interference_frames
from ...core.interference.evm import TYPICAL
from ...core.parsing import InputError, Settings, build, load_yaml, plain, setting
from ...core.returns.landing import LandingSpec
from ...core.returns.terrain import AircraftState, Trajectory, reflectivity
from ...core.scene import interference_from_yaml, interferer_to_mapping
from ...core.scene.scene import check_options
from ...core.text import one_line
from ...core.waveform import Waveform


@dataclass(frozen=True)
class ApproachSpec(Settings, where="approach"):
    """Figure 1: the whole approach at one interference level."""

    frames: int = setting(400, 0, 2_000_000)  # evenly spread over the flight; 0 leaves the part out
    sir_db: float = -15.0  # SIR, also that of the sensitivity table
    overlap: float = setting(1.0, 0.0, 1.0)  # active fraction of the frame
    chunk: int = setting(50, 1, 2_000_000)  # frames per point; methods are reset at the start of each


@dataclass(frozen=True)
class LandingConfig(LandingSpec, Settings, where="landing"):
    """Settings of the study, and its landing.

    ``snr_db`` sets the signal-to-noise ratio of every frame; None takes it from the radar equation. With ``doppler:
    false`` the aircraft has no velocity in any frame. The power spectra of ``looks`` consecutive frames are averaged
    for one altitude. ``sensitivity_trials`` is the number of frames per row of the sensitivity table; 0 leaves it
    out. Relative file names are relative to ``folder``.
    """

    name: str = "landing"
    seed: int = setting(1, 0, 2**31 - 1)
    waveform: Waveform = Waveform()
    altimeter: AltimeterSettings = AltimeterSettings(strategy="leading_edge")
    interference: tuple[Interferer, ...] = (Interferer(QpskEmitter(evm=TYPICAL)),)
    methods: tuple[str, ...] = ("none", "lms", "nlms", "blanking", "whitening", "linear_prediction", "tcae")
    method_options: dict[str, dict[str, Any]] = field(default_factory=dict, hash=False)
    snr_db: float | None = None
    doppler: bool = True
    point_target: bool = False
    looks: int = setting(1, 1, 64)
    approach: ApproachSpec = ApproachSpec()
    sensitivity_trials: int = setting(120, 0, 1_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.methods:
            raise ValueError("methods is empty; name at least one, such as none")
        check_options(self.method_options)

    @property
    def flown(self) -> Trajectory:
        """The flight, read once."""
        return _flight(LandingSpec(self.trajectory, folder=self.folder))

    def span_s(self) -> tuple[float, float]:
        """First and last instant of a frame's middle."""
        margin_s = 0.5 * self.waveform.sweep_s * (1 + 2 * self.looks)
        return self.window_s(self.flown, margin_s)

    def states(self, times_s: np.ndarray) -> list[AircraftState]:
        """Aircraft states; without Doppler their velocity is zero."""
        states = self.flown.states(times_s)
        if self.doppler:
            return states
        return [dataclasses.replace(s, velocity_m_per_s=(0.0, 0.0, 0.0)) for s in states]

    def approach_times_s(self) -> np.ndarray:
        """(frames,) instants of figure 1, evenly spread."""
        return np.linspace(*self.span_s(), self.approach.frames)

    def trial_times_s(self, trials: int) -> np.ndarray:
        """(trials,) instants, a random one in each of as many equal parts of the flight."""
        start, end = self.span_s()
        rng = np.random.default_rng([self.seed, 0x71])
        return start + (end - start) * (np.arange(trials) + rng.random(trials)) / max(trials, 1)


@lru_cache(maxsize=4)
def _flight(spec: LandingSpec) -> Trajectory:
    return spec.flight()


def parse_config(data: dict[str, Any], *, source: str = "study", folder: str = "") -> LandingConfig:
    """A validated study from nested mappings, as YAML gives them.

    Raises `InputError`: source, key, value, what is allowed.
    """
    try:
        if "curve" in data:
            raise ValueError("curve is a list of the bench, radalt bench landing; leave it out")
        config = build(
            LandingConfig, {"folder": folder, **data}, "", {"interference": interference_from_yaml}
        )
        reflectivity(config.ground.model, config.ground.land)
    except ValueError as error:
        raise InputError(one_line(f"{source}: {error}")) from None
    return config


def check_config(config: LandingConfig) -> None:
    """Check files, coverage and heights before the run.

    Raises ValueError, of terrain and trajectory too: one line about the first fault.
    """
    if not (config.approach.frames or config.sensitivity_trials):
        raise InputError("approach.frames and sensitivity_trials are both 0; give one of them")
    rng, samples = np.random.default_rng(0), config.waveform.samples_per_frame
    radar = config.radar(config.waveform, config.seed)
    interference_frames(config.interference, 1, samples, config.waveform.rate_hz, rng)
    states = config.states(np.linspace(*config.span_s(), 64))
    for state in states:
        radar.facets(state)
    lat, lon, altitude = np.array([(s.latitude_deg, s.longitude_deg, s.altitude_m) for s in states]).T
    height = altitude - config.ground_model().height_m(lat, lon)
    high = int(np.argmax(height))
    top = config.altimeter.resolved(config.waveform).max_altitude_m
    if height[high] > top:
        raise InputError(
            f"the flight reaches {height[high]:.0f} m above ground at t = {states[high].time_s:g} s, beyond "
            f"altimeter.max_altitude_m {top:g}; raise it, or cut with trajectory.start_s"
        )


def load_config(path: Path | str) -> LandingConfig:
    """Read a study file; relative file names in it are relative to its folder."""
    path = Path(path)
    data = load_yaml(path, what="study") or {}
    if not isinstance(data, dict):
        raise InputError(f"study {path}: expected a mapping of keys, found {type(data).__name__}")
    return parse_config(data, source=str(path), folder=str(path.resolve().parent))


def config_dict(config: LandingConfig) -> dict[str, Any]:
    """The study as plain mappings, the inverse of `parse_config`."""
    names = (f.name for f in dataclasses.fields(config) if f.name != "folder")
    mapping = {name: plain(getattr(config, name)) for name in names}
    return mapping | {"interference": [interferer_to_mapping(i) for i in config.interference]}
