"""Dechirped half sweeps at the decimated rate: returns and noise as the altimeter's decimator passes them.

A frame of noise at the full rate costs more time than altimeter and tracker together. The decimator is linear, so noise
has a covariance behind it, which is drawn from; and so has a sum of scatterers, each a tone in a half sweep, the sum at
some instants, from which it follows (`core/returns/terrain/synthesis.py`). Left out is the time in which an echo is
still on the slope before, which the altimeter leaves out, too. Without mitigation nothing else sees the frames.
"""

from functools import lru_cache

import numpy as np

from ...core.altimeter.altimeter import Altimeter
from ...core.returns.terrain.synthesis import NODE_STEP, _interpolator
from ...core.waveform import C_M_PER_S, exp_cycles
from .cases import WAVEFORM

_BAND_HZ = 16e3  # grid of the middles of bands, so that few tables are made
_SHARED = (
    4  # frames that share a beat's frequency: at 70 m/s it is 1 cm off nadir's, and 0.1 m at a beam's edge
)


class Beats:
    """Half sweeps of one altimeter at its decimated rate."""

    def __init__(self, altimeter: Altimeter) -> None:
        self.altimeter = altimeter
        self._tables = lru_cache(maxsize=64)(self._table)
        d, table = altimeter.decimator, altimeter._table
        at = (np.arange(d.outputs)[:, None] + 1) * d.factor - 1 - np.arange(d.samples)
        taps = np.where((at >= 0) & (at < d.taps.size), d.taps[np.clip(at, 0, d.taps.size - 1)], 0.0)
        # the reference has unit power, so the window alone matters; both halves have the same
        weighted = taps * np.abs(table[0].astype(complex))
        values, vectors = np.linalg.eigh(weighted @ weighted.T)
        self._noise = (vectors * np.sqrt(np.maximum(values, 0.0))).T.astype(np.float32)

    def noise(self, frames: int, rng: np.random.Generator) -> np.ndarray:
        """(frames, 2, outputs) complex64 of white noise with unit power in each rail at the full rate."""
        rails = rng.standard_normal((frames, 2, 2, len(self._noise)), dtype=np.float32) @ self._noise
        return (rails[:, :, 0] + 1j * rails[:, :, 1]).astype(np.complex64)

    def returns(self, amplitude: np.ndarray, range_m: np.ndarray, rate_m_per_s: np.ndarray) -> np.ndarray:
        """(frames, 2, outputs) complex64 of scatterers: (n,) amplitudes, (frames, n) ranges amid frames, rates."""
        w, out = WAVEFORM, []
        k, middle = w.slope_hz_per_s, 0.5 * w.half_sweep_s
        carrier_hz = w.carrier_hz - (0.5 * w.bandwidth_hz if w.centered else 0.0)
        tau, rate = 2.0 / C_M_PER_S * range_m, 2.0 / C_M_PER_S * rate_m_per_s
        shared = _SHARED if tau.shape[1] > 1 + _SHARED else 1
        for half, sign in enumerate((1.0, -1.0)):  # as in `synthesise`
            delay = tau - sign * middle * rate
            cycles = delay * (0.5 * sign * k * delay - (carrier_hz + k * middle))
            tone_hz = -sign * k * delay[::shared] - (carrier_hz + k * middle) * rate[::shared]
            mid_hz = _BAND_HZ * round(0.5 * float(tone_hz.min() + tone_hz.max()) / _BAND_HZ)
            tone_hz -= mid_hz
            count = 2 * NODE_STEP * (1 + int(2.0 * np.abs(tone_hz).max() * w.half_sweep_s / NODE_STEP))
            table, first_s, step_s = self._tables(half, mid_hz, count)
            sums = np.empty((len(tau), table.shape[0]), dtype=np.complex64)
            for row, tone in enumerate(tone_hz):
                part = slice(row * shared, (row + 1) * shared)
                begin = amplitude * _exp(cycles[part] + tone * first_s)
                sums[part] = _tones(begin.astype(np.complex64), tone * step_s, table.shape[0])
            out.append(sums @ table)
        return np.stack(out, axis=1)

    def _table(self, half: int, mid_hz: float, count: int) -> tuple[np.ndarray, float, float]:
        """(nodes, outputs) complex64: what the decimator makes of one half sweep that is 1 at a node, around a tone."""
        w = WAVEFORM
        matrix, first_s, step_s = _interpolator(w.samples_per_half, w.rate_hz, count)
        time = w.sample_times_s[: w.samples_per_half] - 0.5 * w.half_sweep_s
        frames = np.zeros((matrix.shape[1], 2, w.samples_per_half), dtype=np.complex64)
        frames[:, half] = matrix.T * exp_cycles(mid_hz * time, np.complex128)
        frames[:, half] *= w.reference.reshape(2, -1)[half]
        low = self.altimeter.decimator.mix(frames, self.altimeter._table)[:, half]
        return low.copy(), first_s, step_s


def _exp(cycles: np.ndarray) -> np.ndarray:
    """`exp_cycles` in single precision."""
    angle = (2.0 * np.pi * (cycles - np.rint(cycles))).astype(np.float32)
    out = np.empty(angle.shape, dtype=np.complex64)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out


def _tones(begin: np.ndarray, step: np.ndarray, nodes: int) -> np.ndarray:
    """(F, nodes) complex64 sums over n tones ``begin exp(2 pi i step node)``: (F, n) complex64, and (n,) cycles."""
    inner = int(np.ceil(np.sqrt(nodes)))
    outer = -(-nodes // inner)
    high = np.empty((outer, *begin.shape), np.complex64)
    high[0], turn = begin, _exp(step * inner)
    for p in range(1, outer):
        np.multiply(high[p - 1], turn, out=high[p])
    low = _exp(np.arange(inner)[:, None] * step)
    sums = high.reshape(-1, step.size) @ low.T
    return sums.reshape(outer, len(begin), inner).transpose(1, 0, 2).reshape(len(begin), -1)[:, :nodes]
