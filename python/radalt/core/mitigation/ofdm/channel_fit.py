"""The channel of every subcarrier from decided points, constant over the frame or moving with time."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .lattice import box

__all__ = ["fit", "sums"]

_STEADY = np.float32(
    1e-4
)  # of the energy, added to what would make a channel move that one symbol alone tells of


def sums(
    agreement: np.ndarray, weight: np.ndarray, times: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of a polynomial of ``order`` in time: (order + 1, K) complex64, (2 order + 1, K) float32.

    ``agreement`` (L, K) is received times conjugate model, ``weight`` (L, K) the model's power; zero where not to be
    used.
    """
    if order == 0:
        return agreement.sum(axis=0)[None], weight.sum(axis=0)[None]
    # einsum: a product of matrices this thin costs more in threads than in arithmetic
    basis = np.stack([times**n for n in range(2 * order + 1)])
    right = np.einsum("nl,lk->nk", basis[: order + 1].astype(np.complex64), agreement)
    return right, np.einsum("nl,lk->nk", basis, weight)


def fit(right: np.ndarray, left: np.ndarray, order: int, width: int) -> np.ndarray:
    """(order + 1, K) coefficients of the factor by which the model has to be multiplied, over ``width`` subcarriers
    each.

    1 where too little was received to tell.
    """
    right, left = right[: order + 1], left[: 2 * order + 1]
    if width > 1:
        right = ndimage.uniform_filter1d(right, width, axis=1)
        left = box(left, width)
    energy = left[0]
    if order == 0:
        factor = right / np.maximum(energy, 1e-30)
    elif order == 1:
        square = left[2] + _STEADY * energy
        determinant = np.maximum(energy * square - left[1] * left[1], 1e-30)
        factor = np.stack([square * right[0] - left[1] * right[1], energy * right[1] - left[1] * right[0]])
        factor /= determinant
    else:
        rows = np.add.outer(np.arange(order + 1), np.arange(order + 1))
        matrix = left[rows].transpose(2, 0, 1).astype(np.float64)
        steady = np.diag([0.0] + [_STEADY] * order)
        matrix += energy[:, None, None] * steady + 1e-30 * np.eye(order + 1)
        factor = np.linalg.solve(matrix, right.T[..., None].astype(np.complex128))[..., 0].T
    unknown = energy <= 1e-3 * energy.mean()
    factor[0, unknown], factor[1:, unknown] = 1, 0
    return factor.astype(np.complex64)
