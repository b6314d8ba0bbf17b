"""Time-frequency weights behind whitening: each cell of the plane by the inverse of its interference power."""

import numpy as np

from ..stft import Stft
from ..waveform import Waveform
from .base import Mitigation, PlotStyle, peak_scale, unit_peak
from .whitening import Whitening

_WINDOW = 64  # samples; the root of the default sweep's time-bandwidth product, where the return is narrowest
_HOPS, _CELLS = 32, 16  # sides of the blocks in hops and in cells: four and more times what a return occupies
_QUIET = 0.1  # quantile of the levels that is taken for the noise
_SAMPLE = 7  # every so many hops are enough for that quantile
_TINY = np.float32(1e-12)  # of a frame of unit peak: below any cell of a receiver


class TimeFrequency(Mitigation):
    """``X / max(S, S_quiet)`` in the plane of the whitened frame, ``S`` the local level of ``|X|^2``.

    Card: *time-varying Wiener filter without a model of the signal.* `whitening` levels what is narrower than the
    sweep all the time; what remains is uneven over time and frequency (symbols, bursts, control channels). Cells
    count by the inverse of their interference power: the level is the larger of two block means of ``log |X|^2``, one
    along time and one along frequency, since a return fills neither. No training, no model of an interferer.

    F. Hlawatsch et al., "Time-frequency formulation, design, and implementation of time-varying optimal filters for
    signal estimation", IEEE Trans. Signal Processing 48(5), 2000.
    """

    name = "time_frequency"
    style = PlotStyle("#AA4499", "D", (0, (3, 1)))

    def __init__(self, waveform: Waveform) -> None:
        self._whitening = Whitening(waveform)
        self._stft = Stft(waveform.samples_per_frame, min(_WINDOW, waveform.samples_per_frame // 4 * 4))
        super().__init__(waveform)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = self._whitening.process(unit_peak(batch))
        for frame in out:
            plane = self._stft.forward(frame)
            power = np.square(plane.real)
            power += np.square(plane.imag)
            np.maximum(power, _TINY, out=power)
            log = np.log(power, out=power)  # float32: vectorised, and a tenth of the time of a median
            excess = np.maximum(_block_means(log, _HOPS, 0), _block_means(log, _CELLS, 1))
            excess -= np.quantile(excess[::_SAMPLE], _QUIET)
            plane *= np.exp(-np.maximum(excess, 0, out=excess), out=excess)
            frame[:] = self._stft.inverse(plane)
        return out * peak_scale(batch)


def _block_means(cells: np.ndarray, size: int, axis: int) -> np.ndarray:
    """Means of (m, k) cells over blocks of about ``size`` along an axis, in the shape of the cells."""
    count = cells.shape[axis]
    edges = np.linspace(0, count, max(1, round(count / size)) + 1).astype(int)
    sizes = np.diff(edges)
    sums = np.add.reduceat(cells, edges[:-1], axis=axis)
    sums /= sizes[:, None] if axis == 0 else sizes
    return np.repeat(sums, sizes, axis=axis)
