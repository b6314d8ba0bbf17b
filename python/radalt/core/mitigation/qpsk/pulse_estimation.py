"""The pulse that symbols were sent with, channel and filters included, by least squares."""

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft, linalg

from ...waveform import read_only
from .cma_equaliser import Symbols
from .nufft import OVERSAMPLING, SPREAD_POINTS, correction, spread
from .overlap_save import OverlapSave
from .settings import QpskSettings


class SymbolTrain(OverlapSave):
    """Impulses at the symbols' times, to be filtered by a pulse.

    ``times`` (K,) float: in samples of the frame; ``values`` (K,) complex64; ``count``, ``length``: samples of the
    frame, and of a pulse. ``known``: samples in which all symbols are known; ``middle``, ``half``: of the ramp that
    rises from -1 to 1 over the symbols, in samples.
    """

    def __init__(self, times: np.ndarray, values: np.ndarray, count: int, length: int) -> None:
        super().__init__(count, length)
        hop, size = round(OVERSAMPLING * self.hop), round(OVERSAMPLING * self.size)
        self._grid = np.zeros(self.segments * hop + size, dtype=np.complex64)
        self._windows = sliding_window_view(self._grid, size)[: self.segments * hop : hop]
        self.send(times, values)

    def send(self, times: np.ndarray, values: np.ndarray) -> None:
        """Other symbols, in the next frame; parameters as above."""
        margin = self.length // 2
        self.known = slice(int(times[0]) + margin, max(int(times[0]) + margin, int(times[-1]) - margin))
        self.middle, self.half = (times[-1] + times[0]) / 2, (times[-1] - times[0]) / 2
        self._times, self._values = times, values

    def spectrum(self) -> np.ndarray:
        """(count,) complex64, transform of the impulses."""
        points = fft.next_fast_len(int(np.ceil(OVERSAMPLING * self.samples)))
        grid = np.zeros(points, dtype=np.complex64)
        spread(grid, points / self.samples * self._times, self._values)
        return _bins(grid, self.samples)

    def segment_transforms(self) -> np.ndarray:
        """(segments, size) complex64 transforms of the impulses' segments, which are to be filtered."""
        self._grid[:] = 0
        spread(self._grid, OVERSAMPLING * (self._times + self.length // 2 - 1), self._values)
        return _bins(self._windows, self.size)

    def ramp(self) -> np.ndarray:
        """(segments,) float32: where between -1 and 1 the middle of each segment is."""
        middle = (np.arange(self.segments) + 0.5) * self.hop
        return ((middle - self.middle) / self.half).astype(np.float32)


@lru_cache(maxsize=8)
def _correction(count: int, points: int) -> np.ndarray:
    """(count,) float32, read-only: what the bins of a frame are multiplied by, made of a grid of so many points."""
    return read_only(correction(fft.fftfreq(count) * count / points, SPREAD_POINTS))


def _bins(grid: np.ndarray, count: int) -> np.ndarray:
    """(..., count) complex64 transforms, below half the sample rate, of (..., points) of a finer grid."""
    spectrum, factors = fft.fft(grid), _correction(count, grid.shape[-1])
    out = np.empty((*grid.shape[:-1], count), dtype=np.complex64)
    half = count - count // 2
    np.multiply(spectrum[..., :half], factors[:half], out=out[..., :half])
    np.multiply(spectrum[..., half - count :], factors[half:], out=out[..., half:])
    return out


def estimate_pulse(
    frame: np.ndarray, symbols: Symbols, s: QpskSettings
) -> tuple[np.ndarray, SymbolTrain, np.ndarray]:
    """(n,) complex64, what the symbols leave of a frame; their train, and the (2, length) pulses.

    The model is ``sum_k b_k (g_0 + u g_1)(n - t_k)``, where u rises from -1 to 1 over the frame: a carrier, a clock
    or a path that drifts changes the pulse in proportion to time, for as long as the change is small. Both pulses are
    fitted in turns, with the Toeplitz matrix of a long frame, to what is left of the frame.
    """
    count = frame.size
    length = s.pulse_samples
    train = SymbolTrain(symbols.times, symbols.values, count, length)
    spectrum = train.spectrum()
    impulses = fft.ifft(spectrum)
    # the transform of a real sequence: half of it says all
    lags = fft.rfft(spectrum.real**2 + spectrum.imag**2)[:length].conj().astype(np.complex128) / count
    lags[0] *= 1 + s.pulse_loading
    cholesky = linalg.lapack.zpotrf(linalg.toeplitz(lags))[0]
    sent = symbols.times[symbols.decisions != 0]
    train.middle, train.half = (sent[-1] + sent[0]) / 2, (sent[-1] - sent[0]) / 2
    ramp = ((np.arange(count) - train.middle) / train.half).astype(np.float32)
    # symbols that a burst's edge cuts are not known
    begin = max(train.known.start, int(sent[0]) + length // 2)
    span = slice(begin, max(begin, min(train.known.stop, int(sent[-1]) - length // 2)))
    scale = sent.size / max(1, np.count_nonzero((sent > span.start) & (sent < span.stop)))
    weights = scale * np.array([[1], [3]])  # the mean square of a ramp is a third
    sources = np.stack([train.transforms(impulses), train.transforms(impulses * ramp)])
    pulses = np.zeros((2, length), dtype=np.complex128)
    residual, power = frame, np.inf
    for _ in range(s.pulse_iterations):
        before, power = power, np.vdot(residual[span], residual[span]).real
        if power > (1 - s.min_correction) * before:
            break
        right = train.correlations((sources * train.to_correlate(residual, span).conj()).sum(axis=1).conj())
        pulses += linalg.lapack.zpotrs(cholesky, (weights * right).T)[0].T
        responses = train.responses(pulses)
        residual = frame - train.filtered(sources[0] * responses[0] + sources[1] * responses[1])
    return residual, train, pulses
