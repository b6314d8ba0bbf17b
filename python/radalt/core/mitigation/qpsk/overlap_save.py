"""Short filters over a frame by overlap-save: transforms of many segments cost less than one of the frame."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft

# segments that a processor's vector unit transforms side by side: their number is a multiple of it
_BATCH = 4
# samples of a segment, about: the shortest transforms per sample for filters of 64 to 192 taps
_SEGMENT = 500


class OverlapSave:
    """Segments of a frame that overlap by a filter.

    ``count``: samples of the frame; ``length``: samples of a filter, even. Its middle one, number ``length / 2``,
    delays nothing.
    """

    def __init__(self, count: int, length: int) -> None:
        self.length = length
        self.samples = count
        self.segments = _BATCH * max(1, round(count / (_BATCH * _SEGMENT)))
        self.hop = 2 * -(-count // (2 * self.segments))
        self.size = fft.next_fast_len(self.hop + length - 1, real=True)
        while self.size % 2:
            self.size = fft.next_fast_len(self.size + 1, real=True)
        self._padded = np.zeros(self.segments * self.hop + self.size, dtype=np.complex64)
        self._overlapping = sliding_window_view(self._padded, self.size)[
            : self.segments * self.hop : self.hop
        ]
        self._kept = np.zeros(self.segments * self.hop, dtype=np.complex64)
        self._delayed = np.zeros((self.segments, self.size), dtype=np.complex64)

    def transforms(self, frame: np.ndarray) -> np.ndarray:
        """(segments, size) complex64 transforms of a (count,) frame's segments, which are to be filtered."""
        before = self.length // 2 - 1
        self._padded[before : before + self.samples] = frame
        return fft.fft(self._overlapping)

    def responses(self, taps: np.ndarray) -> np.ndarray:
        """(..., size) complex64 frequency responses of (..., length) filters."""
        return fft.fft(taps.astype(np.complex64, copy=False), self.size)

    def filtered(self, products: np.ndarray) -> np.ndarray:
        """(..., count) complex64 samples from (..., segments, size) transforms times responses."""
        out = fft.ifft(products, overwrite_x=True)[..., self.length - 1 : self.length - 1 + self.hop]
        return out.reshape(*products.shape[:-2], -1)[..., : self.samples]

    def to_correlate(self, frame: np.ndarray, span: slice) -> np.ndarray:
        """(segments, size) complex64 transforms of the samples of a (count,) frame in ``span``, for `correlations`."""
        self._kept[: span.start] = self._kept[span.stop :] = 0
        self._kept[span] = frame[span]
        self._delayed[:, self.length - 1 : self.length - 1 + self.hop] = self._kept.reshape(-1, self.hop)
        return fft.fft(self._delayed)

    def correlations(self, products: np.ndarray) -> np.ndarray:
        """(..., length) correlations from (..., size) conjugate `transforms` times `to_correlate`, summed."""
        return fft.ifft(products)[..., : self.length]
