"""The channel of every subcarrier by least squares, and running means over subcarriers."""

import numpy as np
import pytest

from radalt.core.mitigation.ofdm.channel_fit import _solved, best_order, fit, smooth_fit, sums
from radalt.core.mitigation.ofdm.demodulator import times_of
from radalt.core.mitigation.ofdm.lattice import box


def noise(rng, *shape):
    return rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] * np.sqrt(0.5)


@pytest.mark.parametrize("echo_s", [0.6e-6, 5e-6])
def test_a_channel_that_is_smooth_over_subcarriers_has_a_third_of_the_noise(echo_s):
    """Of two paths in opposite motion, on average over the band. What it smooths away stays below -60 dB, and where the
    echo comes 5 us later (ETU) below -40 dB."""
    rng = np.random.default_rng(15)
    times, frequency_hz = times_of(13), 15e3 * np.arange(-250, 250)
    late = np.exp(-2j * np.pi * frequency_hz * echo_s)
    channel = np.exp(0.2j * times)[:, None] + 0.4 * np.exp(-0.2j * times)[:, None] * late
    error = 1e-2 * noise(rng, *channel.shape)
    weight = np.ones(channel.shape, dtype=np.float32)

    def wrong(told, fitted):
        right, left = sums((channel + told).astype(np.complex64), weight, times, 2)
        factors = fitted(right, left)
        found = sum(times[:, None] ** n * one for n, one in enumerate(factors))
        return np.mean(np.abs(found - channel) ** 2)

    def smooth(right, left):
        return smooth_fit(right, left, channel)

    assert wrong(0 * error, smooth) < (1e-6 if echo_s < 1e-6 else 1e-4)
    if echo_s < 1e-6:
        assert wrong(error, smooth) < 0.4 * wrong(error, lambda *both: fit(*both, 2, 1))


def test_systems_of_all_subcarriers_are_solved_at_once():
    """As LAPACK solves each; some are nearly singular."""
    rng = np.random.default_rng(5)
    root = rng.standard_normal((40, 9, 9)) * np.geomspace(1.0, 1e-3, 9)
    matrix, right = root.transpose(0, 2, 1) @ root, rng.standard_normal((40, 9, 2)).view(complex)
    told = np.linalg.solve(matrix, right)[:, :, 0].T
    found = _solved(matrix.transpose(1, 2, 0).copy(), right[:, :, 0].T)
    assert np.max(np.abs(found - told)) < 1e-6 * np.max(np.abs(told))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_order_that_a_channel_has_is_found_with_the_error_that_it_leaves(order):
    """The error is the noise's power, by what is left per element and unknown."""
    rng = np.random.default_rng(19)
    times, shape = times_of(13), (13, 500)
    courses = noise(rng, order + 1, 500) + 1
    points = noise(rng, *shape)
    sure = rng.random(shape) < 0.8
    heard = sum(times[:, None] ** n * one for n, one in enumerate(courses)) * points
    heard = (heard + 1e-2 * noise(rng, *shape)).astype(np.complex64)
    agreement = (heard * points.conj() * sure).astype(np.complex64)
    weight = (np.abs(points) ** 2 * sure).astype(np.float32)
    factor, error = best_order(heard, agreement, weight, times, sure, 0.0, read=True)
    assert len(factor) == order + 1
    model = sum(times[:, None] ** n * one for n, one in enumerate(factor)) * points
    left = (np.abs(heard - model) ** 2 * sure).sum(axis=0) / np.maximum(sure.sum(axis=0) - order - 1, 1)
    assert error == pytest.approx(np.median(left), rel=0.05)
    assert error == pytest.approx(1e-4, rel=0.2)


def test_running_means_are_those_of_their_windows():
    values = np.random.default_rng(20).random((3, 50), dtype=np.float32)
    for width, before in ((20, 9), (12, None), (5, 0)):
        ahead = width // 2 if before is None else before
        for beside, mode in ((0.0, "constant"), (None, "edge")):
            wide = np.pad(values, ((0, 0), (ahead, width - 1 - ahead)), mode=mode)
            means = np.lib.stride_tricks.sliding_window_view(wide, width, axis=1).mean(axis=-1)
            np.testing.assert_allclose(box(values, width, before=before, beside=beside), means, rtol=1e-5)
