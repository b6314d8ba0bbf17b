"""A channel that fades and turns within a frame: it is read from its best symbols on."""

import numpy as np

from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation import create
from radalt.core.waveform import Waveform

W = Waveform()
TIME_S = np.arange(7500) / 7.5e6


def left_db(rng):
    """What is left of a carrier whose strongest path vanishes within the frame and returns turned by pi, in dB.

    Two paths, half as strong and a few samples later, stay; the noise is 60 dB below.
    """
    sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7500, 7.5e6, rng)
    doppler = 2 * np.pi * 60 * TIME_S
    heard = 2 * np.sin(doppler - 2 * np.pi * 60 * 0.4e-3) * sent
    heard += 0.5 * np.roll(sent, 3) + 0.35j * np.cos(doppler) * np.roll(sent, 1)
    heard += rng.standard_normal((7500, 2)).view(np.complex128)[:, 0] * 10 ** (-63 / 20)
    out = create("ofdm_cancel", W).process(heard.astype(np.complex64)[None])[0]
    return 10 * np.log10(np.median(np.abs(out[600:-600]) ** 2) / np.mean(np.abs(heard) ** 2))


def test_a_frame_whose_channel_fades_in_the_middle_is_read():
    """Most of them are; rounding, which differs from one NumPy to the next, decides about some."""
    rng = np.random.default_rng(5)
    assert sum(left_db(rng) < -48 for _ in range(8)) >= 6
