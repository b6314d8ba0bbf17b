"""Which cell of the up sweep and which of the down sweep are one target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .altimeter_settings import Reason
from .cfar import Significance

__all__ = ["FLOOR", "Found", "PairSearch"]

FLOOR = (
    3.0  # significance that each half sweep has to show on its own for the two to agree: noise does in 5 %
)
_CUT = 8.0  # noise levels by which a neighbour has to exceed a cell that lies on its flank
_MAIN_LOBE = 1.0  # resolution cells from a peak to what may be another return


class Found(NamedTuple):
    """Outcome of a search over n frames.

    Attributes
    ----------
    reason : (n,) int
        `Reason`, as far as the spectrum decides it.
    pair : (n, 2) int
        Up and down cell counted from the margin; without detection the best pair all the same.
    lead : (n,) float32
        Joint significance of the pair less that of the best other pair; infinite if there is none.
    """

    reason: np.ndarray
    pair: np.ndarray
    lead: np.ndarray


@dataclass(frozen=True, eq=False)
class PairSearch:
    """Joint test of both half sweeps.

    Parameters
    ----------
    margin : int
        Cells at either end of the spectrum without a noise level.
    first, last : int
        Cells searched, ``first..last-1``, counted from ``margin``.
    apart : (int, int)
        Least and greatest difference, up cell less down cell, that the allowed speeds make.
    per_resolution : int
        Cells per resolution cell.
    cell_threshold, pair_threshold : float
        On one cell's significance, and on the sum of two.
    flank : float
        Power half a resolution cell away over a cell's own that no peak shows.
    side_lobes : (J,) float array
        Greatest side lobe by distance in cells.
    outshining : bool
        Whether a strongest cell beyond the span of altitudes is taken for the return.
    """

    margin: int
    first: int
    last: int
    apart: tuple[int, int]
    per_resolution: int
    cell_threshold: float
    pair_threshold: float
    flank: float
    side_lobes: np.ndarray
    outshining: bool

    def __call__(self, power: np.ndarray, cells: Significance) -> Found:
        """The pair of greatest joint significance, and whether it is a target.

        Forced and declared decisions are the same pair: it is declared if the sum exceeds the threshold and each half
        sweep shows it above a floor of its own.

        Parameters
        ----------
        power : (n, 2, J) float32
        cells : Significance
            Of the cells with a noise level.
        """
        value = cells.value[..., self.first : self.last]
        pair, joint, lead = self._best_pair(value)
        n = np.arange(len(pair))
        each = value[n[:, None], np.arange(2), pair]
        found = (joint + cells.spared > self.pair_threshold) & (each >= FLOOR).all(axis=1)
        reason = np.full(len(found), Reason.OK)
        if not found.all():
            single = (value[~found].max(axis=-1) > self.cell_threshold).all(axis=-1)
            reason[~found] = np.where(single, Reason.SWEEPS_DISAGREE, Reason.NO_DETECTION)
        pair += self.first
        # from here on half sweeps are rows, whichever frame they belong to
        rows, at = power.reshape(-1, power.shape[-1]), pair.reshape(-1)
        noise = cells.noise.reshape(len(rows), -1)[np.arange(len(rows)), at]
        cut, beyond = self._on_flank(rows, at, noise)
        side_lobe, outshone = self._outshone(rows, at)
        doubt = (cut | side_lobe | beyond).reshape(-1, 2).any(axis=1) | outshone
        if doubt.any():
            reason[found & (cut | side_lobe).reshape(-1, 2).any(axis=1)] = Reason.SWEEPS_DISAGREE
            reason[found & (beyond.reshape(-1, 2).any(axis=1) | outshone)] = Reason.OUT_OF_RANGE
        return Found(reason, pair, lead)

    def _best_pair(self, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 2) cells of the greatest sum of (n, 2, cells), the sum, and its lead over the best rival.

        A rival has a cell beyond the main lobe in at least one half sweep: a side lobe, or a grating lobe of what is
        left of a sweep.
        """
        up, down = value[:, 0], value[:, 1]
        least, most = self.apart
        count, n = up.shape[1], np.arange(len(up))
        partner = self._partners(down)
        joint = up + partner
        pair = np.empty((len(up), 2), dtype=np.intp)
        pair[:, 0] = cell = joint.argmax(axis=1)
        window = cell[:, None] - np.arange(least, most + 1)
        inside = (window >= 0) & (window < count)
        window = np.clip(window, 0, count - 1)
        pair[:, 1] = window[n, np.where(inside, down[n[:, None], window], -1.0).argmax(axis=1)]
        best = joint[n, cell]
        lobe = max(1, round(_MAIN_LOBE * self.per_resolution))
        steps = np.arange(-lobe, lobe + 1)
        near = np.clip(pair[..., None] + steps, 0, count - 1)
        joint[n[:, None], near[:, 0]] = -np.inf
        rest = down.copy()
        rest[n[:, None], near[:, 1]] = -np.inf
        rival = np.maximum(joint.max(axis=1), (up + self._partners(rest)).max(axis=1))
        return pair, best, best - rival

    def _partners(self, down: np.ndarray) -> np.ndarray:
        """(n, cells) greatest down cell that the allowed differences pair with each up cell; -inf where there is none.

        Running maximum of ``width`` cells from maxima of 1, 2, 4, ... cells.
        """
        least, most = self.apart
        width, (n, count) = most - least + 1, down.shape
        padded = np.full((n, count + abs(most) + abs(least) + 2 * width), -np.inf, dtype=down.dtype)
        lead = max(0, most) + width
        padded[:, lead : lead + count] = down
        have = 1
        while have < width:
            step = min(have, width - have)
            padded[:, :-step] = np.maximum(padded[:, :-step], padded[:, step:])
            have += step
        return padded[:, lead - most : lead - most + count]

    def _on_flank(
        self, power: np.ndarray, cells: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(2 n,) flags: the cell is on the flank of a peak beyond the allowed speeds; beyond the altitudes' span."""
        rows, at, far = np.arange(len(cells)), cells + self.margin, max(1, self.per_resolution // 2)
        lower, here, upper = power[rows, at - far], power[rows, at], power[rows, at + far]
        higher = np.maximum(lower, upper)
        flank = (higher > self.flank * here) & (higher > here + _CUT * noise)
        edge = ((cells <= self.first) & (lower > upper)) | ((cells >= self.last - 1) & (upper > lower))
        return flank & ~edge, flank & edge

    def _outshone(self, power: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Flags by the strongest cell of each half sweep: (2 n,) the cell is no more than its side lobe.

        And (n,) the strongest is the return: it lies beyond the span of altitudes in both half sweeps, 10 dB above the
        cells found.
        """
        rows, at = np.arange(len(cells)), cells + self.margin
        strongest = power.argmax(axis=1)
        here, top = power[rows, at], power[rows, strongest]
        side_lobe = here <= self.side_lobes[np.abs(strongest - at)] * top
        if not self.outshining:
            return side_lobe, np.zeros(len(cells) // 2, dtype=bool)
        outside = (strongest < self.margin + self.first) | (strongest >= self.margin + self.last)
        return side_lobe, (outside & (top > 10.0 * here)).reshape(-1, 2).all(axis=1)
