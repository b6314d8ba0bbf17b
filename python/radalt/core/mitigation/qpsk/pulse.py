"""What decided symbols sound like at the receiver: the pulse by least squares, channel and filters included."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft, linalg

from .between import RATE, impulses_flat, spread
from .equaliser import Symbols
from .pieces import Pieces

__all__ = ["Train", "heard"]

_SYMBOLS = 14  # that a pulse lasts
_FEWEST, _MOST = 64, 192  # samples that a pulse lasts
_LOADING = 1e-4  # of the symbols' power: outside their band there is nothing to be fitted to
_ROUNDS = 4
_SETTLED = 0.8  # of the residual power before, at which another round gains nothing


@lru_cache(maxsize=8)
def _flat(count: int, points: int) -> np.ndarray:
    """(count,) float32, read-only: what the bins of a frame are multiplied by, made of a grid of so many points."""
    factors = impulses_flat(fft.fftfreq(count) * count / points)
    factors.setflags(write=False)
    return factors


def _bins(grid: np.ndarray, count: int) -> np.ndarray:
    """(..., count) complex64 transforms, below half the sample rate, of (..., points) of a finer grid."""
    spectrum, factors = fft.fft(grid), _flat(count, grid.shape[-1])
    out = np.empty((*grid.shape[:-1], count), dtype=np.complex64)
    half = count - count // 2
    np.multiply(spectrum[..., :half], factors[:half], out=out[..., :half])
    np.multiply(spectrum[..., half - count :], factors[half:], out=out[..., half:])
    return out


class Train(Pieces):
    """Impulses at the symbols' times, filtered by pulses as long as a symbol can be heard.

    Parameters
    ----------
    times : (K,) float
        In samples of the frame.
    values : (K,) complex64
    count, length : int
        Samples of the frame, and of a pulse.

    Attributes
    ----------
    known : slice
        Samples in which all symbols are known.
    middle, half : float
        Of the ramp that rises from -1 to 1 over the frame, in samples.
    """

    def __init__(self, times: np.ndarray, values: np.ndarray, count: int, length: int) -> None:
        super().__init__(count, length)
        hop, size = round(RATE * self.hop), round(RATE * self._size)
        self._grid = np.zeros(self.count * hop + size, dtype=np.complex64)
        self._windows = sliding_window_view(self._grid, size)[: self.count * hop : hop]
        self.send(times, values)

    def send(self, times: np.ndarray, values: np.ndarray) -> None:
        """Other symbols, in the next frame; parameters as above."""
        self.known = slice(int(times[0]) + self.length // 2, int(times[-1]) - self.length // 2)
        self.middle, self.half = (times[-1] + times[0]) / 2, (times[-1] - times[0]) / 2
        self._times, self._values = times, values

    def spectrum(self) -> np.ndarray:
        """(count,) complex64, transform of the impulses."""
        points = fft.next_fast_len(int(np.ceil(RATE * self._samples)))
        grid = np.zeros(points, dtype=np.complex64)
        spread(grid, points / self._samples * self._times, self._values)
        return _bins(grid, self._samples)

    def sources(self) -> np.ndarray:
        """(pieces, size) complex64 transforms of the impulses in pieces, which are to be filtered."""
        self._grid[:] = 0
        spread(self._grid, RATE * self._times + RATE * (self.length // 2 - 1), self._values)
        return _bins(self._windows, self._size)

    def places(self) -> np.ndarray:
        """(pieces,) float32: where between -1 and 1 the middle of each piece is."""
        middle = (np.arange(self.count) + 0.5) * self.hop
        return ((middle - self.middle) / self.half).astype(np.float32)


def heard(frame: np.ndarray, symbols: Symbols) -> tuple[np.ndarray, Train, np.ndarray]:
    """(n,) complex64, the part of a frame that the symbols explain; their train, and the (2, length) pulses.

    ``sum_k b_k (g_0 + u g_1)(n - t_k)``, where u rises from -1 to 1 over the frame: a carrier, a clock or a path that
    drifts changes the pulse in proportion to time, for as long as the change is small. Both pulses are fitted in turns,
    with the Toeplitz matrix of a long frame, to what is left of the frame.
    """
    count = frame.size
    length = 2 * round(_SYMBOLS * float(symbols.times[1] - symbols.times[0]) / 2)
    length = min(max(length, _FEWEST), _MOST)
    train = Train(symbols.times, symbols.values, count, length)
    spectrum, known = train.spectrum(), train.known
    steady = fft.ifft(spectrum)
    # the transform of a real sequence: half of it says all
    lag_zero_first = (
        fft.rfft(spectrum.real**2 + spectrum.imag**2)[:length].conj().astype(np.complex128) / count
    )
    lag_zero_first[0] *= 1 + _LOADING
    solved = linalg.lapack.zpotrf(linalg.toeplitz(lag_zero_first))[0]
    sent = symbols.times[symbols.points != 0]
    train.middle, train.half = (sent[-1] + sent[0]) / 2, (sent[-1] - sent[0]) / 2
    ramp = ((np.arange(count) - train.middle) / train.half).astype(np.float32)
    # at a burst's edge symbols are cut, and cut symbols are not known
    begin, end = max(known.start, int(sent[0]) + length // 2), min(known.stop, int(sent[-1]) - length // 2)
    span = slice(begin, max(begin, end))
    scale = sent.size / max(1, np.count_nonzero((sent > begin) & (sent < end)))
    weights = scale * np.array([[1], [3]])
    sources = np.stack([train.transforms(steady), train.transforms(steady * ramp)])
    pulses = np.zeros((2, length), dtype=np.complex128)
    left, model = frame, np.zeros_like(frame)
    rest = np.inf
    for _ in range(_ROUNDS):
        last, rest = rest, np.vdot(left[span], left[span]).real
        if rest > _SETTLED * last:
            break
        lags = train.lags((sources * train.compared(left, span).conj()).sum(axis=1).conj())
        pulses += linalg.lapack.zpotrs(solved, (weights * lags).T)[0].T
        short = train.filters(pulses)
        model = train.filtered(sources[0] * short[0] + sources[1] * short[1])
        left = frame - model
    return model, train, pulses
