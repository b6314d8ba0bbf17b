"""Points of QPSK and square QAM at unit mean power: the nearest, and which alphabet a block of elements has."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

__all__ = ["BLOCK", "CELL", "DENSE", "SPARSE_ERROR", "SPARSE_POINTS", "box", "nearest", "power", "sparse"]

DENSE = (16, 64, 256)
BLOCK = 12  # subcarriers of a resource block, of one user and one kind
SPARSE_ERROR = 0.04  # mean squared error below which a block is one of few points; 64QAM has 0.1 from these
_SCALE = {m: np.float32(np.sqrt(1.5 / (m - 1))) for m in (4, *DENSE)}  # half the distance of two neighbours
# squared error of a number anywhere in a cell; for the few points the error that 64QAM has from them
CELL = {m: np.float32(2 * (2 * _SCALE[m]) ** 2 / 12) for m in DENSE}
_ROOT2 = np.float32(np.sqrt(2))
_EMPTY = np.float32(0.25)  # power below which nothing is nearer than a point of QPSK
_BOOSTED = np.float32(
    (1 + np.sqrt(2)) ** 2 / 4
)  # power above which QPSK 3 dB up (demodulation pilots) is nearer
_QPSK = np.exp(0.25j * np.pi * (1 + 2 * np.arange(4)))
# silence, QPSK, QPSK 3 dB up
SPARSE_POINTS = np.concatenate([[0], _QPSK, _ROOT2 * _QPSK]).astype(np.complex64)


def power(values: np.ndarray) -> np.ndarray:
    """Squared modulus, float32 for complex64."""
    return values.real * values.real + values.imag * values.imag


def box(values: np.ndarray, width: int) -> np.ndarray:
    """Running mean over the last axis."""
    return ndimage.uniform_filter1d(values, width, axis=-1, mode="nearest") if width > 1 else values


def nearest(values: np.ndarray, points: int) -> np.ndarray:
    """Nearest of 4, 16, 64 or 256 points to each complex64 value, as complex64."""
    half = _SCALE[points]
    top = np.float32(np.sqrt(points) / 2 - 1)
    rails = np.ascontiguousarray(values).view(np.float32) * (np.float32(0.5) / half)
    np.floor(rails, out=rails)
    np.maximum(rails, -top - 1, out=rails)
    np.minimum(rails, top, out=rails)
    rails += np.float32(0.5)
    rails *= 2 * half
    return rails.view(np.complex64)


def sparse(values: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Nearest of `SPARSE_POINTS`; ``level`` is the power of ``values``."""
    rails = np.copysign(np.float32(np.sqrt(0.5)), np.ascontiguousarray(values).view(np.float32))
    scale = np.where(level > _BOOSTED, _ROOT2, np.float32(1))
    scale[level < _EMPTY] = 0
    return rails.view(np.complex64) * scale
