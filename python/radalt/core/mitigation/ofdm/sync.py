"""Synchronisation: spacing, symbol timing and CFO from the cyclic prefix, the long prefix from fourth powers."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .channel_estimation import fourth_powers, level_in_use
from .equaliser import ElementGrid, timing_ramp
from .numerology import Numerology, fold_index
from .return_mask import ReturnMask
from .settings import OfdmSettings


@dataclass(frozen=True)
class Prefix:
    """Cyclic prefix of a frame (J.-J. van de Beek et al., IEEE Trans. Signal Process. 45(7), 1997)."""

    middle: float  # sample of the middle of a prefix
    cfo: float  # carrier frequency offset from the nearest whole subcarrier, in subcarriers, -0.5..0.5
    contrast: float  # peak of the folded correlation over its scatter elsewhere


def find_prefix(frame: np.ndarray, numerology: Numerology) -> Prefix:
    """Correlation ``x[n + K] conj(x[n])`` of an (N,) complex64 frame, folded over the symbols."""
    product = frame[numerology.useful :] * frame[: -numerology.useful].conj()
    bins = round(numerology.spacing)
    index = fold_index(product.size, numerology.spacing)
    folded = np.bincount(index, product.real, bins) + 1j * np.bincount(index, product.imag, bins)
    folded -= folded.mean()  # a tone correlates everywhere
    width = int(numerology.prefix)
    total = ndimage.uniform_filter1d(folded, width, mode="wrap")
    size = np.abs(total)
    peak = int(size.argmax())
    margin = int(1.5 * width) + 1
    rest = size.take(np.arange(peak + margin, peak + bins - margin + 1), mode="wrap")
    scatter = np.sqrt(np.mean(rest**2))
    contrast = float(size[peak] / scatter) if scatter > 0 else 0.0
    return Prefix(peak * numerology.spacing / bins, float(np.angle(total[peak]) / (2 * np.pi)), contrast)


def acquire(
    frame: np.ndarray, prefix: Prefix, numerology: Numerology, mask: ReturnMask, settings: OfdmSettings
) -> tuple[ElementGrid, float]:
    """Elements of a frame with the long prefix in its likeliest place, and a long prefix's middle in samples.

    The fourth power removes the data from QPSK and QAM. What is left is alike in all symbols if they were taken at the
    right times; n long prefixes between two symbols turn subcarrier k by ``exp(2j pi 4 n k d / K)``, d being the extra
    length. All places of the long prefix are tried: the sum of the Gram matrix's moduli is largest at the right one.
    """
    count, per_cycle = numerology.useful, numerology.per_cycle
    step = count + numerology.prefix
    middles = prefix.middle % numerology.spacing + numerology.spacing * np.arange(-1, frame.size // count + 1)
    _, starts = numerology.windows(middles, frame.size)
    index = np.arange(len(starts))
    delay = starts - starts[0] - index * step
    grid = ElementGrid(frame, numerology, prefix.cfo, starts, delay, np.zeros(len(starts), dtype=int))
    free = mask.free(starts, prefix.cfo)
    level, used = grid.level = level_in_use(grid.raw, free, numerology, settings)
    fourth = fourth_powers(grid.raw * grid.ramp, level, free & used)
    most = -(-len(starts) // per_cycle) + 1
    longer = timing_ramp(4 * numerology.longer * np.arange(most), numerology)
    some = slice(None, None, 2)  # subcarriers that are enough for the Gram matrices
    rows = (longer[:, None, some] * fourth[:, some]).reshape(most * len(starts), -1)
    gram = np.abs(rows @ fourth[:, some].conj().T).reshape(most, len(starts), -1)
    later, earlier = np.maximum.outer(index, index), np.minimum.outer(index, index)
    scores = np.empty(per_cycle)
    for place in range(per_cycle):
        passed = np.cumsum((index % per_cycle == place) & (index > 0))
        scores[place] = gram[np.abs(passed[:, None] - passed), later, earlier].sum()
    place = int(scores.argmax())
    passed = np.cumsum((index % per_cycle == place) & (index > 0))
    grid.segment = passed - passed[0]
    grid.segments = np.searchsorted(grid.segment, np.arange(grid.segment[-1] + 1))
    grid.ramp = timing_ramp(numerology.longer * passed - delay, numerology)
    return grid, float(starts[0] + place * step + (numerology.longer if place else 0.0))
