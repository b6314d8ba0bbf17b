"""A channel that moves: one course for all symbols, and points on the axes that stay there."""

from dataclasses import replace

import numpy as np
import pytest

from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation import create
from radalt.core.mitigation.ofdm import still
from radalt.core.mitigation.ofdm.channel_fit import standing
from radalt.core.mitigation.ofdm.demodulator import again
from radalt.core.mitigation.ofdm.lattice import DENSE, SPARSE_POINTS, decide, nearest
from radalt.core.waveform import Waveform

W = Waveform()
TIME_S = np.arange(7500) / 7.5e6
MIDDLE = slice(600, -600)


def test_points_on_the_axes_are_decided_again_on_the_axes():
    """The primary synchronisation signal is BPSK; in elements that hold the return, too, its points are on the axes."""
    rng = np.random.default_rng(1)
    anything = rng.standard_normal((4, 240, 2), dtype=np.float32).view(np.complex64)[..., 0]
    points = nearest(anything, 64)
    points[0, :120] = rng.choice([1, -1], 120)
    points[1, 120:] = rng.choice(SPARSE_POINTS[1:5], 120)
    heard = points + np.float32(0.01) * anything[::-1]
    every = np.ones(points.shape, dtype=bool)
    within = np.abs(np.arange(240) - 119.5) > 12  # blocks of one alphabet
    found = decide(heard, every, np.zeros(4, dtype=int))
    np.testing.assert_allclose(found.points[:, within], points[:, within], atol=1e-6)
    kinds = np.full(points.shape, DENSE.index(64), dtype=np.int8)
    again(found, heard, np.ones(240, dtype=np.complex64), every, kinds)
    np.testing.assert_allclose(found.points[:, within], points[:, within], atol=1e-6)
    assert found.capped[:, within].max() < 0.1


def faded_sums(count):
    """Frames (count, 7500) of a carrier over two paths of opposite Doppler whose sum fades, noise 50 dB below it."""
    rng = np.random.default_rng(5)
    turning = np.exp(2j * np.pi * 120.0 * (TIME_S - 0.5e-3))
    frames = np.empty((count, 7500), dtype=np.complex64)
    for frame in frames:
        sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7501, 7.5e6, rng)
        heard = sent[1:] * turning - 0.9 * sent[:-1] * turning.conj()
        heard /= np.sqrt(np.mean(np.abs(heard) ** 2))
        noise = rng.standard_normal((7500, 2)).view(np.complex128)[:, 0]
        frame[:] = heard + 10 ** (-53 / 20) * noise
    return frames


def test_where_the_sum_of_echoes_fades_one_course_of_all_symbols_explains_them(monkeypatch):
    """Only noise is left, in frames that are given that course, and it is taken where it leaves less."""
    even, taken = still._evened, []

    def told(frame, received, modulator):
        found = even(frame, received, modulator)
        if found:
            heard = frame.clear & frame.grid.used
            assert found.received.noise <= received.noise
            assert found.received.capped[heard].mean() <= received.capped[heard].mean()
            np.testing.assert_allclose(np.abs(found.received.phase), 1, atol=1e-5)
        taken.append(found is not None)
        return found

    monkeypatch.setattr(still, "_evened", told)
    frames = faded_sums(6)
    method = create("ofdm_cancel", W)
    for frame in frames:
        method.reset()
        out = method.process(frame[None])[0]
        # noise in the elements that may hold a return, and whatever the channel's own noise adds
        assert np.median(np.abs(out[MIDDLE]) ** 2) < 10 ** (-5.5)
    assert any(taken)  # how many depends on rounding: both readings may be as good


def test_a_channel_that_stands_still_is_not_given_a_course(monkeypatch):
    monkeypatch.setattr(still, "_less", lambda *_: pytest.fail("there is no change within symbols"))
    rng = np.random.default_rng(7)
    sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7500, 7.5e6, rng)
    noise = rng.standard_normal((7500, 2)).view(np.complex128)[:, 0] * 10 ** (-53 / 20)
    out = create("ofdm_cancel", W).process((sent + noise).astype(np.complex64)[None])[0]
    assert np.median(np.abs(out[MIDDLE]) ** 2) < 10 ** (-5.5)


def test_a_symbol_that_was_read_in_part_has_its_spread_taken_away(monkeypatch):
    """What it spreads over its weak elements is what hides them; a symbol that a burst cuts is left alone."""
    whole, taken = still._whole, []

    def told(frame, received):
        error = received.misread.copy()
        error[[2, 5]] = 0.3, 0.7
        cut = frame.clear.copy()
        cut[7] = False
        taken.append(whole(replace(frame, clear=cut), replace(received, misread=error)))
        return whole(frame, received)

    monkeypatch.setattr(still, "_whole", told)
    create("ofdm_cancel", W).process(faded_sums(1))
    assert taken and all(one[2] and not one[5] and not one[7] for one in taken)


def test_a_course_of_which_few_symbols_tell_does_not_run_away():
    """The channel of subcarriers that are silent in most symbols stays as loud as what is received there."""
    rng = np.random.default_rng(9)
    times = np.linspace(-1, 1, 13, dtype=np.float32)
    points = nearest(rng.standard_normal((13, 500, 2), dtype=np.float32).view(np.complex64)[..., 0], 64)
    points[4:, 200:220] = 0
    channel = (1 + 0.2 * times[:, None] + np.zeros(500)).astype(np.complex64)
    symbols = channel * points
    runs = channel * (1 + 30 * np.maximum(times, 0)[:, None] ** 2 * (np.arange(500) // 20 == 10)).astype(
        np.complex64
    )
    every = np.ones(points.shape, dtype=bool)
    kept, _ = standing(symbols, runs, points, times, every, 1e-9, every)
    np.testing.assert_array_equal(kept[:, :200], channel[:, :200])
    assert np.abs(kept).max() < 2.5 < np.abs(runs).max()


def test_a_symbol_that_fades_is_taken_away_like_the_others():
    """The amplitude falls evenly to a fifth: the last symbols have less than a tenth of the first one's power."""
    rng = np.random.default_rng(11)
    sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7500, 7.5e6, rng)
    noise = rng.standard_normal((7500, 2)).view(np.complex128)[:, 0] * 10 ** (-53 / 20)
    method = create("ofdm_cancel", W)
    out = method.process((sent * (1 - 0.8e3 * TIME_S) + noise).astype(np.complex64)[None])[0]
    assert method.busy == 1
    late = out[-1200:-600]
    assert np.any(late) and np.median(np.abs(late) ** 2) < 10 ** (-4.8)
