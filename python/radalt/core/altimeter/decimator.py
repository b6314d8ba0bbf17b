"""Low-pass and decimation of dechirped half sweeps to the beat band, as a matrix product per block."""

import threading

import numpy as np
from scipy.linalg import blas

from ..fir import kaiser_lowpass

_THREADS = 16  # threads for which buffers are kept; a flowgraph has an altimeter for each method


class Decimator:
    """Keeps a band of ``width_hz`` around zero of blocks of ``samples`` samples, aliases 80 dB down.

    - ``samples``: samples per block, taken as zero beyond both ends
    - ``rate_hz``: complex input rate
    - ``width_hz``: band to keep, <= ``rate_hz``. A transition band as wide keeps the filter near 4 taps per phase.
    - ``factor``: decimation; 1 passes the input through
    - ``taps`` (T,) float
    - ``outputs``: output samples per block, the filter's tail included

    Examples
    --------
    >>> Decimator(3750, 7.5e6, 246e3).factor
    15
    """

    def __init__(self, samples: int, rate_hz: float, width_hz: float) -> None:
        self.samples, self.rate_hz = samples, rate_hz
        self.factor = max(1, int(rate_hz / (2.0 * width_hz)))
        self.rate_out_hz = rate_hz / self.factor
        self.taps = np.ones(1)
        if self.factor > 1:
            self.taps = kaiser_lowpass(width_hz / 2, self.rate_out_hz - width_hz / 2, rate_hz)
        self.outputs = -(-(samples + self.taps.size - 1) // self.factor)
        phases = -(-self.taps.size // self.factor)
        # a row of samples makes a run of outputs and reaches into the next ones; with runs about half as long as the
        # reach, few terms overlap and the product wastes little on taps outside the filter
        self._run = max(1, phases // 2)
        self._overlap = -(-(self._run + phases - 1) // self._run)
        self._row = self._run * self.factor
        # rows of zeros before the block, so that every output has all its terms
        self._rows = -(-self.outputs // self._run) + self._overlap - 1
        self._matrix = self._polyphase()
        # a decimator is shared by all who measure the same sweep. By thread, and not threading.local(): an array held
        # there ends a flowgraph with SIGSEGV from Python 3.13 on (tests/test_threads.py)
        self._scratch: dict[int, np.ndarray] = {}
        self._lock = threading.Lock()

    def _polyphase(self) -> np.ndarray:
        """(2 O, 2 R): from a row of R complex samples, rails side by side, to its share of O outputs.

        Output ``m`` sums taps ``(m + 1) D - 1 - n`` times sample ``n``, both counted from the row's first.
        """
        d = self.factor
        index = (np.arange(self._overlap * self._run)[:, None] + 1) * d - 1 - np.arange(self._row)[None, :]
        inside = (index >= 0) & (index < self.taps.size)
        taps = np.where(inside, self.taps[np.clip(index, 0, self.taps.size - 1)], 0.0)
        return np.asfortranarray(np.kron(taps, np.eye(2)), dtype=np.float32)

    def buffer(self, blocks: int) -> np.ndarray:
        """(blocks, B) complex64 to put blocks into, zero before and after them; the calling thread's own.

        The next call returns it again. The oldest threads are forgotten, since no thread says that it ends: a running
        one keeps its buffer until it is done with it, and its next call gets another. A new thread with the number of
        an ended one takes over that one's.
        """
        thread = threading.get_ident()
        known = self._scratch.get(thread)
        if known is None or len(known) != blocks:
            known = np.zeros((blocks, self._rows * self._row), dtype=np.complex64)
            with self._lock:
                self._scratch[thread] = known
                while len(self._scratch) > _THREADS:
                    del self._scratch[next(iter(self._scratch))]
        return known

    def mix(self, frames: np.ndarray, table: np.ndarray) -> np.ndarray:
        """(n, b, outputs) complex64 of (n, b, samples) complex frames of b blocks, each times the table (b, samples).

        A frame at a time, so that it stays in the cache between mixing and filter.
        """
        if self.factor == 1:
            return np.multiply(frames, table, dtype=np.complex64)
        count, blocks = frames.shape[:2]
        rows, terms = self._rows, self._overlap
        buffer = self.buffer(blocks)
        lead = (terms - 1) * self._row
        mixed = buffer[:, lead : lead + self.samples]
        share = np.empty((count, blocks * rows, 2 * terms * self._run), dtype=np.float32)
        # One product per frame: BLAS rounds differently with the number of rows, and a frame's result must not depend
        # on how many came with it. SciPy's BLAS, not NumPy's: NumPy below 2 takes new processors for one of 2004, at a
        # fifth of the speed. BLAS counts columns first, so both sides are transposed, and so is the share that it
        # writes into.
        columns = buffer.view(np.float32).reshape(blocks * rows, -1).T
        for frame, part in zip(frames, share, strict=True):
            np.multiply(frame, table, out=mixed)
            blas.sgemm(1.0, self._matrix, columns, c=part.T, overwrite_c=1)
        share = share.view(np.complex64).reshape(count * blocks, rows, terms, self._run)
        out = share[:, terms - 1 :, 0].copy()
        for k in range(1, terms):
            out += share[:, terms - 1 - k : rows - k, k]
        return np.ascontiguousarray(out.reshape(count, blocks, out.shape[1] * self._run)[..., : self.outputs])
