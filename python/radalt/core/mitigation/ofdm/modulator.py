"""Decided symbols as samples again, with their prefixes, and a frame less these."""

from __future__ import annotations

import numpy as np
from scipy import fft

from .lattice import middle, power
from .numerology import Numerology

__all__ = ["BLANKED", "Modulator"]

BLANKED = 6.0  # times the median power: what is left where symbols meet
_FEW = 25  # one sample in 25 tells the median


class Modulator:
    """OFDM modulation of frames of ``count`` samples (TS 38.211 clause 5.3.1).

    The windows of the symbols are given by their first samples ``starts`` (L,); elements (L, K) have the lowest
    frequency first.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._places: tuple[bytes, np.ndarray, slice, np.ndarray] | None = None

    def subtract(
        self,
        frame: np.ndarray,
        turn: np.ndarray | None,
        model: np.ndarray,
        readable: np.ndarray,
        starts: np.ndarray,
        numerology: Numerology,
    ) -> np.ndarray:
        """(N,) complex64: the frame less the ``model`` (L, K) of its readable symbols, with its carrier again, and
        blanked where symbols meet."""
        out = frame - self.samples(model, readable, starts, numerology)
        if turn is not None:
            out *= turn.conj()
        level = power(out)
        out *= level <= np.float32(BLANKED) * middle(level[::_FEW])
        return out

    def samples(
        self, elements: np.ndarray, readable: np.ndarray, starts: np.ndarray, numerology: Numerology
    ) -> np.ndarray:
        """(N,) complex64 samples of a frame's symbols with their prefixes; 0 for those not readable, and outside."""
        useful = numerology.useful
        lowest_last = np.concatenate([elements[:, useful // 2 :], elements[:, : useful // 2]], axis=1)
        symbols = fft.ifft(lowest_last, axis=1, norm="ortho", overwrite_x=True)
        if not readable.all():
            symbols[~readable] = 0
        places, inside, _ = self._gather(starts, numerology)
        out = symbols.ravel().take(places)
        out[: inside.start] = out[inside.stop :] = 0
        return out

    def offsets(self, starts: np.ndarray, numerology: Numerology) -> np.ndarray:
        """(N,) float32 distance of each sample from the middle of its symbol, in symbols."""
        since = self._gather(starts, numerology)[2]
        return ((since - numerology.useful / 2) / numerology.spacing).astype(np.float32)

    def _gather(self, starts: np.ndarray, numerology: Numerology) -> tuple[np.ndarray, slice, np.ndarray]:
        """For each sample of a frame, which one of the symbols without prefixes it is, (N,) int; which of them are in
        symbols at all; and how many samples each is after the first of its symbol's window, (N,) int32."""
        key = starts.tobytes()
        if self._places is None or self._places[0] != key:
            count = self._count
            half = numerology.prefix / 2
            edges = np.append(starts - half, starts[-1] + numerology.useful + half).round().astype(int)
            lengths = np.diff(np.clip([0, *edges[1:-1], count], 0, count))
            since = np.arange(count, dtype=np.int32) - np.repeat(starts.astype(np.int32), lengths)
            places = since % numerology.useful + np.repeat(
                np.arange(starts.size) * numerology.useful, lengths
            )
            inside = slice(max(0, edges[0]), edges[-1])
            self._places = key, places, inside, since
        return self._places[1:]
