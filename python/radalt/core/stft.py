"""Short-time Fourier transform of frames with three quarters overlap, and its inverse."""

import numpy as np
from scipy import fft

from .fir import cosine_window

_OVERLAP = 4  # windows that hold each sample


class Stft:
    """Plane of a frame: Hann windows every quarter of their length, the frame's ends within whole windows.

    ``samples``: samples N of a frame; ``window``: window length in samples, a multiple of 4 within 8..N. ``hops``:
    windows of a frame.
    """

    def __init__(self, samples: int, window: int) -> None:
        self.samples, self.window = samples, window
        self.hop = window // _OVERLAP
        self.hops = -(-samples // self.hop) + _OVERLAP - 1
        self._taper = cosine_window("hann", window, periodic=True).astype(np.float32)
        self._lead = window - self.hop
        self._padded = (self.hops - 1) * self.hop + window
        norm = np.zeros(self._padded)
        for h in range(self.hops):
            norm[h * self.hop : h * self.hop + window] += self._taper.astype(float) ** 2
        self._norm = (1.0 / norm[self._lead : self._lead + samples]).astype(np.float32)

    def forward(self, frames: np.ndarray) -> np.ndarray:
        """(..., hops, window) complex64 of (..., N) complex frames."""
        padded = np.zeros((*frames.shape[:-1], self._padded), dtype=np.complex64)
        padded[..., self._lead : self._lead + self.samples] = frames
        views = np.lib.stride_tricks.sliding_window_view(padded, self.window, axis=-1)[..., :: self.hop, :]
        return fft.fft(views * self._taper, axis=-1, overwrite_x=True)

    def inverse(self, plane: np.ndarray) -> np.ndarray:
        """(..., N) complex64 frames whose windows are nearest to the plane, which is used up."""
        pieces = fft.ifft(plane, axis=-1, overwrite_x=True)
        pieces *= self._taper
        first = plane.shape[:-2]
        quarters = pieces.reshape(*first, self.hops, _OVERLAP, self.hop)
        out = np.zeros((*first, self.hops + _OVERLAP - 1, self.hop), dtype=np.complex64)
        for quarter in range(_OVERLAP):
            out[..., quarter : quarter + self.hops, :] += quarters[..., quarter, :]
        return out.reshape(*first, -1)[..., self._lead : self._lead + self.samples] * self._norm
