"""Which cell of the up sweep and which of the down sweep are one target."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..spectral_line import running_maxima
from .altimeter_settings import Reason
from .cfar import Cfar, Significance

# Least significance of each half sweep on its own: noise exceeds it in 5 %.
FLOOR = 3.0
_CUT = 8.0  # noise levels by which a neighbour has to exceed a cell that lies on its flank
_HALVES = np.arange(2)
# least power, over the cells found, of a line beyond the span that is taken for the return
_OUTSHINING = 10.0
_MAIN_LOBE = 1.0  # resolution cells from a peak to what may be another return
# Points per cell in the search of pairs: where holes in the sweep narrow the peak, a return between two cells loses up
# to 0.4 dB, and a grating lobe on a cell would win.
_FINER = 2
# Excess over the threshold of a pair that is tested again without its own side lobes. With 2 the shipped network made
# up to 10 false altitudes more in 1,000 frames of interference alone, with 5 up to 3. Whitening then finds 1 % less in
# a mixture at -40 dB.
_SECOND_LOOK = 5.0
# Least share of the pairs' likelihood near the altitude of the pair found. Where less lies there, an error of one half
# sweep passes as a speed. With 0.9 another 1 % of right altitudes is lost under interference (docs/detection.md).
_LEAST_MASS = 0.8
# Standard deviation, in points, of the difference of the two halves' beats from which the mean of the likelihood is the
# better estimate: one half sweep is then broad, and its peak may be anywhere within the allowed speeds
_BROAD = 1.2


class Found(NamedTuple):
    """Outcome of a search over n frames."""

    reason: np.ndarray  # (n,) int: `Reason`, as far as the spectrum decides it
    pair: np.ndarray
    """(n, 2) int: up and down cell counted from the margin; without detection the best pair all the same."""
    around: np.ndarray  # (n, 2, 3) float32: power of each cell and its two neighbours
    noise: np.ndarray  # (n, 2) float32: noise level of each cell
    lead: np.ndarray
    """(n,) float32: joint significance of the pair less that of the best other pair, both halves' noise taken as
    one."""
    mean: np.ndarray
    """(n, 2) float: mean of the likelihood around a pair of which a half sweep is broad, in cells counted from the
    margin; else NaN."""


@dataclass(frozen=True, eq=False)
class PairSearch:
    """Joint test of both half sweeps.

    - ``first``, ``last``: cells searched, ``first..last-1``, counted from the margin
    - ``cell_threshold``, ``pair_threshold``: on one cell's significance, and on the sum of two
    """

    cfar: Cfar  # which gives the noise levels; its margin are the cells at either end of the spectrum that have none
    first: int
    last: int
    apart: tuple[int, int]
    """(int, int): least and greatest difference, up cell less down cell, that the allowed speeds make."""
    per_resolution: int  # cells per resolution cell
    cell_threshold: float
    pair_threshold: float
    spare: float
    """Decrease of the pair threshold per unit of `Significance.uncounted`: 1 per cell searched, 2 per pair of cells."""
    flank: float  # ratio of the power half a resolution cell away to a cell's own that no peak reaches
    side_lobes: np.ndarray  # (J,) float: greatest side lobe by distance in cells
    outshining: bool  # whether a strongest cell beyond the span of altitudes is taken for the return
    near: float | None = None
    """Distance of altitudes, in cells, within which most of the pairs' likelihood has to lie; None: no such test."""

    def __call__(self, power: np.ndarray, cells: Significance) -> Found:
        """The pair of greatest power over noise, and whether it is a target.

        All cells of a half sweep share its noise, so that the most likely pair is that of the greatest sum of powers
        over it, however uncertain the noise is. The sum of significances would favour a side lobe of equal power in
        both halves. Forced and declared decisions are the same pair: it is declared if the sum of its significance
        exceeds the threshold and each half sweep shows it above a floor of its own.

        ``power`` (n, 2, J) float32; ``cells``: of the cells with a noise level.
        """
        fine = self._finer(power)
        level = cells.level
        if level.shape[-1] > 1:
            level = np.repeat(level[..., self.first : self.last], _FINER, axis=-1)[..., : fine.shape[-1]]
        at, best, rival = self._best_pair(fine / level)
        n, halves = np.arange(len(at))[:, None], _HALVES
        peak = fine[n, halves, at]
        pair = self._cells_of(at, power)
        noise = cells.noise[n, halves, pair]
        each = cells.of(peak[..., None], noise[..., None])[..., 0]
        joint = each.sum(axis=1)
        found = (joint > self.threshold(cells)) & (each >= FLOOR).all(axis=1)
        doubtful = np.nonzero(found & self._doubtful(joint, each, power.shape[-1]))[0]
        if doubtful.size:
            found[doubtful] = self._stands_out(
                power[doubtful], cells.frames(doubtful), pair[doubtful], peak[doubtful]
            )
        missed = np.nonzero(~found & cells.colour.any(axis=1))[0]
        if missed.size:
            found[missed] = self._beyond_its_lobes(
                power[missed], cells.frames(missed), pair[missed], peak[missed]
            )
        reason = np.full(len(found), Reason.OK)
        mean = np.full(pair.shape, np.nan)
        tested = np.nonzero(found)[0] if self.near is not None else np.zeros(0, dtype=int)
        if tested.size:
            mass, centre, spread = self._likely(fine[tested], noise[tested], at[tested])
            reason[tested[mass < _LEAST_MASS]] = Reason.AMBIGUOUS
            broad = spread > _BROAD
            mean[tested[broad]] = centre[broad] / _FINER + self.first
        if not found.all():
            single = self._single(cells)
            reason[~found] = np.where(single[~found], Reason.SWEEPS_DISAGREE, Reason.NO_DETECTION)
        far = max(1, self.per_resolution // 2)
        steps = self.cfar.margin + np.array([-far, -1, 0, 1, far])
        around = power[n[..., None], _HALVES[:, None], pair[..., None] + steps]
        cut, beyond = self._on_flank(around[..., ::2], pair, noise)
        side_lobe, outshone = self._outshone(power, pair, around[..., 2])
        doubt = cut | side_lobe
        if (doubt | beyond).any() or outshone.any():
            reason[found & doubt.any(axis=1)] = Reason.SWEEPS_DISAGREE
            reason[found & (beyond.any(axis=1) | outshone)] = Reason.OUT_OF_RANGE
        looks = cells.looks.sum(axis=1)
        lead = looks * (np.log1p(best / looks) - np.log1p(np.maximum(rival, 0.0) / looks))
        return Found(reason, pair, around[..., 1:4], noise, lead, mean)

    def threshold(self, cells: Significance) -> np.ndarray:
        """(n,) what the sum of both halves' significance has to exceed where noise lasts without a gap."""
        return self.pair_threshold - self.spare * cells.uncounted

    def _single(self, cells: Significance) -> np.ndarray:
        """(n,) bool: whether each half sweep shows a cell above the threshold for one."""
        span = slice(self.first, self.last)
        factor = cells.looks * np.expm1(self.cell_threshold / cells.looks)
        return (cells.power[..., span] > cells.noise[..., span] * factor[..., None]).any(axis=-1).all(axis=-1)

    def _doubtful(self, joint: np.ndarray, each: np.ndarray, count: int) -> np.ndarray:
        """(n,) bool: whether a pair might not be declared against the highest level that the span can have of its own.

        All of a band's noise within the span is ``most`` times its mean, and no significance falls by more than that.
        What only a lowered threshold lets pass is among them.
        """
        most = (count - self.cfar.energy) / (self.last - self.first - self.cfar.energy)
        return (joint <= most * self.pair_threshold) | (each < most * FLOOR).any(axis=1)

    def _finer(self, power: np.ndarray) -> np.ndarray:
        """(n, 2, points) power over the span, with a point between any two cells: a cubic through four."""
        cells = power[..., self.cfar.margin + self.first - 1 : self.cfar.margin + self.last + 1]
        inner = cells[..., 1:-1]
        fine = np.empty((*inner.shape[:-1], _FINER * inner.shape[-1] - 1), dtype=np.float32)
        fine[..., ::_FINER] = inner
        between = np.float32(9.0 / 16.0) * (inner[..., :-1] + inner[..., 1:])
        between -= np.float32(1.0 / 16.0) * (cells[..., :-3] + cells[..., 3:])
        np.maximum(between, 0.0, out=fine[..., 1::_FINER])
        return fine

    def _cells_of(self, at: np.ndarray, power: np.ndarray) -> np.ndarray:
        """(n, 2) cells, counted from the margin, of points of `_finer`; between two the stronger."""
        cell = at // _FINER + self.first
        here = cell + self.cfar.margin
        n = np.arange(len(at))[:, None]
        return cell + ((at % _FINER > 0) & (power[n, _HALVES, here + 1] > power[n, _HALVES, here]))

    def _stands_out(
        self, power: np.ndarray, cells: Significance, pair: np.ndarray, peak: np.ndarray
    ) -> np.ndarray:
        """(n,) bool: whether pairs of peak powers (n, 2) exceed the threshold over `Cfar.declared_level`."""
        at = pair + self.cfar.margin
        each, own = self._against_span(power, cells, at, peak)
        # support alone spares once; more is for noise that is known to last without a gap
        shared = 0.5 * ((1.0 - cells.colour) * self.cfar.shared(power, at)).sum(axis=1)
        fall = cells.uncounted + (self.spare - 1.0) * np.clip(shared, 0.0, cells.uncounted)
        threshold = self.pair_threshold - np.where(own, 0.0, fall)
        return (each.sum(axis=1) > threshold) & (each >= FLOOR).all(axis=1)

    def _beyond_its_lobes(
        self, power: np.ndarray, cells: Significance, pair: np.ndarray, peak: np.ndarray
    ) -> np.ndarray:
        """(n,) bool: whether a band is coloured by a return's side lobes alone, and the return stands out of all of it.

        The level of the whole band holds the lobes too, so it is not too low.
        """
        at = pair + self.cfar.margin
        beyond = np.minimum(self.cfar.colour_beyond(power, cells.support, at), cells.colour)
        out = (beyond < cells.colour).any(axis=1)
        k = np.nonzero(out)[0]
        if k.size:
            again = self.cfar.significance(power[k], cells.support[k], beyond[k])
            each, _ = self._against_span(power[k], again, at[k], peak[k])
            out[k] = (each.sum(axis=1) > self.pair_threshold + _SECOND_LOOK) & (each >= FLOOR).all(axis=1)
        return out

    def _against_span(
        self, power: np.ndarray, cells: Significance, at: np.ndarray, peak: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) significance of peaks over `Cfar.declared_level`, and (n,) whether that is the span's own."""
        margin = self.cfar.margin
        span = slice(margin + self.first, margin + self.last)
        noise, own = self.cfar.declared_level(power, cells, at, span)
        return cells.of(peak[..., None], noise[..., None])[..., 0], own

    def _best_pair(self, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 2) points of the greatest sum of (n, 2, points), the sum, and that of the best rival."""
        up, down = value[:, 0], value[:, 1]
        least, most = (_FINER * cells for cells in self.apart)
        count, n = up.shape[1], np.arange(len(up))
        padded = self._padded(down)
        joint = up + running_maxima(padded, most - least + 1)[:, -count:]
        cell = joint.argmax(axis=1)
        best = joint[n, cell]
        lobe = max(1, round(_MAIN_LOBE * _FINER * self.per_resolution))
        # partners of the main lobe of the up cell: those of its own cell are in the middle
        first = cell[:, None] - lobe
        at = np.clip(first + np.arange(2 * lobe + most - least + 1), 0, padded.shape[1] - 1)
        near = padded[n[:, None], at]
        partner = near[:, lobe : near.shape[1] - lobe].argmax(axis=1)
        pair = np.array([cell, cell - most + partner]).T
        ups = np.clip(first + np.arange(2 * lobe + 1), 0, count - 1)
        joint[n[:, None], ups] = -np.inf
        steps = np.arange(near.shape[1])
        near[np.abs(steps - (partner + lobe)[:, None]) <= lobe] = -np.inf
        rest = up[n[:, None], ups] + running_maxima(near, most - least + 1)
        return pair, best, np.maximum(joint.max(axis=1), rest.max(axis=1))

    def _likely(
        self, fine: np.ndarray, noise: np.ndarray, at: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Likelihood of the altitude of the pairs found, at points ``at`` (n, 2) of `_finer`, among all pairs.

        A tone of unknown phase in noise has the likelihood ``exp(P / noise)`` in a cell of power ``P``. Those of the
        two half sweeps multiply, and every altitude and every allowed speed is as likely as any other beforehand.
        ``mass`` (n,): share of the likelihood within ``near`` of the mean altitude; ``mean`` (n, 2): points of the mean
        of all pairs within twice ``near`` of the one found; ``spread`` (n,): standard deviation of their difference.
        """
        near, apart, off, inner, room = self._pairs_around
        count, frames = fine.shape[-1], np.arange(len(fine))[:, None, None]
        # nothing beyond either end, as far as partners of any point go
        each = np.zeros((len(fine), 2, count + 2 * room), dtype=np.float32)
        inside = each[..., room : room + count]
        np.divide(fine, noise[..., None], out=inside)
        inside -= inside.max(axis=-1, keepdims=True)
        np.exp(inside, out=inside)
        # sums over the partners least..most below each up point
        sums = np.cumsum(each[:, 1], axis=1, dtype=float)
        least, most = (_FINER * cells for cells in self.apart)
        above, below = (sums[:, room - d :][:, :count] for d in (least, most + 1))
        total = np.einsum("ni,ni->n", inside[:, 0], above - below)
        # all pairs around the one found, by the difference of their points and by the sum, which is twice the altitude
        middle = at.sum(axis=1)
        twice = middle[:, None, None] + (apart + off)  # twice the up point
        ups = (twice >> 1) + (2 * each.shape[-1] * frames + room)
        weight = np.where(twice & 1, 0.0, each.take(ups) * each.take(ups + (each.shape[-1] - apart)))
        by_off, by_apart = weight.sum(axis=1), np.where(inner, weight, 0.0).sum(axis=2)
        peak = np.where(inner, by_off, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = (peak @ off) / peak.sum(axis=1)
            mass = np.where(np.abs(off - mean[:, None]) <= near, by_off, 0.0).sum(axis=1) / total
            difference = (by_apart @ apart)[:, 0] / by_apart.sum(axis=1)
            spread = np.sqrt((by_apart @ apart**2)[:, 0] / by_apart.sum(axis=1) - difference**2)
        middle = middle + mean
        return mass, 0.5 * np.array([middle + difference, middle - difference]).T, spread

    @cached_property
    def _pairs_around(self) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, int]:
        """Of `_likely`: ``near`` in points, (D, 1) differences, (K,) sums and whether near, room beyond either end."""
        assert self.near is not None
        near, (least, most) = 2.0 * _FINER * self.near, (_FINER * cells for cells in self.apart)
        off = np.arange(-int(3.0 * near), int(3.0 * near) + 1)
        room = 2 * max(-least, most, 0) + int(3.0 * near) + 2
        return near, np.arange(least, most + 1)[:, None], off, np.abs(off) <= 2.0 * near, room

    def _padded(self, down: np.ndarray) -> np.ndarray:
        """Down points, so that the partners that the allowed differences give up point ``k`` start at ``k``."""
        least, most = (_FINER * cells for cells in self.apart)
        count = down.shape[1]
        padded = np.full((len(down), count + most - least), -np.inf, dtype=down.dtype)
        low, high = max(0, -most), min(count, count - least)  # down cells that are a partner of any up cell
        padded[:, low + most : high + most] = down[:, low:high]
        return padded

    def _on_flank(
        self, around: np.ndarray, cells: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) flags of cells on the flank of a peak: one beyond the allowed speeds; one beyond the altitudes' span.

        From the powers (n, 2, 3) half a resolution cell below, here and half a resolution cell above.
        """
        lower, here, upper = around[..., 0], around[..., 1], around[..., 2]
        higher = np.maximum(lower, upper)
        flank = (higher > self.flank * here) & (higher > here + _CUT * noise)
        edge = ((cells <= self.first) & (lower > upper)) | ((cells >= self.last - 1) & (upper > lower))
        return flank & ~edge, flank & edge

    def _outshone(
        self, power: np.ndarray, pair: np.ndarray, here: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Flags by the strongest cell of each half sweep: (n, 2) the cell may be a side lobe of it.

        And (n,) the strongest is the return: it lies beyond the span of altitudes in both half sweeps, 10 dB above
        the cells found.
        """
        strongest, top = power.argmax(axis=-1), power.max(axis=-1)
        side_lobe = here <= self.side_lobes[np.abs(strongest - (pair + self.cfar.margin))] * top
        if not self.outshining:
            return side_lobe, np.zeros(len(pair), dtype=bool)
        outside = (strongest < self.cfar.margin + self.first) | (strongest >= self.cfar.margin + self.last)
        return side_lobe, (outside & (top > _OUTSHINING * here)).all(axis=1)
