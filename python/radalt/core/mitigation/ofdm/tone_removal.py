"""Tones on top of a wide signal: found as lines of the frame's spectrum, fitted by least squares, subtracted."""

from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.linalg import blas

from ...fir import periodic_hann
from ...waveform import read_only

_LINE = 30.0  # times the median power of the bins around it; of 7,500 bins of noise the largest has 13
_PEAK = 20.0  # times the mean power of all bins: a fainter tone does no harm
_BLOCK = 125  # bins with one floor
_AROUND = 2  # bins that a line takes on either side
_RANGE = 1e-2  # of the strongest line's power: fainter ones may be its side lobes
_MOST = 8  # tones
_PASSES = 4
_ROUNDS = 2  # of all tones together
_LOADING = 1e-6  # two tones less than a bin apart make the equations nearly singular


def without_tones(frame: np.ndarray) -> np.ndarray | None:
    """An (N,) complex64 frame less its tones, at most eight; None if it has none, or lines that are no steady tones.

    A wide signal's power is shared by thousands of bins, a tone's is in one. So a tone of a hundredth of that power
    can be seen and fitted.
    """
    lines = _lines(frame)
    if not 0 < lines.size <= _MOST:
        return None
    rest, turns = frame, np.zeros(0)
    for _ in range(_PASSES):
        rest, turns = _fitted(frame, np.concatenate([turns, lines]))
        lines = _lines(rest)
        if not lines.size:
            return rest
        if lines.size + turns.size > _MOST:
            break
    return None


def _lines(frame: np.ndarray) -> np.ndarray:
    """(k,) cycles per frame of the lines that stand out of the spectrum around them."""
    count = frame.size
    spectrum = fft.fft(frame * periodic_hann(count))
    with np.errstate(over="ignore"):  # power may overflow float32; such frames are left alone
        level = spectrum.real**2 + spectrum.imag**2
    if not level.max() > _PEAK * level.mean():
        return np.zeros(0)
    blocks = level[: count - count % _BLOCK].reshape(-1, _BLOCK)
    floor = np.sort(blocks, axis=1)[:, _BLOCK // 2]
    # next to a wide signal the floor is that signal's
    floor = np.concatenate([floor[-1:], floor, floor[:1]])
    floor = np.maximum(np.maximum(floor[:-2], floor[2:]), floor[1:-1])
    high = np.flatnonzero(blocks.max(axis=1) > np.maximum(_LINE * floor, _RANGE * level.max()))
    least = np.full(count, np.inf, dtype=np.float32)
    for block in high:
        least[block * _BLOCK : (block + 1) * _BLOCK] = max(_LINE * floor[block], _RANGE * level.max())
    high = np.flatnonzero(level > least)
    neighbours = level.take(high[:, None] + np.arange(-_AROUND, _AROUND + 1), mode="wrap")
    return high[level[high] >= neighbours.max(axis=1)].astype(float)


def _fitted(frame: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) complex64 frame less tones of about ``turns`` (k,) cycles per frame, and what these are exactly, (k,).

    Least squares over ``sum_k (a_k + b_k t) exp(2j pi f_k t)``, t in frames from the middle. What of ``b_k / a_k`` is
    imaginary is an error of ``f_k`` (Gauss and Newton's method).
    """
    count, tones = frame.size, turns.size
    basis = np.empty((2 * tones, count), dtype=np.complex64)
    columns = basis.T  # as BLAS has them: it conjugates without a copy
    for _ in range(_ROUNDS):
        _carriers(turns, basis[:tones])
        np.multiply(basis[:tones], _time(count), out=basis[tones:])
        gram = blas.cherk(1.0, columns, trans=2)  # its upper half
        gram += np.triu(gram, 1).conj().T
        gram[np.diag_indices(len(gram))] *= 1 + _LOADING
        factor = np.linalg.solve(gram, blas.cgemv(1.0, columns, frame, trans=2))
        amplitude, slope = factor.reshape(2, -1)
        turns = turns + np.clip((slope / amplitude).imag / (2 * np.pi), -0.5, 0.5)
    return frame - blas.cgemv(1.0, columns, factor), turns


@lru_cache(maxsize=4)
def _time(count: int) -> np.ndarray:
    """(count,) float32 times in frames from the middle, read-only."""
    return read_only(((np.arange(count) - (count - 1) / 2) / count).astype(np.float32))


def _carriers(turns: np.ndarray, out: np.ndarray) -> None:
    """Carriers of so many cycles per frame into (tones, count) complex64: products of few long and few short steps."""
    count = out.shape[1]
    short = int(np.sqrt(count))
    rows, rest = divmod(count, short)
    step = 2j * np.pi / count * turns[:, None]
    few = np.exp(step * np.arange(short)).astype(np.complex64)
    long = np.exp(short * step * np.arange(rows + 1)).astype(np.complex64)
    whole = out[:, : rows * short].reshape(-1, rows, short)
    np.multiply(long[:, :rows, None], few[:, None], out=whole)
    np.multiply(long[:, rows:], few[:, :rest], out=out[:, rows * short :])
