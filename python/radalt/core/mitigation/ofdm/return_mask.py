"""Return mask: the resource elements that a radar return of any altitude in the span may occupy."""

import numpy as np

from ...waveform import C_M_PER_S, Waveform, read_only
from .numerology import Numerology
from .settings import OfdmSettings


class ReturnMask:
    """Elements in which the sweep, delayed by 0 to ``2 span / c``, passes a symbol.

    At sample n the sweep is at ``f(n)``; with the delays of the span the return occupies ``f(n - d)``, d = 0..D. A
    symbol of one FFT is touched in the subcarriers nearest to these, and in ``mask_margin`` on either side. The other
    elements are return-free whatever the altitude: at 1,500 m five of six.
    """

    def __init__(
        self, waveform: Waveform, numerology: Numerology, span_m: float, settings: OfdmSettings
    ) -> None:
        reference = waveform.reference.astype(np.complex128)
        cycles = np.angle(reference[1:] * reference[:-1].conj()) / (2 * np.pi)
        count = numerology.useful
        self._bins = np.rint(np.append(cycles, cycles[-1]) * count).astype(int) + count // 2
        self._margin = settings.mask_margin
        delay = int(np.ceil(2 * span_m / C_M_PER_S * waveform.rate_hz))
        self._window = np.arange(-delay, count)
        self._count = count
        self._last: tuple[bytes, int, np.ndarray] | None = None

    def free(self, starts: np.ndarray, cfo: float) -> np.ndarray:
        """(L, K) bool, read-only: return-free elements of the symbols whose FFTs begin at ``starts`` (L,).

        ``cfo`` in subcarriers was removed from the samples, so the sweep lies that much lower.
        """
        shift = round(cfo)
        key = starts.tobytes(), shift
        if self._last is None or self._last[:2] != key:
            places = (starts[:, None] + self._window) % self._bins.size
            rows = np.arange(len(starts))[:, None]
            hit = np.zeros((len(starts), self._count), dtype=bool)
            hit[rows, (self._bins[places] - shift) % self._count] = True
            mask = hit.copy()
            for off in range(1, self._margin + 1):
                mask |= np.roll(hit, off, axis=1)
                mask |= np.roll(hit, -off, axis=1)
            self._last = *key, read_only(~mask)
        return self._last[2]
