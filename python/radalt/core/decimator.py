"""Low-pass and decimation of dechirped half sweeps to the beat band, as a matrix product a block."""

from __future__ import annotations

import numpy as np
from scipy import signal

__all__ = ["Decimator"]


class Decimator:
    """Keeps a band of ``width_hz`` around zero of blocks of ``samples`` samples, aliases 80 dB down.

    Parameters
    ----------
    samples : int
        Samples a block, both ends zero outside.
    rate_hz : float
        Complex input rate.
    width_hz : float
        Band to keep, <= ``rate_hz``. A transition band as wide keeps the filter near 4 taps a phase.

    Attributes
    ----------
    factor : int
        Decimation; 1 passes the input through.
    rate_out_hz : float
    taps : (T,) float array
    outputs : int
        Output samples a block, the filter's tail included.

    Examples
    --------
    >>> Decimator(3750, 7.5e6, 246e3).factor
    15
    """

    def __init__(self, samples: int, rate_hz: float, width_hz: float) -> None:
        self.samples, self.rate_hz = samples, rate_hz
        self.factor = max(1, int(rate_hz / (2.0 * width_hz)))
        self.rate_out_hz = rate_hz / self.factor
        self.taps = self._lowpass(width_hz)
        self.outputs = -(-(samples + self.taps.size - 1) // self.factor)
        self._phases = -(-self.taps.size // self.factor)
        self._lead = (
            self._phases * self.factor
        )  # zeros before the block, so that every output has all its terms
        self._rows = self.outputs + self._phases
        self._matrix = self._polyphase()

    def _lowpass(self, width_hz: float) -> np.ndarray:
        if self.factor == 1:
            return np.ones(1)
        nyquist = self.rate_hz / 2
        stop = self.rate_out_hz - width_hz / 2
        count, beta = signal.kaiserord(80.0, (stop - width_hz / 2) / nyquist)
        return signal.firwin(count | 1, 0.5 * (stop + width_hz / 2) / nyquist, window=("kaiser", beta))

    def _polyphase(self) -> np.ndarray:
        """(2 D, 2 P): a row of D complex samples, real and imaginary parts side by side, to its share of P outputs.

        Output ``m`` sums taps ``(m + 1) D - 1 - n`` times sample ``n = b D + r`` over blocks ``b = m - s``.
        """
        d, phases = self.factor, self._phases
        taps = np.zeros(phases * d)
        taps[: self.taps.size] = self.taps
        index = np.arange(phases)[None, :] * d + d - 1 - np.arange(d)[:, None]
        return np.kron(taps[index], np.eye(2)).astype(np.float32)

    def buffer(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """A zeroed complex64 buffer for blocks of the given leading shape, and its part that takes the samples."""
        if self.factor == 1:
            whole = np.zeros((*shape, self.outputs), dtype=np.complex64)
            return whole, whole
        whole = np.zeros((*shape, self._rows * self.factor), dtype=np.complex64)
        return whole, whole[..., self._lead : self._lead + self.samples]

    def apply(self, buffer: np.ndarray) -> np.ndarray:
        """(..., outputs) complex64 of a buffer that was made by `buffer` and filled."""
        if self.factor == 1:
            return buffer
        rows, phases = self._rows, self._phases
        # one product a block: BLAS rounds differently with the number of rows, and a frame's result must not depend on
        # how many came with it
        share = np.matmul(buffer.view(np.float32).reshape(-1, rows, 2 * self.factor), self._matrix)
        share = share.view(np.complex64)
        block, row, one = share.strides
        # output m = sum over s of share[m + phases - s, s]: a walk along anti-diagonals
        terms = np.lib.stride_tricks.as_strided(
            share[:, phases:],
            (phases, share.shape[0], self.outputs),
            (one - row, block, row),
            writeable=False,
        )
        return np.add.reduce(terms, axis=0).reshape(*buffer.shape[:-1], self.outputs)
