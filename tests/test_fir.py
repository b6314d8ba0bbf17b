"""Windows and low-pass against SciPy's own, which the package does without (core/fir.py)."""

import numpy as np
import pytest
from scipy import signal

from radalt.core.fir import WINDOWS, cosine_window, kaiser_lowpass, kaiser_window, tukey_window


@pytest.mark.parametrize("points", [8, 65, 3750])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("name", WINDOWS)
def test_windows_are_scipys_to_the_bit(name, points, periodic):
    expected = signal.get_window(name, points, fftbins=periodic)
    assert np.array_equal(cosine_window(name, points, periodic=periodic), expected)


@pytest.mark.parametrize("points", [20, 7500, 7501])
def test_tukey_and_kaiser_are_scipys_to_the_bit(points):
    assert np.array_equal(tukey_window(points, 0.1), signal.windows.tukey(points, 0.1))
    assert np.array_equal(kaiser_window(points, 5.0), signal.windows.kaiser(points, 5.0))


@pytest.mark.parametrize(
    ("pass_hz", "stop_hz", "rate_hz"), [(123e3, 377e3, 7.5e6), (1.5e6, 4.7e6, 56e6), (3.375e6, 3.75e6, 30e6)]
)
def test_low_pass_is_scipys_to_the_bit_and_keeps_its_word(pass_hz, stop_hz, rate_hz):
    taps = kaiser_lowpass(pass_hz, stop_hz, rate_hz)
    count, beta = signal.kaiserord(80.0, (stop_hz - pass_hz) / (rate_hz / 2))
    window = ("kaiser", beta)
    assert np.array_equal(taps, signal.firwin(count | 1, (stop_hz + pass_hz) / 2, window=window, fs=rate_hz))
    frequency, response = signal.freqz(taps, worN=20_000, fs=rate_hz)
    assert np.abs(response[frequency >= stop_hz]).max() < 10 ** (-78 / 20)
    assert np.abs(np.abs(response[frequency <= pass_hz]) - 1).max() < 3e-4
