"""Diffuse ground as a deramping altimeter receives it: facets by one inverse FFT per half sweep.

Cells of a metre need facets closer than any grid of terrain: rings of equal area about nadir, drawn per sweep.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ..returns.terrain.antenna import Antenna
from ..returns.terrain.ground import Reflectivity
from ..waveform import C_M_PER_S, Waveform, altitude_to_delay_s, exp_cycles

_GRID = 4  # beat grid, steps per resolution cell: a facet's phase error is an eighth of a cycle at most
# off-nadir angle up to which there are facets: a beam of 40 degrees is 37 dB down there, two-way
_EDGE_DEG = 50.0
_FACETS = 4000  # number of facets: 8 in the first metre of range at 5,000 ft


@dataclass(frozen=True)
class DiffuseGround:
    """Level ground that scatters without a specular part, with independent speckle per sweep."""

    antenna: Antenna
    ground: Reflectivity
    forward_m_per_s: float = 0.0  # horizontal speed: the Doppler of facets ahead and behind

    def frame(
        self, waveform: Waveform, height_m: float, power_mw: float, rng: np.random.Generator
    ) -> np.ndarray:
        """(N,) complex64 IF frame of mean power ``power_mw``."""
        edge = height_m * np.tan(np.radians(_EDGE_DEG))
        off = edge * np.sqrt((np.arange(_FACETS) + rng.random(_FACETS)) / _FACETS)  # equal areas
        azimuth = 2 * np.pi * rng.random(_FACETS)
        theta = np.arctan2(off, height_m)
        gain = self.antenna.gain(theta, azimuth)
        share = gain**2 * self.ground.sigma0(theta, waveform.carrier_hz) * np.cos(theta) ** 4  # 1 / R^4
        share *= power_mw / share.sum()
        speckle = np.sqrt(0.5 * share) * (rng.standard_normal(_FACETS) + 1j * rng.standard_normal(_FACETS))
        rate = -self.forward_m_per_s * np.sin(theta) * np.cos(azimuth)
        return facet_frame(waveform, np.hypot(height_m, off), rate, speckle)


def facet_frame(
    waveform: Waveform, range_m: np.ndarray, range_rate_m_per_s: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """(N,) complex64 sum of returns, each of one beat per half sweep.

    ``waveform``: Deramped; ``range_m``, ``range_rate_m_per_s`` (m,) float: at the middle of the frame; the rate
    positive climbing; ``amplitude`` (m,) complex.
    """
    w, half = waveform, waveform.samples_per_half
    delay = altitude_to_delay_s(range_m)
    doppler = 2.0 * range_rate_m_per_s / C_M_PER_S * w.carrier_hz
    out = np.empty(w.samples_per_frame, dtype=np.complex64)
    size = _GRID * half
    blind = int(np.ceil(delay.min() * w.rate_hz)) + 2
    for k, slope in enumerate(w.half_slopes):
        beat = -slope * w.slope_hz_per_s * delay - doppler
        # phase at the half's beginning: carrier, ramp, and Doppler up to the frame's middle
        start = np.mod(-w.carrier_hz * delay, 1.0) + slope * 0.5 * w.slope_hz_per_s * delay**2
        start = start + slope * 0.5 * w.bandwidth_hz * delay + (0.0 if k else doppler * w.half_sweep_s)
        bins = np.rint(beat * size / w.rate_hz).astype(int)
        # the rounded beat agrees in the middle of the half
        start = start + (beat - bins * w.rate_hz / size) * 0.5 * w.half_sweep_s
        weights = amplitude * exp_cycles(start, np.complex128)
        real, imag = (np.bincount(bins % size, part, size) for part in (weights.real, weights.imag))
        grid = real + 1j * imag
        out[k * half : (k + 1) * half] = (fft.ifft(grid.astype(np.complex64)) * np.float32(size))[:half]
        out[k * half : k * half + blind] = 0
    return out
