"""Array helpers of the receiver: powers, complex exponentials without a call per element, blocks of subcarriers."""

from functools import lru_cache

import numpy as np
from scipy import ndimage

from ...spectral_line import upper_median
from ...waveform import read_only


def power(x: np.ndarray) -> np.ndarray:
    """``|x|^2`` of complex x, any shape, real."""
    return x.real**2 + x.imag**2


def exp_ramp(step_cycles: np.ndarray, count: int, first: float = 0.0) -> np.ndarray:
    """``exp(j 2 pi step_l (first + n))``: (L,) cycles give (L, count) complex64.

    With n = a b + c it is a product of two short exponentials; 20 times cheaper than one call per element.
    """
    step = np.asarray(step_cycles, dtype=float)[:, None]
    short = max(1, int(np.sqrt(count)))
    coarse = np.exp(2j * np.pi * np.mod(step * (first + short * np.arange(-(-count // short))), 1.0))
    fine = np.exp(2j * np.pi * step * np.arange(short))
    out = coarse.astype(np.complex64)[:, :, None] * fine.astype(np.complex64)[:, None, :]
    return out.reshape(len(step), -1)[:, :count]


def block_sums(values: np.ndarray, block: int) -> np.ndarray:
    """(..., K) real or complex, sums over blocks of that many subcarriers: (..., K / block)."""
    if block == 4 and values.dtype == np.float32 and values.flags.c_contiguous:
        pairs = values.view(np.complex64)  # half as many strided reads
        pairs = pairs[..., ::2] + pairs[..., 1::2]
        return pairs.real + pairs.imag
    out = values[..., ::block]
    for k in range(1, block):
        out = out + values[..., k::block]
    return out


@lru_cache(maxsize=64)
def _members(segments: tuple[int, ...], count: int) -> np.ndarray:
    rows = np.arange(count)
    starts = np.array(segments)[:, None]
    ends = np.array((*segments[1:], count))[:, None]
    return read_only(((rows >= starts) & (rows < ends)).astype(np.float32))


def segment_sums(values: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """(L, K) float32 or complex64 summed from each row in ``segments`` to the next: (len(segments), K)."""
    which = _members(tuple(segments.tolist()), len(values))
    if values.dtype == np.complex64:
        return (which @ np.ascontiguousarray(values).view(np.float32)).view(np.complex64)
    return which @ values


def segment_spread(values: np.ndarray, segments: np.ndarray, count: int) -> np.ndarray:
    """(len(segments), K) float32 values of segments, repeated for each of their rows: (count, K)."""
    return _members(tuple(segments.tolist()), count).T @ values


def spread(values: np.ndarray, block: int) -> np.ndarray:
    """(..., n) values of blocks, repeated for each of their subcarriers: (..., n block)."""
    return np.repeat(values, block, axis=-1)


def median(values: np.ndarray) -> np.floating:
    """`upper_median` of all values."""
    return upper_median(values.ravel())


def moving_sum(values: np.ndarray, width: int) -> np.ndarray:
    """Sums over ``width`` (odd) neighbours along the last axis, fewer at the ends; same shape."""
    reach = min(width // 2, values.shape[-1] - 1)
    if reach <= 0:
        return values
    if reach > 3:
        return ndimage.uniform_filter1d(values, 2 * reach + 1, axis=-1, mode="constant") * np.float32(
            2 * reach + 1
        )
    out = values.copy()
    for k in range(1, reach + 1):
        out[..., k:] += values[..., :-k]
        out[..., :-k] += values[..., k:]
    return out


def moving_average(values: np.ndarray, width: int) -> np.ndarray:
    """Means over ``width`` neighbours along the last axis, ends repeated; same shape, real or complex."""
    return ndimage.uniform_filter1d(values, width, axis=-1, mode="nearest")
