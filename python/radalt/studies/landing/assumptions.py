"""Assumptions on which a landing result depends, a row of the sensitivity table each."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

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

    ``name``, ``group``, ``text``: key, part of the table, and the assumption in words; ``changes``: fields of the
    study, those within a part as a mapping, and functions of the study's own value.
    """

    name: str
    group: str
    text: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    shift_db: float = 0.0  # added to the study's SIR

    def change(self, study: LandingConfig) -> LandingConfig:
        """The changed study."""
        return _replaced(study, self.changes)


def _replaced(part: Any, changes: Mapping[str, Any]) -> Any:
    found = {}
    for name, value in changes.items():
        own = getattr(part, name)
        nested = isinstance(value, dict)
        found[name] = _replaced(own, value) if nested else value(own) if callable(value) else value
    return replace(part, **found)


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


def _ground(model: str, land: str, text: str) -> Assumption:
    return Assumption(f"{model}_{land}", "ground", text, {"ground": {"model": model, "land": land}})


def _emitter(name: str, text: str, emitter: object, shift_db: float = 0.0) -> Assumption:
    return Assumption(name, "interference", text, {"interference": (Interferer(emitter),)}, shift_db)


# gain of dechirping a half sweep (B T_h = 3750) against interference that is white over the band
COMPRESSION_DB = 35.7

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("baseline", "baseline", "as the study"),
    Assumption("no_interference", "baseline", "no interference", {"interference": ()}),
    Assumption("point", "ground", "point target instead of terrain", {"point_target": True}),
    Assumption("flat", "ground", "flat earth", {"terrain": {"files": ()}}),
    _ground("constant_gamma", "urban_low_relief", "constant gamma, no nadir peak"),
    _ground("ulaby_dobson", "soil", "Ulaby-Dobson, soil"),
    _ground("morchin", "wooded_hills", "Morchin, wooded hills"),
    Assumption("level_-10", "ground", "sigma0 -10 dB", {"ground": {"level_db": lambda db: db - 10.0}}),
    Assumption("level_+10", "ground", "sigma0 +10 dB", {"ground": {"level_db": lambda db: db + 10.0}}),
    Assumption("beam_60", "ground", "beam 60 degrees", {"antenna": {"pattern": None, "beamwidth_deg": 60.0}}),
    Assumption("strongest", "detection", "detection: strongest", {"altimeter": {"strategy": "strongest"}}),
    Assumption("centroid", "detection", "detection: centroid", {"altimeter": {"strategy": "centroid"}}),
    Assumption("looks_8", "detection", "8 sweeps averaged", {"looks": 8}),
    Assumption("doppler_off", "detection", "Doppler off", {"doppler": False}),
    *(
        Assumption(f"snr_{snr_db:g}", "noise", f"SNR {snr_db:g} dB a sample", {"snr_db": snr_db})
        for snr_db in (10.0, 0.0, -10.0, -20.0, -30.0)
    ),
    _emitter("ideal", "QPSK, ideal emitter", QpskEmitter()),
    _emitter("qpsk_shaped", "QPSK, root-raised-cosine", QpskEmitter(pulse="rrc", evm=TYPICAL)),
    _emitter("qpsk_received", "QPSK behind a receiver's filter", ReceivedQpsk()),
    _emitter(
        "qpsk_received_minus_25", "QPSK behind a receiver's filter, SIR 25 dB lower", ReceivedQpsk(), -25.0
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
