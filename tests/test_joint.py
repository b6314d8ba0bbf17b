"""QPSK and OFDM of equal power in one band, read jointly; what is not both of them is not touched."""

import numpy as np
import pytest

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.qpsk_received import QpskReceivedEmitter
from radalt.core.mitigation import create
from radalt.core.mitigation.joint import JointCancel
from radalt.core.mitigation.ofdm.tones import without_tones
from radalt.core.mitigation.qpsk.clock import find_clocks
from radalt.core.mitigation.qpsk.equaliser import Equaliser, nearest
from radalt.core.mitigation.qpsk.sequence import decide_sequence, other_decisions
from radalt.core.mitigation.qpsk.trains import Impulses, Pulse, Steps
from radalt.core.receiver.altimeter import Altimeter
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform

W = Waveform()
N, RATE_HZ = W.samples_per_frame, W.rate_hz
QPSK = {"paper": QpskEmitter(), "received": QpskReceivedEmitter()}
NR = NrEmitter(cell_id=77, frame_count=2, seed=55)


def frames_under(emitters, sir_db, count, seed):
    """(count, N) frames under emitters of equal power, that SIR in all, at an SNR of 10 dB; and their altitudes."""
    rng = np.random.default_rng(seed)
    altitude_m = rng.uniform(3.0, 1500.0, count)
    frames = point_return(W, altitude_m, phase_cycles=rng.random(count), dtype=np.complex128)
    frames = frames + np.sqrt(0.05) * rng.standard_normal((count, N, 2)).view(np.complex128)[..., 0]
    if emitters:
        parts = [Interferer(emitter, 0.0) for emitter in emitters]
        frames = frames + interference_frames(parts, count, N, RATE_HZ, rng, total_sir_db=sir_db)
    return frames.astype(np.complex64), altitude_m


def in_narrow_noise(count, seed):
    """Points of QPSK, and the same under noise of a quarter of their band, 7 dB below them."""
    rng = np.random.default_rng(seed)
    points = nearest(rng.standard_normal((count, 2)).astype(np.float32).view(np.complex64)[:, 0])
    noise = np.fft.fft(rng.standard_normal((count, 2)).view(np.complex128)[:, 0])
    noise[count // 8 : -(count // 8)] = 0
    noise = np.fft.ifft(noise)
    noise *= 10 ** (-7 / 20) / np.sqrt(np.mean(np.abs(noise) ** 2))
    return points, (points + noise + 0.02 * rng.standard_normal(count)).astype(np.complex64)


@pytest.mark.parametrize("pulse", QPSK)
def test_hybrid_measures_under_tones_qpsk_and_nr_of_equal_power(pulse):
    # today's other methods end at -30 dB
    frames, altitude_m = frames_under([ToneEmitter(3), QPSK[pulse], NR], -40.0, 6, 1)
    method = create("hybrid", W)
    result = Altimeter(W).process(method.process(frames))
    right = result["valid"] & (np.abs(result["altitude_m"] - altitude_m) < 5)
    assert right.sum() >= 5
    assert method.cancelled >= 5


@pytest.mark.parametrize(
    "emitters",
    [(), (NR,), (QPSK["paper"],), (QPSK["received"],), (ToneEmitter(3), QpskEmitter(pulse="rrc"))],
    ids=["none", "nr", "paper", "received", "rrc"],
)
def test_a_frame_that_does_not_hold_both_is_no_mixture(emitters):
    method = JointCancel(W)
    for frame in frames_under(emitters, -30.0, 3, 2)[0]:
        toneless = without_tones(frame)
        assert method.cancel(frame if toneless is None else toneless) is None


def test_a_mixture_that_cannot_be_read_goes_where_it_went_before(monkeypatch):
    # noise 6 dB below each of the two: 64QAM cannot be read
    frames, _ = frames_under([QPSK["received"], NR], -35.0, 2, 3)
    noise = np.random.default_rng(4).standard_normal((2, N, 2)).view(np.complex128)[..., 0]
    frames = (frames + 10 ** ((35 - 3 - 6 - 3) / 20) * noise).astype(np.complex64)
    asked = []
    cancel = JointCancel.cancel
    monkeypatch.setattr(
        JointCancel, "cancel", lambda self, frame: asked.append(cancel(self, frame)) or asked[-1]
    )
    cleaned = create("hybrid", W).process(frames)
    assert asked == [None, None]
    np.testing.assert_array_equal(create("hybrid", W, joint=False).process(frames), cleaned)
    assert len(asked) == 2  # nothing is asked where it is left out


@pytest.mark.parametrize("level", [0.0, 1e-15, 1e15, 1e18])
def test_any_level_is_taken(level):
    frame = frames_under([QPSK["received"], NR], -40.0, 1, 5)[0][0]
    out = JointCancel(W).cancel(frame * np.float32(level))
    assert (out is None) == (level in (0.0, 1e18))  # of the last one squares do not fit
    if out is not None:
        assert 0 < np.mean(np.abs(out / np.float32(level)) ** 2) < 4


def test_errors_narrower_than_the_symbol_rate_are_predicted_and_vanish():
    points, outputs = in_narrow_noise(2000, 6)
    alone = nearest(outputs)
    assert np.count_nonzero(alone != points) > 20
    assert np.abs(decide_sequence(outputs, alone) - points).max() < 1e-3


@pytest.mark.parametrize("count", [70, 333, 2000])
def test_a_sequence_without_noise_is_what_it_is(count):
    points, _ = in_narrow_noise(count, 7)
    np.testing.assert_allclose(decide_sequence(points, points), points, atol=1e-3)


def test_the_likeliest_other_decision_mends_a_wrong_one():
    points, outputs = in_narrow_noise(2000, 8)
    wrong = points.copy()
    wrong[900:902] = -wrong[900:902].conj()
    events = other_decisions(outputs, wrong)
    events.flip(wrong, int(events.cost.argmin()))
    np.testing.assert_array_equal(wrong, points)


def test_steps_on_the_sample_grid_are_found_to_the_sample_under_a_signal_as_strong():
    rng = np.random.default_rng(9)
    sent = QPSK["paper"].samples(N, RATE_HZ, rng).astype(np.complex64)
    other = NR.samples(N, RATE_HZ, rng).astype(np.complex64)
    clock = find_clocks(sent, 28.0)[0]
    equaliser = Equaliser(sent, clock)
    symbols = equaliser.symbols(equaliser.blind(0))
    steps = Steps(sent + other, other, symbols, clock)
    inner = slice(100, -100)
    held = steps.source(steps.points)[inner] * sent[inner].conj()
    assert np.mean(np.abs(held - held.mean()) > 0.1) < 2e-3  # one symbol's turn against the emitter's phase


@pytest.mark.parametrize("pulse", QPSK)
def test_what_right_symbols_sound_like_is_known_better_than_the_other_signal_is_strong(pulse):
    rng = np.random.default_rng(10)
    sent = QPSK[pulse].samples(N, RATE_HZ, rng).astype(np.complex64)
    other = NR.samples(N, RATE_HZ, rng).astype(np.complex64)
    clock = find_clocks(sent, 28.0)[0]
    equaliser = Equaliser(sent, clock)
    symbols = equaliser.symbols(equaliser.blind(0))
    train = Steps(sent, other, symbols, clock) if pulse == "paper" else Impulses(symbols, clock, N)
    model = Pulse(sent + other, train, train.points, slice(0, N)).heard(train.points)
    inner = slice(100, -100)
    # 64 taps that are fitted to 7,500 samples have an error of -20 dB
    assert np.mean(np.abs(model - sent)[inner] ** 2) < 10 ** (-20.5 / 10)
