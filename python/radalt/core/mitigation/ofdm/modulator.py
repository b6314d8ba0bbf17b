"""Decided symbols as samples again, with their prefixes, and a frame less these."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class _Layout:
    """Where a frame's symbols are.

    Attributes
    ----------
    edges : (L + 1,) int
        Where each symbol begins, in the middle of its prefix, and where the last one ends.
    places : (n,) int
        For each sample that is in a symbol, which one of the symbols without prefixes it is.
    inside : slice
        Which samples are.
    meetings : (m, 2 _REACH + 1) int
        Samples around each place where symbols meet, or begin or end, inside the frame.
    """

    edges: np.ndarray
    places: np.ndarray
    inside: slice
    meetings: np.ndarray


class Modulator:
    """OFDM modulation of frames of ``count`` samples (TS 38.211 clause 5.3.1).

    The windows of the symbols are given by their first samples ``starts`` (L,); elements (L, K) have the lowest
    frequency first.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._last: tuple[bytes, _Layout] | None = None

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
            places, usual = self._layout(starts, numerology).meetings, np.minimum(few, most).mean()
            total = np.add.reduce(np.minimum(level.take(places), most), axis=0)
            louder = np.convolve(total, _SMOOTH, mode="same") > _LOUDER * usual * len(places)
            kept[places[:, louder]] = False
        out *= kept
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
        layout, out = self._layout(starts, numerology), np.zeros(self._count, dtype=symbols.dtype)
        # all places are inside: to clip none spares a copy
        symbols.take(layout.places, out=out[layout.inside], mode="clip")
        return out

    def offsets(self, starts: np.ndarray, numerology: Numerology) -> np.ndarray:
        """(N,) float32 distance of each sample from the middle of its symbol, in symbols."""
        bounds = [0, *self._layout(starts, numerology).edges[1:-1], self._count]
        since = np.arange(self._count) - np.repeat(starts, np.diff(np.clip(bounds, 0, self._count)))
        return ((since - numerology.useful / 2) / numerology.spacing).astype(np.float32)

    def _layout(self, starts: np.ndarray, numerology: Numerology) -> _Layout:
        """Where the symbols are whose windows begin at ``starts`` (L,)."""
        key = starts.tobytes()
        if self._last is None or self._last[0] != key:
            useful, half = numerology.useful, numerology.prefix / 2
            edges = np.append(starts - half, starts[-1] + useful + half).round().astype(int)
            # first half of the prefix, symbol, and what comes again of it in the second half of the next prefix
            bounds = np.append(np.stack([edges[:-1], starts, starts + useful], axis=1), edges[-1])
            bounds = np.clip(bounds, 0, self._count)
            ahead = (np.arange(starts.size) * useful - starts)[:, None] + [useful, 0, -useful]
            places = np.arange(bounds[0], bounds[-1]) + np.repeat(ahead, np.diff(bounds))
            met = edges[(edges >= _REACH) & (edges < self._count - _REACH)]
            meetings = met[:, None] + np.arange(-_REACH, _REACH + 1)
            self._last = key, _Layout(edges, places, slice(bounds[0], bounds[-1]), meetings)
        return self._last[1]
