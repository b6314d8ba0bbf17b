"""What QPSK symbols sound like under another signal: impulses or steps, through a pulse of few taps."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from scipy import fft, linalg

from ..ofdm.lattice import box, power
from .clock import Clock
from .equaliser import Equaliser, Symbols
from .pieces import Pieces
from .pulse import Train

__all__ = ["Impulses", "Pulse", "Steps", "SymbolTrain"]

_FITS = 6
_SETTLED = 0.9  # of the residual power before, at which another fit gains nothing
_LOADING = 1e-4  # of the train's power
_SHRUNK = 1.5  # times its variance: a tap with less power is none
_NEAR = np.ones(3) / 3  # taps whose powers are alike
_WIDTH = 31  # bins over which a spectrum is averaged
_GRADIENTS, _CONVERGED = 60, 1e-6  # steps at most; power left
# symbols by which the steps may be early or late, and fall behind over the frame: ranges and steps of three searches
_SEARCHES = (((1.5, 0.02), (0.0, 1.0)), ((0.04, 0.005), (0.1, 0.02)), ((0.006, 0.001), (0.02, 0.005)))


class SymbolTrain(Protocol):
    """Symbols at their times in a frame of N samples.

    Attributes
    ----------
    length : int
        Samples of the pulse that they are filtered by.
    points : (K,) complex64
        First decisions.
    times : (K,) float
        In samples.
    known : slice
        Samples in which all symbols are known.
    """

    length: ClassVar[int]
    points: np.ndarray
    times: np.ndarray
    known: slice

    def outputs(self, frame: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """(K,) points with noise, out of a ``frame`` (N,), of which ``rest`` (N,) is not these symbols."""

    def source(self, points: np.ndarray) -> np.ndarray:
        """(N,) samples, before the pulse, of unit points (K,)."""


class Impulses:
    """An impulse per symbol: QPSK as a receiver hears it. A `SymbolTrain`."""

    length: ClassVar[int] = 64

    def __init__(self, symbols: Symbols, clock: Clock, count: int) -> None:
        self._clock, self._count = clock, count
        self._turn = symbols.values * symbols.points.conj()
        self.times, self.points = symbols.times, symbols.points
        self.known = self._train(symbols.values).known

    def outputs(self, frame: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """See `SymbolTrain`: an equaliser that is fitted to the first decisions."""
        return _Fitted(frame, self._clock).outputs(self.points * self._turn) * self._turn.conj()

    def source(self, points: np.ndarray) -> np.ndarray:
        """See `SymbolTrain`."""
        return fft.ifft(self._train(points * self._turn).spectrum())

    def _train(self, values: np.ndarray) -> Train:
        return Train(self.times, values, self._count, self.length)


class _Fitted(Equaliser):
    """An equaliser with all symbols given."""

    def outputs(self, values: np.ndarray) -> np.ndarray:
        return self._rows @ self._fitted(values[self._asked])


class Steps:
    """A value per symbol, held from one sample to another: QPSK that is switched on the sample grid. A `SymbolTrain`.

    ``rest`` (N,) is what of a ``frame`` (N,) is not these symbols. Times and rate of the steps are searched near those
    of ``symbols``.
    """

    length: ClassVar[int] = 16

    def __init__(self, frame: np.ndarray, rest: np.ndarray, symbols: Symbols, clock: Clock) -> None:
        at = _steps(frame, rest, symbols, clock)
        number = np.arange(
            at[0], at[-1] + 1
        )  # before the first and after the last symbol, some are not yet decided
        self._at = at - at[0]
        self._begins = np.flatnonzero(np.diff(self._at, prepend=-1))
        self._seen = (number >= 0) & (number < symbols.points.size)
        nearest = number.clip(0, symbols.points.size - 1)
        self._turn = (symbols.values * symbols.points.conj())[nearest]
        self.points = symbols.points[nearest]
        self.times = self._begins + 0.5 * np.diff(self._begins, append=frame.size)
        self.known = slice(0, frame.size)

    def outputs(self, frame: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """See `SymbolTrain`: least squares, weighted with the rest's spectrum, by conjugate gradients."""
        weight = _whitening(rest)

        def onto(samples: np.ndarray) -> np.ndarray:
            return np.add.reduceat(fft.ifft(fft.fft(samples) * weight), self._begins) * self._turn.conj()

        left = onto(frame.astype(np.complex128))
        out, step = np.zeros_like(left), left
        size = np.vdot(left, left).real
        least = _CONVERGED * size
        for _ in range(_GRADIENTS):
            moved = onto((step * self._turn)[self._at])
            along = size / np.vdot(step, moved).real
            out += along * step
            left = left - along * moved
            size, before = np.vdot(left, left).real, size
            if size < least:
                break
            step = left + size / before * step
        seen = self._seen
        return (out * (np.count_nonzero(seen) / np.vdot(self.points[seen], out[seen]))).astype(np.complex64)

    def source(self, points: np.ndarray) -> np.ndarray:
        """See `SymbolTrain`."""
        return (points * self._turn)[self._at]


def _whitening(rest: np.ndarray) -> np.ndarray:
    """(N,) one over the smoothed power spectrum of ``rest`` (N,), of mean 1."""
    weight = 1 / np.maximum(box(power(fft.fft(rest)), _WIDTH), np.float32(1e-30))
    return weight / weight.mean()


def _steps(frame: np.ndarray, rest: np.ndarray, symbols: Symbols, clock: Clock) -> np.ndarray:
    """(N,) int: which symbol each sample holds, at the times that fit the frame best; below 0 or from K on none of
    ``symbols``."""
    count = frame.size
    clear = fft.ifft(fft.fft(frame) * _whitening(rest)).conj().astype(np.complex64)
    values = np.concatenate([[0], symbols.values, [0]]).astype(np.complex64)
    place = (np.arange(count) - symbols.times[0]) * clock.rate + 0.5
    course = np.linspace(-0.5, 0.5, count)

    def held(shift: float, stretch: float) -> np.ndarray:
        return np.floor(place + (shift + stretch * course)).astype(np.intp)

    def agreement(one: tuple[float, float]) -> float:
        return abs(clear @ values[(held(*one) + 1).clip(0, values.size - 1)])

    best = 0.0, 0.0
    for ranges in _SEARCHES:
        shifts, stretches = (
            at + np.arange(-reach, reach + step / 2, step)
            for at, (reach, step) in zip(best, ranges, strict=True)
        )
        best = max(((shift, stretch) for stretch in stretches for shift in shifts), key=agreement)
    return held(*best)


class Pulse:
    """The pulse through which a train of ``points`` (K,) fits a ``frame`` (N,) best where it is known and ``inside``.

    As in `heard`, it drifts over the frame. Taps that do not stand out of their own variance are none: under a signal
    of equal power 64 taps alone would leave a part in a hundred of it.
    """

    def __init__(self, frame: np.ndarray, train: SymbolTrain, points: np.ndarray, inside: slice) -> None:
        self._train, count, length = train, frame.size, train.length
        span = slice(max(inside.start, train.known.start), min(inside.stop, train.known.stop))
        self._pieces = pieces = Pieces(count, length)
        self._ramp = np.linspace(-1, 1, count, dtype=np.float32)
        source = train.source(points)
        lags = fft.ifft(power(fft.fft(source)))[:length].astype(np.complex128)
        lags[0] *= 1 + _LOADING
        solved = linalg.cho_factor(linalg.toeplitz(lags))
        shares = count / (span.stop - span.start) * np.array([[1.0], [3.0]])
        sources = self._sources(source)
        pulses = np.zeros((2, length), dtype=np.complex128)
        left, rest = frame, np.inf
        for _ in range(_FITS):
            last, rest = rest, np.vdot(left[span], left[span]).real
            if rest > _SETTLED * last:
                break
            right = pieces.lags((sources * pieces.compared(left, span).conj()).sum(axis=1).conj())
            pulses += linalg.cho_solve(solved, (shares * right).T).T
            left = frame - self._filtered(sources, pulses)
        variance = np.diag(linalg.cho_solve(solved, np.eye(length))).real
        variance = rest / (span.stop - span.start) * variance * shares
        size = np.stack([np.convolve(row, _NEAR, "same") for row in power(pulses)])
        self._pulses = pulses * np.maximum(0, 1 - _SHRUNK * variance / np.maximum(size, 1e-30))

    def heard(self, points: np.ndarray) -> np.ndarray:
        """(N,) complex64 what unit points (K,) of the same train sound like."""
        return self._filtered(self._sources(self._train.source(points)), self._pulses)

    def _sources(self, source: np.ndarray) -> np.ndarray:
        return np.stack([self._pieces.transforms(source), self._pieces.transforms(source * self._ramp)])

    def _filtered(self, sources: np.ndarray, pulses: np.ndarray) -> np.ndarray:
        filters = self._pieces.filters(pulses)
        return self._pieces.filtered(sources[0] * filters[0] + sources[1] * filters[1])
