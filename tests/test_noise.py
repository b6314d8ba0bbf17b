"""The receiver's noise is white, circular and Gaussian, out to its tails."""

import numpy as np
import pytest
from frames import N
from scipy import stats

from radalt.core.channel.noise import ReceiverNoise

BLOCKS = 200


@pytest.fixture(scope="module")
def rails() -> np.ndarray:
    """(BLOCKS, 2 N) float64 rails of unit variance: 3e6 numbers."""
    noise = ReceiverNoise(N, [7, 1])
    out = np.zeros((BLOCKS, N), dtype=np.complex64)
    for block in out:
        noise.add(block, power=2.0)
    return out.view(np.float32).astype(float)


def test_rails_are_normal(rails):
    """Moments within four standard errors, and the whole distribution by Kolmogorov and Smirnov."""
    count = rails.size
    assert abs(rails.mean()) < 4 / np.sqrt(count)
    assert abs(rails.var() - 1) < 4 * np.sqrt(2 / count)
    assert abs(np.mean(rails**3)) < 4 * np.sqrt(15 / count)
    assert abs(np.mean(rails**4) - 3) < 4 * np.sqrt(96 / count)  # kurtosis
    assert stats.kstest(rails.reshape(-1), "norm").pvalue > 1e-3


@pytest.mark.parametrize("level", [1.0, 2.0, 3.0, 4.0, 4.5])
def test_tails_are_as_heavy_as_they_should_be(rails, level):
    """Counts beyond a level on both sides, within four standard errors of the Poisson law."""
    expected = 2 * stats.norm.sf(level) * rails.size
    assert np.sum(np.abs(rails) > level) == pytest.approx(expected, abs=4 * np.sqrt(expected))


def test_numbers_of_a_pair_are_independent(rails):
    """They come of one radius and one angle: neither they nor their squares nor their products may know each other."""
    first, second = rails[:, :N].reshape(-1), rails[:, N:].reshape(-1)
    limit = 4 / np.sqrt(first.size)
    for a, b in ((first, second), (first**2, second**2), (np.abs(first), second), (first, second**3)):
        assert abs(np.corrcoef(a, b)[0, 1]) < limit
    ratio = stats.kstest(first[::10] / second[::10], "cauchy")  # of two independent normal numbers
    assert ratio.pvalue > 1e-3


def test_samples_are_circular_and_white(rails):
    samples = rails.view(complex)
    power = np.abs(samples) ** 2
    assert abs(np.mean(samples**2)) < 4 * np.sqrt(2) * 2 / np.sqrt(samples.size)
    assert stats.kstest(power.reshape(-1), "expon", args=(0, 2.0)).pvalue > 1e-3
    for lag in (1, 2, 7, N // 2, N):  # within a block, between the halves it is made in, and between blocks
        stream = samples.reshape(-1)
        assert abs(np.mean(stream[lag:] * np.conj(stream[:-lag]))) < 4 * 2 / np.sqrt(stream.size)
        squares = power.reshape(-1)
        assert abs(np.corrcoef(squares[lag:], squares[:-lag])[0, 1]) < 4 / np.sqrt(squares.size)


def test_noise_is_added_at_its_power_and_follows_its_seed():
    signal = np.exp(2j * np.pi * 0.01 * np.arange(N)).astype(np.complex64)
    one, same, other = (signal.copy() for _ in range(3))
    for block, seed in ((one, 1), (same, 1), (other, 2)):
        ReceiverNoise(N, [seed]).add(block, power=0.01)
    assert one.tobytes() == same.tobytes() and one.tobytes() != other.tobytes()
    assert np.mean(np.abs(one - signal) ** 2) == pytest.approx(0.01, rel=0.05)
