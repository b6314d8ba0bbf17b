"""Frames that tests make: circular white noise, point returns in it, and how many altitudes of them are right."""

import numpy as np

from radalt.core.altimeter.altimeter import Altimeter
from radalt.core.returns.point import point_return
from radalt.core.timing.segmenter import Frame
from radalt.core.waveform import Waveform

W = Waveform()
N = W.samples_per_frame
ALTIMETER = Altimeter(W)


def white(rng: np.random.Generator, count: int, samples: int = W.samples_per_frame) -> np.ndarray:
    """(count, samples) complex128 noise of unit power."""
    return np.sqrt(0.5) * rng.standard_normal((count, 2 * samples)).view(complex)


def noise(rng: np.random.Generator, count: int, snr_db: float) -> np.ndarray:
    """(count, N) complex64 noise under a return of unit power."""
    rails = rng.standard_normal((count, 2 * W.samples_per_frame), dtype=np.float32)
    return rails.view(np.complex64) * np.float32(10.0 ** (-snr_db / 20.0) / np.sqrt(2.0))


def returns(rng, count: int, snr_db: float = 10.0, *, waveform: Waveform = W, span_m=(3.0, 1500.0)):
    """Altitudes drawn from a span, m, and (count, N) complex128 frames of point returns in noise."""
    altitude_m = rng.uniform(*span_m, count)
    frames = point_return(waveform, altitude_m, phase_cycles=rng.random(count), dtype=np.complex128)
    return altitude_m, frames + 10.0 ** (-snr_db / 20.0) * white(rng, *frames.shape)


def measured(frames: list[Frame], altimeter: Altimeter = ALTIMETER) -> np.ndarray:
    """Results for frames of a segmenter."""
    offset_s, index = np.array([f.offset_s for f in frames]), np.array([f.index for f in frames])
    samples = np.stack([f.samples for f in frames])
    return altimeter.process(samples, timing_offset_s=offset_s, frame_index=index)


def right(frames: np.ndarray, altitude_m: np.ndarray, altimeter: Altimeter = ALTIMETER) -> float:
    """Share of the frames whose altitude is declared, and within 5 m of the truth."""
    result = altimeter.process(np.asarray(frames, dtype=np.complex64))
    return float(np.mean(result["valid"] & (np.abs(result["altitude_m"] - altitude_m) < 5.0)))
