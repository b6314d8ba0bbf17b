"""Between samples: impulses at any time, and a signal at any time, by a short window (Kaiser-Bessel)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

__all__ = ["RATE", "at", "impulses_flat", "samples_flat", "spread"]

RATE = 1.5  # points per sample of the grid that impulses are spread over, at least
_WIDTH, _APART = 6, 3  # points per impulse, and from one to the next at least: images are 90 dB down
_NARROW = 4  # points that tell what is between them: errors are 50 dB down
_TABLE = 2048  # steps of a window per point


def _beta(width: int) -> float:
    """Of the window whose images are lowest below half the sample rate."""
    return np.pi * width * (1 - 0.5 / RATE)


@lru_cache(maxsize=2)
def _window(width: int) -> np.ndarray:
    """Kaiser-Bessel window, (width, _TABLE + 1) float32, read-only: the points around each place between two."""
    distance = np.arange(1 - width // 2, width // 2 + 1)[:, None] - np.arange(_TABLE + 1) / _TABLE
    inside = np.maximum(1 - (2 * distance / width) ** 2, 0)
    beta = _beta(width)
    window = (np.i0(beta * np.sqrt(inside)) / np.i0(beta) * (inside > 0)).astype(np.float32)
    window.setflags(write=False)
    return window


def _flat(cycles: np.ndarray, width: int) -> np.ndarray:
    """float32, one over the window's transform at ``cycles`` per point, any shape."""
    beta = _beta(width)
    argument = np.sqrt(beta**2 - (np.pi * width * cycles) ** 2)
    return (np.i0(beta) / width * argument / np.sinh(argument)).astype(np.float32)


def impulses_flat(cycles: np.ndarray) -> np.ndarray:
    """(...) float32 that the transform of a grid of impulses is multiplied by at (...) ``cycles`` per point."""
    return _flat(cycles, _WIDTH)


def samples_flat(cycles: np.ndarray) -> np.ndarray:
    """(...) float32 that the transform of samples is multiplied by for `at`, at (...) ``cycles`` per sample."""
    return _flat(cycles, _NARROW)


def spread(grid: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Put impulses ``values`` (K,) at (K,) ``places`` on a complex64 ``grid`` of zeros, three points or more apart.

    Impulses are spread over a finer grid, whose transform is then made flat (A. Dutt and V. Rokhlin, SIAM J. Sci.
    Comput. 14(6), 1993). Images of what is above two thirds of the grid's rate fall into what is below.
    """
    first, weights = _around(places, _WIDTH)
    for offset, part in enumerate(weights * values):
        # no point is written to twice, and not to those of others before the third
        if offset < _APART:
            grid[offset:][first] = part
        else:
            grid[offset:][first] += part


def at(samples: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(K,) complex64, what (n,) ``samples`` that were made flat are at (K,) ``places``.

    As exact as said where they have no more than two thirds of their band.
    """
    first, weights = _around(places, _NARROW)
    out = samples.take(first) * weights[0]
    for offset in range(1, _NARROW):
        out += samples[offset:].take(first) * weights[offset]
    return out


def _around(places: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(K,) the first of the points around each of (K,) ``places``, and their (width, K) weights."""
    whole = places.astype(np.intp)
    weights = _window(width).take(((places - whole) * _TABLE + 0.5).astype(np.intp), axis=1)
    whole += 1 - width // 2
    return whole, weights
