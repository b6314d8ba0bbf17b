"""Users of unequal powers: each one's lattice has an amplitude of its own, and its points tell it."""

from dataclasses import replace

import numpy as np
import pytest

from radalt.core.mitigation import create
from radalt.core.mitigation.ofdm.acquisition import acquire, find_prefix
from radalt.core.mitigation.ofdm.amplitudes import decide_scaled, levelled
from radalt.core.mitigation.ofdm.demodulator import MORE, SCALED, demodulate, once_more
from radalt.core.mitigation.ofdm.lattice import decide, nearest
from radalt.core.mitigation.ofdm.numerology import SPACINGS_HZ, Numerology
from radalt.core.mitigation.ofdm.ridge import Ridge
from radalt.core.receiver.altimeter import Altimeter, AltimeterSettings
from radalt.studies.cancellation.cases import CASES, WAVEFORM, received

HALVES = np.repeat([0, 1], [5, 8])
USERS = np.repeat(np.arange(10), 50)  # of each subcarrier
KINDS = np.array([16, 64, 256, 4, 64, 16, 256, 64, 4, 256])


def users(rng):
    """(13, 500) elements 50 dB above their noise: ten users of powers within 6 dB, drawn anew in each half slot."""
    points = np.empty((13, 500), dtype=np.complex64)
    for user, kind in enumerate(KINDS):
        anywhere = rng.uniform(-1.3, 1.3, (13, 50, 2)).astype(np.float32).view(np.complex64)[..., 0]
        points[:, user == USERS] = nearest(anywhere, kind)
    own = 10 ** (rng.uniform(-6, 0, (2, 10)) / 20)
    sent = points * own[HALVES][:, USERS].astype(np.float32)
    noise = rng.standard_normal((13, 500, 2)).view(np.complex128)[..., 0] * 10 ** (-53 / 20)
    return sent, (sent + noise).astype(np.complex64)


def wrong(found, sent):
    return np.mean(np.abs(found.points - sent) > 0.03)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_points_of_users_of_unequal_powers_are_told(seed):
    sent, heard = users(np.random.default_rng(seed))
    trusted = np.ones(heard.shape, dtype=bool)
    found, amplitudes = decide_scaled(heard, np.ones(500, dtype=np.float32), trusted, HALVES)
    assert wrong(found, sent) < 0.03 < 0.3 < wrong(decide(heard, trusted, HALVES), sent)
    assert amplitudes.shape == (2, 13, 500)


def test_the_amplitude_does_not_follow_the_channel_of_another_user():
    # in the channel's modulus the step between two users is smoothed, and half of it is in each one's subcarriers
    sent, heard = users(np.random.default_rng(4))
    trusted = np.ones(heard.shape, dtype=bool)
    step = 1 + 0.4 * np.tanh((np.arange(500) - 249.5) / 3)
    found, _ = decide_scaled((heard / step).astype(np.complex64), step.astype(np.float32), trusted, HALVES)
    found.points *= step
    assert wrong(found, sent) < 0.03


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_amplitudes_are_told_up_to_the_last_subcarriers_of_a_user(seed):
    # an amplitude that is wrong by 2 % leaves more than a return 40 dB below
    sent, heard = users(np.random.default_rng(seed))
    trusted = np.ones(heard.shape, dtype=bool)
    found, _ = decide_scaled(heard, np.ones(500, dtype=np.float32), trusted, HALVES)
    assert np.mean(np.abs(found.points - sent) > 0.01) < 0.01


def test_steps_between_users_are_taken_out_of_the_channel():
    rng = np.random.default_rng(5)
    number = np.arange(500)
    true = (1 + 0.3 * np.sin(number / 60)) * np.exp(0.02j * number)
    own = np.where(number < 250, 0.7, 1.1)
    smoothed = np.interp(number, [238, 262], [0.7, 1.1])
    amplitudes = np.broadcast_to((own / smoothed).astype(np.float32), (13, 500))
    told = rng.random((13, 500)) < 0.8
    level = levelled((true * smoothed).astype(np.complex64), amplitudes, told)
    ratio = level / true
    assert np.abs(ratio / ratio[0] - 1).max() < 0.02


@pytest.mark.parametrize("stream", [False, True])
def test_a_return_50_db_below_users_of_unequal_powers_is_measured(stream):
    frames, altitude_m = received(
        replace(CASES["nr10_powers"], stream=stream), -50.0, 20, np.random.default_rng(12)
    )
    method = create("ofdm_cancel", WAVEFORM)
    results = Altimeter(WAVEFORM, AltimeterSettings()).process(method.process(frames))
    assert results["valid"].all()
    error = np.abs(results["altitude_m"] - altitude_m)
    assert np.median(error) < 0.3
    assert error.max() < 2
    assert not stream or method.followed > 15


def test_an_emitter_of_equal_powers_is_read_as_before():
    frames, _ = received(CASES["nr10_stream"], -40.0, 3, np.random.default_rng(13))
    method = create("ofdm_cancel", WAVEFORM)
    method.process(frames)
    assert method._lock.before.scaled is False


def test_a_frame_with_unequal_powers_is_read_once_more_in_a_channel_that_stands_still():
    # turns with a course in time are for moving channels; amplitudes are told for one that is the same in all symbols
    frames, _ = received(CASES["nr10_powers"], -45.0, 1, np.random.default_rng(14))
    frame = (frames[0] / np.sqrt(np.mean(np.abs(frames[0]) ** 2))).astype(np.complex64)
    numerology = Numerology(WAVEFORM.rate_hz, SPACINGS_HZ[0])
    ridge = Ridge(WAVEFORM, numerology, 1500.0)
    grid = acquire(frame, find_prefix(frame, numerology), numerology, lambda starts: ridge.clear(starts, 0.0))
    clear = ridge.clear(grid.starts, 0.0)
    read = demodulate(grid, clear, numerology, SCALED, scaled=True)
    again = once_more(grid, clear, read, numerology, MORE)
    assert again.channel.shape == read.channel.shape == (500,)
    assert again.misread.mean() < 1.2 * read.misread.mean() < 0.1
