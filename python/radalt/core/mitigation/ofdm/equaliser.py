"""Resource elements of a frame: CFO and symbol timing removed, one FFT per symbol, one complex factor per element."""

import numpy as np
from scipy import fft

from .arrays import exp_ramp
from .numerology import Numerology

_LEAST = np.float32(
    1e-4
)  # channel gain below which an element is not divided by it: amplitude of unit mean power


class ElementGrid:
    """Received resource elements of one frame.

    - ``samples`` (N,) complex64: a frame
    - ``cfo``: carrier frequency offset to be removed, in subcarriers
    - ``starts`` (L,) int: first sample of each symbol's FFT
    - ``delay`` (L,) float: samples by which each FFT begins later than the middle of its prefix
    - ``segment`` (L,) int: half slot of each symbol, from 0
    - ``samples`` (N,) complex64: the frame without the CFO
    - ``carrier`` (N,) complex64: the factor that removed it
    - ``ramp`` (L, K) complex64: the factor that removes ``delay`` from the elements: ``exp(-2j pi k delay / K)``.
    - ``raw`` (L, K) complex64: FFTs of the symbols, lowest frequency first; power is kept
    """

    def __init__(
        self,
        samples: np.ndarray,
        numerology: Numerology,
        cfo: float,
        starts: np.ndarray,
        delay: np.ndarray,
        segment: np.ndarray,
    ) -> None:
        self.numerology, self.cfo, self.starts, self.segment = numerology, cfo, starts, segment
        self.segments = np.searchsorted(segment, np.arange(segment[-1] + 1))
        self._places = starts[:, None] + np.arange(numerology.useful)
        self.carrier = exp_ramp(np.array([-cfo / numerology.useful]), samples.size)[0]
        self.samples = samples * self.carrier
        self.raw = self.transform(self.samples)
        self.ramp = timing_ramp(-delay, numerology)
        self.level: tuple[np.ndarray, np.ndarray] | None = None  # of `level_in_use`, where that is known

    def retuned(self, cfo: float) -> "ElementGrid":
        """The same frame and times with another CFO removed."""
        samples = self.samples * self.carrier.conj()
        grid = ElementGrid(samples, self.numerology, cfo, self.starts, np.zeros(len(self)), self.segment)
        grid.ramp = self.ramp
        return grid

    def __len__(self) -> int:
        return len(self.starts)

    def transform(self, samples: np.ndarray) -> np.ndarray:
        """(L, K) complex64 elements of (N,) samples whose CFO is removed, timing not corrected."""
        spectra = fft.fft(samples.take(self._places, mode="wrap"), axis=1, norm="ortho", overwrite_x=True)
        first = (self.numerology.useful + 1) // 2
        return np.concatenate([spectra[:, first:], spectra[:, :first]], axis=1)

    def edges(self) -> np.ndarray:
        """(L + 1,) int samples from which each symbol counts, in the middle of its prefix, and where the last ends."""
        half = self.numerology.prefix / 2
        ends = np.append(self.starts - half, self.starts[-1] + self.numerology.useful + half)
        return np.rint(ends).astype(int)

    def cyclic(self) -> tuple[slice, np.ndarray]:
        """The samples that symbols cover, and for each its place (row K + sample) in the (L, K) useful parts."""
        key = self.starts.tobytes(), self.samples.size
        cache = self.numerology.cyclic
        if key not in cache:
            edges = np.clip(self.edges(), 0, self.samples.size)
            row = np.repeat(np.arange(len(self)), np.diff(edges))
            n = np.arange(edges[0], edges[-1])
            useful = self.numerology.useful
            cache.clear()
            cache[key] = slice(edges[0], edges[-1]), row * useful + (n - self.starts[row]) % useful
        return cache[key]


def timing_ramp(delay: np.ndarray, numerology: Numerology) -> np.ndarray:
    """``exp(2j pi k delay_l / K)`` of the subcarriers k: (L,) samples give (L, K) complex64."""
    count = numerology.useful
    return exp_ramp(np.asarray(delay) / count, count, -(count // 2))


def equalise(elements: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """(L, K) complex64 elements over their channel, (1, K) or (L, K), one tap per element."""
    size = np.abs(channel)
    safe = np.where(size < _LEAST, _LEAST, channel) if size.min() < _LEAST else channel
    return elements * (1 / safe)
