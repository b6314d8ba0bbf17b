"""Frames that a frozen receiver repeats: equal bit for bit, as frames with noise never are."""

import numpy as np

# time over which frames are compared, s: a driver that returns an old buffer repeats tens of frames
_MEMORY_S = 1.0


class RepeatedFrames:
    """Notices frames that are equal to one of the last second.

    Works on *marks*: some numbers of each frame that differ between any two frames of a receiver with noise. The
    segmenter marks frames by their samples, the tracker by cells of their spectra.

    Parameters
    ----------
    sweep_s : float
        Duration of a frame in seconds.

    Examples
    --------
    >>> repeated, frames = RepeatedFrames(1e-3), np.random.default_rng(1).standard_normal((3, 8))
    >>> repeated.check(frames[[0, 1, 2, 1, 2]]).tolist()
    [False, False, False, True, True]
    """

    def __init__(self, sweep_s: float) -> None:
        self._memory = max(2, round(_MEMORY_S / sweep_s))
        self._seen: dict[bytes, int] = {}
        self._count = 0

    def reset(self) -> None:
        """Forget all frames."""
        self._seen.clear()

    def check(self, marks: np.ndarray) -> np.ndarray:
        """(n,) bool: which of these frames repeat an earlier one; ``marks`` is (n, ...) of any kind of number."""
        marks = np.ascontiguousarray(marks)
        again = np.zeros(len(marks), dtype=bool)
        for k, mark in enumerate(marks):
            word = mark.tobytes()
            again[k] = self._count - self._seen.get(word, -self._memory - 1) <= self._memory
            self._seen[word] = self._count
            self._count += 1
        if len(self._seen) > 2 * self._memory:
            oldest = self._count - self._memory
            self._seen = {word: number for word, number in self._seen.items() if number >= oldest}
        return again
