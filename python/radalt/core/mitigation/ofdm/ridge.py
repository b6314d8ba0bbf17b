"""Elements that hold the return as well: where they are, and which part of them is the return."""

from __future__ import annotations

import numpy as np

from ...waveform import Waveform, altitude_to_delay_s
from .demodulator import Received
from .lattice import BLOCK, DENSE, SCALE, SPARSE_POINTS, box, nearest, power
from .numerology import Numerology

__all__ = ["Ridge", "expected_return"]

_MARGIN = 3  # subcarriers: a sweep of 15 kHz in a microsecond leaks into its neighbours
_FOLD = 0.3  # error in the ridge, in cells, up to which a decision is right; a random one has 1
_SIR_DB = np.arange(-34.0, -3.0, 2.0)
_SPREAD = 0.2  # of the return's modulus: noise and Fresnel's ripple
_PRIOR_IN = 0.75  # share of the ridge that the return fills, which has one delay of many
_LEVEL_DB = 8.5  # a return stands in one subcarrier of seven
_SPARSE_PRIOR = np.array([0.2] + [0.15] * 4 + [0.05] * 4, dtype=np.float32)
_SAMPLE = 4  # every so manieth element is asked for the SIR
_FAINT = np.float32(1e-30)


class Ridge:
    """Elements that a return from 0 to ``span_m`` can be in, for any window of a frame."""

    def __init__(self, waveform: Waveform, numerology: Numerology, span_m: float) -> None:
        cycles = np.diff(np.unwrap(np.angle(waveform.reference.astype(np.complex128)))) / (2 * np.pi)
        self._subcarrier = np.append(cycles, cycles[-1]) * numerology.useful
        self._delay = int(np.ceil(altitude_to_delay_s(span_m) * waveform.rate_hz))
        self._numerology = numerology
        self._known: dict[tuple[int, int], np.ndarray] = {}

    def clear(self, starts: np.ndarray, carrier: float) -> np.ndarray:
        """(L, K) bool: elements that no return can be in, of a frame whose ``carrier`` (in subcarriers) was taken
        out."""
        return np.stack([self._clear(int(start), round(carrier)) for start in starts])

    def _clear(self, start: int, carrier: int) -> np.ndarray:
        mask = self._known.get((start, carrier))
        if mask is None:
            useful = self._numerology.useful
            samples = np.arange(start - self._delay, start + useful) % self._subcarrier.size
            at = np.rint(self._subcarrier[samples]).astype(int) - carrier + useful // 2
            mask = np.ones(useful, dtype=bool)
            for margin in (-_MARGIN, 0, _MARGIN):
                mask[(at + margin) % useful] = False
            if len(self._known) > 4096:
                self._known.clear()
            self._known[start, carrier] = mask
        return mask


def _density(distance: np.ndarray, modulus: float, noise: float) -> np.ndarray:
    """Density of a return of that modulus and noise at a distance: on a ring, or (beside the ridge's own line) a
    disc."""
    spread = np.float32((_SPREAD * modulus) ** 2 + noise / 2)
    ring = np.exp((distance - np.float32(modulus)) ** 2 / (-2 * spread))
    ring /= np.maximum(distance, np.float32(0.1 * modulus)) * np.float32(
        2 * np.pi * np.sqrt(2 * np.pi * spread)
    )
    disc = np.float32((0.5 * modulus) ** 2 + noise)
    ring *= np.float32(_PRIOR_IN)
    ring += np.exp(distance * distance / -disc) * np.float32((1 - _PRIOR_IN) / (np.pi * disc))
    return ring


def expected_return(
    received: Received, ridge: np.ndarray, clear: np.ndarray, near_db: float | None = None
) -> tuple[np.ndarray, float] | None:
    """Mean of the return, given what was received, in the elements of ``ridge`` (L, K): (elements,) complex64.

    Where the return is larger than half a cell of the lattice, the nearest point may be any point, and subtracting it
    leaves the return folded into a cell. The return's modulus is the same in all elements, so points at that distance
    from what was received are the likely ones. The mean over them is taken, with the modulus that makes all received
    elements most likely. The SIR in dB that follows is returned as well; ``near_db``, the SIR of the frame before,
    saves the search. None where the nearest points suffice.
    """
    if not ridge.any() or not clear.any() or float(received.error[ridge].mean()) < _FOLD:
        return None
    noise = received.noise
    level = float(np.sqrt(np.mean(power(received.symbols[clear]))))
    channel = received.channel[ridge]
    values = received.symbols[ridge] / channel
    modulus = np.abs(channel)
    kinds = received.kinds[ridge]
    dense = np.array(DENSE, dtype=np.float32)[kinds][:, None]
    root = np.array([SCALE[m] for m in DENSE])[kinds][:, None]
    steps = np.arange(-4, 5, 2, dtype=np.float32)
    around = (steps[:, None] + 1j * steps).ravel().astype(np.complex64)
    near = np.choose(kinds, [nearest(values, m) for m in DENSE])[:, None] + root * around
    top = np.float32(1.001) * (np.sqrt(dense) - 1) * root
    inside = ((np.abs(near.real) <= top) & (np.abs(near.imag) <= top)) / dense
    rests = np.concatenate([values[:, None] - near, values[:, None] - SPARSE_POINTS], axis=1)
    prior = np.concatenate(
        [inside, np.broadcast_to(_SPARSE_PRIOR, (len(values), _SPARSE_PRIOR.size))], axis=1
    )
    distance = np.abs(rests) * modulus[:, None]
    many = near.shape[1]
    plane = np.zeros(ridge.shape, dtype=np.float32)

    def alphabets(sir_db: float, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weight = _density(distance[part], level * 10 ** ((sir_db + _LEVEL_DB) / 20), noise) * prior[part]
        return weight, weight[:, :many].sum(axis=1) + _FAINT, weight[:, many:].sum(axis=1) + _FAINT

    part = slice(None, None, _SAMPLE)

    def evidence(sir_db: float) -> float:
        _, some, scanty = alphabets(sir_db, part)
        return float(np.mean(np.log(np.maximum(some, scanty))))

    tried = _SIR_DB if near_db is None else _SIR_DB[np.abs(_SIR_DB - near_db) < 3]
    sir_db = float(max(tried, key=evidence))
    weight, some, scanty = alphabets(sir_db, slice(None))
    # a block is of one alphabet
    plane[ridge] = np.log(scanty) - np.log(some)
    few = box(plane, BLOCK)[ridge] > 0
    weight[few, :many] = 0
    weight[~few, many:] = 0
    mean = np.einsum("ec,ec->e", weight, rests) / np.where(few, scanty, some)
    return (mean * channel).astype(np.complex64), sir_db
