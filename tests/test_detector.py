"""The detector of interference: what it misses and what it takes for interference, measured."""

import numpy as np
import pytest
from frames import W, white

from radalt.core.interference.placement import Interferer, interference_frames
from radalt.core.mitigation.interference_detector import InterferenceDetector
from radalt.core.returns.point import point_return
from radalt.core.scene import parse_scene

FRAMES = 100


def clean(rng, snr_db, count=FRAMES, shifted=False):
    altitude = rng.uniform(5.0, 1400.0, count)
    frames = np.stack([W.beat_shifted(a) for a in altitude]) if shifted else point_return(W, altitude)
    return frames + 10 ** (-snr_db / 20) * white(rng, count)


EMITTERS = {
    "qpsk": {"qpsk": {"bandwidth_hz": 2.0025e6}},
    "wide qpsk": {"qpsk": {"bandwidth_hz": 7e6}},
    "tones": {"tones": {}},
    "pulses": {"pulsed_radar": {}},
    "nr": {"nr": {}},
}


def jammed(rng, name, sir_db, overlap):
    """Clean frames at 10 dB with interference of this name."""
    emitter = parse_scene({"interference": EMITTERS[name]}).interference[0].emitter
    frames = clean(rng, 10.0)
    return frames + interference_frames([Interferer(emitter, sir_db, overlap)], *frames.shape, W.rate_hz, rng)


@pytest.mark.parametrize("overlap", [0.05, 1.0])
@pytest.mark.parametrize("name", list(EMITTERS))
def test_interference_at_10_db_is_missed_in_less_than_one_of_a_thousand(name, overlap):
    frames = jammed(np.random.default_rng(7), name, 10.0, overlap)
    levels = InterferenceDetector(W).residual_db(frames)
    # stronger than counting a hundred: the threshold lies more than 3.1 standard deviations below the mean
    assert (levels.mean() - -8.0) / levels.std() > 3.1
    assert InterferenceDetector(W).present(frames).all()


@pytest.mark.parametrize("shifted", [False, True])
def test_clean_frames_are_let_pass(shifted):
    frames = clean(np.random.default_rng(3), 10.0, shifted=shifted)
    levels = InterferenceDetector(W).residual_db(frames)
    assert (-8.0 - levels.mean()) / levels.std() > 3.1 and not InterferenceDetector(W).present(frames).any()


def test_without_interference_the_residual_is_the_noise():
    levels = InterferenceDetector(W).residual_db(clean(np.random.default_rng(4), 3.0, count=50, shifted=True))
    assert np.allclose(levels, -3.0, atol=0.3)
    assert InterferenceDetector(W).present(clean(np.random.default_rng(4), 3.0, count=5)).all()


def test_frames_without_signal_or_not_finite_are_not_let_pass_nor_called_white():
    frames = np.zeros((3, W.samples_per_frame), np.complex64)
    frames[1] = np.nan
    frames[2, 17] = np.inf
    assert InterferenceDetector(W).present(frames).all()
    assert not InterferenceDetector(W).white(frames).any()


@pytest.mark.parametrize("snr_db", [-40.0, -20.0, -10.0])
def test_a_return_in_white_noise_is_seen_as_that(snr_db):
    rng = np.random.default_rng(12)
    assert InterferenceDetector(W).white(clean(rng, snr_db)).all()


@pytest.mark.parametrize("sir_db", [-5.0, -50.0])
@pytest.mark.parametrize("overlap", [0.1, 1.0])
@pytest.mark.parametrize("name", ["qpsk", "tones", "pulses", "nr"])
def test_interference_with_room_next_to_it_is_not_white(name, overlap, sir_db):
    assert not InterferenceDetector(W).white(jammed(np.random.default_rng(13), name, sir_db, overlap)).any()
