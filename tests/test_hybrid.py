"""Hybrid: which method a frame goes to, what searches may cost, and that no choice makes a frame worse."""

import functools

import numpy as np
import pytest
from frames import W, returns, right
from scipy import fft, signal

from radalt import Altimeter
from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.qpsk_received import QpskReceivedEmitter
from radalt.core.interference.stream import JammerStream
from radalt.core.mitigation import create

N, RATE_HZ = W.samples_per_frame, W.rate_hz
NR10 = NrEmitter(channel_bandwidth_hz=10e6, seed=3, frame_count=2)


def stream(emitters, sir_db, count, seed, overlap=1.0, *, anew=False):
    """Altitudes and frames of emitters that send on from frame to frame, or are drawn ``anew`` in each."""
    altitude_m, frames = returns(np.random.default_rng(seed), count)
    parts = [Interferer(emitter, 0.0, overlap) for emitter in emitters]
    if anew:
        rng = np.random.default_rng(seed + 1)
        frames += interference_frames(parts, count, N, RATE_HZ, rng, total_sir_db=sir_db)
    else:
        jam = JammerStream(W, parts, seed=seed, free_running=overlap == 1.0, total_sir_db=sir_db)
        jam.next_frame()
        frames += np.stack([jam.next_frame() for _ in range(count)])
    return altitude_m, frames.astype(np.complex64)


independent = functools.partial(stream, anew=True)


def test_a_frame_without_interference_passes_bit_for_bit():
    frames = returns(np.random.default_rng(1), 4)[1].astype(np.complex64)
    method = create("hybrid", W)
    assert method.process(frames).tobytes() == frames.tobytes() and method.searched == 0


@pytest.mark.parametrize("emitter", [NR10, QpskReceivedEmitter()], ids=["OFDM", "QPSK"])
def test_what_can_be_demodulated_is_cancelled_and_tracked(emitter):
    altitude_m, frames = stream([emitter], -45.0, 12, 2)
    method = create("hybrid", W)
    assert right(method.process(frames), altitude_m) >= 0.9
    assert right(create("tcae", W).process(frames), altitude_m) < 0.5
    assert method.cancelled == 12 and method.searched <= 2


def test_tones_go_to_the_network():
    altitude_m, frames = independent([ToneEmitter(3)], -40.0, 4, 3)
    method = create("hybrid", W)
    np.testing.assert_array_equal(method.process(frames), create("tcae", W).process(frames))
    assert method.status()["cancelled"] == 0


@pytest.mark.parametrize(
    ("emitters", "overlap"),
    [
        ((QpskReceivedEmitter(),), 0.3),
        ((ToneEmitter(3), QpskEmitter(), NrEmitter(seed=6, frame_count=2)), 1.0),
        ((NR10, NrEmitter(channel_bandwidth_hz=10e6, seed=4, cell_id=7, frame_count=2)), 1.0),
    ],
    ids=["bursts", "mixture", "two carriers"],
)
def test_where_frames_may_be_dropped_searches_take_a_quarter_of_real_time_at_most(emitters, overlap):
    """25 FFTs of 7,500 points of 40 us are a frame."""
    _, frames = stream(emitters, -40.0, 100, 4, overlap)
    method, spent = create("hybrid", W, other="whitening", drop_when_slow=True), 0.0
    for frame in frames:
        before = method.searched
        method.process(frame)
        if method.searched > before:
            spent += sum(canceller.outcome.ffts for canceller in method._cancellers)
    assert 0 < spent <= 1200 + 0.25 * 25 * len(frames)  # a balance of 600, and the last search of at most 600


def test_where_no_frame_is_dropped_every_emitter_that_is_drawn_anew_is_searched():
    altitude_m, frames = independent([NR10], -40.0, 12, 12)
    method = create("hybrid", W, other="whitening")
    assert right(method.process(frames), altitude_m) >= 0.9 and method.searched >= 11


def test_what_is_left_of_a_strong_burst_is_kept_where_whitening_leaves_no_return():
    altitude_m, frames = independent([QpskReceivedEmitter()], -57.5, 24, 5, 0.3)
    assert right(create("whitening", W).process(frames), altitude_m) < 0.2
    assert right(create("hybrid", W, other="whitening").process(frames), altitude_m) >= 0.9


@pytest.mark.parametrize("start", range(4))
def test_time_division_duplex_is_cancelled_wherever_it_starts(start):
    """At -32 dB 256QAM next to a return that decisions would take for data; uplink slots are silent."""
    emitter = NrEmitter(
        channel_bandwidth_hz=20e6, subcarrier_spacing_hz=30e3, modulation="256qam", evm=0.035, tdd="DDDSU",
        frame_count=2, seed=600 + start, cell_id=600 + start,
    )  # fmt: skip
    altitude_m, frames = stream([emitter], -32.0, 20, 600 + start)
    assert right(frames, altitude_m) <= 0.5
    assert right(create("hybrid", W).process(frames), altitude_m) >= 0.9


def test_a_frame_whose_return_stands_out_is_not_searched():
    _, frames = independent([NR10], -12.0, 4, 5)
    method = create("hybrid", W)
    assert method.process(frames).size and method.searched == 0


def test_an_emitter_that_appears_later_is_found():
    _, before = stream([ToneEmitter(3)], -30.0, 30, 6)
    altitude_m, after = stream([QpskReceivedEmitter()], -45.0, 60, 7)
    method = create("hybrid", W)
    method.process(before)
    cleaned = method.process(after)
    assert right(cleaned, altitude_m) > 0.5 and method.cancelled > 30


def test_the_network_gains_on_the_error_vectors_that_a_cancelled_frame_keeps():
    """Error vectors of 17.5 %, as TS 38.104 allows QPSK, are 15 dB below it, and as narrow."""
    altitude_m, frames = independent([QpskReceivedEmitter(evm=0.175)], -43.0, 20, 8)
    pd = {m: right(create(m, W).process(frames), altitude_m) for m in ("tcae", "qpsk_cancel", "hybrid")}
    assert pd["hybrid"] > max(pd["tcae"], pd["qpsk_cancel"]) + 0.2


def test_a_frame_that_shows_no_return_when_cancelled_goes_to_the_network_as_received():
    """Error vectors hide it; the network knows QPSK that is constant between symbols, as no filter leaves it."""
    altitude_m, frames = independent([QpskEmitter(evm="typical")], -45.0, 10, 11)
    hybrid, cleaned = create("hybrid", W), frames.copy()
    for row, frame in zip(cleaned, frames, strict=True):
        hybrid.reset()
        row[:] = hybrid.process(frame)
        assert hybrid.cancelled == 1
    assert right(create("qpsk_cancel", W).process(frames), altitude_m) < 0.6
    assert right(cleaned, altitude_m) >= 0.8


@pytest.mark.parametrize("sir_db", [-15.0, -23.0])
@pytest.mark.parametrize("emitters", [(NR10,), (QpskReceivedEmitter(),), (ToneEmitter(2),)])
def test_no_frame_is_worse_than_without_mitigation(emitters, sir_db):
    altitude_m, frames = independent(emitters, sir_db, 20, 9)
    assert right(create("hybrid", W).process(frames), altitude_m) >= right(frames, altitude_m) - 0.05


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("level", [0.0, 1e-38, 1e30, 3e38])
def test_frames_of_any_level_pass_without_a_warning(level):
    rng = np.random.default_rng(3)
    noise = rng.uniform(-1.0, 1.0, (2, 2 * N)).astype(np.float32)
    assert create("hybrid", W).process((noise * np.float32(level)).view(np.complex64)).shape == (2, N)


def test_two_dft_spread_signals_make_no_altitude_without_a_return():
    """LTE's uplink of 600 and of 120 subcarriers, 26 dB over the noise: no more than in noise, 1.55 % by design."""
    rng = np.random.default_rng(1007)
    frames = np.sqrt(0.5) * rng.standard_normal((200, 2 * N)).view(complex)
    for width, first in ((600, -300), (120, 20)):
        grid, data = np.zeros((200, 15, 1000), complex), rng.integers(4, size=(200, 15, width))
        grid[..., np.arange(width) + first] = fft.fft(np.exp(0.5j * np.pi * data), norm="ortho")
        symbols = fft.ifft(grid, norm="ortho")[..., np.r_[930:1000, :1000]].reshape(200, -1)[:, : 2 * N]
        frames += 10**1.5 * np.sqrt(500 / width) * signal.resample_poly(symbols, 1, 2, axis=-1)
    for name in ("tcae", "hybrid"):
        assert Altimeter(W).process(create(name, W).process(frames.astype(np.complex64)))["valid"].sum() <= 8
