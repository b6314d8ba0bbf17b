"""Training examples, made on the fly from the module's own core: no second copy of the physics.

An example is a function of (configuration, seed, index) alone: the altitude, what the ground returns, the
noise and the interference. `configs.SceneConfig` names the distributions.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from configs import CONFIGS, SceneConfig

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frame
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.interference.evm import TYPICAL
from radalt.core.interference.multipath import FadedEmitter, FadingChannel
from radalt.core.interference.placement import Emitter
from radalt.core.mitigation.any_sweep import layout_of
from radalt.core.mitigation.base import MitigationError
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform

__all__ = [
    "batches",
    "content_hash",
    "example",
    "make_batch",
    "return_parts",
    "stored_set",
    "sweep_of",
]

_BANK = 48  # different long signals a slow emitter is cut from
_BANK_SAMPLES = 65536
_DOPPLER_HZ = 120.0  # 30 km/h at 4.3 GHz
_FILTER_EDGE = (0.4, 0.49)  # of the rate: from there a receiver's filter falls to nothing at half the rate
_CLOCK = 2e-6
_GUARD_M = 60.0  # three range cells beyond the span, where a return is neither asked for nor forbidden
_OWN_NOISE_DB = (-20.0, -3.0)  # of an interferer's own noise to it

_OWN_SHARE = 0.3  # of the batches have the default sweep
_SWEEP_SAMPLES = (600, 20_000)  # per frame: longer ones cost as many steps
# of the default rate: NR for another sweep is made at one of these, so that its 5 MHz are all of the band, two thirds
# or a sixth of it
_NR_RATES = (0.5, 1.0, 1.0, 4.0)


def sweep_of(config: SceneConfig, batch: int, waveform: Waveform) -> Waveform:
    """Sweep of a batch: ``waveform``, or with ``any_sweep`` in 70 % one drawn for it.

    1 to 56 MHz, 0.2 to 10 ms, centred or not, sampled at the bandwidth or up to half above, 600 to 20,000 samples, at a
    rate that the network takes without resampling.
    """
    rng = np.random.default_rng([config.seed, 2 * 10**9, batch])
    if not config.any_sweep or rng.random() < _OWN_SHARE:
        return waveform
    while True:
        bandwidth_hz, sweep_s = (
            float(np.exp(rng.uniform(*np.log(span)))) for span in ((1e6, 56e6), (2e-4, 1e-2))
        )
        rate_hz = max(2e6, bandwidth_hz * float(rng.choice([1.0, 1.0, rng.uniform(1.0, 1.5)])))
        centered = bool(rng.random() < 0.7)
        samples = 2 * int(np.ceil(rate_hz * sweep_s / 2))
        if not _SWEEP_SAMPLES[0] <= samples <= _SWEEP_SAMPLES[1]:
            continue
        drawn = Waveform(bandwidth_hz, sweep_s, samples / sweep_s, centered=centered)
        try:
            samples = layout_of(drawn).samples
            drawn = replace(drawn, rate_hz=samples / sweep_s)
            if layout_of(drawn).samples == samples:
                return drawn
        except MitigationError:  # outside what the network serves
            continue


_RECORDED = 1 / 3  # of the interferers, where there are recordings


def _digest(recording: str) -> str:
    """SHA-256 of a recording's samples: a copy under another name is the same recording."""
    meta = Path(recording)
    data = meta.with_suffix(".sigmf-data") if meta.suffix == ".sigmf-meta" else meta
    try:
        return hashlib.sha256(data.read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(
            f"recording {data}: {error.strerror}; name a .sigmf-meta file beside its .sigmf-data"
        ) from None


def split_recordings(recordings: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Recordings to train with and to validate with, told apart by their samples; none is in both.

    Every fourth by digest validates, one of two or three as well; a single one trains. Whole files: parts of one
    recording share transmitter, channel and receiver.
    """
    files = {_digest(name): name for name in recordings}
    ordered = [files[digest] for digest in sorted(files)]
    validation = ordered[::4] if len(ordered) > 1 else []
    return tuple(name for name in ordered if name not in validation), tuple(validation)


@lru_cache(maxsize=2)
def _shaped_bank(rate_hz: float, evm: float | str = 0.0) -> list[np.ndarray]:
    """Long root-raised-cosine QPSK signals of many bandwidths: shaping 7500 samples anew costs 8 ms."""
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
    """20 ms of NR carriers at several offsets, loads and cells."""
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
    """Emitter that cuts random windows from ready signals, turned by a random phase and moved in
    frequency."""

    bank: tuple[np.ndarray, ...]
    carrier_hz: float = 0.0

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`."""
        signal = self.bank[rng.integers(len(self.bank))]
        start = rng.integers(0, signal.size - count + 1)
        cycles = rng.random() + np.arange(count) * (self.carrier_hz / rate_hz)
        return signal[start : start + count] * np.exp(2j * np.pi * cycles)


def _emitter(kind: str, rate_hz: float, rng: np.random.Generator, typical: float = 0.0) -> object:
    """One member of an interferer family."""
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
    """An emitter as a receiver hears it: through paths, with a clock of its own, through the receiver's filter."""

    emitter: Emitter

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`."""
        profile = str(rng.choice(["EPA", "EVA", "PA", "RA4", "ETU"]))
        doppler_hz = float(rng.choice([0.0, rng.uniform(0.0, _DOPPLER_HZ)]))
        channel = FadingChannel(profile=profile, doppler_hz=doppler_hz)
        spectrum = np.fft.fft(
            FadedEmitter(emitter=self.emitter, channel=channel).samples(count, rate_hz, rng)
        )
        frequency = np.fft.fftfreq(count)
        edge = rng.uniform(*_FILTER_EDGE)
        spectrum *= np.clip((0.5 - np.abs(frequency)) / (0.5 - edge), 0.0, 1.0)
        # with a clock off by d sample n is x(n + n d), to first order x + n d x': at most 0.04 of a sample
        drift = rng.uniform(-_CLOCK, _CLOCK) * np.arange(count)
        return np.fft.ifft(spectrum) + drift * np.fft.ifft(2j * np.pi * frequency * spectrum)


@dataclass(frozen=True)
class _Noisy:
    """An emitter with white noise at this power beside its own."""

    emitter: Emitter
    noise_db: float

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`."""
        signal = self.emitter.samples(count, rate_hz, rng)
        sigma = np.sqrt(0.5 * np.mean(np.abs(signal) ** 2) * 10.0 ** (self.noise_db / 10.0))
        return signal + sigma * rng.standard_normal((count, 2)).view(np.complex128)[:, 0]


def _impair(frame: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """The frame after a fractional sample delay and a carrier offset of up to 4 kHz (1 ppm), zeros kept
    zero."""
    active = frame != 0
    shift = np.fft.fftfreq(frame.size) * rng.uniform(-0.5, 0.5)
    delayed = np.fft.ifft(np.fft.fft(frame) * np.exp(2j * np.pi * shift))
    cycles = np.arange(frame.size) * (rng.uniform(-4e3, 4e3) / rate_hz)
    return np.where(active, delayed * np.exp(2j * np.pi * cycles), 0)


def _interference(
    config: SceneConfig, waveform: Waveform, rng: np.random.Generator, samples: int
) -> np.ndarray:
    """(samples,) complex128 of unit-power-return SIR drawn from the configuration; may be silent."""
    rate_hz = Waveform.rate_hz if config.any_sweep else waveform.rate_hz
    other = config.any_sweep and waveform != Waveform()
    names = [name for name, _ in config.kinds]
    weights = np.array([weight for _, weight in config.kinds])
    levels = {name: (low, high) for name, low, high in config.levels_db}
    total = np.zeros(samples, dtype=np.complex128)
    for _ in range(rng.choice(len(config.counts), p=config.counts)):
        if config.recordings and rng.random() < _RECORDED:
            file, offset_hz = (
                str(rng.choice(config.recordings)),
                float(rng.choice([0.0, 0.2, -0.2])) * rate_hz,
            )
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


@lru_cache(maxsize=2)
def _lasting(config: SceneConfig, waveform: Waveform, seed: int, group: int) -> np.ndarray:
    """(persistent, N) interference that goes on through a group of examples, whose SIR is the mean over all."""
    rng = np.random.default_rng([seed, 10**9 + 1, group])
    samples = waveform.samples_per_frame
    return _interference(config, waveform, rng, config.persistent * samples).reshape(-1, samples)


def _convert(frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The frame as a coarse converter gives it."""
    bits = int(rng.choice([1, 2, 3, 4, 6, 8]))
    rails = frame.view(np.float64)
    full_scale = rng.uniform(1.0, 4.0) * np.sqrt(np.mean(rails**2))
    step, top = (
        2.0 * full_scale / 2**bits,
        2 ** (bits - 1),
    )  # mid-tread, but for one bit, which would lose zero
    codes = np.sign(rails) * 0.5 if bits == 1 else np.clip(np.rint(rails / step), -top, top - 1)
    return (step * codes).view(np.complex128)


def _amplified(frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The frame behind an amplifier (Rapp's model, smoothness 2) and a converter that clips at twice its saturation."""
    saturation = rng.uniform(1.0, 4.0) * np.sqrt(np.mean(np.abs(frame) ** 2))
    frame = frame / (1.0 + (np.abs(frame) / saturation) ** 4) ** 0.25
    top = 2 ** (int(rng.choice([8, 10, 12])) - 1)
    step = 2.0 * saturation / top
    return (step * np.clip(np.rint(frame.view(np.float64) / step), -top, top - 1)).view(np.complex128)


def return_parts(config: SceneConfig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(m,) excess ranges in metres and (m,) complex amplitudes of the return's parts, the nearest first."""
    draw = rng.random()
    if draw < config.multipath:
        count = int(rng.integers(1, 4))
        excess = np.concatenate([[0.0], np.sort(rng.uniform(5.0, 120.0, count))])
        level_db = np.concatenate([[0.0], rng.uniform(-25.0, -6.0, count)])
    elif draw < config.multipath + config.extended:
        count = 10
        depth_m = float(
            np.exp(rng.uniform(np.log(4.0), np.log(80.0)))
        )  # beam-limited ground, exponential decay
        excess = np.concatenate([[0.0], np.sort(rng.uniform(0.0, 4.0 * depth_m, count - 1))])
        fading_db = 10.0 * np.log10(rng.exponential(1.0, count) + 1e-3)
        level_db = fading_db - 10.0 / np.log(10.0) * excess / depth_m
        level_db[0] += 3.0  # coherent part at nadir
    else:
        return np.zeros(1), np.exp(2j * np.pi * rng.random(1))
    amplitude = 10.0 ** (level_db / 20.0) * np.exp(2j * np.pi * rng.random(excess.size))
    return excess, amplitude


def _band_limited(samples: int, waveform: Waveform, rng: np.random.Generator) -> np.ndarray:
    """(samples,) real Gaussian noise of unit variance in 10 % of the sweep's bandwidth."""
    spectrum = np.fft.rfft(rng.standard_normal(samples))
    spectrum[np.fft.rfftfreq(samples, 1.0 / waveform.rate_hz) > 0.05 * waveform.bandwidth_hz] = 0.0
    noise = np.fft.irfft(spectrum, samples)
    return noise / noise.std()


def example(
    config: SceneConfig, waveform: Waveform, seed: int, index: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """One example.

    Returns
    -------
    received : (N,) complex64
        Return of unit mean power, noise and interference.
    clean : (N,) complex64
        The return alone; the noise where there is none within the span.
    altitude_m : float
        Of the nearest part of the return.
    """
    rng = np.random.default_rng([seed, index])
    altitude_m = float(rng.uniform(*config.altitude_m))
    beyond = bool(config.beyond) and rng.random() < config.beyond
    if beyond:
        top = config.altitude_m[1]
        altitude_m = float(rng.uniform(top + _GUARD_M, 4.0 * top))
    speed = config.max_vertical_speed_m_per_s * float(rng.uniform(-1, 1))
    excess, amplitude = return_parts(config, rng)
    parts = point_return(waveform, altitude_m + excess, vertical_speed_m_per_s=speed)
    clean = amplitude @ parts
    if config.second and rng.random() < config.second:
        level_db, phase_cycles = rng.uniform(-15.0, 0.0), rng.random(1)
        other = np.array([rng.uniform(*config.altitude_m)])
        clean = (
            clean + 10.0 ** (level_db / 20.0) * point_return(waveform, other, phase_cycles=phase_cycles)[0]
        )
    if config.envelope:
        clean = clean * (1.0 + config.envelope * _band_limited(clean.size, waveform, rng))
    clean /= np.sqrt(np.mean(np.abs(clean) ** 2))
    sigma = np.sqrt(0.5 * 10.0 ** (-rng.uniform(*config.snr_db) / 10.0))
    noise = sigma * rng.standard_normal((clean.size, 2)).view(np.complex128)[:, 0]
    label = noise / (sigma * np.sqrt(2.0)) if beyond else clean
    if config.empty and rng.random() < config.empty:
        clean, noise = noise / (sigma * np.sqrt(2.0)), 0.0
        label = clean
    if config.persistent > 1:
        group, place = divmod(index, config.persistent)
        received = clean + noise + _lasting(config, waveform, seed, group)[place]
    else:
        received = clean + noise + _interference(config, waveform, rng, clean.size)
    if config.front_end and rng.random() < config.front_end:
        received = _amplified(received, rng)
    if rng.random() < config.converter:
        received = _convert(received, rng)
    return received.astype(np.complex64), label.astype(np.complex64), altitude_m


def make_batch(
    config: SceneConfig, waveform: Waveform, seed: int, first: int, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Examples ``first .. first + count - 1``: two (count, 2, N) float32 arrays and (count,) metres."""
    rows = [example(config, waveform, seed, first + i) for i in range(count)]
    received, clean = (np.stack([row[i] for row in rows]) for i in (0, 1))
    return _planes(received), _planes(clean), np.array([row[2] for row in rows])


def _planes(frames: np.ndarray) -> np.ndarray:
    """(n, N) complex64 -> (n, 2, N) float32."""
    n, samples = frames.shape
    return np.ascontiguousarray(frames.view(np.float32).reshape(n, samples, 2).transpose(0, 2, 1))


def stored_set(config: SceneConfig, waveform: Waveform, folder: Path) -> np.ndarray:
    """(size + validation, 2, 2, N) float16 of a finite set: received and clean planes, made once and kept on disk.

    An epoch then costs no CPU for its data. float16 rounds by 2**-11, 66 dB below the sample.
    """
    count = config.size + config.validation
    name = hashlib.sha256(f"{description(config)} {waveform}".encode()).hexdigest()[:16]
    path = folder / f"{name}.npy"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        new = path.with_suffix(f".{os.getpid()}.new")
        shape = (count, 2, 2, waveform.samples_per_frame)
        kept = np.lib.format.open_memmap(new, "w+", np.float16, shape)
        for index in range(count):
            frames = np.stack(example(config, waveform, config.seed, index)[:2])
            kept[index] = _planes(frames)
        kept.flush()
        new.replace(path)
    return np.load(path, mmap_mode="r")


def batches(
    config: SceneConfig,
    waveform: Waveform,
    batch: int,
    first: int = 0,
    share: int = 1,
    stored: np.ndarray | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray, Waveform]]:
    """Endless training batches from example ``first`` on, with their sweep; a finite set repeats in a new order every
    epoch, read from ``stored`` where that is given. One of ``share`` that make them in turns makes every ``share``-th.
    """
    position, config = first, replace(config, recordings=split_recordings(config.recordings)[0])
    while True:
        if config.size == 0:
            sweep = sweep_of(config, position // batch, waveform)
            yield *make_batch(config, sweep, config.seed, position, batch)[:2], sweep
        else:
            epoch, offset = divmod(position, config.size)
            order = np.random.default_rng([config.seed, 10**9, epoch]).permutation(config.size)
            wanted = order[(offset + np.arange(batch)) % config.size]
            if stored is None:
                rows = [example(config, waveform, config.seed, int(index)) for index in wanted]
                received, clean = (_planes(np.stack([row[i] for row in rows])) for i in (0, 1))
            else:
                received, clean = (stored[wanted, i].astype(np.float32) for i in (0, 1))
            yield received, clean, waveform
        position += share * batch


def validation_batches(
    config: SceneConfig, waveform: Waveform, count: int, batch: int = 32
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, Waveform]]:
    """Examples that no training batch holds: the set's own validation part, else another seed; other recordings."""
    config = replace(config, recordings=split_recordings(config.recordings)[1])
    if config.size:
        first, count = config.size, min(count, config.validation)
    else:
        config, first = replace(config, seed=config.seed + 10**6), 0
    for k in range(0, count, batch):
        sweep = sweep_of(config, k // batch, waveform)
        yield *make_batch(config, sweep, config.seed, first + k, min(batch, count - k)), sweep


def description(config: SceneConfig) -> str:
    """The configuration as canonical JSON, without later entries that say nothing, so that older hashes stay."""
    entries = asdict(config)
    entries["recordings"] = sorted(map(_digest, config.recordings))
    for name in (
        "converter",
        "empty",
        "beyond",
        "second",
        "received",
        "own_noise",
        "typical",
        "front_end",
        "envelope",
        "levels_db",
        "any_sweep",
        "recordings",
    ):
        if not entries[name]:
            del entries[name]
    if config.persistent == 1:
        del entries["persistent"]
    return json.dumps(entries, sort_keys=True)


def content_hash(config: SceneConfig, waveform: Waveform, count: int) -> str:
    """SHA-256 over the configuration and the received and clean samples of the first ``count`` examples.

    Samples are rounded to 1e-4 of full scale first, so that the last bit of a math library does not change
    the hash.
    """
    digest = hashlib.sha256(description(config).encode())
    for index in range(count):
        sweep = sweep_of(config, index // 32, waveform)
        for frame in example(config, sweep, config.seed, index)[:2]:
            digest.update(np.rint(frame.view(np.float32) * 1e4).astype("<i4").tobytes())
    return digest.hexdigest()


def main() -> None:
    """Print a configuration and its content hash."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("name", choices=sorted(CONFIGS))
    parser.add_argument(
        "--count", type=int, default=0, help="examples to hash; 0: the whole finite set, else 1024"
    )
    args = parser.parse_args()
    config = replace(CONFIGS[args.name])
    count = args.count or (config.size + config.validation) or 1024
    print(json.dumps({"config": asdict(config), "hashed_examples": count}))
    print(content_hash(config, Waveform(), count))


if __name__ == "__main__":
    main()
