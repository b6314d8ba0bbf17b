"""Constant false-alarm rate: noise level of every beat cell, and the probability that noise reaches a cell's power."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..spectral_line import significance

_BLOCK = 8.0  # resolution cells in a block of the test for colour
_QUARTILES = 1.35  # standard deviations between the quartiles of a normal distribution
# Spread of block levels over that of white noise: white up to the first value, coloured from the second on.
_WHITE, _COLOURED = 1.5, 3.5
_FEWEST_BLOCKS = 4  # least number of blocks for a test of colour
_LOCAL = 0.6  # independent share of a local level's training cells: the level varies over them
_FEWEST = 4.0  # least number of independent cells (looks) that a noise level is the mean of
_NEAR = 8.0  # resolution cells to either side of a return that are left out where the span is compared with the rest
# Resolution cells from a block to a return, up to which the return's side lobes may colour the block.
_LOBES = 12.0
_QUIETER = 2.0  # standard deviations by which cells beyond the span have to be quieter
_NARROWEST = 0.05  # least support of a half sweep
_ROUNDING = 1e-9  # least power over the mean of the band: lower ones are rounding
_TINY = float(np.finfo(np.float32).tiny)


class Significance(NamedTuple):
    """Cells of both half sweeps, held against noise."""

    power: np.ndarray  # (n, 2, C) float32: of the cells that have all their training cells
    noise: np.ndarray  # (n, 2, C) float32: noise level, without the cell's own energy
    level: np.ndarray
    """(n, 2, C) or (n, 2, 1) float32: noise level with it: the same for every cell of a white band, so that cells
    compare as their powers do."""
    looks: np.ndarray  # (n, 2) float32: independent cells that the noise level is the mean of
    support: np.ndarray  # (n, 2) float: see `support_of`
    colour: np.ndarray
    """(n, 2) float: 0 where the level is that of the whole band, 1 where it is that of the cells around."""
    uncounted: np.ndarray
    """(n,) float32: ln(cells per independent trial), mean of both halves: above 0 where a shortened window widens the
    main lobe."""

    @property
    def value(self) -> np.ndarray:
        """(n, 2, C) float32 significance of the cells, see `of`."""
        return self.of(self.power, self.noise)

    def of(self, power: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """(n, 2, k) `significance` of powers over noise levels."""
        return significance(power, noise, self.looks[..., None])

    def frames(self, which: np.ndarray) -> "Significance":
        """The same for some of the frames, by index or mask."""
        return Significance(*(field[which] for field in self))


@dataclass(frozen=True)
class Cfar:
    """Cell averaging, over the whole band where its noise is white and around the cell where it is not.

    A cell of power ``P`` over the mean of ``K`` independent noise cells exceeds ``r`` with probability ``(1 +
    r/K)^-K``, so ``K log(1 + r/K)`` is exponential of mean 1 whatever ``K`` is. Interference that lasts for a share
    of the half sweep gives cells that are correlated over the inverse of that share: ``K`` falls with it
    (`support_of`).

    White noise is averaged over the band, less what a tone of the cell's power adds to it: a level of 32 cells costs
    1 dB, and more in correlated noise. A network that passes part of the band leaves noise of another level in every
    part, and the mean of the band is below most peaks. So the quartiles of blocks of 8 resolution cells are compared;
    where they are farther apart than in white noise of that support, the level comes from the cells around. A return
    fills one or two blocks and does not move the quartiles. One of a sweep in pieces fills more: `colour_beyond`.

    A network that was trained on a span of altitudes leaves little beyond it, so that the band's mean is below the
    level within. Blocks do not show that where support is narrow: each has too few independent cells.
    `declared_level` compares all cells on either side of the span's ends.

    - ``train``, ``guard``: training groups on each side around a group of cells, and guard groups between
    """

    train: int = 16
    guard: int = 1
    group: int = 4  # neighbouring cells that share a noise level: as many as a resolution cell has
    per_resolution: float = 4.0  # cells per resolution cell, ``1 / T_h``
    energy: float = 4.0  # energy of a tone over its power in the cell where it peaks
    whole: float = 1.0  # support of white noise under the window
    change: float = 0.19  # mean squared change of white noise from cell to cell, over its mean square

    def __post_init__(self) -> None:
        if self.train < 2 or self.guard < 0:
            raise ValueError(
                f"cfar.train {self.train} has to be at least 2, cfar.guard {self.guard} at least 0"
            )

    @property
    def margin(self) -> int:
        """Cells needed on each side of a cell under test."""
        return (self.train + self.guard) * self.group

    def significance(
        self, power: np.ndarray, support: np.ndarray, colour: np.ndarray | None = None
    ) -> Significance:
        """Significance of the cells that have all their training cells: element 0 belongs to cell ``margin``.

        ``power`` (n, 2, J) float32; ``support`` (n, 2) float: see `support_of`; ``colour`` (n, 2) float: see
        `Significance`; by default it follows from the band's blocks.
        """
        t, g, q = self.train, self.guard, self.group
        m = t + g
        groups = power.shape[-1] // q
        inner = groups - 2 * m
        cells = power[..., m * q : (m + inner) * q]
        sums = power[..., 0 : groups * q : q]
        for k in range(1, q):
            sums = sums + power[..., k : groups * q : q]
        whole = sums.sum(axis=-1, keepdims=True)
        noise = (whole - np.float32(self.energy) * cells) * np.float32(1.0 / (q * groups - self.energy))
        level = whole * np.float32(1.0 / (q * groups))
        least = level * np.float32(_ROUNDING) + np.float32(_TINY)
        colour = self._colour(sums, support) if colour is None else colour
        if colour.any():
            around = self._around(sums)
            local = colour.astype(np.float32)[..., None]
            level = np.repeat(level + local * (around - level), q, axis=-1)
            around = np.repeat(around, q, axis=-1)
            around -= noise
            around *= local
            noise += around
        np.maximum(noise, least, out=noise)
        level = np.maximum(level, least)
        share = colour / (2.0 * t * _LOCAL) + (1.0 - colour) / (groups - self.energy / q)
        looks = np.maximum(support / (share * self.per_resolution) * q, _FEWEST).astype(np.float32)
        uncounted = -0.5 * ((1.0 - colour) * np.log(np.minimum(support / self.whole, 1.0))).sum(axis=1)
        return Significance(cells, noise, level, looks, support, colour, uncounted.astype(np.float32))

    def declared_level(
        self, power: np.ndarray, cells: Significance, at: np.ndarray, span: slice
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noise levels for a declaration, and frames in which they are the span's own.

        They are the span's own where the cells beyond it are quieter by two standard deviations, both half sweeps
        together. The residual of a method comes from all over the sweep: the number of trials is not reduced, and the
        threshold is not lowered. Without this, 5 % of frames of a mixture alone at INR 50 dB were declared behind the
        shipped network.

        ``power`` (n, 2, J) float32; ``at`` (n, 2) int: cells found, of all J; ``span``: cells searched, of all J.
        Returns ``noise`` (n, 2) float; ``own`` (n,) bool.
        """
        total = power.shape[-1]
        rows = power.reshape(-1, total)
        index, here = np.arange(total), at.reshape(-1, 1)
        inside = (index >= span.start) & (index < span.stop)
        far = np.abs(index - here) > _NEAR * self.per_resolution
        count_in, count_out = (np.maximum((far & part).sum(axis=-1), 1) for part in (inside, ~inside))
        sum_in, sum_out = (np.where(far & part, rows, 0.0).sum(axis=-1) for part in (inside, ~inside))
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.log(sum_in / count_in) - np.log(sum_out / count_out)
        variance = self.per_resolution * (1.0 / count_in + 1.0 / count_out) / cells.support.ravel()
        step, variance = (x.reshape(at.shape).sum(axis=1) for x in (step, variance))
        own = step > _QUIETER * np.sqrt(variance)
        tone = self.energy * np.take_along_axis(power, at[..., None], axis=-1)[..., 0].astype(float)
        level = (power[..., span].sum(axis=-1) - tone) / (span.stop - span.start - self.energy)
        band = (power.sum(axis=-1) - tone) / (total - self.energy)
        noise = np.take_along_axis(cells.noise, at[..., None] - self.margin, axis=-1)[..., 0]
        return noise + own[:, None] * (1.0 - cells.colour) * np.maximum(level - band, 0.0), own

    def shared(self, power: np.ndarray, at: np.ndarray) -> np.ndarray:
        """(n, 2) logarithm of the cells that are one trial, against white noise, by how slowly power changes.

        Noise in a part of the half sweep changes slowly from cell to cell, with the standard deviation of the time
        that it lasts. Pieces from all over the sweep have little support and change as fast as white noise.

        ``power`` (n, 2, J) float32; ``at`` (n, 2) int: cells found, of all J: those near by do not count.
        """
        far = np.abs(np.arange(power.shape[-1]) - at[..., None]) > _NEAR * self.per_resolution
        kept = np.where(far, power, 0.0)
        changes = np.where(far[..., 1:] & far[..., :-1], np.diff(power), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            change = (changes**2).sum(axis=-1) / (kept**2).sum(axis=-1)
            return -0.5 * np.log(change / self.change)

    def _around(self, sums: np.ndarray) -> np.ndarray:
        """(n, 2, inner) float32 mean power of the training cells, from sums over groups (n, 2, groups)."""
        t, g, m = self.train, self.guard, self.train + self.guard
        inner = sums.shape[-1] - 2 * m
        total = np.zeros((*sums.shape[:-1], sums.shape[-1] + 1))  # float64: exact enough at 100 dB range
        total[..., 1:] = sums  # a sum that converts as it goes takes longer
        np.cumsum(total, axis=-1, out=total)
        near = total[..., m + g + 1 : m + g + 1 + inner] - total[..., t : t + inner]
        around = total[..., 2 * m + 1 :] - total[..., :inner] - near
        return (around * (0.5 / (self.group * t))).astype(np.float32)

    def colour_beyond(self, power: np.ndarray, support: np.ndarray, at: np.ndarray) -> np.ndarray:
        """(n, 2) colour of half sweeps without the surroundings of a cell; 1 where too little is left.

        Where a method leaves pieces of the sweep, a return has side lobes over a quarter of the band. Its blocks then
        differ as those of coloured noise do, and the level around the return is its own.

        ``power`` (n, 2, J) float32; ``support`` (n, 2) float; ``at`` (n, 2) int: cells found, of all J.
        """
        size = self._block * self.group
        count = power.shape[-1] // size
        levels = power[..., : count * size].reshape(*support.shape, count, size).sum(axis=-1)
        middle = size * (np.arange(count) + 0.5)
        far = np.abs(middle - at[..., None]) > 0.5 * size + _LOBES * self.per_resolution
        left = far.sum(axis=-1, keepdims=True)
        levels = np.sort(np.where(far, levels, np.inf), axis=-1)
        low, high = (
            np.take_along_axis(levels, np.maximum(k, 0), axis=-1)[..., 0]
            for k in (left // 4, left - 1 - left // 4)
        )
        with np.errstate(invalid="ignore"):  # nothing left
            return np.where(left[..., 0] < _FEWEST_BLOCKS, 1.0, self._spread(low, high, support))

    @property
    def _block(self) -> int:
        """Groups in a block of the test for colour."""
        return max(1, round(_BLOCK * self.per_resolution / self.group))

    def _colour(self, sums: np.ndarray, support: np.ndarray) -> np.ndarray:
        """(n, 2) in 0..1: how far block levels are apart, over what white noise of that support makes of them."""
        block = self._block
        count = sums.shape[-1] // block
        if count < _FEWEST_BLOCKS:
            return np.zeros(support.shape)
        levels = sums[..., : count * block].reshape(*support.shape, count, block).sum(axis=-1)
        levels.sort(axis=-1)
        return self._spread(levels[..., count // 4], levels[..., count - 1 - count // 4], support)

    @staticmethod
    def _spread(low: np.ndarray, high: np.ndarray, support: np.ndarray) -> np.ndarray:
        """(n, 2) in 0..1 colour of bands from the quartiles of their blocks' levels."""
        spread = np.log(np.maximum(high, _TINY) / np.maximum(low, _TINY)) / _QUARTILES
        colour = (_BLOCK * support * spread**2 - _WHITE) / (_COLOURED - _WHITE)
        return np.minimum(np.maximum(colour, 0.0), 1.0)


def support_of(samples: np.ndarray, count: float) -> np.ndarray:
    """Share of a half sweep that its noise lasts for, by the fourth moment of its samples.

    ``2 (sum e)^2 / (n sum e^2)`` with ``e = |x|^2``: 1 for Gaussian noise of constant power (``E e^2 = 2 (E e)^2``),
    its share for noise in a part of the samples. Kept within 0.05..1.

    ``samples`` (..., M) complex: dechirped and decimated; ``count``: samples ``n`` that make up the half sweep,
    without what filters add.
    """
    rails = samples.view(np.float32)
    squares = rails * rails
    energy = squares[..., ::2] + squares[..., 1::2]
    first = energy.sum(axis=-1).astype(np.float64)
    second = np.einsum("...i,...i->...", energy, energy)
    share = 2.0 * first**2 / (count * second)
    # nothing, or nothing that is a number, counts as whole
    return np.fmax(np.fmin(share, 1.0), _NARROWEST)
