"""What decided symbols sound like at the receiver: the pulse by least squares, channel and filters included."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import fft, linalg

from .equaliser import Symbols

__all__ = ["heard"]

_WIDTH = 6  # points per symbol on the grid of twice the rate
_BETA = 2.3 * _WIDTH  # Kaiser-Bessel window: images are 100 dB down
_TABLE = 512  # steps of that window per point
_SYMBOLS = 14  # that a pulse lasts
_FEWEST, _MOST = 64, 192  # samples that a pulse lasts
_LOADING = 1e-4  # of the symbols' power: outside their band there is nothing to be fitted to
_ROUNDS = 4
_SETTLED = 0.8  # of the residual power before, at which another round gains nothing


@lru_cache(maxsize=1)
def _window() -> np.ndarray:
    """Kaiser-Bessel window by distance, (_WIDTH // 2 * _TABLE + 2,) float32."""
    distance = np.arange(_WIDTH // 2 * _TABLE + 2) / _TABLE
    inside = np.maximum(1 - (2 * distance / _WIDTH) ** 2, 0)
    return (np.i0(_BETA * np.sqrt(inside)) / np.i0(_BETA) * (inside > 0)).astype(np.float32)


def _spectrum(symbols: Symbols, count: int) -> np.ndarray:
    """(count,) complex64 transform of an impulse per symbol at its exact time, below half the sample rate.

    Impulses are spread over a grid of twice the rate (A. Dutt and V. Rokhlin, SIAM J. Sci. Comput. 14(6), 1993). The
    window's own transform stays in: the pulse that is fitted takes it up.
    """
    grid = np.zeros(2 * count, dtype=np.complex64)
    place = 2 * symbols.times
    whole = place.astype(np.intp)
    step = np.rint((place - whole) * _TABLE).astype(np.intp)
    window = _window()
    for offset in range(1 - _WIDTH // 2, _WIDTH // 2 + 1):
        # symbols are two and more points apart, so no point is written to twice
        grid[whole + offset] += symbols.values * window[np.abs(offset * _TABLE - step)]
    spectrum = fft.fft(grid, overwrite_x=True)
    return np.concatenate([spectrum[: count // 2], spectrum[-(count // 2) :]])


def heard(frame: np.ndarray, symbols: Symbols) -> tuple[np.ndarray, slice]:
    """(n,) complex64, the part of a frame that the symbols explain, and the samples in which all symbols are known.

    ``sum_k b_k (g_0 + u g_1)(n - t_k)``, where u rises from -1 to 1 over the frame: a carrier, a clock or a path that
    drifts changes the pulse in proportion to time, for as long as the change is small. Both pulses are fitted in turns,
    with the Toeplitz matrix of a long frame, to what is left of the frame.
    """
    count = frame.size
    apart = float(symbols.times[1] - symbols.times[0])
    length = int(np.clip(2 * round(_SYMBOLS * apart / 2), _FEWEST, _MOST))
    lags = np.arange(-length // 2, length // 2)
    spectrum = _spectrum(symbols, count)
    power = spectrum.real**2 + spectrum.imag**2
    lag_zero_first = fft.ifft(power)[:length].astype(np.complex128)
    lag_zero_first[0] *= 1 + _LOADING
    solved = linalg.cho_factor(linalg.toeplitz(lag_zero_first), overwrite_a=True, check_finite=False)
    sent = symbols.times[symbols.points != 0]
    middle, half = (sent[-1] + sent[0]) / 2, (sent[-1] - sent[0]) / 2
    ramp = ((np.arange(count) - middle) / half).astype(np.float32)
    drifting = fft.fft(fft.ifft(spectrum) * ramp)
    known = slice(int(symbols.times[0]) + length // 2, int(symbols.times[-1]) - length // 2)
    response, change = (np.zeros(length, dtype=np.complex128) for _ in range(2))
    model = np.zeros(count, dtype=np.complex64)
    # at a burst's edge symbols are cut, and cut symbols are not known
    begin, end = max(known.start, int(sent[0]) + length // 2), min(known.stop, int(sent[-1]) - length // 2)
    scale = sent.size / np.count_nonzero((sent > begin) & (sent < end))

    def transform(pulse: np.ndarray) -> np.ndarray:
        padded = np.zeros(count, dtype=np.complex64)
        padded[lags] = pulse
        return fft.fft(padded, overwrite_x=True)

    rest = np.inf
    for _ in range(_ROUNDS):
        left = np.zeros(count, dtype=np.complex64)
        left[begin:end] = frame[begin:end] - model[begin:end]
        before, rest = rest, np.vdot(left, left).real
        if rest > _SETTLED * before:
            break
        left = fft.fft(left, overwrite_x=True)
        both = np.stack(
            [
                scale * fft.ifft(spectrum.conj() * left)[lags],
                3 * scale * fft.ifft(drifting.conj() * left)[lags],
            ],
            axis=1,
        )
        step = linalg.cho_solve(solved, both, check_finite=False)
        response += step[:, 0]
        change += step[:, 1]
        model = fft.ifft(transform(response) * spectrum + transform(change) * drifting)
    return model.astype(np.complex64), known
