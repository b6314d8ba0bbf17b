"""Training examples, made on the fly from the module's own core: no second copy of the physics.

An example is a function of (configuration, seed, index) alone. `configs.SceneConfig` has the distributions, and
`interferers` makes the interference.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from configs import CONFIGS, SceneConfig
from interferers import interference

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

_GUARD_M = 60.0  # gap between the span and returns beyond it: three range cells without examples
_OWN_SHARE = 0.3  # share of batches at the default sweep
_SWEEP_SAMPLES = (600, 20_000)  # least and most samples per frame; longer frames cost too many steps


def sweep_of(config: SceneConfig, batch: int, waveform: Waveform) -> Waveform:
    """Sweep of a batch: ``waveform``, or with ``any_sweep`` in 70 % of batches a random one.

    Random sweeps have 1 to 56 MHz, 0.2 to 10 ms, centred or not, 600 to 20,000 samples, at 1 to 1.5 times the bandwidth
    and a rate that the network takes without resampling.
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
        except MitigationError:  # outside the network's range
            continue


def _digest(recording: str) -> str:
    """SHA-256 of a recording's samples, by which copies under other names are recognised."""
    meta = Path(recording)
    data = meta.with_suffix(".sigmf-data") if meta.suffix == ".sigmf-meta" else meta
    try:
        return hashlib.sha256(data.read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(
            f"recording {data}: {error.strerror}; name a .sigmf-meta file next to its .sigmf-data"
        ) from None


def split_recordings(recordings: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Recordings for training and for validation, distinguished by their samples; none is in both.

    Every fourth by digest is for validation, of two or three the first; a single one is for training. Files stay whole,
    since parts of a recording share transmitter, channel and receiver.
    """
    files = {_digest(name): name for name in recordings}
    ordered = [files[digest] for digest in sorted(files)]
    validation = ordered[::4] if len(ordered) > 1 else []
    return tuple(name for name in ordered if name not in validation), tuple(validation)


@lru_cache(maxsize=2)
def _lasting(config: SceneConfig, waveform: Waveform, seed: int, group: int) -> np.ndarray:
    """(persistent, N) continuous interference of a group of examples, at an SIR averaged over the group."""
    rng = np.random.default_rng([seed, 10**9 + 1, group])
    samples = waveform.samples_per_frame
    return interference(config, waveform, rng, config.persistent * samples).reshape(-1, samples)


def _convert(frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The frame behind a coarse converter."""
    bits = int(rng.choice([1, 2, 3, 4, 6, 8]))
    rails = frame.view(np.float64)
    full_scale = rng.uniform(1.0, 4.0) * np.sqrt(np.mean(rails**2))
    step, top = 2.0 * full_scale / 2**bits, 2 ** (bits - 1)
    # mid-tread; one bit has no code for zero
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
        # beam-limited ground, exponential decay
        depth_m = float(np.exp(rng.uniform(np.log(4.0), np.log(80.0))))
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
        The return alone; the noise if there is no return within the span.
    altitude_m : float
        Altitude of the nearest part of the return.
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
        received = clean + noise + interference(config, waveform, rng, clean.size)
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
    """(size + validation, 2, 2, N) float16: received and clean planes of a finite set, made once and kept on disk.

    Epochs then need no CPU for their data. float16 rounds by 2**-11, 66 dB below the sample.
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
    """Endless training batches from example ``first`` on, with their sweep; ``share`` workers make them in turn.

    A finite set repeats in a new order every epoch, from ``stored`` if given.
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
    """Held-out examples: the validation part of a finite set, else another seed; other recordings."""
    config = replace(config, recordings=split_recordings(config.recordings)[1])
    if config.size:
        first, count = config.size, min(count, config.validation)
    else:
        config, first = replace(config, seed=config.seed + 10**6), 0
    for k in range(0, count, batch):
        sweep = sweep_of(config, k // batch, waveform)
        yield *make_batch(config, sweep, config.seed, first + k, min(batch, count - k)), sweep


def description(config: SceneConfig) -> str:
    """The configuration as canonical JSON, without newer entries at their defaults, so that older hashes hold."""
    entries = asdict(config)
    entries["recordings"] = sorted(map(_digest, config.recordings))
    newer = ("converter", "empty", "beyond", "second", "received", "own_noise", "typical", "front_end")
    for name in (*newer, "envelope", "levels_db", "any_sweep", "recordings"):
        if not entries[name]:
            del entries[name]
    if config.persistent == 1:
        del entries["persistent"]
    return json.dumps(entries, sort_keys=True)


def content_hash(config: SceneConfig, waveform: Waveform, count: int) -> str:
    """SHA-256 over the configuration and the received and clean samples of the first ``count`` examples.

    Samples are rounded to 1e-4 of full scale, so that the hash does not depend on the last bit of a math library.
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
    config = CONFIGS[args.name]
    count = args.count or (config.size + config.validation) or 1024
    print(json.dumps({"config": asdict(config), "hashed_examples": count}))
    print(content_hash(config, Waveform(), count))


if __name__ == "__main__":
    main()
