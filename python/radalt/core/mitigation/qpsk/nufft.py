"""Non-uniform FFT: impulses at any time to a grid, and samples of a signal at any time (Kaiser-Bessel window).

Impulses are spread over a finer grid by a short window, and the transform is divided by the window's (A. Dutt and
V. Rokhlin, SIAM J. Sci. Comput. 14(6), 1993). Interpolation is the adjoint.
"""

from functools import lru_cache

import numpy as np

from ...waveform import read_only

# points of the grid per sample, at least: images of the window are 90 dB down with 6 points
OVERSAMPLING = 1.5
SPREAD_POINTS = 6  # points per impulse
INTERPOLATION_POINTS = 4  # samples per interpolated one: errors are 50 dB down
_TABLE = 2048  # steps of the tabulated window between two points: 66 dB


def _beta(width: int) -> float:
    """Shape of the window whose images are lowest below half the sample rate (Fessler and Sutton, 2003)."""
    return np.pi * width * (1 - 0.5 / OVERSAMPLING)


@lru_cache(maxsize=2)
def _window(width: int) -> np.ndarray:
    """Kaiser-Bessel window, (width, _TABLE + 1) float32, read-only: weights of the points around each place."""
    distance = np.arange(1 - width // 2, width // 2 + 1)[:, None] - np.arange(_TABLE + 1) / _TABLE
    inside = np.maximum(1 - (2 * distance / width) ** 2, 0)
    beta = _beta(width)
    return read_only((np.i0(beta * np.sqrt(inside)) / np.i0(beta) * (inside > 0)).astype(np.float32))


def correction(cycles: np.ndarray, points: int) -> np.ndarray:
    """(...) float32 that a transform is multiplied by at (...) ``cycles`` per point: one over that of the window.

    Of a grid after `spread`, with ``points = SPREAD_POINTS``; of samples before `interpolate`, with
    ``INTERPOLATION_POINTS``.
    """
    beta = _beta(points)
    argument = np.sqrt(beta**2 - (np.pi * points * cycles) ** 2)
    return (np.i0(beta) / points * argument / np.sinh(argument)).astype(np.float32)


def spread(grid: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Add impulses ``values`` (K,) at (K,) ``places``, three points or more apart, to a complex64 ``grid`` of zeros."""
    first, weights = _around(places, SPREAD_POINTS)
    for offset, part in enumerate(weights * values):
        # impulses three points apart or more share no point until the fourth of six: there nothing has to be added to
        if offset < SPREAD_POINTS // 2:
            grid[offset:][first] = part
        else:
            grid[offset:][first] += part


def interpolate(samples: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(K,) complex64 values at (K,) ``places`` of (n,) corrected ``samples`` that fill two thirds of their band."""
    first, weights = _around(places, INTERPOLATION_POINTS)
    out = samples.take(first) * weights[0]
    for offset in range(1, INTERPOLATION_POINTS):
        out += samples[offset:].take(first) * weights[offset]
    return out


def _around(places: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(K,) first points around (K,) ``places``, and their (width, K) weights."""
    whole = places.astype(np.intp)
    weights = _window(width).take(((places - whole) * _TABLE + 0.5).astype(np.intp), axis=1)
    whole += 1 - width // 2
    return whole, weights
