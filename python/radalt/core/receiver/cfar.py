"""Constant false-alarm-rate thresholds with their exact scale factors.

The beat cells come from a windowed, oversampled spectrum, so neighbouring cells are correlated and the textbook
scale factor (independent cells) misses the design false-alarm rate by a factor of several. Here it is solved from
the cells' true covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

__all__ = ["Cfar", "cell_correlation"]


def cell_correlation(window: np.ndarray, lags: int, fft_size: float) -> np.ndarray:
    """(lags,) complex noise correlation between spectral cells ``0`` and ``lag`` of a windowed ``fft_size``-point FFT.

    For white noise, ``E[X_k conj(X_l)]`` is the transform of the squared window at ``k - l``.
    """
    n = np.arange(window.size)
    phase = np.exp(-2j * np.pi * np.outer(np.arange(lags), n) / fft_size)
    correlation = phase @ (np.asarray(window, dtype=float) ** 2)
    return correlation / correlation[0].real


@dataclass(frozen=True)
class Cfar:
    """Sliding-window CFAR over the cells of a power spectrum.

    Parameters
    ----------
    pfa : float
        False-alarm probability of one cell, 1e-12..0.5.
    train, guard : int
        Training and guard cells on each side, in cells of the spectrum as it is sampled.
    kind : str
        ``"ca"`` averages the training cells; ``"os"`` takes an order statistic of training cells far enough apart
        to be independent (H. Rohling, IEEE Trans. AES 19(4), 1983), robust against a second target in them.
    rank : float
        Order statistic as a fraction of the cells, for ``"os"``.
    correlation : tuple of complex
        Noise correlation by lag (`cell_correlation`); empty stands for independent cells.
    """

    pfa: float = 1e-4
    train: int = 32
    guard: int = 6
    kind: str = "ca"
    rank: float = 0.75
    correlation: tuple[complex, ...] = ()

    def __post_init__(self) -> None:
        if not 1e-12 <= self.pfa <= 0.5:
            raise ValueError(f"cfar.pfa is {self.pfa!r}; it has to be within 1e-12..0.5")
        if self.train < 2 or self.guard < 0:
            raise ValueError(
                f"cfar.train {self.train} has to be at least 2, cfar.guard {self.guard} at least 0"
            )
        if self.kind not in ("ca", "os"):
            raise ValueError(f"cfar.kind is {self.kind!r}; allowed: ca, os")
        if not 0 < self.rank <= 1:
            raise ValueError(f"cfar.rank is {self.rank!r}; it has to be within 0..1")

    @property
    def margin(self) -> int:
        """Cells needed on each side of a cell under test."""
        return self.train + self.guard

    def _offsets(self) -> np.ndarray:
        """Training cells' offsets from the cell under test."""
        near, far = self.guard + 1, self.guard + self.train
        stride = 1
        if self.kind == "os" and self.correlation:
            magnitude = np.abs(self.correlation)
            stride = 1 + int(np.max(np.nonzero(magnitude > 0.05)[0]))
        side = np.arange(near, far + 1, stride)
        return np.concatenate([-side[::-1], side])

    def survival(self, ratio: np.ndarray) -> np.ndarray:
        """Probability that a noise cell exceeds ``ratio`` times its own noise estimate, exact in white Gaussian noise.

        Cell averaging: the cell under test is exponential and the training mean a Hermitian quadratic form, so the
        probability is ``prod 1 / (1 + a lambda_i / n)`` over the eigenvalues of the training cells' covariance (moment
        generating function, G. L. Turin, Biometrika 47, 1960). Order statistic: ``prod (n - i)/(n - i + a)``,
        i = 0..k-1 (Rohling 1983, eq. 21).
        """
        a = np.maximum(np.asarray(ratio, dtype=float), 0.0)[..., None]
        offsets = self._offsets()
        n = offsets.size
        if self.kind == "os":
            i = np.arange(self._rank_index(n) + 1)
            return np.exp(-np.sum(np.log1p(a / (n - i)), axis=-1))
        return np.exp(-np.sum(np.log1p(a * self._training_eigenvalues(offsets) / n), axis=-1))

    def scale(self) -> float:
        """Factor between noise estimate and threshold that gives ``pfa`` for one cell of one spectrum."""
        return float(optimize.brentq(lambda a: np.log(self.survival(a)) - np.log(self.pfa), 1e-9, 1e9))

    def joint_scale(self, floor: float) -> float:
        """Threshold on the sum of two independent cells' ratios, each at least ``floor``, that gives ``pfa``.

        ``P = int_floor^inf p(r) S(max(floor, t - r)) dr`` with ``S`` the survival function and ``p`` its density.
        """
        top = float(optimize.brentq(lambda a: np.log(self.survival(a)) - np.log(self.pfa * 1e-3), 1e-9, 1e9))
        ratio = np.linspace(floor, max(top, floor + 1.0), 4001)
        survival = self.survival(ratio)
        mass = -np.diff(survival)
        middle = 0.5 * (ratio[1:] + ratio[:-1])

        def log_excess(threshold: float) -> float:
            other = self.survival(np.maximum(floor, threshold - middle))
            return float(np.log(np.sum(mass * other)) - np.log(self.pfa))

        if log_excess(2 * floor) < 0:  # the floor alone is rarer than pfa
            return 2.0 * floor
        return float(optimize.brentq(log_excess, 2.0 * floor, 4.0 * top))

    def _rank_index(self, n: int) -> int:
        return min(n - 1, max(0, round(self.rank * n) - 1))

    def _training_eigenvalues(self, offsets: np.ndarray) -> np.ndarray:
        """Eigenvalues of the training cells' normalised Hermitian covariance."""
        if not self.correlation:
            return np.ones(offsets.size)
        lag = offsets[:, None] - offsets[None, :]
        table = np.zeros(np.abs(lag).max() + 1, dtype=complex)
        reach = min(table.size, len(self.correlation))
        table[:reach] = self.correlation[:reach]
        covariance = np.where(lag >= 0, table[np.abs(lag)], np.conj(table[np.abs(lag)]))
        return np.maximum(linalg.eigvalsh(covariance), 0.0)

    def noise(self, power: np.ndarray) -> np.ndarray:
        """Noise estimate for every cell that has all its training cells.

        Parameters
        ----------
        power : (..., J) float array

        Returns
        -------
        (..., J - 2 * margin) float array; element 0 belongs to cell ``margin``.
        """
        m, t, g = self.margin, self.train, self.guard
        inner = power.shape[-1] - 2 * m
        if self.kind == "os":
            offsets = self._offsets()
            cells = power[..., (m + np.arange(inner))[:, None] + offsets]
            k = self._rank_index(offsets.size)
            return np.partition(cells, k, axis=-1)[..., k]
        total = np.zeros(
            power.shape[:-1] + (power.shape[-1] + 1,)
        )  # float64 sums: exact enough at 100 dB range
        np.cumsum(power, axis=-1, out=total[..., 1:])
        low = total[..., t : t + inner] - total[..., :inner]
        start = m + g + 1
        high = total[..., start + t : start + t + inner] - total[..., start : start + inner]
        return np.maximum((low + high) / (2 * t), 0.0)
