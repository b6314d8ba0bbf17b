"""What is true of a received frame, whatever is done with it later: found once, and passed on with the frame."""

from functools import lru_cache

import numpy as np

from ..waveform import Waveform
from .beyond_span import BeyondSpan

# Fields of a frame's quality: ``peak`` is its largest rail value (not finite where the frame is not, 0 where it is
# silent), ``beyond`` the power of its strongest return beyond the span of altitudes over that within it
# (`BeyondSpan.ratio`; from 1 on nothing within the span is the ground), NaN where that is not known.
QUALITY_DTYPE = np.dtype([("peak", np.float32), ("beyond", np.float64)])


class FrameQuality:
    """Quality of received frames, for methods, altimeter and tracker alike.

    ``max_altitude_m``: highest altitude that the altimeter searches.

    Examples
    --------
    >>> w = Waveform()
    >>> FrameQuality(w, 1500.0)(w.reference[None]).tolist()
    [(1.0, 0.0)]
    """

    def __init__(self, waveform: Waveform, max_altitude_m: float) -> None:
        self._beyond_span = _beyond_span(waveform, max_altitude_m)

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """(n,) array of `QUALITY_DTYPE` of (n, N) complex64 frames."""
        quality = levels(frames)
        quality["beyond"] = self._beyond_span.ratio(frames)
        return quality


def levels(frames: np.ndarray) -> np.ndarray:
    """(n,) array of `QUALITY_DTYPE` of (n, N) complex64 frames of which no span is known: their peaks alone."""
    quality = np.zeros(len(frames), dtype=QUALITY_DTYPE)
    quality["peak"], quality["beyond"] = rail_peak(frames)[:, 0], np.nan
    return quality


def rail_peak(frames: np.ndarray) -> np.ndarray:
    """(n, 1) float32 largest rail value of each (n, N) complex64 frame, not finite where the frame is not."""
    rails = frames.view(np.float32)
    return np.maximum(rails.max(axis=1, keepdims=True), -rails.min(axis=1, keepdims=True))


@lru_cache(maxsize=64)
def _beyond_span(waveform: Waveform, max_altitude_m: float) -> BeyondSpan:
    """One for all with the same sweep and span: it has tables, but no state."""
    return BeyondSpan(waveform, max_altitude_m)
