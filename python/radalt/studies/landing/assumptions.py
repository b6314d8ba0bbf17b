"""Assumptions on which a landing result depends, a row of the sensitivity table each."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from ...core.interference import Interferer, QpskEmitter, ToneEmitter
from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.receiver_filter import window_taps
from .config import LandingConfig


@dataclass(frozen=True)
class Assumption:
    """A study changed in one assumption.

    ``name``, ``group``, ``text``: key, part of the table, and the assumption in words.
    """

    name: str
    group: str
    text: str
    change: Callable[[LandingConfig], LandingConfig] = lambda study: study
    """From the study to the changed one."""
    shift_db: float = 0.0  # added to the study's SIR


@dataclass(frozen=True)
class ReceivedQpsk:
    """QPSK with rectangular pulses behind a receiver: made at four times the rate, filtered, decimated.

    Sampled at the radar's rate without a filter, such pulses are constant between symbol edges, so that a method can
    remove them exactly at any level; no receiver delivers that.
    """

    emitter: QpskEmitter = QpskEmitter(evm=TYPICAL)

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`."""
        taps = window_taps(rate_hz, 4)
        wide = self.emitter.samples(4 * count + taps.size, 4 * rate_hz, rng)
        return signal.upfirdn(taps, wide, 1, 4)[taps.size // 4 :][:count]


def _snr(snr_db: float) -> Assumption:
    return Assumption(
        f"snr_{snr_db:g}", "noise", f"SNR {snr_db:g} dB a sample", lambda s: replace(s, snr_db=snr_db)
    )


def _ground(model: str, land: str, text: str) -> Assumption:
    def change(study: LandingConfig) -> LandingConfig:
        return replace(study, ground=replace(study.ground, model=model, land=land))

    return Assumption(f"{model}_{land}", "ground", text, change)


def _level(level_db: float) -> Assumption:
    def change(study: LandingConfig) -> LandingConfig:
        return replace(study, ground=replace(study.ground, level_db=study.ground.level_db + level_db))

    return Assumption(f"level_{level_db:+g}", "ground", f"sigma0 {level_db:+g} dB", change)


def _detection(strategy: str) -> Assumption:
    def change(study: LandingConfig) -> LandingConfig:
        return replace(study, altimeter=replace(study.altimeter, strategy=strategy))

    return Assumption(strategy, "detection", f"detection: {strategy.replace('_', ' ')}", change)


def _emitter(name: str, text: str, emitter: object) -> Assumption:
    def change(study: LandingConfig) -> LandingConfig:
        return replace(study, interference=(Interferer(emitter),))

    return Assumption(name, "interference", text, change)


# gain of dechirping a half sweep (B T_h = 3750) against interference that is white over the band
COMPRESSION_DB = 35.7

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("baseline", "baseline", "as the study"),
    Assumption("no_interference", "baseline", "no interference", lambda s: replace(s, interference=())),
    Assumption("point", "ground", "point target instead of terrain", lambda s: replace(s, point_target=True)),
    Assumption("flat", "ground", "flat earth", lambda s: replace(s, terrain=replace(s.terrain, files=()))),
    _ground("constant_gamma", "urban_low_relief", "constant gamma, no nadir peak"),
    _ground("ulaby_dobson", "soil", "Ulaby-Dobson, soil"),
    _ground("morchin", "wooded_hills", "Morchin, wooded hills"),
    _level(-10.0),
    _level(+10.0),
    Assumption(
        "beam_60",
        "ground",
        "beam 60 degrees",
        lambda s: replace(s, antenna=replace(s.antenna, pattern=None, beamwidth_deg=60.0)),
    ),
    _detection("strongest"),
    _detection("centroid"),
    Assumption("looks_8", "detection", "8 sweeps averaged", lambda s: replace(s, looks=8)),
    Assumption("doppler_off", "detection", "Doppler off", lambda s: replace(s, doppler=False)),
    _snr(10.0),
    _snr(0.0),
    _snr(-10.0),
    _snr(-20.0),
    _snr(-30.0),
    _emitter("ideal", "QPSK, ideal emitter", QpskEmitter()),
    _emitter("qpsk_shaped", "QPSK, root-raised-cosine", QpskEmitter(pulse="rrc", evm=TYPICAL)),
    _emitter("qpsk_received", "QPSK behind a receiver's filter", ReceivedQpsk()),
    replace(
        _emitter(
            "qpsk_received_minus_25", "QPSK behind a receiver's filter, SIR 25 dB lower", ReceivedQpsk()
        ),
        shift_db=-25.0,
    ),
    _emitter("tones", "5 tones", ToneEmitter(count=5)),
    _emitter("qpsk_wide", "QPSK over the whole band", QpskEmitter(bandwidth_hz=7.4e6, evm=TYPICAL)),
    _emitter("nr_5", "5G NR downlink, 5 MHz", NrEmitter(channel_bandwidth_hz=5e6, evm=TYPICAL)),
    _emitter("nr_10", "5G NR downlink, 10 MHz", NrEmitter(channel_bandwidth_hz=10e6, evm=TYPICAL)),
    Assumption(
        "sir_after_dechirp",
        "level",
        "SIR meant after dechirping (35.7 dB lower before)",
        shift_db=-COMPRESSION_DB,
    ),
    Assumption("sir_minus_15", "level", "SIR 15 dB lower", shift_db=-15.0),
    Assumption("sir_minus_25", "level", "SIR 25 dB lower", shift_db=-25.0),
)
