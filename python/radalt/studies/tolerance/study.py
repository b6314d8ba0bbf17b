"""The tolerance campaign: break-points by altimeter, interferer, altitude, method and seed.

IF frames of an interferer are made once per point and scaled, so that levels, altitudes and criteria share them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from scipy.constants import foot

from ...core.channel.auxiliary import AuxiliaryReceiver, AuxiliarySettings, Direction
from ...core.deramp.emitters import delayed_if
from ...core.deramp.front_end import rectified
from ...core.deramp.ground import DiffuseGround
from ...core.deramp.if_waveform import white_noise
from ...core.deramp.profile import Profile, load_profile
from ...core.interference.emitters.faa_91_220 import MAX_ALTITUDE_FT, pfd_dbw_per_m2_mhz
from ...core.mitigation import create
from ...core.returns.point import point_return
from ...core.timing.auxiliary_cancel import AuxiliaryCancel, CancelSettings
from ...evaluation.engine.study import Point, Study
from ...evaluation.results.rows import Columns
from .criteria import CRITERIA, RUN_IN, break_level, judged
from .interferers import INTERFERERS, MECHANISMS, NOT_ALONE, THRESHOLD, Interferer, locked_m, others_mw

SECOND = "auxiliary_cancel"
# those that work behind an IF filter
METHODS = ("none", "whitening", "linear_prediction", "blanking", SECOND)
KEEP_SCALE = ("none", "blanking", SECOND)  # methods that leave the scale of the IF
_CHUNK = 8  # outputs per call of the detector
# The second antenna, its front end but for the ripple the profile's own: a second emitter is elsewhere
_DIRECTIONS = Direction(), Direction(gain_db=0.0, delay_s=-3e-9)
AUXILIARY = AuxiliarySettings(directions=_DIRECTIONS, image_db=None, third_order_db=None, adc_bits=0)
_PIECE_S = 55e-6  # a carrier of 1 MHz stays in the IF for that long at 43 GHz/s
_APART = 0.05  # of the altitude; an equal sweep nearer to it could pass the criteria (2 %) for the return
_MOST_LOSS_DB = 160  # in which the loop loss of a lost track is searched
# Mean density of interference in the sweep over the power of the return at the break-point, dB/MHz, measured with white
# noise and nearly the same for all interferers. Only where a bisection starts.
_EXPECTED_DB = 30.0


@dataclass(frozen=True)
class TolerancePoint(Point):
    """One altimeter, interferer, method and seed; its rows are the altitudes."""

    profile: str = "typical"
    mechanisms: str = "all"  # or `alone` or `without` one of `MECHANISMS`
    interferer: str = "white_noise"
    method: str = "none"
    seed: int = 1


class Trial:
    """One realisation of noise and interference, at any level, over one altitude at a time.

    ``outputs``: outputs that the criteria count; ``ground``: ``point`` or ``diffuse``. With the method
    `auxiliary_cancel`, ``auxiliary`` is the second antenna, and ``cancel`` has settings of its canceller other than
    those that a mixer asks for.
    """

    def __init__(
        self,
        profile: Profile,
        interferer: str,
        method: str,
        outputs: int,
        seed: int,
        ground: str = "point",
        auxiliary: AuxiliarySettings = AUXILIARY,
        cancel: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        self.profile, self.kind, self.ground = profile, INTERFERERS[interferer], ground
        self.rng = np.random.default_rng([seed, *interferer.encode()])
        frames = (outputs + RUN_IN) * profile.sweeps_per_output
        w, density = profile.waveform, profile.noise_mw_per_hz
        self.noise = [white_noise(w, frames, density, self.rng)]
        self.banks = [self.kind.bank(profile, frames, self.rng)]
        self.others = others_mw(profile, frames, self.rng) if self.kind.others else None
        self.burst_s = self.kind.bursts.period_s * self.rng.random() if self.kind.bursts else 0.0
        self.detector = profile.make_detector()
        options = {"max_altitude_m": profile.max_range_m} if method == "blanking" else {}
        self.method = None if method in ("none", SECOND) else create(method, w, **options)
        self.canceller, self.gains_db = None, [0.0]
        emitted = self.banks
        if self.kind.elsewhere_db is not None:
            other = self.kind.bank(profile, frames, self.rng)
            emitted = [self.banks[0], np.float32(10 ** (self.kind.elsewhere_db / 20)) * other]
            self.banks = [sum(emitted)]
        if method == SECOND:
            settings = {"reach_s": 0.0, "order": 1, "pieces": round(w.sweep_s / _PIECE_S)} | cancel
            settings = CancelSettings(**settings)
            self.canceller = AuxiliaryCancel(w, settings, max_altitude_m=profile.max_range_m)
            # both antennas receive the emitter's broadband noise as they receive the emitter
            own = 10 ** (self.kind.floor_dbc_per_hz / 10)
            emitted = [bank + white_noise(w, frames, own, self.rng) for bank in emitted]
            second = replace(auxiliary, directions=auxiliary.directions[: len(emitted)])
            receiver = AuxiliaryReceiver(w, second, (), 0.0, seed)
            channels = [
                receiver.receive(i, np.zeros(1), lambda k, s, i=i: delayed_if(w, emitted[k][i : i + 1], s))
                for i in range(frames)
            ]
            self.banks = [np.concatenate(bank).astype(np.complex64) for bank in zip(*channels, strict=True)]
            self.noise.append(white_noise(w, frames, density, self.rng))
            # each front end's own distortion lies in the emitter's band, as another one of the kind does
            self.distortion = [self.kind.bank(profile, frames, self.rng) for _ in range(2)]
            self.gains_db.append(auxiliary.directions[0].gain_db)
            self.leakage = np.float32(10 ** (-auxiliary.isolation_db / 20))

    def returns(self, altitude_ft: float) -> np.ndarray:
        """(1, N) or (frames, N) complex64: the return at the loop loss of an altitude."""
        p, w = self.profile, self.profile.waveform
        power_mw = 10 ** ((p.transmit_dbm - p.loop_loss_db(altitude_ft)) / 10)
        range_m = (altitude_ft + p.installation_delay_ft) * foot
        if self.ground == "point":
            return np.float32(np.sqrt(power_mw)) * point_return(w, np.array([range_m]))
        ground = DiffuseGround(p.antenna, p.ground)
        rng = np.random.default_rng([int(altitude_ft), *self.rng.bit_generator.seed_seq.entropy])
        out = np.empty_like(self.noise[0])
        for frame in out:
            frame[:] = ground.frame(w, range_m, power_mw, rng)
        return out

    def outputs(self, returns: np.ndarray, level_dbm: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Status and altitude in metres of the counted outputs; level None is without interference."""
        p, per = self.profile, self.profile.sweeps_per_output
        frames = len(self.noise[0])
        chunk = frames if p.detector == "tracker" else _CHUNK * per
        found = []
        if self.method is not None:
            self.method.reset()
        if self.canceller is not None:  # it measures the isolation before there is interference
            self.canceller.reset()
            self._received(returns, None, slice(0, per))
        for first in range(0, frames, chunk):
            part = slice(first, first + chunk)
            found.append(self.detector(self._received(returns, level_dbm, part)))
        status, altitude = (np.concatenate(column)[RUN_IN:] for column in zip(*found, strict=True))
        return status, altitude - p.installation_delay_ft * foot

    def unlock_loss_db(self, returns: np.ndarray, altitude_ft: float) -> float | None:
        """Loop loss at which a criterion falls without interference, to +/-0.5 dB; the altitude stays."""
        p, loss_db = self.profile, self.profile.loop_loss_db(altitude_ft)

        def failed(more_db: int) -> bool:
            weaker = returns * np.float32(10 ** (-more_db / 20))
            return any(judged(*self.outputs(weaker, None), altitude_ft * foot, p.output_s).values())

        more_db = break_level(failed, min(p.unlock_loss_db, _MOST_LOSS_DB) - loss_db, _MOST_LOSS_DB)
        return None if more_db is None else loss_db + more_db

    def _received(self, returns: np.ndarray, level_dbm: float | None, part: slice) -> np.ndarray:
        """IF frames of a slice, as the detector gets them."""
        back = returns if len(returns) == 1 else returns[part]
        y = self._channel(0, back, level_dbm, part)
        if self.canceller is not None:
            y = self.canceller.process(y, self._channel(1, self.leakage * back, level_dbm, part))
        return y if self.method is None else self.method.process(y)

    def _channel(self, k: int, back: np.ndarray, level_dbm: float | None, part: slice) -> np.ndarray:
        """Converted IF frames of a slice of one receive channel, ``level_dbm`` that of the first."""
        p = self.profile
        if level_dbm is None:
            y = self.noise[k][part] + back
        else:
            return_mw = float(np.mean(np.abs(back[0]) ** 2))
            at_dbm = level_dbm + self.gains_db[k]
            gain, added = self.kind.in_receiver(p, at_dbm, return_mw)
            if self.canceller is not None:
                del added["own noise"]  # which both antennas receive: it is in the bank
            density, weak = sum(added.values()) / p.noise_mw_per_hz, gain.weak
            rest: np.ndarray | float = 0.0
            if self.kind.bursts is not None:
                frames = np.arange(len(self.noise[0]))[part, None]
                time_s = self.burst_s + (frames * p.waveform.sweep_s + p.waveform.sample_times_s)
                on = self.kind.bursts.on(time_s)
                weak = self.kind.bursts.gain(time_s, gain.weak, p.recovery_s)
                through = gain.own**2 * 10 ** (self.kind.at_amplifier_dbm(p, level_dbm) / 10)
                density, rest = density * on, rectified(through * on, p.iip2_dbm)
            y = self.noise[k][part] * np.sqrt(1 + density, dtype=np.float32)
            y += np.asarray(weak, dtype=np.float32) * back + np.asarray(rest, dtype=np.complex64)
            if self.banks[k] is not None:
                y += np.float32(gain.own * 10 ** (level_dbm / 20)) * self.banks[k][part]
            if self.canceller is not None and gain.distortion > 0:
                y += np.float32(np.sqrt(gain.distortion) * 10 ** (at_dbm / 20)) * self.distortion[k][part]
        if self.others is not None:
            y += self.others[part]
        blocks = y.reshape(-1, p.sweeps_per_output * y.shape[1])
        rms = np.sqrt(0.5 * np.mean(blocks.real**2 + blocks.imag**2, axis=1))
        if k:  # no weak return is to be kept there: its gain control is for the peak
            peak = np.abs(blocks.view(np.float32)).max(axis=1)
            rms = np.maximum(rms, peak * 10 ** (-p.headroom_db / 20))
        return p.converter(y, np.repeat(rms, p.sweeps_per_output)[:, None])


@lru_cache(maxsize=4)
def _profile(name: str) -> Profile:
    return load_profile(name)


def altered(profile: Profile, mechanisms: str) -> Profile:
    """A profile with mechanisms switched off: ``all``, ``without NAME``, ``alone NAME``."""
    how, _, name = mechanisms.partition(" ")
    off = {} if how == "all" else MECHANISMS[name]
    if how == "alone":  # the detector's threshold stays
        others = [v for k, v in MECHANISMS.items() if k not in (name, THRESHOLD)]
        off = {k: v for numbers in others for k, v in numbers.items()}
    return replace(profile, **off)


_STATED = "profile mechanisms interferer method ground altitude_ft seed outputs output_s loop_loss_db".split()
_BREAK = "return_dbm unlock_loss_db first break_dbm break_dbm_per_mhz break_dbw_per_m2_mhz margin_db".split()
COLUMNS = Columns((*_STATED, *_BREAK, *(f"{name}_dbm" for name in CRITERIA), "levels"))


@dataclass(frozen=True)
class ToleranceStudy(Study):
    """A grid of altimeters, interferers, methods, altitudes and seeds."""

    profiles: tuple[str, ...]  # paths, or names of shipped profiles
    interferers: tuple[str, ...]
    methods: tuple[str, ...]
    altitudes_ft: tuple[float, ...]
    outputs: int = 150  # outputs that every criterion counts: the duration of a trial
    seeds: int = 3  # number of realisations
    ground: str = "point"
    """``point`` (at the loop loss of diffuse ground, as a test set shows it) or ``diffuse``."""
    decompose: bool = False
    """Measure interferers outside the band also with each of `MECHANISMS` alone, and without it; those in the band
    also without compression."""
    seed: int = 2  # the first realisation; the shipped profiles were fitted on 1

    tables: ClassVar[Mapping[str, Columns]] = {"rows": COLUMNS}
    published: ClassVar[Mapping[str, str]] = {
        "rows.csv": "data/tolerance.csv",
        "tolerance.svg": "figures/tolerance.svg",
    }

    def head(self) -> dict[str, Any]:
        numbers = [_profile(name) for name in self.profiles]
        altimeters = [{k: getattr(p, k) for k in p.__dataclass_fields__} for p in numbers]
        return vars(self) | {"altimeters": altimeters}

    def check(self) -> None:
        """See `Study`; raises ValueError, one line."""
        profiles = [_profile(name) for name in self.profiles]
        names = [p.name for p in profiles]
        if len(set(names)) < len(names):
            raise ValueError(f"--profile: two altimeters have one name: {', '.join(names)}; rename one")
        for name in self.interferers:
            if name not in INTERFERERS:
                raise ValueError(f"--interferers: {name!r} is unknown; there are {', '.join(INTERFERERS)}")
            for p in profiles:
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
        for p in profiles:
            if min(self.altitudes_ft) > p.max_altitude_ft:
                raise ValueError(
                    f"--altitudes-ft: {p.name} has none within 10..{p.max_altitude_ft:g}, its span; name one"
                )
        kinds = [INTERFERERS[name] for name in self.interferers]
        if SECOND in self.methods and any(kind.blocker or kind.others for kind in kinds):
            raise ValueError(
                f"--method: {SECOND} takes out emitters in the band; leave those outside it and other altimeters out"
            )
        for p, name in product(profiles, self.methods):
            if p.unlock_loss_db < 200 and name not in KEEP_SCALE:
                raise ValueError(
                    f"--method: {name} changes the scale of the IF, on which {p.name} has its threshold on power; "
                    "leave it out, or set the profile's unlock_loss_db to 200"
                )
        for feet in self.altitudes_ft:
            for p in profiles:
                apart_m = abs(locked_m(p) - (feet + p.installation_delay_ft) * foot)
                if "equal_locked" in self.interferers and apart_m < _APART * feet * foot:
                    raise ValueError(
                        f"--altitudes-ft: {feet:g} ft is where equal_locked appears, which could do no harm there; "
                        "name another altitude"
                    )

    def points(self) -> Sequence[TolerancePoint]:
        found = []
        for name, method, interferer, seed in product(
            self.profiles, self.methods, self.interferers, range(self.seed, self.seed + self.seeds)
        ):
            p = _profile(name)
            frames = (self.outputs + RUN_IN) * p.sweeps_per_output
            cases = ["all"]
            if self.decompose and not INTERFERERS[interferer].blocker:
                cases.append("without compression")
            elif self.decompose:
                cases += [f"alone {m}" for m in MECHANISMS if m not in NOT_ALONE]
                cases += [f"without {m}" for m in MECHANISMS]
            for case in cases:
                words = f"{p.name}, {interferer}, {method}, seed {seed}" + f", {case}" * (case != "all")
                found.append(TolerancePoint(words, frames, "rows", name, case, interferer, method, seed))
        return found

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """A row per altitude within the span."""
        p = altered(_profile(point.profile), point.mechanisms)
        trial = Trial(p, point.interferer, point.method, self.outputs, point.seed, self.ground)
        return [self._row(p, point, trial, feet) for feet in self.altitudes_ft if feet <= p.max_altitude_ft]

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
            "mechanisms": point.mechanisms,
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
        if point.mechanisms == "all" and point.interferer == self.interferers[0]:
            row["unlock_loss_db"] = trial.unlock_loss_db(returns, feet)
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
        density, flux = broken + unit_db, trial.kind.flux_dbw_per_m2_mhz(p, broken)
        # Table 1 applies to low altitudes
        margin = flux - self.asked(p, trial.kind) if feet <= MAX_ALTITUDE_FT else np.nan
        densities = {"break_dbm_per_mhz": density, "break_dbw_per_m2_mhz": flux, "margin_db": margin}
        return row | {"first": first, "break_dbm": broken} | densities

    @staticmethod
    def asked(profile: Profile, kind: Interferer) -> float:
        """Least level of Table 1 in dBW/m^2/MHz within a carrier outside the band, else that of the band."""
        at_hz, side = kind.center_hz or profile.carrier_hz, 0.5 * (kind.bandwidth_hz or 0.0) * kind.blocker
        return float(pfd_dbw_per_m2_mhz(np.linspace(at_hz - side, at_hz + side, 99)).min())
