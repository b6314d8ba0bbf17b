"""Constellations: density, posterior mean and second moment of one rail, as tables.

A point of square QAM has two independent rails (TS 38.211 clause 5.1). With noise of variance ``nu`` per element
(``nu / 2`` per rail) and levels ``a`` of equal probability, a received rail x has the density
``p(x) = mean_a exp(-(x - a)^2 / nu) / sqrt(pi nu)``, and ``E[a | x] = sum_a a exp(-(x - a)^2 / nu) / sum_a exp(...)``.
"""

from functools import lru_cache

import numpy as np

from ...waveform import read_only

EMPTY, QPSK, BOOSTED, QAM = (
    0,
    1,
    2,
    (3, 4, 5),
)  # silence, QPSK, QPSK 3 dB up, 16 to 256QAM: rows of the tables
NOISE_DB = np.arange(
    -52.0, 7.0, 2.0
)  # of the tables; finer noise than a step's width needs no row of its own
_STEPS = 128  # per unit of amplitude: a fifth of half the distance between points of 256QAM
# density per unit of amplitude; products of smaller ones are denormal numbers, which cost tenfold
_LEAST = 1e-12
_TOP = 2 * _STEPS  # steps; the outermost point of any constellation is at 1.1 units, QPSK 3 dB up at 1
_LEVELS = (
    np.zeros(1),
    np.sqrt(0.5) * np.array([-1.0, 1.0]),
    np.array([-1.0, 1.0]),
    *(np.arange(1 - m, m, 2) * np.sqrt(1.5 / (m * m - 1)) for m in (4, 8, 16)),
)


@lru_cache(maxsize=1)
def rail_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Densities, means and second moments, each (6, noise * |x|) float32, by rows `EMPTY` to `QAM`; read-only."""
    x = (np.arange(_TOP) + 0.5) / _STEPS
    tables = np.empty((3, len(_LEVELS), NOISE_DB.size, _TOP), np.float32)
    for row, levels in enumerate(_LEVELS):
        distance = (x[:, None] - levels) ** 2
        for number, noise in enumerate(10 ** (NOISE_DB / 10)):
            exponent = -distance / noise
            top = exponent.max(axis=1, keepdims=True)
            weight = np.exp(exponent - top)
            total = weight.sum(axis=1)
            weight /= total[:, None]
            density = np.exp(top[:, 0]) * total / levels.size / np.sqrt(np.pi * noise)
            tables[0, row, number] = np.maximum(density, _LEAST)
            tables[1, row, number] = weight @ levels
            tables[2, row, number] = weight @ levels**2
    density, mean, second = read_only(tables).reshape(3, len(_LEVELS), -1)
    return density, mean, second


def rail_index(values: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(2, ...) intp: places in the tables of the rails of complex64 ``values`` (...) with float32 ``noise`` (...).

    Signs are left to the caller.
    """
    step = np.float32(10 / np.log(10) / (NOISE_DB[1] - NOISE_DB[0]))
    row = np.log(noise + np.float32(1e-12))
    row *= step
    row -= np.float32(NOISE_DB[0] / (NOISE_DB[1] - NOISE_DB[0]) - 0.5)
    np.maximum(row, 0, out=row)
    np.minimum(row, NOISE_DB.size - 1, out=row)
    np.floor(row, out=row)
    row *= np.float32(_TOP)
    rails = np.empty((2, *values.shape), np.float32)
    np.abs(values.real, out=rails[0])
    np.abs(values.imag, out=rails[1])
    rails *= np.float32(_STEPS)
    np.minimum(rails, np.float32(_TOP - 1), out=rails)
    rails += row
    return rails.astype(np.intp)
