"""Stiff, extreme and broken frames with what is true of each: the cases of the stability report.

A case is a handful of frames, the altitudes that would be right, and the bound within which a declared altitude has to
lie. It is made from its own name's seed, so that any case can be run alone.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import fft

from ...core.deramp.front_end import Amplifier
from ...core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from ...core.interference.evm import TYPICAL
from ...core.receiver.altimeter import AltimeterSettings
from ...core.returns.point import point_return
from ...core.waveform import Waveform

__all__ = ["CLEAN_ALTITUDE_M", "GROUPS", "Case", "coloured_noise", "noisy"]

CLEAN_ALTITUDE_M = 500.0  # of the frame that follows every case and has to be right again
_SCENE = AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=0.0)
_FRAMES = 8


@dataclass(frozen=True)
class Case:
    """Frames and the truth behind them.

    Attributes
    ----------
    group, name : str
    frames : (n, N) complex64
    truth_m : (n, k) float array
        Altitudes that count as right, k alternatives a frame; NaN where none is.
    bound_m : float
        Largest error of a declared altitude.
    waveform : Waveform
    settings : AltimeterSettings
    detects : bool
        Whether the chain without mitigation has to declare every frame.
    noise_limited : bool
        Whether noise or interference can pass for a return: then false alarms at the CFAR's design rate are allowed.
    """

    group: str
    name: str
    frames: np.ndarray
    truth_m: np.ndarray
    bound_m: float = 5.0
    waveform: Waveform = Waveform()
    settings: AltimeterSettings = _SCENE
    detects: bool = False
    noise_limited: bool = False


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


def noisy(frames: np.ndarray, snr_db: float | None, rng: np.random.Generator) -> np.ndarray:
    """Frames (n, N) with white noise at ``snr_db`` under a unit return; None for none."""
    if snr_db is None:
        return frames.astype(np.complex64)
    noise = rng.standard_normal((*frames.shape, 2)) @ np.array([1.0, 1.0j])
    return (frames + noise * 10.0 ** (-snr_db / 20.0) / np.sqrt(2.0)).astype(np.complex64)


def coloured_noise(spread: float, count: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """(count, samples) unit-power noise whose spectrum rises evenly in decibels from 1 to ``spread`` and falls again.

    Its covariance has eigenvalues over the same range (Szegoe), so ``spread`` is the condition number that long filters
    meet.
    """
    frequency = np.abs(fft.fftfreq(samples))
    shape = spread ** (1.0 - 2.0 * frequency)
    noise = rng.standard_normal((count, samples, 2)) @ np.array([1.0, 1.0j])
    noise = fft.ifft(noise * np.sqrt(shape), axis=1)
    return noise / np.sqrt(np.mean(np.abs(noise) ** 2, axis=1, keepdims=True))


def _case(group: str, name: str, frames: np.ndarray, truth: np.ndarray | float, **kw: object) -> Case:
    truth = np.asarray(truth, dtype=float)
    truth = np.broadcast_to(
        truth[:, None] if truth.ndim == 1 else truth,
        (len(frames), max(1, truth.shape[-1] if truth.ndim == 2 else 1)),
    )
    return Case(group, name, frames.astype(np.complex64), truth, **kw)


def _altitudes(rng: np.random.Generator, count: int = _FRAMES) -> np.ndarray:
    return rng.uniform(20.0, 1450.0, count)


def _interfered(
    name: str, interferers: list[Interferer], snr_db: float | None = 10.0, count: int = _FRAMES
) -> tuple:
    rng, w = _rng(name), Waveform()
    truth = _altitudes(rng, count)
    frames = noisy(point_return(w, truth), snr_db, rng)
    total = interference_frames(interferers, count, w.samples_per_frame, w.rate_hz, rng)
    return frames + total, truth


def stiff_cases() -> Iterator[Case]:
    """Ill-conditioned inputs of adaptive and whitening filters."""
    w = Waveform()
    for power in range(0, 11, 2):
        name = f"interference of eigenvalue spread 1e{power}, SIR -30 dB"
        rng = _rng(name)
        truth = _altitudes(rng, 40)
        noise = coloured_noise(10.0**power, 40, w.samples_per_frame, rng) * 10**1.5
        yield _case(
            "stiff",
            name,
            noisy(point_return(w, truth), 10.0, rng) + noise,
            truth,
            noise_limited=True,
            bound_m=20.0,
        )
    name = "one tone, no noise, SIR -40 dB (covariance of rank 2)"
    frames, truth = _interfered(name, [Interferer(ToneEmitter(frequencies_hz=(1.1e6,)), -40.0)], None)
    yield _case("stiff", name, frames, truth, noise_limited=True, bound_m=20.0)
    name = "two tones 1 Hz apart, SIR -30 dB"
    frames, truth = _interfered(name, [Interferer(ToneEmitter(frequencies_hz=(1.1e6, 1.1e6 + 1.0)), -30.0)])
    yield _case("stiff", name, frames, truth, noise_limited=True, bound_m=20.0)
    for what, emitter in (("QPSK", QpskEmitter(pulse="rrc", evm=TYPICAL)), ("a tone", ToneEmitter(1))):
        name = f"{what} 80 dB above the return"
        frames, truth = _interfered(name, [Interferer(emitter, -80.0)], count=40)
        yield _case("stiff", name, frames, truth, noise_limited=True, bound_m=20.0)


def scene_cases() -> Iterator[Case]:
    """Extreme altitudes, speeds and levels."""
    yield from _altitude_cases()
    yield from _speed_cases()
    w = Waveform()
    for sir_db in range(-80, 81, 20):
        name = f"SIR {sir_db:+d} dB, QPSK"
        frames, truth = _interfered(
            name, [Interferer(QpskEmitter(pulse="rrc", evm=TYPICAL), float(sir_db))], count=40
        )
        yield _case("scene", name, frames, truth, detects=sir_db >= 0, noise_limited=True)
    name = "SIR -20 dB, QPSK, ideal emitter"
    frames, truth = _interfered(name, [Interferer(QpskEmitter(pulse="rrc"), -20.0)], count=40)
    yield _case("scene", name, frames, truth, detects=False, noise_limited=True)
    for snr_db in (*range(-40, 101, 20), None):
        name = "no noise at all" if snr_db is None else f"SNR {snr_db:+d} dB"
        rng = _rng(name)
        truth = _altitudes(rng, 40)
        frames = noisy(point_return(w, truth), snr_db, rng)
        yield _case("scene", name, frames, truth, detects=snr_db is None or snr_db >= 0, noise_limited=True)
    for label, overlap in (("none", 0.0), ("one sample", 1e-9), ("all", 1.0)):
        name = f"overlap {label}, SIR -20 dB"
        frames, truth = _interfered(name, [Interferer(QpskEmitter(evm=TYPICAL), -20.0, overlap)], count=40)
        yield _case("scene", name, frames, truth, detects=overlap < 1, noise_limited=True)


def _altitude_cases() -> Iterator[Case]:
    w, n = Waveform(), _FRAMES
    for name, altitude, settings, detects in (
        ("altitude 0", 0.0, _SCENE, True),
        ("altitude 0.1 m", 0.1, _SCENE, True),
        ("altitude 7 m, a third of a cell", 7.0, _SCENE, True),
        (
            "altitude 37 km, by the unambiguous limit",
            37_000.0,
            AltimeterSettings(max_altitude_m=37_400.0),
            True,
        ),
    ):
        frames = noisy(np.tile(point_return(w, altitude), (n, 1)), 20.0, _rng(name))
        yield _case(
            "scene",
            name,
            frames,
            np.full(n, altitude),
            settings=settings,
            detects=detects,
            noise_limited=True,
            bound_m=20.0,
        )
    for altitude in (1530.0, 1600.0, 3000.0, 40_000.0, 60_000.0):
        name = f"altitude {altitude:g} m, beyond the span of 1500 m"
        frames = noisy(np.tile(point_return(w, altitude), (n, 1)), 30.0, _rng(name))
        yield _case("scene", name, frames, np.full(n, altitude), noise_limited=True)
    name = "altitude steps of 1000 m from frame to frame"
    truth = np.where(np.arange(n) % 2 == 0, 150.0, 1150.0)
    frames = noisy(point_return(w, truth), 10.0, _rng(name))
    yield _case("scene", name, frames, truth, detects=True, noise_limited=True)
    name = "cliff: ground at 120 m and at 420 m in one beam"
    settings = AltimeterSettings(max_altitude_m=1500.0, strategy="leading_edge")
    rng = _rng(name)
    heights = np.where(np.arange(200) % 2 == 0, 120.0, 420.0) + rng.exponential(5.0, 200)
    parts = [
        point_return(w, heights, phase_cycles=rng.random(200)).sum(axis=0) / np.sqrt(200.0) for _ in range(n)
    ]
    frames = noisy(np.stack(parts), 20.0, rng)
    yield _case("scene", name, frames, np.tile([[120.0, 420.0]], (n, 1)), bound_m=20.0, settings=settings)


def _speed_cases() -> Iterator[Case]:
    w = Waveform()
    for speed in (-150.0, 150.0, 175.0, 200.0, 300.0, 600.0):
        name = f"vertical speed {speed:+g} m/s, allowed 150"
        rng = _rng(name)
        truth = _altitudes(rng)
        frames = noisy(point_return(w, truth, vertical_speed_m_per_s=speed), 20.0, rng)
        settings = AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=150.0)
        yield _case(
            "scene", name, frames, truth, settings=settings, detects=abs(speed) <= 150, noise_limited=True
        )
    name = "vertical speed +50 m/s, allowed 0"
    rng = _rng(name)
    truth = _altitudes(rng)
    yield _case(
        "scene",
        name,
        noisy(point_return(w, truth, vertical_speed_m_per_s=50.0), 20.0, rng),
        truth,
        noise_limited=True,
    )


def waveform_cases() -> Iterator[Case]:
    """Other sweeps: B T_h not whole, 10 us to 100 ms, 0.1 to 200 MHz."""
    for waveform in (
        Waveform(bandwidth_hz=7.100123e6, centered=False),
        Waveform(bandwidth_hz=6.7001666e6, sweep_s=3e-3, centered=False),
        Waveform(sweep_s=16e-6),
        Waveform(sweep_s=10e-6, bandwidth_hz=20e6, rate_hz=20e6),
        Waveform(sweep_s=100e-6),
        Waveform(sweep_s=10e-3),
        Waveform(sweep_s=100e-3),
        Waveform(bandwidth_hz=0.1e6),
        Waveform(bandwidth_hz=0.1e6, rate_hz=0.1e6),
        Waveform(bandwidth_hz=1e6),
        Waveform(bandwidth_hz=50e6, rate_hz=50e6),
        Waveform(bandwidth_hz=200e6, rate_hz=200e6, sweep_s=100e-6),
        Waveform(bandwidth_hz=200e6, rate_hz=200e6),
    ):
        centring = "" if waveform.centered else ", not centred"
        name = (
            f"B {waveform.bandwidth_hz / 1e6:.7g} MHz, T {waveform.sweep_s * 1e3:g} ms, "
            f"{waveform.rate_hz / 1e6:g} MS/s{centring}"
        )
        rng = _rng(name)
        settings = AltimeterSettings(max_vertical_speed_m_per_s=0.0)
        top = settings.resolved(waveform).max_altitude_m
        truth = np.array([0.05, 0.3, 0.6, 0.8]) * top
        frames = noisy(point_return(waveform, truth, frame_index=np.arange(4)), 20.0, rng)
        bound = max(5.0, 0.5 * waveform.range_resolution_m)
        yield _case(
            "waveform",
            name,
            frames,
            truth,
            bound_m=bound,
            waveform=waveform,
            settings=settings,
            noise_limited=True,
        )


def number_cases() -> Iterator[Case]:
    """The ends of the number range, broken samples and coarse converters."""
    w, n = Waveform(), 4
    rng = _rng("numbers")
    truth = _altitudes(rng, n)
    good = noisy(point_return(w, truth), 20.0, rng)
    nothing = np.full(n, np.nan)
    yield _case("numbers", "all zeros", np.zeros_like(good), nothing)
    yield _case("numbers", "a constant", np.ones_like(good), nothing)
    yield _case("numbers", "a constant 1e20", np.full_like(good, 1e20), nothing)
    for scale in (1e-30, 1e-15, 1e15, 1e30):
        yield _case("numbers", f"amplitude {scale:g}", good * np.float32(scale), truth, detects=True)
    yield _case("numbers", "denormal amplitude 1e-40", good * np.float32(1e-40), truth)
    yield _case("numbers", "amplitude 1e38, squares overflow", good * np.float32(1e38), truth)
    for label, value in (("NaN", np.nan), ("infinity", np.inf), ("minus infinity in Q", -1j * np.inf)):
        broken = good.copy()
        broken[:, 1234] = value
        yield _case("numbers", f"{label} in one sample", broken, nothing)
    spike = good.copy()
    spike[:, 1234] = 1e30
    yield _case("numbers", "one sample of 1e30", spike, truth)
    yield from _converter_cases(good, truth)


def _converter_cases(good: np.ndarray, truth: np.ndarray) -> Iterator[Case]:
    rails = good.view(np.float32)
    yield _case(
        "numbers",
        "clipped at a tenth of the return",
        np.clip(rails, -0.1, 0.1).view(np.complex64),
        truth,
        detects=True,
    )
    for bits in (12, 8, 4, 1):
        step = np.float32(2.0 / 2 ** (bits - 1))
        levels = (
            np.sign(rails)
            if bits == 1
            else np.clip(np.rint(rails / step), -(2 ** (bits - 1)), 2 ** (bits - 1) - 1) * step
        )
        yield _case(
            "numbers",
            f"{bits}-bit converter",
            levels.astype(np.float32).view(np.complex64),
            truth,
            detects=True,
        )
    yield _case("numbers", "DC 40 dB above the return", good + np.complex64(100.0), truth)


def front_end_cases() -> Iterator[Case]:
    """An amplifier deep in compression, and blockers beside the band whose third-order product is a line in the IF."""
    amplifier = Amplifier(p1db_dbm=-20.0, iip3_dbm=-8.0)  # of the profile fmcw_150mhz
    return_dbm, n = -80.0, _FRAMES

    def amplified(frames: np.ndarray) -> np.ndarray:
        """Frames over the return's amplitude, before and behind the amplifier."""
        scaled = frames * 10.0 ** (return_dbm / 20.0)
        return scaled * amplifier.gain(np.abs(scaled)) * 10.0 ** (-return_dbm / 20.0)

    qpsk = QpskEmitter(pulse="rrc", evm=TYPICAL)
    for what, emitter, above_db in (
        ("a tone", ToneEmitter(1), 0.0),
        ("a tone", ToneEmitter(1), 40.0),
        ("QPSK", qpsk, 40.0),
    ):
        name = f"{what} {above_db:g} dB above compression, return 60 dB below it"
        frames, truth = _interfered(name, [Interferer(emitter, -60.0 - above_db)])
        yield _case("front_end", name, amplified(frames), truth, noise_limited=True)
    # sweeps of two other altimeters, 10 and 20 MHz above the band; 2 f1 - f2 and 2 tau1 - tau2 make a return of 800 m
    w = Waveform(rate_hz=60e6)
    t = np.arange(w.samples_per_frame) / w.rate_hz
    delayed = point_return(w, np.array([900.0, 1000.0])) * np.exp(2j * np.pi * np.outer([10e6, 20e6], t))
    for blocker_dbm in (-40.0, -34.0):
        product_db = 3.0 * blocker_dbm + 16.0 - return_dbm
        name = f"two blockers at {blocker_dbm:g} dBm, product {product_db:g} dB from the return"
        rng = _rng(name)
        truth = rng.uniform(20.0, 700.0, n)
        blockers = delayed.sum(axis=0) * 10.0 ** ((blocker_dbm - return_dbm) / 20.0)
        frames = amplified(noisy(point_return(w, truth), 10.0, rng) + blockers)
        yield _case("front_end", name, frames, truth, waveform=w, detects=True, noise_limited=True)


# in the order of the report
GROUPS: dict[str, Callable[[], Iterator[Case]]] = {
    "stiff": stiff_cases,
    "scene": scene_cases,
    "waveform": waveform_cases,
    "numbers": number_cases,
    "front_end": front_end_cases,
}
