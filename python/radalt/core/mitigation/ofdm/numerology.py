"""Numerology: lengths and times of the symbols of LTE and NR at the radar's rate."""

from functools import lru_cache

import numpy as np

from ...waveform import read_only

_CYCLE_S = 0.5e-3  # from one long prefix to the next, TS 38.211 clause 5.3.1
_PREFIX_S = 144 / 30.72e6  # short prefix at 15 kHz, TS 38.211 clause 5.3.1; it shrinks with the symbol
_LONGER_S = 16 / 30.72e6  # by which the long prefix exceeds it, whatever the spacing
_BASE_HZ = 15e3


class Numerology:
    """One subcarrier spacing at one sample rate (TS 38.211 clause 5.3.1, normal prefix).

    - ``rate_hz``, ``spacing_hz``: the rate has to be a whole multiple of the spacing, so that a symbol is a whole
      number of samples
    - ``useful``: samples of a symbol without its prefix, and subcarriers K in the band
    - ``per_cycle``: symbols from one long prefix to the next
    - ``prefix``, ``longer``, ``cycle``, ``spacing``: samples of the short prefix; of the long one beyond that;
      between long prefixes; mean from symbol to symbol
    - ``subcarriers`` (K,) float32: numbers from the lowest frequency to the highest, 0 at the middle of the band
    - ``block``: adjacent subcarriers that share one noise and one constellation: the most of 4, 2, 1 that divides K
    """

    def __init__(self, rate_hz: float, spacing_hz: float) -> None:
        self.spacing_hz = spacing_hz
        self.useful = round(rate_hz / spacing_hz)
        self.per_cycle = round(7 * spacing_hz / _BASE_HZ)
        self.prefix = _PREFIX_S * _BASE_HZ / spacing_hz * rate_hz
        self.longer = _LONGER_S * rate_hz
        self.cycle = _CYCLE_S * rate_hz
        self.spacing = self.cycle / self.per_cycle
        self.subcarriers = np.arange(self.useful, dtype=np.float32) - self.useful // 2
        # a block covers as many hertz whatever the spacing, so that it has few users
        self.block = next(n for n in (4, 2, 1) if self.useful % n == 0 and n * spacing_hz <= 4 * _BASE_HZ)
        self.cyclic: dict[
            tuple[bytes, int], tuple[slice, np.ndarray]
        ] = {}  # the last of `ElementGrid.cyclic`

    def blocks(self, subcarriers: int) -> int:
        """Odd number of blocks that cover about so many subcarriers of 15 kHz."""
        return 2 * round(subcarriers * _BASE_HZ / self.spacing_hz / self.block / 2 - 0.5) + 1

    def windows(self, times: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Which of the symbols whose prefixes have their middles at ``times`` a frame of ``samples`` holds.

        Returns their numbers (L,) and the first samples (L,) int of their FFTs. An FFT begins in the middle of the
        prefix, where neither early nor late echoes bring in another symbol.
        """
        starts = np.rint(times).astype(int)
        held = np.flatnonzero((starts >= 0) & (starts + self.useful <= samples))
        return held, starts[held]

    def times(self, first_long: float, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """(n,) times of the middles of the prefixes around a frame, a long one at ``first_long``, and their half slots.

        Half slots (n,) int count from one long prefix to the next.
        """
        n = np.arange(-self.per_cycle - 1, samples // self.useful + self.per_cycle + 2)
        cycle, within = np.divmod(n, self.per_cycle)
        times = first_long % self.cycle + cycle * self.cycle + within * (self.useful + self.prefix)
        return times, cycle


@lru_cache(maxsize=4)
def fold_index(count: int, spacing: float) -> np.ndarray:
    """(count,) int, read-only: position of each sample in a symbol of mean length ``spacing``."""
    bins = round(spacing)
    return read_only((np.arange(count) * (bins / spacing)).astype(np.intp) % bins)
