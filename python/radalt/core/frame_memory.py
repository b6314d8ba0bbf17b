"""What several methods compute from the same received frame, computed once."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

__all__ = ["FrameMemory"]

# Readers of one segmenter are never further apart than its output holds (128 frames where a vector is a frame).
_FRAMES = 256


class FrameMemory:
    """Rows of a function of frames, remembered for whoever brings the same frame next.

    Parameters
    ----------
    compute : callable
        (n, N) complex64 -> tuple of arrays whose first axis is the frame.
    frames : int
        Frames that are remembered, the oldest forgotten first.

    Attributes
    ----------
    computed : int
        Frames that were computed.

    Notes
    -----
    A frame is known by two sums, of its samples' 64 bits under odd weights modulo 2^64 and of its rails under random
    weights in float32. The first differs wherever one sample does, whatever its size; the second where signs or phases
    of many do, which the first may miss. Safe to call from several threads: one computes, the others find it done.

    Examples
    --------
    >>> memory = FrameMemory(lambda frames: (np.abs(frames).sum(axis=1),))
    >>> frames = np.ones((3, 8), dtype=np.complex64) * np.arange(3)[:, None].astype(np.complex64)
    >>> first, = memory(frames)
    >>> again, = memory(frames[::-1])
    >>> [float(v) for v in again], memory.computed
    ([16.0, 8.0, 0.0], 3)
    """

    def __init__(
        self, compute: Callable[[np.ndarray], tuple[np.ndarray, ...]], frames: int = _FRAMES
    ) -> None:
        self._compute, self._limit = compute, int(frames)
        self._rows: dict[tuple[int, bytes], tuple[np.ndarray, ...]] = {}
        self._weights = np.zeros(0, dtype=np.uint64), np.zeros(0, dtype=np.float32)
        self._lock = threading.Lock()
        self.computed = 0

    def __call__(self, frames: np.ndarray) -> tuple[np.ndarray, ...]:
        """The function of ``(n, N)`` complex64 frames."""
        keys = self._keys(np.ascontiguousarray(frames))
        with self._lock:
            missing = [i for i, key in enumerate(keys) if key not in self._rows]
            if missing:
                fresh = self._compute(frames if len(missing) == len(keys) else frames[missing])
                self.computed += len(missing)
                for row, i in enumerate(missing):
                    self._rows[keys[i]] = tuple(array[row] for array in fresh)
            rows = [self._rows[key] for key in keys]
            while len(self._rows) > self._limit:
                del self._rows[next(iter(self._rows))]
        if len(missing) == len(keys):
            return fresh
        return tuple(np.stack(column) for column in zip(*rows, strict=True))

    def _keys(self, frames: np.ndarray) -> list[tuple[int, bytes]]:
        words, rails = frames.view(np.uint64), frames.view(np.float32)
        odd, random = self._weights
        if odd.size != words.shape[1]:
            odd = np.arange(1, 2 * words.shape[1], 2, dtype=np.uint64)
            random = np.random.default_rng(0).standard_normal(rails.shape[1], dtype=np.float32)
            self._weights = odd, random  # both at once: another thread may be asking
        with np.errstate(invalid="ignore", over="ignore"):  # a frame may hold anything
            sums = np.einsum("ij,j->i", rails, random)
        bits = [value.tobytes() for value in sums]
        return list(zip(np.einsum("ij,j->i", words, odd).tolist(), bits, strict=True))
