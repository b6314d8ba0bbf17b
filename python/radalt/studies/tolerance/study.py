"""The tolerance campaign: break-points by interferer, altitude, method and seed.

IF frames of an interferer are made once per point and scaled, so that levels, altitudes and criteria share them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from scipy.constants import foot

from ...core.deramp.ground import DiffuseGround
from ...core.deramp.if_waveform import white_noise
from ...core.deramp.profile import Profile, load_profile
from ...core.interference.emitters.faa_91_220 import MAX_ALTITUDE_FT, pfd_dbw_per_m2_mhz
from ...core.mitigation import create
from ...core.returns.link_budget import port_density_dbm_per_mhz
from ...core.returns.point import point_return
from ...evaluation.engine.study import Point, Study
from ...evaluation.results.rows import Columns
from .criteria import CRITERIA, RUN_IN, break_level, judged
from .interferers import INTERFERERS, locked_m, others_mw

METHODS = ("none", "whitening", "linear_prediction", "blanking")  # those that work behind an IF filter
_CHUNK = 8  # outputs per call of the detector
_APART = 0.05  # of the altitude; an equal sweep nearer to it could pass the criteria (2 %) for the return
# Mean density of interference in the sweep over the power of the return at the break-point, dB/MHz, measured with white
# noise and nearly the same for all interferers. Only where a bisection starts.
_EXPECTED_DB = 30.0


@dataclass(frozen=True)
class TolerancePoint(Point):
    """One interferer, method and seed; its rows are the altitudes."""

    interferer: str = "white_noise"
    method: str = "none"
    seed: int = 1


class Trial:
    """One realisation of noise and interference, at any level, over one altitude at a time.

    Parameters
    ----------
    profile : Profile
    interferer, method : str
    outputs : int
        Outputs that the criteria count.
    seed : int
    ground : str
        ``point`` or ``diffuse``.
    """

    def __init__(
        self, profile: Profile, interferer: str, method: str, outputs: int, seed: int, ground: str = "point"
    ) -> None:
        self.profile, self.kind, self.ground = profile, INTERFERERS[interferer], ground
        self.rng = np.random.default_rng([seed, *interferer.encode()])
        frames = (outputs + RUN_IN) * profile.sweeps_per_output
        self.noise = white_noise(profile.waveform, frames, profile.noise_mw_per_hz, self.rng)
        self.bank = self.kind.bank(profile, frames, self.rng)
        self.others = others_mw(profile, frames, self.rng) if self.kind.others else None
        self.detector = profile.make_detector()
        options = {"max_altitude_m": profile.max_range_m} if method == "blanking" else {}
        self.method = None if method == "none" else create(method, profile.waveform, **options)

    def returns(self, altitude_ft: float) -> np.ndarray:
        """(1, N) or (frames, N) complex64: the return at the loop loss of an altitude."""
        p, w = self.profile, self.profile.waveform
        power_mw = 10 ** ((p.transmit_dbm - p.loop_loss_db(altitude_ft)) / 10)
        range_m = (altitude_ft + p.installation_delay_ft) * foot
        if self.ground == "point":
            return np.float32(np.sqrt(power_mw)) * point_return(w, np.array([range_m]))
        ground = DiffuseGround(p.antenna, p.ground)
        rng = np.random.default_rng([int(altitude_ft), *self.rng.bit_generator.seed_seq.entropy])
        out = np.empty_like(self.noise)
        for frame in out:
            frame[:] = ground.frame(w, range_m, power_mw, rng)
        return out

    def outputs(self, returns: np.ndarray, level_dbm: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Status and altitude in metres of the counted outputs; level None is without interference."""
        p, per = self.profile, self.profile.sweeps_per_output
        frames = len(self.noise)
        chunk = frames if p.detector == "tracker" else _CHUNK * per
        found = []
        if self.method is not None:
            self.method.reset()
        for first in range(0, frames, chunk):
            part = slice(first, first + chunk)
            found.append(self.detector(self._received(returns, level_dbm, part)))
        status, altitude = (np.concatenate(column)[RUN_IN:] for column in zip(*found, strict=True))
        return status, altitude - p.installation_delay_ft * foot

    def _received(self, returns: np.ndarray, level_dbm: float | None, part: slice) -> np.ndarray:
        """IF frames of a slice, as the detector gets them."""
        p = self.profile
        back = returns if len(returns) == 1 else returns[part]
        if level_dbm is None:
            y = self.noise[part] + back
        else:
            gain, added = self.kind.in_receiver(p, level_dbm)
            y = self.noise[part] * np.float32(np.sqrt(1 + added / p.noise_mw_per_hz))
            y += np.float32(gain.weak) * back
            if self.bank is not None:
                y += np.float32(gain.own * 10 ** (level_dbm / 20)) * self.bank[part]
        if self.others is not None:
            y += self.others[part]
        if p.mixer == "real":
            y = y.real.astype(np.complex64)
        blocks = y.reshape(-1, p.sweeps_per_output * y.shape[1])
        rms = np.sqrt(0.5 * np.mean(blocks.real**2 + blocks.imag**2, axis=1))
        y = p.converter(y, np.repeat(rms, p.sweeps_per_output)[:, None])
        return y if self.method is None else self.method.process(y)


@lru_cache(maxsize=4)
def _profile(name: str) -> Profile:
    return load_profile(name)


_TEXT = ("profile", "interferer", "method", "ground", "first")
_BREAK = ("break_dbm", "break_dbm_per_mhz", "break_dbw_per_m2_mhz", "margin_db")
COLUMNS = Columns(
    (*_TEXT[:4], "altitude_ft", "seed", "outputs", "output_s", "loop_loss_db", "return_dbm", "first")
    + (*_BREAK, *(f"{name}_dbm" for name in CRITERIA), "levels"),
    text=frozenset(_TEXT),
    whole=frozenset({"seed", "outputs", "levels"}),
)


@dataclass(frozen=True)
class ToleranceStudy(Study):
    """A grid of interferers, methods, altitudes and seeds for one altimeter.

    Attributes
    ----------
    profile : str
        Path, or name of a shipped profile.
    interferers, methods : tuple of str
    altitudes_ft : tuple of float
    outputs : int
        Outputs that every criterion counts: the duration of a trial.
    seeds : int
        Realisations 1, 2, ...
    ground : str
        ``point`` (at the loop loss of diffuse ground, as a test set shows it) or ``diffuse``.
    """

    profile: str
    interferers: tuple[str, ...]
    methods: tuple[str, ...]
    altitudes_ft: tuple[float, ...]
    outputs: int = 150
    seeds: int = 3
    ground: str = "point"

    tables: ClassVar[Mapping[str, Columns]] = {"rows": COLUMNS}
    published: ClassVar[Mapping[str, str]] = {
        "rows.csv": "data/tolerance.csv",
        "tolerance.svg": "figures/tolerance.svg",
    }

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        p = _profile(self.profile)
        words = {k: v for k, v in vars(p).items() if k in p.__dataclass_fields__ and k != "standing"}
        return vars(self) | {"altimeter": words, "standing": {k: list(v) for k, v in p.standing.items()}}

    def check(self) -> None:
        """See `Study`; raises ValueError, one line."""
        p = _profile(self.profile)
        for name in self.interferers:
            if name not in INTERFERERS:
                raise ValueError(f"--interferers: {name!r} is unknown; there are {', '.join(INTERFERERS)}")
            try:
                INTERFERERS[name].bank(p, 1, np.random.default_rng(1))
            except ValueError as error:  # the sweep or the IF's rate does not fit
                raise ValueError(f"--interferers: {name}: {error}") from None
        for name in self.methods:
            if name not in METHODS:
                raise ValueError(
                    f"--method: {name!r} is none of those that work behind an IF filter, where a deramping altimeter "
                    f"has its samples: {', '.join(METHODS)}"
                )
        for feet in self.altitudes_ft:
            if not 10 <= feet <= p.max_altitude_ft:
                raise ValueError(
                    f"--altitudes-ft: {feet:g} ft; it has to be within 10..{p.max_altitude_ft:g}, the span of {p.name}"
                )
            apart_m = abs(locked_m(p) - (feet + p.installation_delay_ft) * foot)
            if "equal_locked" in self.interferers and apart_m < _APART * feet * foot:
                raise ValueError(
                    f"--altitudes-ft: {feet:g} ft is where equal_locked appears, which could do no harm there; name "
                    "another altitude"
                )

    def points(self) -> Sequence[TolerancePoint]:
        """See `Study`."""
        frames = (self.outputs + RUN_IN) * _profile(self.profile).sweeps_per_output
        return [
            TolerancePoint(f"{i}, {m}, seed {s}", frames, interferer=i, method=m, seed=s)
            for m in self.methods
            for i in self.interferers
            for s in range(1, self.seeds + 1)
        ]

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """A row per altitude."""
        p = _profile(self.profile)
        trial = Trial(p, point.interferer, point.method, self.outputs, point.seed, self.ground)
        return [self._row(p, point, trial, feet) for feet in self.altitudes_ft]

    def _row(self, p: Profile, point: Point, trial: Trial, feet: float) -> dict[str, Any]:
        returns = trial.returns(feet)
        known: dict[float | None, dict[str, bool]] = {}

        def failed(level: float | None) -> dict[str, bool]:
            if level not in known:
                known[level] = judged(*trial.outputs(returns, level), feet * foot, p.output_s)
            return known[level]

        loss_db = p.loop_loss_db(feet)
        row = {
            "profile": p.name,
            "interferer": point.interferer,
            "method": point.method,
            "ground": self.ground,
            "altitude_ft": feet,
            "seed": point.seed,
            "outputs": self.outputs,
            "output_s": p.output_s,
            "loop_loss_db": loss_db,
            "return_dbm": p.transmit_dbm - loss_db,
        }
        clean = [name for name, fails in failed(None).items() if fails]
        if clean:
            return row | {"first": "without interference: " + " ".join(clean), "levels": 1}
        unit_db = trial.kind.density_dbm_per_mhz(p, 0.0)
        expected = p.transmit_dbm - loss_db + _EXPECTED_DB - unit_db
        breaks = {
            name: break_level(lambda x, n=name: failed(x)[n], expected, trial.kind.highest_dbm(p))
            for name in CRITERIA
        }
        row |= {f"{name}_dbm": level for name, level in breaks.items()} | {"levels": len(known)}
        levels = [level for level in breaks.values() if level is not None]
        if not levels:
            return row | {"first": "none"}
        broken = min(levels)
        first = " ".join(name for name, level in breaks.items() if level == broken)
        return row | {"first": first, "break_dbm": broken} | self._densities(p, trial, feet, broken)

    def _densities(self, p: Profile, trial: Trial, feet: float, level_dbm: float) -> dict[str, float]:
        """Densities at the port and in the air, and the margin to Table 1 where that applies."""
        at_hz = trial.kind.center_hz or p.carrier_hz
        density = trial.kind.density_dbm_per_mhz(p, level_dbm)
        unit = port_density_dbm_per_mhz(0.0, frequency_hz=at_hz, gain_dbi=p.gain_dbi, cable_db=p.cable_db)
        flux = density - unit
        margin = flux - float(pfd_dbw_per_m2_mhz(at_hz)) if feet <= MAX_ALTITUDE_FT else np.nan
        return {"break_dbm_per_mhz": density, "break_dbw_per_m2_mhz": flux, "margin_db": margin}
