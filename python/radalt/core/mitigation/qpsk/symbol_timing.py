"""Symbol rate and timing of a linear modulation about which nothing is known."""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ...fir import cosine_window, periodic_hann
from ...spectral_line import peak_curve, peak_offset, upper_median
from ...waveform import exp_cycles
from .settings import QpskSettings

_PEAK_CURVE = peak_curve(cosine_window("hann", 256, periodic=True), 1 / 256)


@dataclass(frozen=True)
class SymbolTiming:
    """The line that symbols leave in the product of neighbouring samples."""

    rate: float  # symbols per sample
    instant: float
    """Sample at which the line peaks, near the middle of the frame; symbols lie at a fixed distance from it."""


def find_symbol_timing(frame: np.ndarray, s: QpskSettings) -> SymbolTiming | None:
    """Symbol timing of an (n,) complex64 frame: the slowest line of like power to the strongest; None without one.

    The mean of ``x[n] x*[n-1]`` is periodic with the symbols (cyclostationarity; W. A. Gardner, IEEE Signal Process.
    Mag. 8(2), 1991). Of ``|x|^2`` rectangular pulses of constant modulus would show no line. Short transitions make
    harmonics nearly as strong as the symbol rate, and echoes make them stronger.
    """
    count = frame.size
    spectrum = fft.rfft(_neighbour_products(frame))
    power = spectrum.real**2 + spectrum.imag**2
    bins = s.line_floor_bins
    used = power[: power.size - power.size % bins].reshape(-1, bins)
    contrast = (used / np.maximum(upper_median(used), 1e-30)[:, None]).ravel()
    contrast[: int(s.min_symbol_rate * count)] = 0
    contrast[power.size - 1 :] = 0  # a line between two bins has one on either side
    first = int((contrast > s.harmonic_power * contrast.max()).argmax())
    line = first + int(contrast[first : first + s.line_bins].argmax())
    return _timing(spectrum, line, count) if contrast[line] >= s.min_line_contrast else None


def symbol_instant(frame: np.ndarray, rate: float) -> float:
    """Sample near the middle of an (n,) complex64 frame at which the line of a known symbol ``rate`` peaks."""
    count = frame.size
    short = int(np.sqrt(count)) + 1
    coarse, fine = exp_cycles(-rate * np.array([[short], [1]]) * np.arange(short))
    phasors = (coarse[:, None] * (fine * np.complex64(np.exp(1j * np.pi * rate * count)))).ravel()[:count]
    return _instant(float(np.angle(_neighbour_products(frame) @ phasors)), rate, count)


def _neighbour_products(frame: np.ndarray) -> np.ndarray:
    """(n,) float32, windowed products of neighbouring samples without their mean."""
    count = frame.size
    product = frame[1:] * frame[:-1].conj()
    mean = complex(product.mean())
    phasor = mean / max(abs(mean), 1e-30)  # the carrier gives every product the same phase
    real = np.zeros(count, dtype=np.float32)
    # the real part of what is rotated back
    np.matmul(
        product.view(np.float32).reshape(-1, 2),
        np.array([phasor.real, phasor.imag], np.float32),
        out=real[1:],
    )
    real[1:] -= np.float32(abs(mean))
    real *= periodic_hann(count)
    return real


def _timing(spectrum: np.ndarray, line: int, count: int) -> SymbolTiming:
    """Rate and phase of a line between two bins."""
    rate = (line + float(peak_offset(np.abs(spectrum[line - 1 : line + 2]) ** 2, _PEAK_CURVE))) / count
    # the window is even about the frame's middle, where the phase of a bin does not depend on the line's place in it
    return SymbolTiming(rate, _instant(float(np.angle(spectrum[line])) + np.pi * line, rate, count))


def _instant(phase: float, rate: float, count: int) -> float:
    """Peak nearest to the frame's middle of a line of that ``phase`` there."""
    # the product of two neighbours belongs to the point between them
    instant = count / 2 - 0.5 - phase / (2 * np.pi * rate)
    return instant + round((count / 2 - instant) * rate) / rate
