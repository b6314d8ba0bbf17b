"""An approach past base stations: power at the port along a glide path, and what the altimeter makes of it.

Per station free space and one reflection from level ground, over the curved Earth: two rays, added over the carrier's
band. Stations add in power. Every place is a trial of its own, at the altitude there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.constants import foot, speed_of_light

from ...core.deramp.profile import Profile, load_profile
from ...core.parsing import InputError, build, check_range, load_yaml
from ...core.returns.terrain.antenna import TabulatedAntenna
from ...core.tracker.tracker_settings import Status
from ...evaluation.engine.study import Point, Run, Study
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.rows import Columns, grouped
from ...evaluation.results.table import DASH, table
from .criteria import RUN_IN, break_level, judged
from .interferers import INTERFERERS
from .report import STYLES
from .study import Trial

_EARTH_M = 4 / 3 * 6.371e6  # radius with standard refraction
_ACROSS = 65  # frequencies over the carrier, over which the two rays are averaged


@dataclass(frozen=True)
class Station:
    """A base station: place, height, antenna's azimuth and downward tilt, EIRP density in the beam."""

    along_m: float
    across_m: float
    height_m: float
    azimuth_deg: float
    tilt_deg: float
    eirp_dbm_per_mhz: float

    def __post_init__(self) -> None:
        check_range("station", self, height_m=(1.0, 500.0), tilt_deg=(-30.0, 60.0))


@dataclass(frozen=True)
class Approach:
    """A straight glide path with stations, as in ``flowgraphs/approaches``.

    ``antenna_floor_dbi`` is the altimeter antenna's gain away from its beam, ``ground_reflection`` the magnitude of the
    ground's reflection (its phase is 180 degrees), ``pattern`` a CSV file of ``azimuth_deg, elevation_deg, gain_dbi``.
    """

    interferer: str
    glide_path_deg: float
    threshold_ft: float
    start_m: float
    step_m: float
    antenna_floor_dbi: float
    ground_reflection: float
    pattern: str
    stations: tuple[Station, ...]

    def __post_init__(self) -> None:
        check_range("approach", self, glide_path_deg=(0.5, 10.0), threshold_ft=(10.0, 500.0))
        check_range("approach", self, start_m=(1.0, 50e3), step_m=(1.0, 50e3), ground_reflection=(0.0, 1.0))
        if not self.stations:
            raise ValueError("stations is empty; name one")
        if not (self.interferer in INTERFERERS and INTERFERERS[self.interferer].blocker):
            outside = [name for name, kind in INTERFERERS.items() if kind.blocker]
            raise ValueError(f"interferer is {self.interferer!r}; allowed: {', '.join(outside)}")

    @property
    def along_m(self) -> list[float]:
        """Distances from the threshold, the farthest first."""
        return np.arange(self.start_m, -0.5 * self.step_m, -self.step_m).clip(0.0).tolist()

    def altitude_ft(self, along_m: float) -> float:
        """Altitude on the glide path."""
        return self.threshold_ft + along_m * float(np.tan(np.radians(self.glide_path_deg))) / foot

    def power_dbm(self, profile: Profile, pattern: TabulatedAntenna, along_m: float) -> float:
        """Mean power of all stations at the port."""
        kind, height_m = INTERFERERS[self.interferer], self.altitude_ft(along_m) * foot
        width_hz = kind.bandwidth_hz or 0.0
        waves_per_m = ((kind.center_hz or 0.0) + width_hz * np.linspace(-0.5, 0.5, _ACROSS)) / speed_of_light
        floor, top, total_mw = 10 ** (self.antenna_floor_dbi / 10), 10 ** (pattern.gain_dbi.max() / 10), 0.0
        for s in self.stations:
            apart_m = float(np.hypot(along_m - s.along_m, s.across_m))
            if apart_m > np.sqrt(2 * _EARTH_M) * (np.sqrt(height_m) + np.sqrt(s.height_m)):
                continue  # beyond the horizon
            mast_m = s.height_m - apart_m**2 / (2 * _EARTH_M)
            azimuth = np.arctan2(-s.across_m, along_m - s.along_m) - np.radians(s.azimuth_deg)
            field = np.zeros(_ACROSS, dtype=complex)
            # rise from the mast to the aircraft, or to its image in the ground
            for rise_m, share in ((height_m - mast_m, 1.0), (-height_m - mast_m, -self.ground_reflection)):
                up = np.arctan2(rise_m, apart_m) + np.radians(s.tilt_deg) * np.cos(azimuth)
                # both rays arrive from below the aircraft
                nadir = np.arctan2(apart_m, rise_m * np.sign(share))
                own = max(float(profile.antenna.gain(nadir, 0.0)), floor)
                gains = own * pattern.gain(np.pi / 2 - up, azimuth)
                paths = waves_per_m * np.hypot(apart_m, rise_m)
                field += share * np.sqrt(gains / top) / (4 * np.pi * paths) * np.exp(-2j * np.pi * paths)
            total_mw += 10 ** (s.eirp_dbm_per_mhz / 10) * width_hz / 1e6 * float(np.mean(np.abs(field) ** 2))
        return float(10 * np.log10(max(total_mw, 1e-30)) - profile.cable_db)


def load_approach(path: str | Path) -> tuple[Approach, TabulatedAntenna]:
    """An approach and its pattern; InputError, one line, with the file."""
    try:
        found = build(Approach, load_yaml(Path(path), what="approach"), "approach")
        return found, TabulatedAntenna.load(Path(path).parent / found.pattern)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"approach {Path(path).name}: {error}") from None


@dataclass(frozen=True)
class PlacePoint(Point):
    """An altimeter at a distance from the threshold."""

    profile: str = ""
    along_m: float = 0.0


_NUMBERS = ("along_m", "altitude_ft", "power_dbm", "break_dbm", "normal", "tracked_ft")
COLUMNS = Columns(("profile", *_NUMBERS, "failed", "interferer"))


@dataclass(frozen=True)
class ApproachStudy(Study):
    """Altimeters along an approach; see `Approach`."""

    profiles: tuple[str, ...]
    approach: Approach
    pattern: TabulatedAntenna
    outputs: int = 40

    tables: ClassVar[Mapping[str, Columns]] = {"rows": COLUMNS}
    published: ClassVar[Mapping[str, str]] = {
        "rows.csv": "data/tolerance_approach.csv",
        "approach.svg": "figures/tolerance_approach.svg",
    }

    def head(self) -> dict[str, Any]:
        pattern = [getattr(self.pattern, k).tolist() for k in ("angle_deg", "azimuth_deg", "gain_dbi")]
        altimeters = [asdict(load_profile(name)) for name in self.profiles]
        own = {"outputs": self.outputs, "approach": asdict(self.approach)}
        return own | {"pattern": pattern, "altimeters": altimeters}

    def points(self) -> Sequence[PlacePoint]:
        """See `Study`: places within the span."""
        found = []
        for name in self.profiles:
            p = load_profile(name)
            frames = (self.outputs + RUN_IN) * p.sweeps_per_output
            inside = [x for x in self.approach.along_m if self.approach.altitude_ft(x) <= p.max_altitude_ft]
            found += [PlacePoint(f"{p.name}, {x:g} m", frames, "rows", name, x) for x in inside]
        return found

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """One row: altitude and status at the stations' power, and the power that breaks the altimeter there."""
        p, feet = load_profile(point.profile), self.approach.altitude_ft(point.along_m)
        trial = Trial(p, self.approach.interferer, "none", self.outputs, 1)
        returns, power = trial.returns(feet), self.approach.power_dbm(p, self.pattern, point.along_m)

        def outcome(level_dbm: float) -> tuple[np.ndarray, str]:
            status, altitude_m = trial.outputs(returns, level_dbm)
            fails = judged(status, altitude_m, feet * foot, p.output_s)
            return altitude_m[status == Status.NORMAL], " ".join(k for k, has in fails.items() if has)

        tracked_m, failed = outcome(power)
        broken = break_level(lambda level: bool(outcome(level)[1]), power, trial.kind.highest_dbm(p))
        tracked_ft = float(tracked_m.mean() / foot) if tracked_m.size else None
        numbers = (point.along_m, feet, power, broken, tracked_m.size / self.outputs, tracked_ft)
        words = {"profile": p.name, "failed": failed or "none", "interferer": self.approach.interferer}
        return [words | dict(zip(_NUMBERS, numbers, strict=True))]

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        save_figure(draw_approach(rows["rows"]), folder.path / "approach.png")
        header = "altimeter | to the threshold, m | altitude, ft | power, dBm | breaks at, dBm | NORMAL | tracked, ft"
        lines = [
            [r["profile"], *(DASH if r[k] is None else f"{r[k]:.1f}" for k in _NUMBERS), r["failed"]]
            for r in rows["rows"]
        ]
        values = {"approach": self.approach, "place_table": table(f"{header} | failed", lines)}
        return write_result(folder, Path(__file__).with_name("approach.md.j2"), run.as_dict(), rows, values)


def draw_approach(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Altitude, power and status over the distance to the threshold."""
    figure = new_figure(6.4, 6.0)
    axes = figure.subplots(3, 1, sharex=True)
    found = grouped(rows, "profile")
    for (name, mine), (colour, marker) in zip(found.items(), STYLES, strict=False):
        of = {k: [np.nan if r[k] is None else r[k] for r in mine] for k in _NUMBERS}
        x, style = np.array(of["along_m"]) / 1e3, {"color": colour, "marker": marker, "markersize": 4}
        axes[0].plot(x, of["altitude_ft"], color="#999999", linewidth=1, zorder=0)
        axes[1].plot(x, of["power_dbm"], color="#56B4E9", linewidth=2, zorder=0)
        axes[0].plot(x, of["tracked_ft"], linestyle="", label=name, **style)
        axes[1].plot(x, of["break_dbm"], linestyle="--", **style)
        axes[2].plot(x, of["normal"], **style)
    words = ("altitude, ft", "at the port, dBm\n(dashed: breaks it)", "NORMAL, share of outputs")
    for axis, text in zip(axes, words, strict=True):
        axis.set_ylabel(text)
        axis.grid(True, linewidth=0.4, alpha=0.5)
    axes[2].set_ylim(-0.05, 1.05)
    axes[2].set_xlabel("to the threshold, km")
    axes[2].invert_xaxis()
    axes[0].legend(fontsize=8, frameon=False, ncols=len(found))
    return figure
