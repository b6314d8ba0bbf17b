"""Samples of the second receive channel, cut at the frames of the first."""

import numpy as np

from .frame import Frame
from .segmenter import FrameSegmenter

_FRAMES = 16  # frames kept beyond those that the segmenter averages and holds back


class AuxiliarySamples:
    """Keeps the second channel's samples, by the segmenter's sample counter, until it releases the frames.

    ``segmenter``: of the first channel.
    """

    def __init__(self, segmenter: FrameSegmenter) -> None:
        self._segmenter, self._n = segmenter, segmenter.waveform.samples_per_frame
        settings = segmenter.settings
        self._most = (settings.acquisition_frames + settings.confirm_frames + _FRAMES) * self._n
        self._buffer = np.empty(2 * self._most, np.complex64)
        self._filled = self._next = 0  # samples in the buffer, and the counter of the next one

    def push(self, samples: np.ndarray) -> None:
        """Take the samples of the first channel's next `FrameSegmenter.push`, before it is called."""
        if self._segmenter.sample_counter != self._next:  # no frame reaches across a gap
            self._filled, self._next = 0, self._segmenter.sample_counter
        end = self._filled + samples.size
        if end > self._buffer.size:
            kept = self._buffer[max(0, self._filled - self._most) : self._filled]
            end = kept.size + samples.size
            self._buffer = np.concatenate(
                [kept, np.empty(max(2 * self._most, end) - kept.size, np.complex64)]
            )
        self._buffer[end - samples.size : end] = samples
        self._filled, self._next = end, self._next + samples.size

    def cut(self, frames: list[Frame]) -> np.ndarray:
        """(n, N) samples of the second channel in frames of the first; NaN where they are not known."""
        out = np.full((len(frames), self._n), np.nan, np.complex64)
        for row, frame in zip(out, frames, strict=True):
            begin = self._filled - (self._next - frame.start_sample)
            if 0 <= begin <= self._filled - self._n:
                row[:] = self._buffer[begin : begin + self._n]
        return out
