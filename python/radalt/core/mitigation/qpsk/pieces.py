"""Short filters over a frame by overlap-save."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft

__all__ = ["Pieces"]

_BATCH = 4  # pieces that the processor transforms side by side
_PIECE = 500  # samples of a piece, about


class Pieces:
    """A frame in pieces that overlap by a filter: transforms of many at once cost less than one of the frame.

    Parameters
    ----------
    count : int
        Samples of the frame.
    length : int
        Samples of a filter, even. Its middle one, number ``length / 2``, delays nothing.
    """

    def __init__(self, count: int, length: int) -> None:
        self.length = length
        self._samples = count
        self.count = _BATCH * max(1, round(count / (_BATCH * _PIECE)))
        self.hop = _even(-(-count // self.count))
        self._size = _even(fft.next_fast_len(self.hop + length - 1, real=True))
        while fft.next_fast_len(self._size, real=True) > self._size:
            self._size += 2
        self._padded = np.zeros(self.count * self.hop + self._size, dtype=np.complex64)
        self._overlapping = sliding_window_view(self._padded, self._size)[: self.count * self.hop : self.hop]
        self._kept = np.zeros(self.count * self.hop, dtype=np.complex64)
        self._late = np.zeros((self.count, self._size), dtype=np.complex64)

    def transforms(self, frame: np.ndarray) -> np.ndarray:
        """(pieces, size) complex64 transforms of a (count,) frame's pieces, which are to be filtered."""
        before = self.length // 2 - 1
        self._padded[before : before + self._samples] = frame
        return fft.fft(self._overlapping)

    def filters(self, taps: np.ndarray) -> np.ndarray:
        """(..., size) complex64 transforms of (..., length) filters."""
        return fft.fft(taps.astype(np.complex64, copy=False), self._size)

    def filtered(self, products: np.ndarray) -> np.ndarray:
        """(..., count) complex64 samples from (..., pieces, size) transforms of pieces times filters."""
        out = fft.ifft(products, overwrite_x=True)[..., self.length - 1 : self.length - 1 + self.hop]
        return out.reshape(*products.shape[:-2], -1)[..., : self._samples]

    def compared(self, frame: np.ndarray, span: slice) -> np.ndarray:
        """(pieces, size) complex64 transforms of the samples of a (count,) frame in ``span``, with what is filtered."""
        self._kept[: span.start] = self._kept[span.stop :] = 0
        self._kept[span] = frame[span]
        self._late[:, self.length - 1 : self.length - 1 + self.hop] = self._kept.reshape(-1, self.hop)
        return fft.fft(self._late)

    def lags(self, products: np.ndarray) -> np.ndarray:
        """(..., length) correlations from (..., size) conjugate transforms of pieces times those compared, summed."""
        return fft.ifft(products)[..., : self.length]


def _even(count: int) -> int:
    """It, or the next number."""
    return count + count % 2
