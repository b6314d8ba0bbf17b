"""Decided symbols as samples again, with their prefixes, and a frame less these."""

from __future__ import annotations

import numpy as np
from scipy import fft

from .lattice import middle, power
from .numerology import Numerology

__all__ = ["BLANKED", "Modulator"]

BLANKED = 6.0  # times the median power: what is left where symbols meet
_FEW = 25  # one sample in 25 tells the median
_REACH = 40  # samples on either side of where symbols meet; the receiver's skirts ring that long
_SMOOTH = np.full(5, 0.2, dtype=np.float32)  # such samples are judged together
_LOUDER = 1.3  # times the usual power, in the mean of all places where symbols meet: such samples are blanked


class Modulator:
    """OFDM modulation of frames of ``count`` samples (TS 38.211 clause 5.3.1).

    The windows of the symbols are given by their first samples ``starts`` (L,); elements (L, K) have the lowest
    frequency first.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._places: tuple[bytes, np.ndarray, slice, np.ndarray] | None = None
        self._around: tuple[bytes, np.ndarray] | None = None

    def subtract(
        self,
        frame: np.ndarray,
        turn: np.ndarray | None,
        model: np.ndarray,
        readable: np.ndarray,
        starts: np.ndarray,
        numerology: Numerology,
        *,
        alike: bool = True,
    ) -> np.ndarray:
        """(N,) complex64: the frame less the ``model`` (L, K) of its readable symbols, with its carrier again, and
        blanked where symbols meet.

        What is left is ``alike`` in all samples, unless more of the emitter was left where symbols meet.
        """
        out = frame - self.samples(model, readable, starts, numerology)
        if turn is not None:
            out *= turn.conj()
        level = power(out)
        few = level[::_FEW]
        most = np.float32(BLANKED * middle(few))
        kept = level <= most
        if alike:
            places, usual = self._meetings(starts, numerology), np.minimum(few, most).mean()
            total = np.add.reduce(np.minimum(level.take(places), most), axis=0)
            louder = np.convolve(total, _SMOOTH, mode="same") > _LOUDER * usual * len(places)
            kept[places[:, louder]] = False
        out *= kept
        return out

    def _meetings(self, starts: np.ndarray, numerology: Numerology) -> np.ndarray:
        """(n, 2 _REACH + 1) int: samples around each place where symbols meet, or begin or end, inside the frame."""
        key = starts.tobytes()
        if self._around is None or self._around[0] != key:
            half = numerology.prefix / 2
            at = np.append(starts - half, starts[-1] + numerology.useful + half).round().astype(int)
            at = at[(at >= _REACH) & (at < self._count - _REACH)]
            self._around = key, at[:, None] + np.arange(-_REACH, _REACH + 1)
        return self._around[1]

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
