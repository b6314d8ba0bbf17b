"""Interference of training examples: emitters drawn from a configuration, as received."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from configs import SceneConfig

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frame
from radalt.core.interference.effects import ImpairedEmitter, Impairments
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.interference.evm import TYPICAL
from radalt.core.interference.multipath import FadingChannel
from radalt.core.interference.placement import Emitter
from radalt.core.waveform import Waveform

__all__ = ["interference"]

_BANK = 48  # long signals from which windows of a slow emitter are cut
_BANK_SAMPLES = 65536  # samples of each, almost nine frames
_DOPPLER_HZ = 120.0  # largest Doppler of a channel: 30 km/h at 4.3 GHz
# edge of a receiver's filter over the rate; it falls linearly to zero at half the rate
_FILTER_EDGE = (0.4, 0.49)
_CLOCK = 2e-6  # largest relative clock offset: two crystals of 1 ppm
_OWN_NOISE_DB = (-20.0, -3.0)  # white noise of an interferer over its power
_RECORDED = 1 / 3  # share of interferers that are recordings, if there are any
# rates over the default rate at which NR for another sweep is made: its 5 MHz are then all of the band, two thirds or
# a sixth
_NR_RATES = (0.5, 1.0, 1.0, 4.0)


@lru_cache(maxsize=2)
def _shaped_bank(rate_hz: float, evm: float | str = 0.0) -> list[np.ndarray]:
    """Long root-raised-cosine QPSK signals of many bandwidths, since to shape 7500 samples costs 8 ms."""
    rng = np.random.default_rng(77)
    bank = []
    for bandwidth_hz in np.exp(rng.uniform(np.log(0.4e6), np.log(4e6), _BANK)):
        emitter = QpskEmitter(bandwidth_hz=float(bandwidth_hz), pulse="rrc", evm=evm)
        bank.append(emitter.samples(_BANK_SAMPLES, rate_hz, rng))
    bank += [
        QpskEmitter(pulse="rrc", evm=evm).samples(_BANK_SAMPLES, rate_hz, rng) for _ in range(_BANK // 4)
    ]
    return bank


@lru_cache(maxsize=12)
def _nr_bank(channel_hz: float, rate_hz: float, evm: float | str = 0.0) -> list[np.ndarray]:
    """NR carriers of 20 ms at several offsets, loads and cells."""
    rng = np.random.default_rng(int(channel_hz) % 1009)
    bank = []
    for i in range(14):
        offset_hz = 0.0 if i < 6 else float(np.round(rng.uniform(-3e6, 3e6), -4))
        emitter = NrEmitter(
            channel_bandwidth_hz=channel_hz,
            carrier_hz=offset_hz,
            cell_id=int(rng.integers(1008)),
            modulation=str(rng.choice(["qpsk", "16qam", "64qam", "256qam"])),
            load=1.0 if i < 8 else float(rng.uniform(0.1, 1.0)),
            frame_count=2,
            seed=1000 + i,
            evm=evm,
        )
        bank.append(emitter.samples(150_000, rate_hz, rng))
    return bank


@dataclass(frozen=True)
class _Cut:
    """Emitter that cuts random windows from stored signals, with a random phase and a frequency offset."""

    bank: tuple[np.ndarray, ...]
    carrier_hz: float = 0.0

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`."""
        signal = self.bank[rng.integers(len(self.bank))]
        start = rng.integers(0, signal.size - count + 1)
        cycles = rng.random() + np.arange(count) * (self.carrier_hz / rate_hz)
        return signal[start : start + count] * np.exp(2j * np.pi * cycles)


def _emitter(kind: str, rate_hz: float, rng: np.random.Generator, typical: float = 0.0) -> object:
    """A random member of an interferer family."""
    centred = rng.random() < 0.5
    if kind == "tones":
        return ToneEmitter(int(rng.integers(1, 11)))
    evm = TYPICAL if typical and kind.startswith(("qpsk", "nr")) and rng.random() < typical else 0.0
    if kind == "nr5":
        return _Cut(tuple(_nr_bank(5e6, rate_hz, evm)))
    if kind == "nr10":
        return _Cut(tuple(_nr_bank(10e6, rate_hz, evm)))
    carrier_hz = 0.0 if centred else float(rng.uniform(-0.35, 0.35) * rate_hz)
    if kind == "qpsk_shaped":
        return _Cut(tuple(_shaped_bank(rate_hz, evm)), carrier_hz)
    if kind == "qpsk_rectangular":
        standard = rng.random() < 0.4
        bandwidth_hz = 2.0025e6 if standard else float(np.exp(rng.uniform(np.log(0.4e6), np.log(4e6))))
        return QpskEmitter(bandwidth_hz=bandwidth_hz, carrier_hz=carrier_hz, evm=evm)
    if kind == "radar":
        swept_hz, period_s = (np.exp(rng.uniform(*np.log(span))) for span in ((4e6, 30e6), (0.3e-3, 4e-3)))
        return FmcwEmitter(
            carrier_hz=carrier_hz,
            sweep_bandwidth_hz=float(swept_hz),
            sweep_period_s=float(period_s),
            up_fraction=float(rng.choice([0.5, 1.0])),
        )
    raise ValueError(
        f"unknown interferer kind {kind!r}; known: tones, qpsk_rectangular, qpsk_shaped, nr5, nr10, radar"
    )


@dataclass(frozen=True)
class _Received:
    """An emitter as received: with multipath, its own clock and the receiver's filter."""

    emitter: Emitter

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`."""
        profile = str(rng.choice(["EPA", "EVA", "PA", "RA4", "ETU"]))
        doppler_hz = float(rng.choice([0.0, rng.uniform(0.0, _DOPPLER_HZ)]))
        channel = FadingChannel(profile=profile, doppler_hz=doppler_hz)
        spectrum = np.fft.fft(
            ImpairedEmitter(emitter=self.emitter, effects=Impairments(fading=channel)).samples(
                count, rate_hz, rng
            )
        )
        frequency = np.fft.fftfreq(count)
        edge = rng.uniform(*_FILTER_EDGE)
        spectrum *= np.clip((0.5 - np.abs(frequency)) / (0.5 - edge), 0.0, 1.0)
        # a clock offset d makes sample n x(n + n d), to first order x + n d x': at most 0.04 of a sample
        drift = rng.uniform(-_CLOCK, _CLOCK) * np.arange(count)
        return np.fft.ifft(spectrum) + drift * np.fft.ifft(2j * np.pi * frequency * spectrum)


@dataclass(frozen=True)
class _Noisy:
    """An emitter with white noise of its own, ``noise_db`` over its power."""

    emitter: Emitter
    noise_db: float

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`."""
        signal = self.emitter.samples(count, rate_hz, rng)
        sigma = np.sqrt(0.5 * np.mean(np.abs(signal) ** 2) * 10.0 ** (self.noise_db / 10.0))
        return signal + sigma * rng.standard_normal((count, 2)).view(np.complex128)[:, 0]


def _impair(frame: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """The frame after a fractional sample delay and a carrier offset of up to 4 kHz (1 ppm); zeros stay zero."""
    active = frame != 0
    shift = np.fft.fftfreq(frame.size) * rng.uniform(-0.5, 0.5)
    delayed = np.fft.ifft(np.fft.fft(frame) * np.exp(2j * np.pi * shift))
    cycles = np.arange(frame.size) * (rng.uniform(-4e3, 4e3) / rate_hz)
    return np.where(active, delayed * np.exp(2j * np.pi * cycles), 0)


def interference(
    config: SceneConfig, waveform: Waveform, rng: np.random.Generator, samples: int
) -> np.ndarray:
    """(samples,) complex128 at an SIR drawn from the configuration, against a return of unit power; may be silent."""
    rate_hz = Waveform.rate_hz if config.any_sweep else waveform.rate_hz
    other = config.any_sweep and waveform != Waveform()
    names = [name for name, _ in config.kinds]
    weights = np.array([weight for _, weight in config.kinds])
    levels = {name: (low, high) for name, low, high in config.levels_db}
    total = np.zeros(samples, dtype=np.complex128)
    for _ in range(rng.choice(len(config.counts), p=config.counts)):
        if config.recordings and rng.random() < _RECORDED:
            file = str(rng.choice(config.recordings))
            offset_hz = float(rng.choice([0.0, 0.2, -0.2])) * rate_hz
            kind, emitter = "recording", RecordingEmitter(file=file, offset_hz=offset_hz)
        else:
            kind = str(rng.choice(names, p=weights / weights.sum()))
            relative = float(rng.choice(_NR_RATES)) if other and kind.startswith("nr") else 1.0
            emitter = _emitter(kind, relative * rate_hz, rng, config.typical)
        if config.received and rng.random() < config.received:
            emitter = _Received(emitter)
        if config.own_noise and rng.random() < config.own_noise:
            emitter = _Noisy(emitter, float(rng.uniform(*_OWN_NOISE_DB)))
        overlap = 1.0 if rng.random() < config.full_overlap else float(rng.uniform(0.02, 1.0))
        span_db = levels.get(kind, (-10.0, 0.0))
        placed = Interferer(emitter, float(rng.uniform(*span_db)), overlap)
        part = interference_frame(placed, samples, rate_hz, rng)
        total += _impair(part, rate_hz, rng) if rng.random() < config.impaired else part
    power = np.mean(np.abs(total) ** 2)
    if power == 0 or config.levels_db:
        return total
    return total * np.sqrt(10.0 ** (-rng.uniform(*config.sir_db) / 10.0) / power)
