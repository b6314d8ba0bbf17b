"""Interferers of the tolerance campaign: their frames at the IF, and the meaning of their level."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.deramp.emitters import Carrier, Emitter, OtherAltimeter, Tone, interference_if
from ...core.deramp.front_end import Bursts, EnvelopeGain, rectified_mw_per_hz
from ...core.deramp.if_waveform import IfWaveform, white_noise
from ...core.deramp.profile import Profile
from ...core.interference.emitters.nr import NrEmitter
from ...core.returns.link_budget import port_density_dbm_per_mhz
from ...core.waveform import altitude_to_delay_s
from .criteria import HIGHEST_DBM

_LOCKED_M = 450.0  # range at which an equal, locked sweep appears, installation delay included
_LOCKED_SHARE = 0.75  # of the span, where that is less: it has to lie within
# Broadband noise of an emitter next to its signal: that of an oscillator (assumed); for NR an adjacent channel leakage
# ratio of 45 dB, the usual limit of base stations, over the whole sweep.
_OSCILLATOR_DBC_PER_HZ = -130.0
_LEAKAGE_DBC_PER_HZ = -45.0 - 69.7  # 69.7 dB: the 9.36 MHz that the carrier occupies
# 5G carriers of 100 MHz outside the band, by their centre: below 3.98 GHz, and on to 4.14 GHz as it was opened in 2026
_BLOCKERS_MHZ = (3750, 3930, 4050, 4100, 4140)
_BLOCKER_BANDWIDTH_HZ = 98e6
# Their unwanted emission in the band: -28.4 of 65 dBm/MHz (limits of the FCC for 3.98 to 4.14 GHz, at second hand)
_UNWANTED_DBC_PER_HZ = -28.4 - 65.0 - 79.9  # 79.9 dB: the 98 MHz that the carrier occupies
_TDD = Bursts(5e-3, 0.74)  # a common pattern of 5 ms, downlink in 52 of 70 symbols
_OWN_APART_HZ = 10e6  # centres of the aircraft's own altimeters
# another aircraft's at 200 m, 0 dBi each way and 6 dB of cables: 26 - 91 - 6 dBm (assumed)
_FOREIGN_DBM = -71.0

# What each mechanism outside the band costs is seen by switching it off: numbers of a profile as good as none.
THRESHOLD = "threshold on power"
NOT_ALONE = (THRESHOLD, "modulated leakage")  # the detector's, which stays; compression modulates
MECHANISMS = {
    "compression": {"p1db_dbm": 100.0, "iip3_dbm": 120.0},
    "modulated leakage": {"isolation_db": 200.0},
    "second order": {"iip2_dbm": 200.0},
    "oscillator noise": {"lo_far_noise_dbc_per_hz": -200.0},
    "recovery": {"recovery_s": 0.0},
    THRESHOLD: {"unlock_loss_db": 200.0},
}


def _retimed(w: IfWaveform, sweep_s: float, bandwidth_hz: float) -> IfWaveform:
    """The sweep of another altimeter, of which only phase and frequency are used."""
    return replace(w, sweep_s=sweep_s, bandwidth_hz=bandwidth_hz, rate_hz=w.samples_per_frame / sweep_s)


def _tone(profile: Profile, rng: np.random.Generator) -> Emitter:
    return Tone(0.08 * profile.bandwidth_hz, rng.random())


def _nr(profile: Profile, rng: np.random.Generator) -> Emitter:
    # 100 ms of data before they repeat: a sweep of 10 ms would meet one frame of 10 ms in the same place for ever
    nr = NrEmitter(channel_bandwidth_hz=10e6, frame_count=10, seed=int(rng.integers(1 << 31)))
    return Carrier.begun(nr, profile.waveform, nr.occupied_bandwidth_hz, 0.07 * profile.bandwidth_hz, rng)


def _other(profile: Profile, rng: np.random.Generator) -> Emitter:
    w = profile.waveform
    period = 1.3 * w.sweep_s
    return OtherAltimeter(_retimed(w, period, 0.9 * w.bandwidth_hz), delay_s=period * rng.random())


def locked_m(profile: Profile) -> float:
    """Range at which an equal, locked sweep appears."""
    return min(_LOCKED_M, _LOCKED_SHARE * profile.max_range_m)


def _locked(profile: Profile, rng: np.random.Generator) -> Emitter:
    return OtherAltimeter(profile.waveform, delay_s=float(altitude_to_delay_s(locked_m(profile))))


@dataclass(frozen=True)
class Interferer:
    """A kind of interference; its level is the mean power at the port while it transmits."""

    title: str
    emitter: Callable[[Profile, np.random.Generator], Emitter] | None = None
    """Callable (profile, rng) -> Emitter, or None None for white noise and for signals next to the band."""
    constant_envelope: bool = False
    """Whether its envelope at the amplifier is constant."""
    bandwidth_hz: float | None = None
    """Bandwidth of its power; None is the preselector's noise bandwidth."""
    center_hz: float | None = None
    """None is the altimeter's own band."""
    floor_dbc_per_hz: float = _OSCILLATOR_DBC_PER_HZ
    """Its broadband noise, white over the sweep. Without it blanking would have no limit."""
    others: bool = False
    """Whether the aircraft's other altimeters and a foreign one transmit as well, at their own levels."""
    bursts: Bursts | None = None
    """When it transmits; None is always."""
    elsewhere_db: float | None = None
    """Power of a second one of the kind, in another direction, over the first's; None for none."""

    @property
    def blocker(self) -> bool:
        """Whether it lies outside the band and acts only through amplifier and mixer."""
        return self.center_hz is not None

    def at_amplifier_dbm(self, profile: Profile, level_dbm: float) -> float:
        """Level behind the preselector."""
        if not self.center_hz:
            return level_dbm
        return level_dbm - profile.preselector_loss_db(self.center_hz, self.bandwidth_hz or 0.0)

    def highest_dbm(self, profile: Profile) -> int:
        """Highest level searched: `HIGHEST_DBM` behind the preselector."""
        return int(HIGHEST_DBM - self.at_amplifier_dbm(profile, 0.0))

    def in_receiver(
        self, profile: Profile, level_dbm: float, return_mw: float = 0.0
    ) -> tuple[EnvelopeGain, dict[str, float]]:
        """Gains of the amplifier, and the densities in mW/Hz of the noise that each mechanism adds to the IF.

        The envelope modulates leakage and return, white over its bandwidth; the mixer rectifies it; oscillator noise
        mixes it into the IF. Its own broadband noise is in the sweep's band and passes the preselector.
        """
        p, strong_dbm = profile, self.at_amplifier_dbm(profile, level_dbm)
        width_hz = self.bandwidth_hz or p.noise_bandwidth_hz
        gain = p.amplifier.with_strong(strong_dbm, constant_envelope=self.constant_envelope)
        through = gain.own**2 * 10 ** (strong_dbm / 10)
        modulated = gain.weak**2 * gain.modulation / width_hz
        lo_dbc = p.lo_far_noise_dbc_per_hz if self.blocker else p.lo_noise_dbc_per_hz
        own_gain = gain.weak if self.blocker else gain.own
        return gain, {
            "modulated leakage": modulated * 10 ** ((p.transmit_dbm - p.isolation_db) / 10),
            "modulated return": modulated * return_mw,
            "second order": 0.0
            if self.constant_envelope
            else rectified_mw_per_hz(through, p.iip2_dbm, width_hz),
            "oscillator noise": through * 10 ** (lo_dbc / 10),
            "own noise": own_gain**2 * 10 ** ((level_dbm + self.floor_dbc_per_hz) / 10),
        }

    def density_dbm_per_mhz(self, profile: Profile, level_dbm: float) -> float:
        """Mean power density at the port, over its own band if it is noise or a blocker, else over the sweep."""
        wide = profile.noise_bandwidth_hz if self.emitter is None else profile.bandwidth_hz
        width = self.bandwidth_hz if self.blocker else wide
        return float(level_dbm - 10 * np.log10((width or wide) / 1e6))

    def flux_dbw_per_m2_mhz(self, profile: Profile, level_dbm: float) -> float:
        """Mean power flux density that gives a level at the port, from boresight."""
        p, at_hz = profile, self.center_hz or profile.carrier_hz
        unit = port_density_dbm_per_mhz(0.0, frequency_hz=at_hz, gain_dbi=p.gain_dbi, cable_db=p.cable_db)
        return self.density_dbm_per_mhz(p, level_dbm) - unit

    def bank(self, profile: Profile, frames: int, rng: np.random.Generator) -> np.ndarray | None:
        """(frames, N) complex64 at the IF, power 1 at the port; None for a blocker."""
        if self.blocker:
            return None
        if self.emitter is None:
            return white_noise(profile.waveform, frames, 1.0 / profile.noise_bandwidth_hz, rng)
        return interference_if(profile.waveform, self.emitter(profile, rng), frames)


INTERFERERS = {
    "white_noise": Interferer("white noise"),
    "tone": Interferer("tone", _tone, constant_envelope=True, bandwidth_hz=1.0),
    "nr10": Interferer("10 MHz NR", _nr, bandwidth_hz=9.36e6, floor_dbc_per_hz=_LEAKAGE_DBC_PER_HZ),
    "altimeter": Interferer("another altimeter", _other, constant_envelope=True, bandwidth_hz=1.0),
    "equal_locked": Interferer("equal sweep, locked", _locked, constant_envelope=True, bandwidth_hz=1.0),
    "white_noise_two": Interferer("white noise, and 10 dB weaker from elsewhere", elsewhere_db=-10.0),
}


def _blocker(mhz: int, words: str = "", **keys: Any) -> Interferer:
    return Interferer(
        f"5G at {mhz / 1000:.2f} GHz{words}",
        bandwidth_hz=_BLOCKER_BANDWIDTH_HZ,
        center_hz=1e6 * mhz,
        floor_dbc_per_hz=_UNWANTED_DBC_PER_HZ,
        **keys,
    )


INTERFERERS |= {f"nr100_{mhz}": _blocker(mhz) for mhz in _BLOCKERS_MHZ}
INTERFERERS["nr100_3930_tdd"] = _blocker(3930, ", bursts", bursts=_TDD)
INTERFERERS["nr100_3930_others"] = _blocker(3930, ", own and foreign altimeters on", others=True)


def others_mw(profile: Profile, frames: int, rng: np.random.Generator) -> np.ndarray:
    """(frames, N) complex64: the aircraft's other altimeters of the same type and a foreign one, unsynchronised."""
    w = profile.waveform
    total = np.zeros((frames, w.samples_per_frame), dtype=np.complex64)
    own = [(1 + 0.013 * (k + 1), (k + 1) * _OWN_APART_HZ) for k in range(profile.other_altimeters)]
    levels_dbm = [profile.transmit_dbm - profile.other_coupling_db] * len(own) + [_FOREIGN_DBM]
    for (longer, offset_hz), level_dbm in zip([*own, (1.3, 0.0)], levels_dbm, strict=True):
        period = w.sweep_s * longer
        other = OtherAltimeter(_retimed(w, period, w.bandwidth_hz), period * rng.random(), offset_hz)
        total += np.float32(10 ** (level_dbm / 20)) * interference_if(w, other, frames)
    return total
