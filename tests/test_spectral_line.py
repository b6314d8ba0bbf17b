"""Lines in noise: one interpolator, one noise level, one law of chance, and the false alarms of the tests on them."""

import numpy as np
import pytest
from frames import white

from radalt.core import spectral_line as line
from radalt.core.altimeter.beyond_span import BeyondSpan
from radalt.core.fir import cosine_window
from radalt.core.mitigation.ofdm.return_estimation import ReturnEstimator
from radalt.core.mitigation.ofdm.settings import SETTINGS
from radalt.core.waveform import Waveform

W, SAMPLES = Waveform(), 256


@pytest.mark.parametrize("window, padding, loss", [("boxcar", 2, 1.1), ("boxcar", 4, 1.1), ("hann", 1, 1.85)])
def test_a_peak_is_placed_without_bias_near_the_cramer_rao_bound_wherever_it_lies(window, padding, loss):
    """Variance ``6 / (4 pi^2 N^3 SNR)`` cycles^2 per sample^2 (D. C. Rife and R. R. Boorstyn, 1974); Hann loses."""
    taper, rng = cosine_window(window, SAMPLES, periodic=True), np.random.default_rng(1)
    curve = line.peak_curve(taper, 1 / (padding * SAMPLES))
    offset = np.repeat(np.linspace(-0.5, 0.5, 21), 100)[:, None]
    cycles = (40 + offset) * np.arange(SAMPLES) / (padding * SAMPLES) + rng.random(offset.shape)
    tone = np.exp(2j * np.pi * cycles)
    for sigma in (0.0, 0.5):
        received = tone + sigma * white(rng, *tone.shape)
        power = np.abs(np.fft.fft(received * taper, padding * SAMPLES)) ** 2
        top = 39 + power[:, 39:42].argmax(axis=1)
        around = np.take_along_axis(power, top[:, None] + np.arange(-1, 2), axis=1)
        error = (top + line.peak_offset(around, curve) - 40 - offset[:, 0]).reshape(21, 100)
        if sigma == 0:
            assert np.abs(error).max() < 2e-3
        else:
            bound = sigma * padding * np.sqrt(1.5 / SAMPLES) / np.pi
            assert np.abs(error.mean(axis=1)).max() < 4 * loss * bound / 10
            assert 0.95 * bound < error.std() < loss * bound


@pytest.mark.parametrize("looks", [1, 16])
def test_the_noise_level_is_the_mean_of_one_cell_and_lines_hardly_move_it(looks):
    """The middle of n exponentials has the mean 1/n + ... + 1/((n + 1)/2), which is ln 2 of many."""
    power = np.random.default_rng(2).gamma(looks, size=(1000, 301)).astype(np.float32)
    level = line.noise_level(power, looks)
    assert level.mean() == pytest.approx(1.0, rel=0.005)
    if looks == 1:
        expected = np.sum(1 / np.arange(151, 302)) / np.log(2)
        assert level.mean() == pytest.approx(expected, abs=float(level.std()) / 8)
    power[:, :15] += 1e6
    assert line.noise_level(power, looks).mean() == pytest.approx(1.0, rel=0.08)


def test_chance_of_one_cell_and_of_a_sum():
    """Over a mean of 8 cells -log P is exponential; two cells exceed x with probability (1 + x) exp(-x)."""
    rng = np.random.default_rng(3)
    value = line.significance(rng.exponential(size=10**5), rng.gamma(8, 1 / 8, 10**5), np.full(10**5, 8.0))
    for level in (1.0, 3.0, 6.0):
        assert np.mean(value > level) == pytest.approx(np.exp(-level), rel=0.15)
        assert line.sum_chance(level, 2) == pytest.approx((1 + level) * np.exp(-level))
        assert line.sum_level(line.sum_chance(level, 5), 5) == pytest.approx(level)


def test_noise_passes_the_tests_for_a_return_no_more_often_than_they_state():
    """Two cells beyond the span: pairs as in noise; a visible return: 1 in 10^4; one return left: 1 in 100."""
    frames = white(np.random.default_rng(4), 400).astype(np.complex64)
    beyond, returns = BeyondSpan(W, 1500.0), ReturnEstimator(W, 1500.0, SETTINGS)
    assert np.count_nonzero(beyond.ratio(frames)) - np.isnan(beyond.ratio(frames)).sum() == 0
    beyond._threshold = line.sum_level(line.sum_chance(beyond._threshold, 2) * 2e4, 2)  # 0.2 per frame
    assert np.mean(np.nan_to_num(beyond.ratio(frames)) > 0) < 0.2
    assert max(returns.visibility(frame) for frame in frames) < SETTINGS.visible_ratio
    assert np.mean([returns.is_consistent(frame) for frame in frames]) <= SETTINGS.chance + 0.01
