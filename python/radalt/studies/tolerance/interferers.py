"""Interferers of the tolerance campaign: their frames at the IF, and the meaning of their level."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...core.deramp.emitters import Emitter, Ofdm, OtherAltimeter, Pulses, Qpsk, Tone, interference_if
from ...core.deramp.front_end import EnvelopeGain
from ...core.deramp.if_waveform import IfWaveform, white_noise
from ...core.deramp.profile import Profile
from ...core.waveform import altitude_to_delay_s
from .criteria import HIGHEST_DBM

_LOCKED_M = 450.0  # range at which an equal, locked sweep appears, installation delay included
_LOCKED_SHARE = 0.75  # of the span, where that is less: it has to lie within
_DRIFT = 1e-5  # relative difference of the periods of equal sweeps: two crystals of 5 ppm
# Broadband noise of an emitter beside its signal: that of an oscillator (assumed); for NR an adjacent channel leakage
# ratio of 45 dB, the usual limit of base stations, over the whole sweep.
_OSCILLATOR_DBC_PER_HZ = -130.0
_LEAKAGE_DBC_PER_HZ = -45.0 - 69.7  # 69.7 dB: the 9.36 MHz that the carrier occupies
_BLOCKER_HZ, _BLOCKER_BANDWIDTH_HZ = 3.93e9, 98e6  # a 5G carrier of 100 MHz below 3.98 GHz


def _retimed(w: IfWaveform, sweep_s: float, bandwidth_hz: float) -> IfWaveform:
    """The sweep of another altimeter, of which only phase and frequency are used."""
    return replace(w, sweep_s=sweep_s, bandwidth_hz=bandwidth_hz, rate_hz=w.samples_per_frame / sweep_s)


def _tone(profile: Profile, rng: np.random.Generator) -> Emitter:
    return Tone(0.08 * profile.bandwidth_hz, rng.random())


def _nr(profile: Profile, rng: np.random.Generator) -> Emitter:
    return Ofdm(0.07 * profile.bandwidth_hz, seed=int(rng.integers(1 << 31)))


def _qpsk(profile: Profile, rng: np.random.Generator) -> Emitter:
    return Qpsk(0.08 * profile.bandwidth_hz, seed=int(rng.integers(1 << 31)))


def _other(profile: Profile, rng: np.random.Generator) -> Emitter:
    w = profile.waveform
    period = 1.3 * w.sweep_s
    return OtherAltimeter(_retimed(w, period, 0.9 * w.bandwidth_hz), delay_s=period * rng.random())


def locked_m(profile: Profile) -> float:
    """Range at which an equal, locked sweep appears."""
    return min(_LOCKED_M, _LOCKED_SHARE * profile.max_range_m)


def _locked(profile: Profile, rng: np.random.Generator) -> Emitter:
    return OtherAltimeter(profile.waveform, delay_s=float(altitude_to_delay_s(locked_m(profile))))


def _drifting(profile: Profile, rng: np.random.Generator) -> Emitter:
    """Enters the IF as the run starts and crosses it once."""
    w = profile.waveform
    begin = -w.stop_hz / w.slope_hz_per_s * (0.8 + 0.2 * rng.random())
    return OtherAltimeter(_retimed(w, w.sweep_s * (1 + _DRIFT), w.bandwidth_hz), delay_s=begin)


def _pulses(profile: Profile, rng: np.random.Generator) -> Emitter:
    return Pulses(0.08 * profile.bandwidth_hz, start_s=5e-4 * rng.random())


@dataclass(frozen=True)
class Interferer:
    """A kind of interference; its level is the mean power at the port while it transmits.

    Attributes
    ----------
    title : str
    emitter : callable (profile, rng) -> Emitter, or None
        None for white noise and for signals beside the band.
    constant_envelope : bool
        Whether its envelope at the amplifier is constant.
    bandwidth_hz : float or None
        Bandwidth of its power; None is the preselector's noise bandwidth.
    duty : float
        Share of the time in which it transmits.
    center_hz : float or None
        None is the altimeter's own band.
    floor_dbc_per_hz : float
        Its broadband noise, white over the sweep. Without it blanking would have no limit.
    others : bool
        Whether the aircraft's other altimeters transmit as well, at their own level.
    """

    title: str
    emitter: Callable[[Profile, np.random.Generator], Emitter] | None = None
    constant_envelope: bool = False
    bandwidth_hz: float | None = None
    duty: float = 1.0
    center_hz: float | None = None
    floor_dbc_per_hz: float = _OSCILLATOR_DBC_PER_HZ
    others: bool = False

    @property
    def blocker(self) -> bool:
        """Whether it lies beside the band and acts only through the amplifier."""
        return self.center_hz is not None

    def at_amplifier_dbm(self, profile: Profile, level_dbm: float) -> float:
        """Level behind the preselector."""
        return level_dbm - (
            profile.preselector_loss_db(self.center_hz) if self.center_hz is not None else 0.0
        )

    def highest_dbm(self, profile: Profile) -> int:
        """Highest level searched: `HIGHEST_DBM` behind the preselector."""
        return int(HIGHEST_DBM - self.at_amplifier_dbm(profile, 0.0))

    def in_receiver(self, profile: Profile, level_dbm: float) -> tuple[EnvelopeGain, float]:
        """Gains of the amplifier beside it, and the density in mW/Hz of the noise that it adds to the IF.

        Its envelope modulates the leakage in the amplifier, white over its own bandwidth. In the sweep's band its own
        broadband noise and that of the local oscillator, which mixes it into the IF, are added.
        """
        p, strong_dbm = profile, self.at_amplifier_dbm(profile, level_dbm)
        gain = p.amplifier.beside(strong_dbm, constant_envelope=self.constant_envelope)
        leakage_mw = 10 ** ((p.transmit_dbm - p.isolation_db) / 10) * gain.weak**2
        added = leakage_mw * gain.modulation / (self.bandwidth_hz or p.noise_bandwidth_hz)
        if not self.blocker:
            floor = 10 ** (self.floor_dbc_per_hz / 10) + 10 ** (p.lo_noise_dbc_per_hz / 10)
            added += gain.own**2 * 10 ** (strong_dbm / 10) * self.duty * floor
        return gain, added

    def density_dbm_per_mhz(self, profile: Profile, level_dbm: float) -> float:
        """Mean power density at the port, over its own band if it is noise or a blocker, else over the sweep."""
        wide = profile.noise_bandwidth_hz if self.emitter is None else profile.bandwidth_hz
        width = self.bandwidth_hz if self.blocker else wide
        return float(level_dbm + 10 * np.log10(self.duty) - 10 * np.log10((width or wide) / 1e6))

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
    "qpsk": Interferer("QPSK, 1 MHz", _qpsk, bandwidth_hz=1e6),
    "altimeter": Interferer("another altimeter", _other, constant_envelope=True, bandwidth_hz=1.0),
    "equal_locked": Interferer("equal sweep, locked", _locked, constant_envelope=True, bandwidth_hz=1.0),
    "equal_drifting": Interferer(
        "equal sweep, drifting", _drifting, constant_envelope=True, bandwidth_hz=1.0
    ),
    "white_noise_others": Interferer("white noise, own altimeters on", others=True),
    "pulses": Interferer("pulsed radar", _pulses, constant_envelope=True, bandwidth_hz=1.0, duty=4e-3),
    "blocker": Interferer(
        "5G blocker at 3.93 GHz", bandwidth_hz=_BLOCKER_BANDWIDTH_HZ, center_hz=_BLOCKER_HZ
    ),
}


def others_mw(profile: Profile, frames: int, rng: np.random.Generator) -> np.ndarray:
    """(frames, N) complex64: the aircraft's other altimeters of the same type, unsynchronised, at their own level."""
    w = profile.waveform
    total = np.zeros((frames, w.samples_per_frame), dtype=np.complex64)
    amplitude = np.float32(10 ** ((profile.transmit_dbm - profile.other_coupling_db) / 20))
    for k in range(profile.other_altimeters):
        period = w.sweep_s * (1 + 0.013 * (k + 1))
        other = OtherAltimeter(_retimed(w, period, w.bandwidth_hz), delay_s=period * rng.random())
        total += amplitude * interference_if(w, other, frames)
    return total
