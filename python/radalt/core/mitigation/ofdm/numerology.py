"""Symbols of LTE and NR at the radar's rate: lengths, grid of times, subcarriers."""

from __future__ import annotations

import numpy as np

__all__ = ["SPACINGS_HZ", "Numerology"]

SPACINGS_HZ = (15e3, 30e3)
_CYCLE_S = 0.5e-3  # the long prefix comes every half subframe, TS 38.211 clause 5.3.1
_SHORT_S = 144 / 30.72e6  # of 15 kHz; it shrinks with the symbol
_LONGER_S = 16 / 30.72e6  # whatever the spacing


class Numerology:
    """One subcarrier spacing at one sample rate (TS 38.211 clause 5.3.1, normal prefix).

    Parameters
    ----------
    rate_hz, spacing_hz : float
        The rate has to be a whole multiple of the spacing, so that a symbol is a whole number of samples.

    Attributes
    ----------
    useful : int
        Samples of a symbol without its prefix, and subcarriers in the band.
    prefix, longer : float
        Samples of the short prefix, and how much longer the long one is.
    per_cycle : int
        Symbols from one long prefix to the next.
    spacing : float
        Mean samples from symbol to symbol.
    samples : (useful,) int
        Numbers of a symbol's samples without its prefix, from 0.
    subcarriers : (useful,) float32
        Numbers from the lowest frequency to the highest, 0 at the middle of the band.
    turn : (useful,) float32
        Radians by which a delay of one sample turns each.
    moments : (2 useful, 6) float32
        Powers 0, 1, 2 of ``turn``, for real and imaginary parts that alternate.
    """

    def __init__(self, rate_hz: float, spacing_hz: float) -> None:
        self.spacing_hz = spacing_hz
        self.useful = round(rate_hz / spacing_hz)
        self.per_cycle = round(7 * spacing_hz / SPACINGS_HZ[0])
        self.prefix = _SHORT_S * SPACINGS_HZ[0] / spacing_hz * rate_hz
        self.longer = _LONGER_S * rate_hz
        self.cycle = _CYCLE_S * rate_hz
        self.spacing = self.cycle / self.per_cycle
        self.samples = np.arange(self.useful)
        self.subcarriers = np.fft.fftshift(np.fft.fftfreq(self.useful, 1 / self.useful)).astype(np.float32)
        self.turn = (2 * np.pi / self.useful * self.subcarriers).astype(np.float32)
        self.moments = np.kron(self.turn[:, None] ** np.arange(3), np.eye(2)).astype(np.float32)
        self._places: tuple[bytes, np.ndarray] | None = None  # the last asked for
        self._halves: tuple[tuple[bytes, float], np.ndarray] | None = None  # the last asked for

    def times(self, first_long: float, samples: int) -> np.ndarray:
        """Times of the symbols around a frame of ``samples``, (symbols,) float64, if one with a long prefix is at
        ``first_long``.

        A symbol's time is a fixed distance before its useful part, some way into its prefix.
        """
        cycles = np.arange(-1 - first_long // self.cycle, (samples - first_long) // self.cycle + 1)
        within = np.arange(self.per_cycle) * (self.useful + self.prefix)
        return (first_long + cycles[:, None] * self.cycle + within).ravel()

    def times_at(self, starts: np.ndarray, first_long: float) -> np.ndarray:
        """The `times` of the symbols whose transforms begin at ``starts`` (L,)."""
        passed = self._cycles(starts, first_long)
        within = np.rint((starts - first_long - passed * self.cycle) / (self.useful + self.prefix))
        return first_long + passed * self.cycle + within * (self.useful + self.prefix)

    def places(self, starts: np.ndarray) -> np.ndarray:
        """Numbers of the samples of the windows at ``starts`` (L,), (L, useful) int."""
        key = starts.tobytes()
        if self._places is None or self._places[0] != key:
            self._places = key, starts[:, None] + self.samples
        return self._places[1]

    def halves(self, starts: np.ndarray, first_long: float) -> np.ndarray:
        """Which half slot (from a long prefix to the next) the symbols at ``starts`` (L,) are in, from 0: (L,) int."""
        key = starts.tobytes(), first_long
        if self._halves is None or self._halves[0] != key:
            number = self._cycles(starts, first_long).astype(int)
            self._halves = key, number - number[0]
        return self._halves[1]

    def _cycles(self, starts: np.ndarray, first_long: float) -> np.ndarray:
        """(L,) float64 whole numbers: cycles from the long prefix at ``first_long`` to the last one before each."""
        return np.floor((starts - first_long + self.prefix / 2) / self.cycle)

    def windows(self, times: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Which of the symbols at ``times`` a frame holds, and the first sample of each one's transform: (L,), (L,)
        int.

        A transform starts in the middle of the prefix, where neither an early nor a late echo brings in another symbol.
        At the frame's ends it may be up to a third of the prefix off.
        """
        slack = int(self.prefix / 3)
        starts = np.rint(times).astype(int)
        held = np.flatnonzero((starts >= -slack) & (starts + self.useful <= samples + slack))
        return held, np.clip(starts[held], 0, samples - self.useful)
