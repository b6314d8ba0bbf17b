"""What decided symbols sound like at the receiver: the pulse by least squares, channel and filters included."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import fft, linalg

from .equaliser import Symbols
from .pieces import Pieces

__all__ = ["Train", "heard"]

_WIDTH = 6  # points per symbol on the grid of impulses
_RATE = 1.5  # points per sample of that grid, at least
_BETA = np.pi * _WIDTH * (1 - 0.5 / _RATE)  # Kaiser-Bessel window: images are 90 dB down
_TABLE = 2048  # steps of that window per point
_SYMBOLS = 14  # that a pulse lasts
_FEWEST, _MOST = 64, 192  # samples that a pulse lasts
_LOADING = 1e-4  # of the symbols' power: outside their band there is nothing to be fitted to
_ROUNDS = 4
_SETTLED = 0.8  # of the residual power before, at which another round gains nothing


@lru_cache(maxsize=1)
def _window() -> np.ndarray:
    """Kaiser-Bessel window, (_WIDTH, _TABLE + 1) float32, read-only: the points around each place between two."""
    distance = np.arange(1 - _WIDTH // 2, _WIDTH // 2 + 1)[:, None] - np.arange(_TABLE + 1) / _TABLE
    inside = np.maximum(1 - (2 * distance / _WIDTH) ** 2, 0)
    window = (np.i0(_BETA * np.sqrt(inside)) / np.i0(_BETA) * (inside > 0)).astype(np.float32)
    window.setflags(write=False)
    return window


@lru_cache(maxsize=4)
def _flat(count: int) -> np.ndarray:
    """(count,) float32, read-only: one over the transform of that window."""
    points = fft.next_fast_len(int(np.ceil(_RATE * count)))
    turns = np.pi * _WIDTH * fft.fftfreq(count) * count / points
    argument = np.sqrt(_BETA**2 - turns**2)
    flat = (np.i0(_BETA) / _WIDTH * argument / np.sinh(argument)).astype(np.float32)
    flat.setflags(write=False)
    return flat


def _spectrum(times: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count,) complex64 transform of an impulse per symbol at its exact time, below half the sample rate.

    Impulses are spread over a finer grid (A. Dutt and V. Rokhlin, SIAM J. Sci. Comput. 14(6), 1993).
    """
    points = fft.next_fast_len(int(np.ceil(_RATE * count)))
    grid = np.zeros(points, dtype=np.complex64)
    place = points / count * times
    whole = place.astype(np.intp)
    spread = _window().take(np.rint((place - whole) * _TABLE).astype(np.intp), axis=1) * values
    whole += 1 - _WIDTH // 2
    for offset in range(_WIDTH):
        # symbols are two and more points apart, so no point is written to twice
        grid[offset:][whole] += spread[offset]
    spectrum = fft.fft(grid, overwrite_x=True)
    flat = _flat(count)
    half = count - count // 2
    return np.concatenate([spectrum[:half] * flat[:half], spectrum[half - count :] * flat[half:]])


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
    spectrum, steady : (count,) complex64
        The impulses' transform, and their samples.
    known : slice
        Samples in which all symbols are known.
    middle, half : float
        Of the ramp that rises from -1 to 1 over the frame, in samples.
    """

    def __init__(self, times: np.ndarray, values: np.ndarray, count: int, length: int) -> None:
        super().__init__(count, length)
        self.send(times, values)

    def send(self, times: np.ndarray, values: np.ndarray) -> None:
        """Other symbols, in the next frame; parameters as above."""
        self.known = slice(int(times[0]) + self.length // 2, int(times[-1]) - self.length // 2)
        self.middle, self.half = (times[-1] + times[0]) / 2, (times[-1] - times[0]) / 2
        self.spectrum = _spectrum(times, values, self._samples)
        self.steady = fft.ifft(self.spectrum)

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
    spectrum, known = train.spectrum, train.known
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
    sources = np.stack([train.transforms(train.steady), train.transforms(train.steady * ramp)])
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
