"""Stiff, extreme and broken frames, each with its truth: the cases of the stability report.

A case holds a few frames, the altitudes that would be right, and the largest error of a declared altitude. Its name
seeds it, so that every case can be run alone.
"""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import fft

from ...core.altimeter.altimeter import AltimeterSettings
from ...core.deramp.front_end import Amplifier
from ...core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from ...core.interference.evm import TYPICAL
from ...core.returns.point import point_return
from ...core.waveform import Waveform

CLEAN_ALTITUDE_M = 500.0  # altitude of the clean frame that follows every case, m
_SCENE = AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=0.0)
_FRAMES, _MANY = 8, 40  # frames of a case, and of one in which false alarms are counted
_WIDE_M = 20.0  # largest error, m, where a return is distorted but not another target: a resolution cell


@dataclass(frozen=True)
class Case:
    """Frames and their truth."""

    name: str
    frames: np.ndarray  # (n, N) complex64
    truth_m: np.ndarray
    """(n,) or (n, k) float array: altitudes that count as right, k alternatives per frame; NaN if none is right."""
    bound_m: float = 5.0  # largest error of a declared altitude
    waveform: Waveform = Waveform()
    settings: AltimeterSettings = _SCENE
    detects: bool = False  # whether the chain without mitigation has to declare every frame
    noise_limited: bool = True
    """Whether noise or interference can pass for a return, so that false alarms at the CFAR's design rate are
    allowed."""


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


def noisy(frames: np.ndarray, snr_db: float | None, rng: np.random.Generator) -> np.ndarray:
    """Frames (n, N) with white noise at ``snr_db`` below a unit return; None adds no noise."""
    if snr_db is None:
        return frames.astype(np.complex64)
    noise = rng.standard_normal((*frames.shape, 2)) @ np.array([1.0, 1.0j])
    return (frames + noise * 10.0 ** (-snr_db / 20.0) / np.sqrt(2.0)).astype(np.complex64)


def coloured_noise(spread: float, count: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """(count, samples) unit-power noise whose spectrum rises evenly in decibels from 1 to ``spread`` and falls again.

    The eigenvalues of its covariance span the same range (Szegoe), so ``spread`` is the condition number that long
    filters meet.
    """
    frequency = np.abs(fft.fftfreq(samples))
    shape = spread ** (1.0 - 2.0 * frequency)
    noise = rng.standard_normal((count, samples, 2)) @ np.array([1.0, 1.0j])
    noise = fft.ifft(noise * np.sqrt(shape), axis=1)
    return noise / np.sqrt(np.mean(np.abs(noise) ** 2, axis=1, keepdims=True))


def _altitudes(rng: np.random.Generator, count: int = _FRAMES) -> np.ndarray:
    return rng.uniform(20.0, 1450.0, count)


def _jammed(
    name: str, interferer: Interferer, snr_db: float | None = 10.0, count: int = _FRAMES
) -> tuple[np.ndarray, np.ndarray]:
    """(count, N) complex128 frames of point returns with one interferer, and their altitudes."""
    rng, w = _rng(name), Waveform()
    truth = _altitudes(rng, count)
    frames = noisy(point_return(w, truth), snr_db, rng)
    return frames + interference_frames([interferer], count, w.samples_per_frame, w.rate_hz, rng), truth


def _interfered(
    name: str, interferer: Interferer, snr_db: float | None = 10.0, count: int = _FRAMES, **judged: object
) -> Case:
    frames, truth = _jammed(name, interferer, snr_db, count)
    return Case(name, frames.astype(np.complex64), truth, **judged)


def stiff_cases() -> Iterator[Case]:
    """Ill-conditioned inputs of adaptive and whitening filters."""
    w = Waveform()
    for power in range(0, 11, 2):
        name = f"interference of eigenvalue spread 1e{power}, SIR -30 dB"
        rng = _rng(name)
        truth = _altitudes(rng, _MANY)
        noise = coloured_noise(10.0**power, _MANY, w.samples_per_frame, rng) * 10**1.5
        frames = noisy(point_return(w, truth), 10.0, rng) + noise
        yield Case(name, frames.astype(np.complex64), truth, _WIDE_M)
    name = "one tone, no noise, SIR -40 dB (covariance of rank 2)"
    yield _interfered(name, Interferer(ToneEmitter(frequencies_hz=(1.1e6,)), -40.0), None, bound_m=_WIDE_M)
    name = "two tones 1 Hz apart, SIR -30 dB"
    pair = ToneEmitter(frequencies_hz=(1.1e6, 1.1e6 + 1.0))
    yield _interfered(name, Interferer(pair, -30.0), bound_m=_WIDE_M)
    for what, emitter in (("QPSK", QpskEmitter(pulse="rrc", evm=TYPICAL)), ("a tone", ToneEmitter(1))):
        name = f"{what} 80 dB above the return"
        yield _interfered(name, Interferer(emitter, -80.0), count=_MANY, bound_m=_WIDE_M)


def scene_cases() -> Iterator[Case]:
    """Extreme altitudes, speeds and levels."""
    yield from _altitude_cases()
    yield from _speed_cases()
    for sir_db in range(-80, 81, 20):
        emitter = QpskEmitter(pulse="rrc", evm=TYPICAL)
        name, jam = f"SIR {sir_db:+d} dB, QPSK", Interferer(emitter, float(sir_db))
        yield _interfered(name, jam, count=_MANY, detects=sir_db >= 0)
    ideal = Interferer(QpskEmitter(pulse="rrc"), -20.0)
    yield _interfered("SIR -20 dB, QPSK, ideal emitter", ideal, count=_MANY)
    for snr_db in (*range(-40, 101, 20), None):
        name = "no noise at all" if snr_db is None else f"SNR {snr_db:+d} dB"
        rng = _rng(name)
        truth = _altitudes(rng, _MANY)
        frames = noisy(point_return(Waveform(), truth), snr_db, rng)
        yield Case(name, frames, truth, detects=snr_db is None or snr_db >= 0)
    for label, overlap in (("none", 0.0), ("one sample", 1e-9), ("all", 1.0)):
        interferer = Interferer(QpskEmitter(evm=TYPICAL), -20.0, overlap)
        yield _interfered(f"overlap {label}, SIR -20 dB", interferer, count=_MANY, detects=overlap < 1)


def _altitude_cases() -> Iterator[Case]:
    w, n = Waveform(), _FRAMES
    far = AltimeterSettings(max_altitude_m=37_400.0)
    for name, altitude, settings in (
        ("altitude 0", 0.0, _SCENE),
        ("altitude 0.1 m", 0.1, _SCENE),
        ("altitude 7 m, a third of a cell", 7.0, _SCENE),
        ("altitude 37 km, by the unambiguous limit", 37_000.0, far),
    ):
        frames = noisy(np.tile(point_return(w, altitude), (n, 1)), 20.0, _rng(name))
        yield Case(name, frames, np.full(n, altitude), _WIDE_M, settings=settings, detects=True)
    for altitude in (1530.0, 1600.0, 3000.0, 40_000.0, 60_000.0):
        name = f"altitude {altitude:g} m, beyond the span of 1500 m"
        frames = noisy(np.tile(point_return(w, altitude), (n, 1)), 30.0, _rng(name))
        yield Case(name, frames, np.full(n, altitude))
    name = "altitude steps of 1000 m from frame to frame"
    truth = np.where(np.arange(n) % 2 == 0, 150.0, 1150.0)
    yield Case(name, noisy(point_return(w, truth), 10.0, _rng(name)), truth, detects=True)
    name = "cliff: ground at 120 m and at 420 m in one beam"
    settings = AltimeterSettings(max_altitude_m=1500.0, strategy="leading_edge")
    rng = _rng(name)
    heights = np.where(np.arange(200) % 2 == 0, 120.0, 420.0) + rng.exponential(5.0, 200)
    parts = [
        point_return(w, heights, phase_cycles=rng.random(200)).sum(axis=0) / np.sqrt(200.0) for _ in range(n)
    ]
    both = np.tile([[120.0, 420.0]], (n, 1))
    yield Case(name, noisy(np.stack(parts), 20.0, rng), both, _WIDE_M, settings=settings, noise_limited=False)


def _speed_cases() -> Iterator[Case]:
    allowing = AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=150.0)
    fast = [
        (f"vertical speed {speed:+g} m/s, allowed 150", speed, allowing)
        for speed in (-150.0, 150.0, 175.0, 200.0, 300.0, 600.0)
    ]
    for name, speed, settings in [*fast, ("vertical speed +50 m/s, allowed 0", 50.0, _SCENE)]:
        rng = _rng(name)
        truth = _altitudes(rng)
        frames = noisy(point_return(Waveform(), truth, vertical_speed_m_per_s=speed), 20.0, rng)
        detects = abs(speed) <= settings.max_vertical_speed_m_per_s
        yield Case(name, frames, truth, settings=settings, detects=detects)


def waveform_cases() -> Iterator[Case]:
    """Other sweeps: B T_h not a whole number, 10 us to 100 ms, 0.1 to 200 MHz."""
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
        truth = np.array([0.05, 0.3, 0.6, 0.8]) * settings.resolved(waveform).max_altitude_m
        frames = noisy(point_return(waveform, truth, frame_index=np.arange(4)), 20.0, rng)
        bound_m = max(5.0, 0.5 * waveform.range_resolution_m)
        yield Case(name, frames, truth, bound_m, waveform, settings)


def number_cases() -> Iterator[Case]:
    """The ends of the number range, broken samples and coarse converters; nothing in them passes for a return."""
    for name, frames, truth, detects in _numbers():
        yield Case(name, frames, truth, detects=detects, noise_limited=False)


def _numbers() -> Iterator[tuple[str, np.ndarray, np.ndarray, bool]]:
    """(name, frames, truth, detects) of each case."""
    rng = _rng("numbers")
    truth = _altitudes(rng, 4)
    good = noisy(point_return(Waveform(), truth), 20.0, rng)
    nothing = np.full(4, np.nan)
    yield "all zeros", np.zeros_like(good), nothing, False
    yield "a constant", np.ones_like(good), nothing, False
    yield "a constant 1e20", np.full_like(good, 1e20), nothing, False
    for scale in (1e-30, 1e-15, 1e15, 1e30):
        yield f"amplitude {scale:g}", good * np.float32(scale), truth, True
    yield "denormal amplitude 1e-40", good * np.float32(1e-40), truth, False
    yield "amplitude 1e38, squares overflow", good * np.float32(1e38), truth, False
    for label, value in (("NaN", np.nan), ("infinity", np.inf), ("minus infinity in Q", -1j * np.inf)):
        broken = good.copy()
        broken[:, 1234] = value
        yield f"{label} in one sample", broken, nothing, False
    spike = good.copy()
    spike[:, 1234] = 1e30
    yield "one sample of 1e30", spike, truth, False
    rails = good.view(np.float32)
    yield "clipped at a tenth of the return", np.clip(rails, -0.1, 0.1).view(np.complex64), truth, True
    for bits in (12, 8, 4, 1):
        step, top = np.float32(2.0 / 2 ** (bits - 1)), 2 ** (bits - 1)
        levels = np.sign(rails) if bits == 1 else np.clip(np.rint(rails / step), -top, top - 1) * step
        yield f"{bits}-bit converter", levels.astype(np.float32).view(np.complex64), truth, True
    yield "DC 40 dB above the return", good + np.complex64(100.0), truth, False


def front_end_cases() -> Iterator[Case]:
    """An amplifier deep in compression, and blockers next to the band whose third-order product is a line in the IF."""
    amplifier = Amplifier(p1db_dbm=-20.0, iip3_dbm=-8.0)  # of the profile fmcw_150mhz
    return_dbm = -80.0

    def amplified(frames: np.ndarray) -> np.ndarray:
        """Frames behind the amplifier; before and behind it in units of the return's amplitude."""
        scaled = frames * 10.0 ** (return_dbm / 20.0)
        behind = scaled * amplifier.gain(np.abs(scaled)) * 10.0 ** (-return_dbm / 20.0)
        return behind.astype(np.complex64)

    qpsk = QpskEmitter(pulse="rrc", evm=TYPICAL)
    for what, emitter, above_db in (
        ("a tone", ToneEmitter(1), 0.0),
        ("a tone", ToneEmitter(1), 40.0),
        ("QPSK", qpsk, 40.0),
    ):
        name = f"{what} {above_db:g} dB above compression, return 60 dB below it"
        frames, truth = _jammed(name, Interferer(emitter, -60.0 - above_db))
        yield Case(name, amplified(frames), truth)
    # sweeps of two other altimeters, 10 and 20 MHz above the band; 2 f1 - f2 and 2 tau1 - tau2 make a return of 800 m
    w = Waveform(rate_hz=60e6)
    t = np.arange(w.samples_per_frame) / w.rate_hz
    delayed = point_return(w, np.array([900.0, 1000.0])) * np.exp(2j * np.pi * np.outer([10e6, 20e6], t))
    for blocker_dbm in (-40.0, -34.0):
        product_db = 3.0 * blocker_dbm + 16.0 - return_dbm
        name = f"two blockers at {blocker_dbm:g} dBm, product {product_db:g} dB from the return"
        rng = _rng(name)
        truth = rng.uniform(20.0, 700.0, _FRAMES)
        blockers = delayed.sum(axis=0) * 10.0 ** ((blocker_dbm - return_dbm) / 20.0)
        frames = amplified(noisy(point_return(w, truth), 10.0, rng) + blockers)
        yield Case(name, frames, truth, waveform=w, detects=True)


# in the order of the report
GROUPS: dict[str, Callable[[], Iterator[Case]]] = {
    "stiff": stiff_cases,
    "scene": scene_cases,
    "waveform": waveform_cases,
    "numbers": number_cases,
    "front_end": front_end_cases,
}
