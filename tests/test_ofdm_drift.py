"""A strongest path that moves: it turns all subcarriers alike, within each symbol too, and fades in a curve."""

import numpy as np
import pytest

from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation import create
from radalt.core.waveform import Waveform

W = Waveform()
TIME_S = np.arange(7500) / 7.5e6
MIDDLE = slice(600, -600)


def left_db(course):
    """What is left of a carrier heard through one path of that course in time, with noise 60 dB below it, in dB."""
    rng = np.random.default_rng(5)
    left = []
    for _ in range(4):
        sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7500, 7.5e6, rng) * course
        noise = rng.standard_normal((7500, 2)).view(np.complex128)[:, 0] * 10 ** (-63 / 20)
        heard = (sent + noise).astype(np.complex64)
        method = create("ofdm_cancel", W)
        out = method.process(heard[None])[0]
        assert method.found == 1
        left.append(np.median(np.abs(out[MIDDLE]) ** 2) / np.mean(np.abs(heard) ** 2))
    return 10 * np.log10(np.max(left))


@pytest.mark.parametrize("doppler_hz", [60.0, 120.0])
def test_a_path_that_turns_and_fades_is_taken_away(doppler_hz):
    turning = np.exp(2j * np.pi * doppler_hz * TIME_S)
    assert left_db(turning + 0.3 * turning.conj()) < -62


def test_a_path_that_swells_and_fades_evenly_about_the_middle_is_taken_away():
    assert left_db(1 - 0.4 * (2000 * TIME_S - 1) ** 2) < -60
