"""Float64 references of methods and altimeter that share no code with the core: whole-frame NumPy, no tables."""

from collections.abc import Callable
from functools import partial

import numpy as np

from ...core.mitigation import Mitigation
from ...core.waveform import C_M_PER_S, Waveform


def _whitening(method: Mitigation, frames: np.ndarray) -> np.ndarray:
    spectrum = np.fft.fft(frames, axis=1)
    power = np.abs(spectrum) ** 2
    width = max(1, round(method.smoothing_hz * frames.shape[1] / method.waveform.rate_hz))
    kernel = np.zeros(frames.shape[1])
    kernel[(np.arange(width) - width // 2) % frames.shape[1]] = 1.0 / width
    # circular mean by direct sums: an FFT would spread rounding errors over 100 dB of range
    smooth = np.stack([sum(np.roll(p, int(k)) * kernel[k] for k in np.nonzero(kernel)[0]) for p in power])
    level = smooth.mean(axis=1, keepdims=True)
    smooth = np.maximum(smooth / np.where(level > 0, level, 1.0), 1e-6)
    return np.fft.ifft(spectrum * smooth**-method.exponent, axis=1)


def _lms(method: Mitigation, frames: np.ndarray, normalised: bool = False) -> np.ndarray:
    """Textbook block LMS, ``w += mu sum_n conj(x_n) e_n``; weights and delay line persist unless it restarts."""
    w = method.waveform
    reference = np.exp(2j * np.pi * w.phase_cycles(w.sample_times_s))
    length, out = method.length, np.zeros(frames.shape, complex)
    weights, past = np.zeros(length, complex), np.zeros(length - 1, complex)
    with np.errstate(over="ignore", invalid="ignore"):
        for frame, cleaned in zip(frames, out, strict=True):
            both = (frame, reference)
            source, desired = both if method.wiring == "reference_desired" else both[::-1]
            if method.restart:
                weights, past = np.zeros(length, complex), np.zeros(length - 1, complex)
            line = np.concatenate([past, source])
            past = line[line.size - length + 1 :]
            for first in range(0, frame.size, method.block):
                last = min(first + method.block, frame.size)
                x = np.lib.stride_tricks.sliding_window_view(line, length)[first:last]
                cleaned[first:last] = x @ weights
                gain = method.step / (1e-12 + np.sum(np.abs(x) ** 2)) if normalised else method.step
                weights = weights + gain * (x.conj().T @ (desired[first:last] - cleaned[first:last]))
    return out


# method -> reference; a network has none in float64
REFERENCES: dict[str, Callable[[Mitigation, np.ndarray], np.ndarray]] = {
    "none": lambda method, frames: frames,
    "whitening": _whitening,
    "lms": _lms,
    "lms_reference_input": _lms,
    "nlms": partial(_lms, normalised=True),
}


def covariance_condition(frame: np.ndarray, length: int = 32) -> float:
    """Condition number of the (length, length) sample covariance of a frame; infinite where it is singular."""
    x = np.lib.stride_tricks.sliding_window_view(np.asarray(frame, dtype=complex), length)
    if not np.isfinite(x.view(float)).all() or not np.abs(x).any():
        return float("inf")
    singular = np.linalg.svd(x[:: max(1, x.shape[0] // 4000)] / np.abs(x).max(), compute_uv=False)
    return float((singular[0] / singular[-1]) ** 2) if singular[-1] > 0 else float("inf")


def reference_altitude_m(waveform: Waveform, frame: np.ndarray, beats_hz: tuple[float, float]) -> float:
    """Altitude of one frame in float64, from the maxima of the discrete-time Fourier transform near two beats.

    Newton's iteration on the magnitude of the transform of each dechirped half, started at ``beats_hz`` (up, down).
    """
    half = waveform.samples_per_half
    t = np.arange(half) / waveform.rate_hz
    reference = np.exp(2j * np.pi * waveform.phase_cycles(np.arange(2 * half) / waveform.rate_hz))
    mixed = (np.asarray(frame, dtype=complex) * reference.conj()).reshape(2, half)
    centred = t - t.mean()
    found = []
    # rx conj(ref) has its beat at -k tau on the up sweep, +k tau on the down sweep; results have the up beat positive
    for part, start in zip(mixed, (-beats_hz[0], -beats_hz[1]), strict=True):
        f = start
        for _ in range(20):
            shifted = part * np.exp(-2j * np.pi * f * centred)
            s0, s1, s2 = (np.sum(shifted * (-2j * np.pi * centred) ** k) for k in range(3))
            slope = 2 * np.real(np.conj(s0) * s1)
            curve = 2 * (np.abs(s1) ** 2 + np.real(np.conj(s0) * s2))
            if curve >= 0:
                break
            f -= slope / curve
        found.append(f)
    return C_M_PER_S * (found[1] - found[0]) / (4.0 * waveform.slope_hz_per_s)
