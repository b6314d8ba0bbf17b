"""Dechirped half sweeps at the decimated rate: returns and noise as the altimeter's decimator passes them.

A frame of noise at the full rate costs more time than altimeter and tracker together. The decimator is linear: noise is
drawn from its covariance behind it, and a sum of scatterers, tones in a half sweep, follows from its values at some
instants (`core/returns/terrain/synthesis.py`). Left out is the time in which an echo is still on the slope before.
"""

from functools import lru_cache

import numpy as np

from ...core.altimeter.altimeter import Altimeter
from ...core.returns.terrain.synthesis import NODE_STEP, interpolator
from ...core.waveform import C_M_PER_S, exp_cycles, unit
from .cases import BLOCK, WAVEFORM
from .long_flights import TIMES_S, Scatterers

_BAND_HZ = 8e3  # grid of the middles of bands, so that few tables are made
# Frames that share a beat's frequency, not its phase: at 100 m/s it is 0.3 m off at a beam's edge, nothing at nadir.
_SHARED = 8
_NEGLIGIBLE = 1e-6  # share of the strongest component of noise below which one is left out


class Beats:
    """Half sweeps of one altimeter at its decimated rate."""

    def __init__(self, altimeter: Altimeter) -> None:
        self.altimeter = altimeter
        self._tables = lru_cache(maxsize=64)(self._table)
        d, table = altimeter.decimator, altimeter.mixer
        at = (np.arange(d.outputs)[:, None] + 1) * d.factor - 1 - np.arange(d.samples)
        taps = np.where((at >= 0) & (at < d.taps.size), d.taps[np.clip(at, 0, d.taps.size - 1)], 0.0)
        # the reference has unit power, so the window alone matters; both halves have the same
        weighted = taps * np.abs(table[0].astype(complex))
        values, vectors = np.linalg.eigh(weighted @ weighted.T)
        kept = values > _NEGLIGIBLE * values.max()
        self._noise = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, kept].T.astype(np.float32)

    def noise(self, frames: int, rng: np.random.Generator) -> np.ndarray:
        """(frames, 2, outputs) complex64 of white noise with unit power in each rail at the full rate."""
        # as one matrix: NumPy multiplies a stack of small ones one by one, which takes ten times as long
        drawn = rng.standard_normal((4 * frames, len(self._noise)), dtype=np.float32)
        rails = (drawn @ self._noise).reshape(frames, 2, 2, -1)
        return (rails[:, :, 0] + 1j * rails[:, :, 1]).astype(np.complex64)

    def returns(self, scatterers: Scatterers) -> np.ndarray:
        """(40, 2, outputs) complex64 of scatterers."""
        w, s, out = WAVEFORM, scatterers, []
        k, middle, sweep_s = w.slope_hz_per_s, 0.5 * w.half_sweep_s, w.sweep_s
        carrier_hz = w.carrier_hz - (0.5 * w.bandwidth_hz if w.centered else 0.0) + k * middle
        rates = 2.0 / C_M_PER_S * np.array([s.rate_m_per_s, s.bend_m_per_s2])
        # as in `synthesise`, by powers of the time from the block's middle
        for half, sign in enumerate((1.0, -1.0)):
            delay = 2.0 / C_M_PER_S * np.array([s.range_m, s.rate_m_per_s, 0.5 * s.bend_m_per_s2])
            delay[:2] -= sign * middle * rates
            slope = sign * k * delay[0] - carrier_hz
            cycles = delay * slope
            cycles[0] -= 0.5 * sign * k * delay[0] ** 2
            cycles[2] += 0.5 * sign * k * delay[1] ** 2
            tones_hz = -sign * k * delay[:2] - carrier_hz * rates
            mid_hz = _BAND_HZ * round(0.5 * float(tones_hz[0].min() + tones_hz[0].max()) / _BAND_HZ)
            tones_hz[0] -= mid_hz
            reach_hz = float((np.abs(tones_hz[0]) + np.abs(tones_hz[1]) * 0.5 * BLOCK * sweep_s).max())
            count = NODE_STEP * (1 + int(4.0 * reach_hz * w.half_sweep_s / NODE_STEP))
            table, first_s, step_s = self._tables(half, mid_hz, count)
            sums = np.empty((BLOCK, len(table)), dtype=np.complex64)
            begin = np.empty((_SHARED, s.amplitude.size), dtype=np.complex64)
            bend = _exp(2.0 * cycles[2] * sweep_s**2)
            for first in range(0, BLOCK, _SHARED):
                time_s = TIMES_S[first]
                tone_hz = tones_hz[0] + tones_hz[1] * (time_s + 0.5 * (_SHARED - 1) * sweep_s)
                at = cycles[0] + time_s * (cycles[1] + time_s * cycles[2]) + tone_hz * first_s
                np.multiply(s.amplitude, _exp(at), out=begin[0], casting="same_kind")
                turn = _exp(sweep_s * (cycles[1] + cycles[2] * (2.0 * time_s + sweep_s)))
                for frame in range(1, _SHARED):
                    np.multiply(begin[frame - 1], turn, out=begin[frame])
                    turn *= bend
                sums[first : first + _SHARED] = _tones(begin, tone_hz * step_s, len(table))
            out.append(sums @ table)
        return np.stack(out, axis=1)

    def _table(self, half: int, mid_hz: float, count: int) -> tuple[np.ndarray, float, float]:
        """(nodes, outputs) complex64: what the decimator makes of one half sweep that is 1 at a node, around a tone."""
        w = WAVEFORM
        matrix, first_s, step_s = interpolator(w.samples_per_half, w.rate_hz, count)
        time = w.sample_times_s[: w.samples_per_half] - 0.5 * w.half_sweep_s
        frames = np.zeros((matrix.shape[1], 2, w.samples_per_half), dtype=np.complex64)
        frames[:, half] = matrix.T * exp_cycles(mid_hz * time, np.complex128)
        frames[:, half] *= w.reference.reshape(2, -1)[half]
        return self.altimeter.decimator.mix(frames, self.altimeter.mixer)[:, half].copy(), first_s, step_s


@lru_cache(maxsize=2)
def beats_of(altimeter: Altimeter) -> Beats:
    """The one for an altimeter."""
    return Beats(altimeter)


def _exp(cycles: np.ndarray) -> np.ndarray:
    """`exp_cycles` in single precision."""
    return unit((2.0 * np.pi * (cycles - np.rint(cycles))).astype(np.float32))


def _tones(begin: np.ndarray, step: np.ndarray, nodes: int) -> np.ndarray:
    """(F, nodes) complex64 sums over n tones ``begin exp(2 pi i step node)``: (F, n) complex64, and (n,) cycles."""
    outer = int(np.ceil(np.sqrt(nodes / len(begin))))
    inner = -(-nodes // outer)
    low, turn = np.empty((inner, step.size), np.complex64), _exp(step)
    low[0] = 1.0
    for p in range(1, inner):
        np.multiply(low[p - 1], turn, out=low[p])
    high, turn = np.empty((outer, *begin.shape), np.complex64), _exp(step * inner)
    high[0] = begin
    for p in range(1, outer):
        np.multiply(high[p - 1], turn, out=high[p])
    sums = high.reshape(-1, step.size) @ low.T
    return sums.reshape(outer, len(begin), inner).transpose(1, 0, 2).reshape(len(begin), -1)[:, :nodes]
