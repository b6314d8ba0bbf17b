"""A channel that moves is estimated together with the return; what was misread is not kept for one."""

from types import SimpleNamespace

import numpy as np
import pytest

from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation import create, ofdm_cancel
from radalt.core.mitigation.ofdm import settled
from radalt.core.mitigation.ofdm.acquisition import transforms
from radalt.core.mitigation.ofdm.emission import Emission
from radalt.core.mitigation.ofdm.lattice import CELL
from radalt.core.mitigation.ofdm.modulator import Modulator
from radalt.core.mitigation.ofdm.numerology import Numerology
from radalt.core.mitigation.ofdm.ridge import Ridge, read_around
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform

W = Waveform()
N = W.samples_per_frame
TIME_S = np.arange(N) / W.rate_hz


def noise(rng, *shape):
    return rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] * np.sqrt(0.5)


@pytest.mark.parametrize("altitude_m", [3.0, 437.0, 1490.0])
@pytest.mark.parametrize("speed", [-150.0, 0.0, 150.0])
def test_a_return_is_the_sum_of_its_tones(altitude_m, speed):
    """At an SNR of 10 dB, with a tenth of the frame blanked, less than -20 dB of the return is not in its tones."""
    rng = np.random.default_rng(3)
    back = point_return(
        W,
        np.array([altitude_m]),
        vertical_speed_m_per_s=np.array([speed]),
        phase_cycles=np.array([0.3]),
        dtype=np.complex128,
    )[0]
    heard = (back + np.sqrt(0.1) * noise(rng, N)) * (np.arange(N) % 535 > 53)
    tones = settled.Returned(W, 1500.0)._tones(heard.astype(np.complex64), None)
    rest = back.copy()
    for tone in tones:
        rest -= tone * np.vdot(tone, back) / np.vdot(tone, tone)
    turned = (
        int(np.ceil(2 * altitude_m / 3e8 * W.rate_hz)) + 1
    )  # samples in which the half before still comes back
    away = np.r_[turned : N // 2, N // 2 + turned : N]
    assert np.mean(np.abs(rest[away]) ** 2) < 0.01


def frames_and_truth(count):
    """Frames of two paths with opposite Doppler 40 dB above a return; and return and noise alone."""
    rng = np.random.default_rng(11)
    turning = np.exp(2j * np.pi * 120.0 * (TIME_S - 0.5e-3))
    altitude_m = rng.uniform(50.0, 1400.0, count)
    truth = point_return(
        W,
        altitude_m,
        vertical_speed_m_per_s=np.zeros(count),
        phase_cycles=rng.random(count),
        dtype=np.complex128,
    )
    truth += np.sqrt(0.1) * noise(rng, count, N)
    frames = truth.copy()
    for frame in frames:
        sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(N + 1, W.rate_hz, rng)
        heard = sent[1:] * turning - 0.5 * sent[:-1] * turning.conj()
        frame += 100.0 * heard / np.sqrt(np.mean(np.abs(heard) ** 2))
    return frames.astype(np.complex64), truth


def test_the_return_is_kept_better_where_it_is_settled_with_the_channel(monkeypatch):
    """Elements that are kept differ less from return and noise than where the channel was extrapolated to them."""
    frames, truth = frames_and_truth(6)
    errors, now = {}, []
    settle = settled.Returned.settled

    def told(self, frame, sent, less, modulator):
        out = settle(self, frame, sent, less, modulator)
        received, sent = out[:2]
        turn, clear = frame.straight.turn, frame.clear
        level = np.sqrt(np.mean(np.abs(now[0]) ** 2))
        alone = (now[1] / level * (1 if turn is None else turn)).astype(np.complex64)
        left = received.symbols * received.phase.conj() - sent.elements
        wrong = left - transforms(alone, frame.grid.starts, frame.numerology)
        ends = sent.kept & ~clear & np.isin(np.arange(len(clear)), [0, len(clear) - 1])[:, None]
        errors.setdefault(settled._TURNS, []).append(np.mean(np.abs(wrong[ends]) ** 2) * level**2)
        return out

    monkeypatch.setattr(settled.Returned, "settled", told)
    method = create("ofdm_cancel", W)
    for turns in (0, settled._TURNS):
        monkeypatch.setattr(settled, "_TURNS", turns)
        for frame, alone in zip(frames, truth, strict=True):
            now[:] = frame, alone
            method.reset()
            method.process(frame[None])
    before, after = (np.median(errors[turns]) for turns in (0, settled._TURNS))
    assert after < 0.5 * before


def kept_return(rng, spoilt):
    """The return's elements, and a frame in which those from the symbol ``spoilt`` on are others of its size."""
    numerology = Numerology(W.rate_hz, 15e3)
    starts = numerology.windows(numerology.times(300.0, N), N)[1]
    sweep = point_return(
        W,
        np.array([700.0]),
        vertical_speed_m_per_s=np.zeros(1),
        phase_cycles=np.zeros(1),
        dtype=np.complex128,
    )[0]
    clear = Ridge(W, numerology, 1500.0).clear(starts, 0.0)
    symbols = transforms(sweep.astype(np.complex64), starts, numerology)
    held = ~clear
    size = np.sqrt(np.mean(np.abs(symbols[held]) ** 2))
    heard = symbols + (0.2 * size * noise(rng, *symbols.shape)).astype(np.complex64)
    heard[spoilt:] = 2 * size * noise(rng, *heard[spoilt:].shape)
    frame = SimpleNamespace(grid=SimpleNamespace(starts=starts), numerology=numerology)
    received = SimpleNamespace(symbols=heard, phase=np.ones((len(starts), 1), dtype=np.complex64))
    sent = Emission(np.zeros_like(symbols), np.ones(len(starts), dtype=bool), 1.0, kept=held)
    return sweep, symbols, held, frame, received, sent


def test_a_third_of_a_frame_that_was_misread_does_not_hide_its_return():
    """What is found there is the return, and most of what was misread goes, but hardly anything else."""
    rng = np.random.default_rng(17)
    sweep, symbols, held, frame, received, sent = kept_return(rng, -4)
    tones = settled.Returned(W, 1500.0)._tones(sweep.astype(np.complex64), None)
    back = settled._found(tones, held, received, sent, frame)
    strong = held & (np.abs(symbols) > 0.5 * np.abs(symbols[held]).max())
    assert np.mean(np.abs(back - symbols)[strong] ** 2) < 0.05 * np.mean(np.abs(symbols[strong]) ** 2)
    less = settled._fitting(sent, received, back, held)
    spoilt = held & (np.arange(len(held)) >= len(held) - 4)[:, None]
    assert less.kept[spoilt].mean() < 0.3
    assert less.kept[held & ~spoilt].mean() > 0.95
    gone = held & ~less.kept
    np.testing.assert_array_equal(less.elements[gone], received.symbols[gone])
    assert not less.elements[less.kept].any()


@pytest.mark.parametrize(
    ("misread", "sir_db", "given"), [(0.11, -23.0, False), (0.11, -15.0, False), (0.09, -23.0, True)]
)
def test_a_return_larger_than_a_cell_is_none_where_much_was_misread(misread, sir_db, given):
    received = SimpleNamespace(mean_misread=misread)
    frame = SimpleNamespace(received=received, straight=None, grid=None, clear=None)
    sent = Emission(np.zeros((13, 500)), np.ones(13, dtype=bool), 1.0, sir_db=sir_db)
    out = np.ones(N, dtype=np.complex64)
    found = settled.Returned(W, 1500.0).settled(frame, sent, out, None)
    assert found == ((received, sent, out) if given else None)


def test_noise_is_no_return(monkeypatch):
    found = []
    look = settled._found

    def told(*args):
        found.append(look(*args))
        return found[-1]

    monkeypatch.setattr(settled, "_found", told)
    method = create("ofdm_cancel", W)
    frames, truth = frames_and_truth(3)
    rng = np.random.default_rng(5)
    for frame, alone in zip(frames, truth, strict=True):
        method.reset()
        method.process(frame[None])
        assert found and all(back is not None for back in found)
        found.clear()
        without = frame - alone + np.sqrt(0.1) * noise(rng, N)
        method.reset()
        method.process(without.astype(np.complex64)[None])
        assert found and all(back is None for back in found)
        found.clear()


def test_a_region_that_was_misread_is_not_kept_where_it_looks_like_a_return_by_chance():
    rng = np.random.default_rng(7)
    capped = (0.2 * rng.random((13, 500))).astype(np.float32)
    asked = np.ones(capped.shape, dtype=bool)
    capped[4, 200:300] = np.minimum(2 * rng.random(100), 1)
    kept = read_around(capped, capped, asked)
    assert not kept[4, 210:290].any()
    kept[4, 180:320] = True
    assert kept.all()


def test_patches_of_a_return_from_rough_ground_are_kept():
    """40 echoes over 40 m: elements' powers differ like an exponential variable's, over whole regions. None is lost."""
    rng = np.random.default_rng(9)
    altitude_m = 700.0 + np.append(0.0, rng.exponential(40.0, 39))
    back = point_return(
        W,
        altitude_m,
        vertical_speed_m_per_s=np.zeros(40),
        phase_cycles=rng.random(40),
        dtype=np.complex128,
    ).sum(axis=0)
    numerology = Numerology(W.rate_hz, 15e3)
    starts = numerology.windows(numerology.times(300.0, N), N)[1]
    asked = ~Ridge(W, numerology, 1500.0).clear(starts, 0.0)
    size = np.abs(transforms(back.astype(np.complex64), starts, numerology)) ** 2
    assert size[asked].max() > 10 * size[asked].mean()
    # 64QAM 40 dB above the return: what is left of its elements is that part of a cell
    capped = np.minimum(1e-4 / np.mean(np.abs(back) ** 2) * size / CELL[64], 1).astype(np.float32)
    assert read_around(capped, size.astype(np.float32), asked)[asked].all()


def test_a_return_of_which_most_was_misread_is_not_kept(monkeypatch):
    """A frame then passes as it is: a missing altitude is better than a wrong one."""
    frames, _ = frames_and_truth(1)
    method = create("ofdm_cancel", W)
    assert np.mean(np.abs(method.process(frames)[0]) ** 2) < 3.0
    monkeypatch.setattr(settled, "_ENOUGH", 1.1)
    method.reset()
    np.testing.assert_array_equal(method.process(frames), frames)
    assert method.found == 0


def test_only_what_is_louder_where_symbols_meet_is_blanked():
    """Remains that single samples do not give away are seen in the mean of all places where symbols meet."""
    rng = np.random.default_rng(13)
    numerology = Numerology(W.rate_hz, 15e3)
    held, starts = numerology.windows(numerology.times(300.0, N), N)
    left = np.exp(2j * np.pi * rng.random(N))
    meet = np.append(starts - numerology.prefix / 2, starts[-1] + numerology.useful + numerology.prefix / 2)
    meet = meet[(meet > 40) & (meet < N - 40)].round().astype(int)
    near = (np.abs(np.arange(N)[:, None] - meet) <= 15).any(axis=1)
    louder = left + near * 1.3 * noise(rng, N)
    nothing = np.zeros((starts.size, 500), dtype=np.complex64)
    every = np.ones(starts.size, dtype=bool)
    modulator = Modulator(N)
    out = modulator.subtract(louder.astype(np.complex64), None, nothing, every, starts, numerology)
    inside = (np.abs(np.arange(N)[:, None] - meet) <= 10).any(axis=1)
    beside = (np.abs(np.arange(N)[:, None] - meet) > 25).all(axis=1)
    assert not out[inside].any() and np.all(out[beside])
    np.testing.assert_array_equal(
        modulator.subtract(left.astype(np.complex64), None, nothing, every, starts, numerology),
        left.astype(np.complex64),
    )


@pytest.mark.parametrize(("sir_db", "seen"), [(-10.0, True), (-30.0, False)])
def test_a_return_that_is_seen_as_it_is_needs_no_thorough_reading(monkeypatch, sir_db, seen):
    """Its beat stands above the mean of a half sweep's by the SIR and the gain of 3,750 samples (35.7 dB)."""
    frames, truth = frames_and_truth(2)
    frames = truth + 10 ** (-sir_db / 20 - 2) * (frames - truth)
    asked = []
    read = ofdm_cancel.OfdmCancel._thoroughly
    monkeypatch.setattr(
        ofdm_cancel.OfdmCancel, "_thoroughly", lambda self, first: asked.append(1) or read(self, first)
    )
    method = create("ofdm_cancel", W)
    for frame in frames.astype(np.complex64):
        assert settled.Returned(W, 1500.0).seen(frame) == seen
        method.reset()
        method.process(frame[None])
    assert bool(asked) != seen


def test_one_half_sweep_with_a_tone_in_step_with_it_is_no_return():
    """A return has a beat in both half sweeps."""
    frames, truth = frames_and_truth(1)
    half = truth[0] * (np.arange(N) < N // 2)
    assert not settled.Returned(W, 1500.0).seen((frames[0] - truth[0] + 100 * half).astype(np.complex64))
