"""Fractional delay line: delays a stream by a slowly changing, non-integer number of samples."""

import functools

import numpy as np
from scipy import fft

from ..fir import kaiser_window

HALF_TAPS = 64  # half length of the interpolation kernel, samples: flat to 97 % of the band
# Resolution of a drifting delay, steps per sample: an error of at most 4 cm of altitude at 7.5 MS/s.
STEPS = 256
_FINE_STEPS = 16 * STEPS  # resolution of a fixed delay, steps per sample: an error of at most 2.4 mm
_TAIL = 2 * HALF_TAPS  # kernel length less one, samples
MOST_BLOCKS = 8  # largest number of blocks per push: beyond it the overhead of a call is negligible
# Blocks stored before the history is copied back to the start: a copy per 16 frames costs nothing.
_SPARE_BLOCKS = 16
_KEPT = 4  # cached delays of a repeating stream: return, leakage and gear are three
# FFT length, samples: 2048 points stay in the first-level cache, at half the time of one FFT per frame
_TRANSFORM = 2048
_KERNELS = 512  # cached kernels, 16 KB each: all `STEPS` of a drifting clock, and as many fixed delays


class DelayLine:
    """Delays a stream of blocks by up to ``max_delay`` samples (overlap-save).

    With ``repeats``, for a stream that repeats its blocks as a radar's sweep does, the output of equal samples at a
    known delay costs a comparison instead of an FFT.
    """

    def __init__(self, block: int, max_delay: float, *, repeats: bool = False) -> None:
        self._block, self._repeats = block, repeats
        self._size = fft.next_fast_len(min(block + _TAIL, _TRANSFORM))
        self._parts = -(-block // (self._size - _TAIL))
        self._hop = -(-block // self._parts)
        # parts of equal length overlap by more than the kernel needs; samples before the first one in use
        self._early = self._parts * self._hop - block + self._size - _TAIL - self._hop
        self._history = int(np.ceil(max_delay)) + HALF_TAPS + self._early
        # spare blocks, so that the history is not copied with every push
        self._store = np.empty(self._history + (1 + _SPARE_BLOCKS) * block, dtype=np.complex64)
        self._end = self._history + block
        self._store[: self._end] = 0
        self._last: dict[float, tuple[np.ndarray, np.ndarray]] = {}

    def push(self, samples: np.ndarray) -> None:
        """Append one block, or up to `MOST_BLOCKS`."""
        if self._end + samples.size > self._store.size:
            keep = self._history
            self._store[:keep] = self._store[self._end - keep : self._end].copy()
            self._end = keep
        self._store[self._end : self._end + samples.size] = samples
        self._end += samples.size

    @property
    def memory_blocks(self) -> int:
        """Blocks before one on which its output may depend."""
        return -(-self._history // self._block)

    def read(self, delay: float, blocks: int = 1) -> np.ndarray:
        """(blocks, block) samples delayed by ``delay`` >= 0 against the last push's ``blocks``; read-only.

        Equal to single pushes and reads to the bit; of shape (1, block) where all blocks are equal. Raises `ValueError`
        if a fractional delay is below half the kernel, which would not be causal.
        """
        whole = int(np.floor(delay))
        fraction = round((delay - whole) * _FINE_STEPS) / _FINE_STEPS
        first = self._end - blocks * self._block - whole
        if fraction == 0:
            return self._store[first : first + blocks * self._block].reshape(blocks, self._block)
        if whole < HALF_TAPS:
            raise ValueError(f"a fractional delay of {delay:g} samples is below the kernel's {HALF_TAPS}")
        if not self._repeats:
            return self._filter(first, fraction, blocks)
        spans, known = self._spans(first, blocks), self._last.get(delay)
        if known is not None and _same_bits(known[0], spans):
            return known[1]
        out = self._filter(first, fraction, blocks)
        if len(self._last) >= _KEPT:
            self._last.clear()
        self._last[delay] = spans[-1].copy(), out[-1:]
        return out

    def _spans(self, first: int, blocks: int) -> np.ndarray:
        """(blocks, S) input samples of each output block from ``first`` on."""
        start = first - HALF_TAPS - self._early
        return self._view(start, (blocks, self._block + self._early + _TAIL), (self._block, 1))

    def _filter(self, first: int, fraction: float, blocks: int) -> np.ndarray:
        """(blocks, block) samples from ``first`` on, delayed by ``fraction``: overlap-save in short FFTs."""
        start = first - HALF_TAPS - self._early
        parts = self._view(start, (blocks, self._parts, self._size), (self._block, self._hop, 1))
        spectrum = fft.fft(parts, axis=-1)
        spectrum *= _kernel(fraction, self._size)
        whole = fft.ifft(spectrum, axis=-1, overwrite_x=True)[..., self._size - self._hop :]
        return whole.reshape(blocks, -1)[:, self._parts * self._hop - self._block :]

    def _view(self, first: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> np.ndarray:
        """Overlapping parts of the store, strides in samples; faster than `as_strided`."""
        item = self._store.itemsize
        strides = tuple(item * stride for stride in strides)
        return np.ndarray(shape, self._store.dtype, self._store, first * item, strides)


@functools.lru_cache(maxsize=_KERNELS)
def _kernel(fraction: float, size: int) -> np.ndarray:
    """(size,) transform of a sinc that is delayed by ``fraction``, in a Kaiser window."""
    at = np.arange(_TAIL + 1) - HALF_TAPS - fraction
    window = np.interp(at, np.linspace(-HALF_TAPS - 1, HALF_TAPS + 1, 4097), kaiser_window(4097, 5.0))
    taps = np.sinc(at) * window
    return fft.fft(taps / taps.sum(), size).astype(np.complex64)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether all rows of (m, k) complex64 equal (k,) to the bit; the first column is compared before the rest."""
    return bool((a[0] == b[:, 0]).all()) and bool((a.view(np.int64) == b.view(np.int64)).all())
