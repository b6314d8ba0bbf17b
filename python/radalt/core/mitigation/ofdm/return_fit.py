"""Masked elements: how loud a return is in them, and with which return they are points of the constellation.

A return that is louder in its elements than half the distance of the points is taken for data: decisions wrap, and what
is left of it is wrong. Which return it is can be found all the same. Each masked element says by some nats whether it
is a point once the right return is taken out, and a frame has hundreds of them.
"""

from dataclasses import dataclass

import numpy as np

from .arrays import median, power
from .constellation import rail_index, rail_tables
from .equaliser import ElementGrid
from .return_estimation import ReturnEstimate, ReturnEstimator
from .settings import OfdmSettings
from .soft_demapper import SoftSymbols

_CONTROL = np.array([0.25, 0.5, 0.25], np.float32)  # silence, QPSK, QPSK 3 dB up: of control elements
_OUTLIER = np.float32(1e-4)  # density of an element that is none of the points
RESIDUE = np.float32(0.02)  # of a return's power: it is no exact tone
_RARE = 1e-3  # share of a class that no element has to be compared with
_LOADING = np.float32(1e-3)  # a half sweep may have few elements
_KEPT, _ROUNDS = 2, 3  # candidates that are fitted, and how often


@dataclass(frozen=True)
class MaskedPoints:
    """Masked elements of a frame over their channel, (n,) each, and the probabilities (6, n) of what is sent there."""

    row: np.ndarray
    column: np.ndarray
    z: np.ndarray
    noise: np.ndarray
    size: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(
        cls,
        z: np.ndarray,
        noise: np.ndarray,
        h2: np.ndarray,
        soft: SoftSymbols,
        grid: ElementGrid,
        masked: np.ndarray,
    ) -> "MaskedPoints":
        """Elements (L, K) where ``masked`` is true: equalised ``z``, their noise, and their channel's power."""
        row, column = np.nonzero(masked)
        size = np.broadcast_to(h2, masked.shape)[row, column]
        control = soft.control[row, column]
        order = soft.order[:, grid.segment[row], column // grid.numerology.block] * (1 - control)
        shares = np.concatenate([_CONTROL[:, None] * control, order])
        return cls(row, column, z[row, column], noise[row, column] / size, size, shares)

    def _posterior(self, z: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nats and posterior means, (candidates, n) each, of elements with so much noise."""
        places = rail_index(z, noise)
        densities, means, _ = rail_tables()
        total, mean = np.full(z.shape, _OUTLIER), np.zeros((2, *z.shape), np.float32)
        for row, share in enumerate(self.shares):
            if share.mean() > _RARE:
                likely = densities[row].take(places, mode="clip").prod(axis=0) * share
                total += likely
                mean += likely * means[row].take(places, mode="clip")
        mean /= total
        return np.log(total), np.copysign(mean[0], z.real) + 1j * np.copysign(mean[1], z.imag)

    def return_power(self, step_db: float) -> tuple[np.float32, np.ndarray]:
        """Power of an unknown return, of greatest likelihood on a grid, and the elements' nats (n,) with it."""
        grid_db = np.append(-99, np.arange(-42, -13.9, step_db))
        powers = (median(self.size) * 10 ** (grid_db / 10)).astype(np.float32)
        z = np.broadcast_to(self.z, (powers.size, self.z.size))
        nats, _ = self._posterior(z, self.noise + powers[:, None] / self.size)
        best = int(nats.mean(axis=1).argmax())
        return powers[best], nats[best]

    def fit(
        self, own: np.ndarray, uncertainty: np.ndarray, half: np.ndarray, time: np.ndarray, rounds: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nats (candidates, 2) per half sweep with returns, and the factors (candidates, L) that fit best.

        - ``own`` (candidates, n) complex64: returns in the elements over their channel
        - ``uncertainty`` (candidates, 2) float: of their power, over their power; it halves with each round
        - ``half``, ``time`` (L,) int: half sweep of each symbol, and its time within that, -1 to 1
        - ``rounds``: in which the factors are fitted to the points decided. They are straight lines: beats are not
          exact.
        """
        size, count = power(own), self.row.size
        which = half[self.row]
        basis = np.zeros((count, 2, 3), np.float32)
        basis[np.arange(count), which] = time[self.row, None] ** np.arange(3)
        weighted = (basis * self.size[:, None, None]).reshape(count, 6)
        gram = (size @ weighted).reshape(-1, 2, 3)[..., [[0, 1], [1, 2]]]
        gram = gram + (_LOADING * gram[..., :1, :1] + np.float32(1e-20)) * np.eye(2, dtype=np.float32)
        doubt = uncertainty[:, which].astype(np.float32)
        factor = np.ones((len(own), half.size), np.complex64)
        for again in range(rounds + 1):
            z = self.z - own * factor[:, self.row]
            nats, decided = self._posterior(z, self.noise + (doubt * np.float32(0.5**again) + RESIDUE) * size)
            if again < rounds:
                agreement = (((self.z - decided) * own.conj()) @ weighted).reshape(-1, 2, 3)[..., :2]
                terms = np.linalg.solve(gram, agreement[..., None])[..., 0][:, half]
                factor = (terms[..., 0] + terms[..., 1] * time).astype(np.complex64)
        return nats @ basis[..., 0], factor


class ReturnFit:
    """The return of a frame as its masked elements show it.

    ``factor`` (L, K) complex64: from raw elements to those that were equalised.
    """

    def __init__(
        self,
        points: MaskedPoints,
        grid: ElementGrid,
        factor: np.ndarray,
        returns: ReturnEstimator,
        settings: OfdmSettings,
    ) -> None:
        self._points, self._grid, self._returns, self._s = points, grid, returns, settings
        self._factor = factor[points.row, points.column]
        middle, length = grid.starts + grid.numerology.useful // 2, grid.samples.size // 2
        self.half, self._time = (middle >= length).astype(int), 2 * (middle % length) / length - 1

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """Elements (L, K) of the likeliest return, and (2,) bool whether it is certain in each half sweep."""
        s, points = self._s, self._points
        _, unknown = points.return_power(s.return_step_db)
        least = np.bincount(self.half[points.row], unknown + s.return_nats, 2)
        frame = self._grid.samples * self._grid.carrier.conj()
        candidates = self._returns.candidates(frame, s.return_candidates)
        elements = self._elements(candidates)
        nats, _ = self._fitted(candidates, elements, 0)
        first = nats.sum(axis=1).argsort()[-_KEPT:]
        candidates = [candidates[k] for k in first]
        nats, elements = self._fitted(candidates, elements[first], _ROUNDS)
        best = int(nats.sum(axis=1).argmax())
        gain, found = nats[best] - least, elements[best]
        if gain.max() > 0 > gain.min():
            near = self._returns.neighbours(frame, candidates[best])
            nats, elements = self._fitted(near, self._elements(near), _ROUNDS)
            k = int(gain.argmin())
            nearest = int(nats[:, k].argmax())
            gain[k] = nats[nearest, k] - least[k]
            found = np.where((self.half == k)[:, None], elements[nearest], found)
        return found, gain > 0

    def _elements(self, tried: list[ReturnEstimate]) -> np.ndarray:
        return np.stack([self._grid.transform(one.samples * self._grid.carrier) for one in tried])

    def _fitted(
        self, tried: list[ReturnEstimate], elements: np.ndarray, rounds: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nats (candidates, 2) and elements (candidates, L, K) of returns with the factors that fit best."""
        own = elements[:, self._points.row, self._points.column] * self._factor
        uncertainty = np.minimum(self._s.return_uncertainty / np.stack([one.ratios for one in tried]), 1)
        nats, factor = self._points.fit(own, uncertainty, self.half, self._time, rounds)
        return nats, elements * factor[..., None]
