"""Which cell of the up sweep and which of the down sweep are one target (docs/design.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from .altimeter_settings import Reason

__all__ = ["FLOOR", "Found", "PairSearch"]

FLOOR = 3.0  # power over noise that each half sweep has to show on its own for the two to agree


class Found(NamedTuple):
    """Outcome of a search over n frames.

    Attributes
    ----------
    reason : (n,) int
        `Reason`, as far as the spectrum decides it.
    pair : (n, 2) int
        Up and down cell counted from the margin; without detection the best pair all the same.
    around : (n, 2, 3) float32
        Power of each cell and its two neighbours.
    """

    reason: np.ndarray
    pair: np.ndarray
    around: np.ndarray


@dataclass(frozen=True, eq=False)
class PairSearch:
    """Joint test of both half sweeps.

    Parameters
    ----------
    margin : int
        Cells at either end of the spectrum without a noise estimate.
    first, last : int
        Cells searched, ``first..last-1``, counted from ``margin``.
    reach : int
        Cells by which Doppler may set the two half sweeps apart.
    climb : int
        Cells from the best ratio to the peak of power beside it, at most.
    cell_threshold, pair_threshold : float
        On one cell's ratio to the noise, and on the sum of two.
    flank : float
        Neighbour-to-cell power that no peak shows.
    side_lobes : (J,) float array
        Greatest side lobe by distance in cells.
    outshining : bool
        Whether a strongest cell beyond the span of altitudes is taken for the return.
    """

    margin: int
    first: int
    last: int
    reach: int
    climb: int
    cell_threshold: float
    pair_threshold: float
    flank: float
    side_lobes: np.ndarray
    outshining: bool

    def __call__(self, power: np.ndarray, noise: np.ndarray) -> Found:
        """Up and down cell are tested together, for every difference that Doppler allows.

        The sum of their ratios to the noise against a two-look threshold, each above a floor of its own, so that both
        sweeps have to show the target.

        Parameters
        ----------
        power : (n, 2, J) float
        noise : (n, 2, J - 2 margin) float
        """
        first, last, margin = self.first, self.last, self.margin
        floor = np.maximum(noise[..., first:last], np.finfo(np.float32).tiny)
        ratio = power[..., margin + first : margin + last] / floor
        pair, joint = self._best_pair(np.where(ratio >= FLOOR, ratio, -np.inf))
        found = joint > self.pair_threshold
        reason = np.full(len(found), Reason.OK)
        if not found.all():
            missed = ~found
            ratio = ratio[missed]
            pair[missed] = self._best_pair(ratio)[0]
            single = (ratio > self.cell_threshold).any(axis=-1).all(axis=-1)
            reason[missed] = np.where(single, Reason.SWEEPS_DISAGREE, Reason.NO_DETECTION)
        pair += first
        # from here on half sweeps are rows, whichever frame they belong to
        rows, cells = power.reshape(-1, power.shape[-1]), pair.reshape(-1)
        around = self._climb(rows, cells)
        cut, beyond = self._on_flank(around, cells)
        side_lobe, outshone = self._outshone(rows, cells)
        doubt = (cut | side_lobe | beyond).reshape(-1, 2).any(axis=1) | outshone
        if doubt.any():
            reason[found & (cut | side_lobe).reshape(-1, 2).any(axis=1)] = Reason.SWEEPS_DISAGREE
            reason[found & (beyond.reshape(-1, 2).any(axis=1) | outshone)] = Reason.OUT_OF_RANGE
        return Found(reason, pair, around.reshape(-1, 2, 3))

    def _best_pair(self, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) up and down cell with the greatest sum of ratios (n, 2, cells) within Doppler's reach, and the sum."""
        reach, cells = self.reach, ratio.shape[-1]
        up, down = ratio[:, 0], ratio[:, 1]
        near = ndimage.maximum_filter1d(down, 2 * reach + 1, axis=-1, mode="constant", cval=-np.inf)
        joint = up + near
        rows = np.arange(len(ratio))
        pair = np.empty((len(ratio), 2), dtype=np.intp)
        pair[:, 0] = cell = joint.argmax(axis=-1)
        window = np.clip(cell[:, None] + np.arange(-reach, reach + 1), 0, cells - 1)
        pair[:, 1] = window[rows, down[rows[:, None], window].argmax(axis=-1)]
        return pair, joint[rows, cell]

    def _climb(self, power: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Climb in place to the top of power within a resolution cell, as far as span and Doppler's reach allow.

        Side lobes of a strong return in the training cells tilt the ratio to the noise, whose largest cell then lies
        beside the peak, where interpolation has no say. Only upwards, never across a valley: a return whose band was
        notched has side lobes as high as its peak within that distance.

        Parameters
        ----------
        power : (2 n, J) rows of up and down sweep in turn
        cells : (2 n,) counted from the margin

        Returns
        -------
        (2 n, 3) powers around the cells.
        """
        far, rows = self.climb, np.arange(len(cells))
        steps = np.arange(-far - 1, far + 2)
        wide = power[rows[:, None], np.clip(cells[:, None] + (self.margin + steps), 0, power.shape[1] - 1)]
        rise = wide[:, 2:-1] - wide[:, 1:-2]
        right = np.logical_and.accumulate(rise[:, far:] > 0, axis=1).sum(axis=1)
        left = np.logical_and.accumulate(rise[:, far - 1 :: -1] < 0, axis=1).sum(axis=1)
        higher = wide[rows, far + 1 + right] >= wide[rows, far + 1 - left]
        step = np.where(higher, right, -left)
        moved = cells + step
        inside = ((moved >= self.first) & (moved < self.last)).reshape(-1, 2).all(axis=1)
        reached = np.abs(moved[::2] - moved[1::2]) <= self.reach
        step *= np.repeat(inside & reached, 2)
        cells += step
        return wide[rows[:, None], (step + far)[:, None] + np.arange(3)]

    def _on_flank(self, around: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(2 n,) flags: the search ended on the flank of a peak beyond Doppler's reach; beyond the altitudes' span."""
        lower, here, upper = around.T
        flank = np.maximum(lower, upper) > self.flank * here
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
