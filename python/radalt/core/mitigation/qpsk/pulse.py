"""What decided symbols sound like at the receiver: the pulse by least squares, channel and filters included."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft, linalg

from .equaliser import Symbols

__all__ = ["heard"]

_WIDTH = 6  # points per symbol on the grid of twice the rate
_BETA = 2.3 * _WIDTH  # Kaiser-Bessel window: images are 100 dB down
_TABLE = 512  # steps of that window per point
_SYMBOLS = 14  # that a pulse lasts
_FEWEST, _MOST = 64, 192  # samples that a pulse lasts
_LOADING = 1e-4  # of the symbols' power: outside their band there is nothing to be fitted to
_BATCH = 4  # pieces that the processor transforms side by side
_PIECE = 500  # samples of a piece, about
_ROUNDS = 4
_SETTLED = 0.8  # of the residual power before, at which another round gains nothing


@lru_cache(maxsize=1)
def _window() -> np.ndarray:
    """Kaiser-Bessel window, (_TABLE + 1, _WIDTH) float32, read-only: the points around each place between two."""
    distance = np.arange(1 - _WIDTH // 2, _WIDTH // 2 + 1) - np.arange(_TABLE + 1)[:, None] / _TABLE
    inside = np.maximum(1 - (2 * distance / _WIDTH) ** 2, 0)
    window = (np.i0(_BETA * np.sqrt(inside)) / np.i0(_BETA) * (inside > 0)).astype(np.float32)
    window.setflags(write=False)
    return window


def _spectrum(symbols: Symbols, count: int) -> np.ndarray:
    """(count,) complex64 transform of an impulse per symbol at its exact time, below half the sample rate.

    Impulses are spread over a grid of twice the rate (A. Dutt and V. Rokhlin, SIAM J. Sci. Comput. 14(6), 1993). The
    window's own transform stays in: the pulse that is fitted takes it up.
    """
    grid = np.zeros(2 * count, dtype=np.complex64)
    place = 2 * symbols.times
    whole = place.astype(np.intp)
    spread = _window()[np.rint((place - whole) * _TABLE).astype(np.intp)] * symbols.values[:, None]
    whole += 1 - _WIDTH // 2
    for offset in range(_WIDTH):
        # symbols are two and more points apart, so no point is written to twice
        grid[whole + offset] += spread[:, offset]
    spectrum = fft.fft(grid, overwrite_x=True)
    return np.concatenate([spectrum[: count - count // 2], spectrum[-(count // 2) :]])


def heard(frame: np.ndarray, symbols: Symbols) -> tuple[np.ndarray, slice]:
    """(n,) complex64, the part of a frame that the symbols explain, and the samples in which all symbols are known.

    ``sum_k b_k (g_0 + u g_1)(n - t_k)``, where u rises from -1 to 1 over the frame: a carrier, a clock or a path that
    drifts changes the pulse in proportion to time, for as long as the change is small. Both pulses are fitted in turns,
    with the Toeplitz matrix of a long frame, to what is left of the frame.
    """
    count = frame.size
    apart = float(symbols.times[1] - symbols.times[0])
    length = min(max(2 * round(_SYMBOLS * apart / 2), _FEWEST), _MOST)
    spectrum = _spectrum(symbols, count)
    # the transform of a real sequence: half of it says all
    lag_zero_first = (
        fft.rfft(spectrum.real**2 + spectrum.imag**2)[:length].conj().astype(np.complex128) / count
    )
    lag_zero_first[0] *= 1 + _LOADING
    solved = linalg.lapack.zpotrf(linalg.toeplitz(lag_zero_first))[0]
    sent = symbols.times[symbols.points != 0]
    middle, half = (sent[-1] + sent[0]) / 2, (sent[-1] - sent[0]) / 2
    ramp = ((np.arange(count) - middle) / half).astype(np.float32)
    known = slice(int(symbols.times[0]) + length // 2, int(symbols.times[-1]) - length // 2)
    # at a burst's edge symbols are cut, and cut symbols are not known
    begin, end = max(known.start, int(sent[0]) + length // 2), min(known.stop, int(sent[-1]) - length // 2)
    scale = sent.size / np.count_nonzero((sent > begin) & (sent < end))
    weights = scale * np.array([[1], [3]])

    # overlap-save: a pulse is short, and transforms of many short pieces at once cost less than one of the frame
    pieces = _BATCH * max(1, round(count / (_BATCH * _PIECE)))
    hop = -(-count // pieces)
    size = fft.next_fast_len(hop + length - 1)
    steady = fft.ifft(spectrum, overwrite_x=True)
    padded = np.zeros((2, pieces * hop + size), dtype=np.complex64)
    before = length // 2 - 1
    padded[0, before : before + count] = steady
    np.multiply(steady, ramp, out=padded[1, before : before + count])
    sources = fft.fft(sliding_window_view(padded, size, axis=1)[:, : pieces * hop : hop])
    left = np.zeros(pieces * hop, dtype=np.complex64)
    left[begin:end] = frame[begin:end]
    late = np.zeros((pieces, size), dtype=np.complex64)
    model = np.zeros(pieces * hop, dtype=np.complex64)
    pulses = np.zeros((2, length), dtype=np.complex128)
    rest = np.inf
    for _ in range(_ROUNDS):
        last, rest = rest, np.vdot(left, left).real
        if rest > _SETTLED * last:
            break
        late[:, length - 1 : length - 1 + hop] = left.reshape(pieces, hop)
        alike = (sources * fft.fft(late).conj()).sum(axis=1).conj()
        pulses += linalg.lapack.zpotrs(solved, (weights * fft.ifft(alike)[:, :length]).T)[0].T
        short = fft.fft(pulses.astype(np.complex64), size)
        made = fft.ifft(sources[0] * short[0] + sources[1] * short[1], overwrite_x=True)
        model = made[:, length - 1 : length - 1 + hop].ravel()
        left[begin:end] = frame[begin:end] - model[begin:end]
    return model[:count], known
