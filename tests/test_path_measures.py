"""Measures of a radio path against closed forms."""

import numpy as np
import pytest
from frames import N

from radalt import Waveform
from radalt.core.radio.path_measures import clipped_percent, ripple_db, strongest_lines


@pytest.mark.parametrize("centered", [True, False])
@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_ripple_of_a_path(centered, delay):
    """A filter of 1 dB times a cosine over the band has a ripple of 2 dB."""
    w = Waveform(centered=centered)
    sweep = np.exp(2j * np.pi * w.phase_cycles(np.mod(w.sample_times_s - delay / w.rate_hz, w.sweep_s)))
    sweeps = sweep * w.frame_rotation(np.arange(3, 7))[:, None]
    assert ripple_db(w, sweeps, delay, first=3) < 0.1
    hz = np.fft.fftfreq(sweeps.shape[1])
    filtered = np.fft.ifft(np.fft.fft(sweeps) * 10 ** (np.cos(2 * np.pi * 2 * hz) / 20))
    assert ripple_db(w, filtered, delay, first=3) == pytest.approx(2.0, abs=0.2)


def test_lines_over_the_noise():
    rng = np.random.default_rng(3)
    noise = 1e-3 * (rng.standard_normal((40, N)) + 1j * rng.standard_normal((40, N)))
    tone = 0.01 * np.exp(2j * np.pi * 300 / N * np.arange(N))
    dc, line, hz = strongest_lines(noise + tone + 0.03, 7.5e6)
    assert dc == pytest.approx(20 * np.log10(0.03), abs=0.05)
    assert (line, hz) == (pytest.approx(-40.0, abs=0.05), pytest.approx(300e3))


def test_clipped_rails():
    samples = np.array([1.0 + 0.2j, -0.5 - 1.0j, np.nan, 0.1], np.complex64)
    assert clipped_percent(samples) == pytest.approx(100 * 2 / 6)
