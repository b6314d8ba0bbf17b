"""Lines in power spectra: level of the noise, the chance that noise shows one, its place between two cells, and pairs.

The altimeter, the tracker, the test for ground beyond the span and the cancellers decide by these. Cells of noise are
exponential, and a sum of ``looks`` of them has a gamma distribution.
"""

import numpy as np
from scipy import special


def upper_median(values: np.ndarray) -> np.ndarray:
    """Upper median over the last axis; `numpy.median` takes three times as long for rows this short."""
    middle = values.shape[-1] // 2
    return np.partition(values, middle, axis=-1)[..., middle]


def noise_level(power: np.ndarray, looks: int = 1) -> np.ndarray:
    """Mean power of noise along the last axis, by its median: lines in a few cells hardly move it.

    ``looks``: cells that were added up to each power, whose mean that of one cell is.
    """
    return upper_median(power) * np.float32(1.0 / special.gammaincinv(looks, 0.5))


def significance(power: np.ndarray, noise: np.ndarray, looks: np.ndarray) -> np.ndarray:
    """``-log P`` of powers, with ``P`` the probability that noise alone reaches them.

    ``P = (1 + r/K)^-K`` for a ratio ``r`` to the mean of ``K`` cells (``looks``). In noise the result is exponential of
    mean 1 whatever ``K`` is.
    """
    value = noise * looks
    np.divide(power, value, out=value)
    value += np.float32(1.0)
    np.log(value, out=value)  # vectorised for float32, unlike log1p
    value *= looks
    return value


def sum_chance(level: float, cells: int) -> float:
    """Probability that a sum of so many noise cells of mean 1 exceeds a level: ``(1 + level) exp(-level)`` of two."""
    return float(special.gammaincc(cells, level))


def sum_level(chance: float, cells: int) -> float:
    """The level of that `sum_chance`."""
    return float(special.gammainccinv(cells, chance))


def running_maxima(rows: np.ndarray, width: int) -> np.ndarray:
    """(n, m) -> (n, m - width + 1) maxima of ``width`` neighbours, from maxima of 1, 2, 4, ... of them."""
    have = 1
    while have < width:
        step = min(have, width - have)
        rows = np.maximum(rows[:, :-step], rows[:, step:])
        have += step
    return rows


def pair_sums(up: np.ndarray, down: np.ndarray, reach: int) -> np.ndarray:
    """(n, m) powers of one half sweep, each with the greatest of the other half (n, m) within ``reach`` cells."""
    wide = np.zeros((len(down), down.shape[1] + 2 * reach), dtype=down.dtype)
    wide[:, reach : wide.shape[1] - reach] = down
    return running_maxima(wide, 2 * reach + 1) + up


def partner(down: np.ndarray, cell: int, reach: int, first: int = 0) -> int:
    """The greatest cell, from ``first`` on, of (m,) powers within ``reach`` cells of one."""
    low = max(cell - reach, first)
    return low + int(down[low : cell + reach + 1].argmax())


def peak_curve(window: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Slope over curvature of three powers around a peak, and the peak's offset in cells, exact for one tone.

    ``window`` (N,): of the samples; ``step``: of a cell, in cycles per sample. See `peak_offset`.
    """
    offsets = np.linspace(-1.0, 1.0, 201)
    # exp(x (k B + b)) = exp(x k B) exp(x b): 2 sqrt(n) exponentials per offset instead of n
    row = int(np.ceil(np.sqrt(window.size)))
    rows = np.pad(window, (0, -window.size % row)).reshape(-1, row)

    def power(cells: np.ndarray) -> np.ndarray:
        turn = -2j * np.pi * step * cells[:, None]
        coarse, fine = np.exp(turn * row * np.arange(len(rows))), np.exp(turn * np.arange(row))
        return np.abs(np.sum((coarse @ rows) * fine, axis=1)) ** 2

    left, here, right = (power(cell - offsets) for cell in (-1, 0, 1))
    bend = 2.0 * here - left - right
    peak = bend > 0.0  # not where cells are so wide that the next one is the top
    return (right - left)[peak] / bend[peak], offsets[peak]


def peak_offset(around: np.ndarray, curve: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(...) offset in cells of a peak from the middle one of (..., 3) powers; the curve's end where it is none.

    ``(R - L) / (2 C - L - R)``, as of a parabola: holes in the sweep, which narrow the peak, change numerator and
    denominator alike, and a noise floor adds to neither. The ratio of ``R`` to ``L`` alone was 1.2 m off behind
    whitening under 5 MHz NR at -30 dB, and this is 0.3 m.
    """
    left, here, right = around[..., 0], around[..., 1], around[..., 2]
    # no peak: towards the higher side
    bend = np.maximum(2.0 * here - left - right, np.finfo(np.float32).tiny)
    return np.interp(np.divide(right - left, bend, dtype=float), *curve)
