"""Return mask: the resource elements that a radar return of any altitude in the span may occupy."""

from __future__ import annotations

import numpy as np

from ...waveform import C_M_PER_S, Waveform
from .numerology import Numerology
from .settings import OfdmSettings

__all__ = ["ReturnMask"]


class ReturnMask:
    """Elements in which the sweep, delayed by 0 to ``2 span / c``, passes a symbol.

    At sample n the sweep is at ``f(n)``; with the delays of the span the return occupies ``f(n - d)``, d = 0..D. A
    symbol of one FFT is touched in the subcarriers nearest to these, and in ``mask_margin`` on either side. The other
    elements are return-free whatever the altitude: at 1,500 m five of six.
    """

    def __init__(self, waveform: Waveform, numerology: Numerology, span_m: float, settings: OfdmSettings) -> None:
        reference = waveform.reference.astype(np.complex128)
        cycles = np.angle(reference[1:] * reference[:-1].conj()) / (2 * np.pi)
        self._cycles = np.append(cycles, cycles[-1])
        self._numerology, self._margin = numerology, settings.mask_margin
        self._delay = int(np.ceil(2 * span_m / C_M_PER_S * waveform.rate_hz))
        self._rows: dict[tuple[int, int], np.ndarray] = {}

    def free(self, starts: np.ndarray, cfo: float) -> np.ndarray:
        """(L, K) bool: return-free elements of the symbols whose FFTs begin at ``starts`` (L,).

        ``cfo`` in subcarriers was removed from the samples, so the sweep lies that much lower.
        """
        return ~np.stack([self._row(int(start), round(cfo)) for start in starts])

    def _row(self, start: int, shift: int) -> np.ndarray:
        row = self._rows.get((start, shift))
        if row is None:
            count = self._numerology.useful
            at = np.arange(start - self._delay, start + count) % self._cycles.size
            middle = np.rint(self._cycles[at] * count).astype(int) - shift + count // 2
            row = np.zeros(count, dtype=bool)
            for off in range(-self._margin, self._margin + 1):
                row[(middle + off) % count] = True
            if len(self._rows) >= 4096:  # rows of 500 bool
                self._rows.clear()
            self._rows[start, shift] = row
        return row
