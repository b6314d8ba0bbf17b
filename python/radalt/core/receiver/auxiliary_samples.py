"""Samples of the second receive channel, cut at the frames of the first."""

import numpy as np

from .frame import Frame
from .segmenter import FrameSegmenter

_FRAMES = (
    32  # frames kept beyond those that the segmenter may hold: more than it takes at a time in acquisition
)


class AuxiliarySamples:
    """Keeps the second channel's samples, by the segmenter's sample counter, until it releases the frames.

    Parameters
    ----------
    segmenter : FrameSegmenter
        Of the first channel.
    """

    def __init__(self, segmenter: FrameSegmenter) -> None:
        self._segmenter, self._n = segmenter, segmenter.waveform.samples_per_frame
        settings = segmenter.settings
        self._most = (settings.acquisition_frames + settings.confirm_frames + _FRAMES) * self._n
        self._kept = np.empty(0, np.complex64)
        self._first = 0  # counter of the first kept sample

    def push(self, samples: np.ndarray) -> None:
        """Take the samples of the first channel's next `FrameSegmenter.push`, before it is called."""
        counter = self._segmenter.sample_counter
        if counter != self._first + self._kept.size:  # no frame reaches across a gap
            self._kept, self._first = np.empty(0, np.complex64), counter
        old = self._kept[-self._most :]
        self._first += self._kept.size - old.size
        self._kept = np.concatenate([old, samples])

    def cut(self, frames: list[Frame]) -> np.ndarray:
        """(n, N) samples of the second channel in frames of the first; NaN where they are not known."""
        out = np.full((len(frames), self._n), np.nan, np.complex64)
        for row, frame in zip(out, frames, strict=True):
            begin = frame.start_sample - self._first
            if 0 <= begin <= self._kept.size - self._n:
                row[:] = self._kept[begin : begin + self._n]
        return out
