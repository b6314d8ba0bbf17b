"""Frame timing: acquired to a fraction of a sample, coasting, honest about every lost sample (docs/design.md)."""

from dataclasses import dataclass

import numpy as np
import pytest
from frames import ALTIMETER, N, W, measured
from test_slips import received

from radalt import Waveform
from radalt.core.channel.settings import ChannelSettings, DropSettings
from radalt.core.channel.simulated import SimulatedChannel
from radalt.core.interference import Interferer, QpskEmitter
from radalt.core.interference.stream import JammerStream
from radalt.core.programme import Programme
from radalt.core.returns.point import point_return
from radalt.core.timing.segmenter import Frame, FrameSegmenter, SegmenterSettings
from radalt.core.timing.sweep_finder import SweepFinder
from radalt.core.waveform import delay_to_altitude_m

LANDING = tuple(np.geomspace(1500, 3, 10))


@dataclass
class Run:
    """What came out of one run, and what was lost in it."""

    frames: list[Frame]
    segmenter: FrameSegmenter
    channel: SimulatedChannel
    gaps: tuple[tuple[int, int], ...]
    unlocked: list[bool]  # by block, after it was pushed

    @property
    def index(self) -> np.ndarray:
        return np.array([f.index for f in self.frames])


def play(
    programme: Programme,
    settings: ChannelSettings,
    seed: int,
    *,
    true_delay: bool = False,
    jammer: Interferer | None = None,
    monitor: bool = True,
) -> Run:
    """Transmitter, channel and segmenter, block by block; tagged gaps are told to the segmenter as rx_time tells."""
    total = programme.total_frames + 3
    flown = programme if true_delay else None
    channel = SimulatedChannel(W, settings, seed=seed, true_delay=flown, frames=total)
    segmenter = FrameSegmenter(W, programme, SegmenterSettings(monitor=monitor), true_delay=true_delay)
    jam = JammerStream(W, [jammer], programme=programme, seed=seed) if jammer else None
    run = Run([], segmenter, channel, channel.gaps, [])
    tables: dict[float, np.ndarray] = {}
    expected = 0
    for block in range(total):
        altitude = 0.0 if true_delay else float(programme.altitude_m(block))
        if altitude not in tables:
            tables[altitude] = W.beat_shifted(altitude)
        tx = tables[altitude]
        for counter, samples in channel.process(tx, jam.next_frame() if jam else None):
            if counter != expected and settings.drops.tagged:
                run.frames += segmenter.jump(counter - expected)
            run.frames += segmenter.push(samples)
            expected = counter + samples.size
        run.unlocked.append(segmenter.state != "locked")
    run.frames += segmenter.drain()
    return run


def errors(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """(frame index, altitude error) of the trials that gave an altitude, 512 frames at a time."""
    programme, index, error = run.segmenter.programme, [], []
    for first in range(0, len(run.frames), 512):
        part = run.frames[first : first + 512]
        number = np.array([f.index for f in part])
        result = measured(part)
        keep = programme.is_trial(number) & result["valid"]
        index.append(number[keep])
        error.append((result["altitude_m"] - programme.altitude_m(number))[keep])
    return np.concatenate(index), np.concatenate(error)


@pytest.mark.parametrize("offset", [0.0, 1.0, 64.5, 100.0, 100.5, 3749.99, 3750.01, 7498.4])
def test_latency_is_measured_to_a_hundredth_of_a_sample(offset):
    """Sweeps repeat, so it is known modulo a frame, -1..N-1: a latency of zero may come out a trifle negative."""
    settings = ChannelSettings(snr_db=20.0, start_offset_samples=offset)
    run = play(Programme((100.0,), 5), settings, 1)
    frame = run.frames[-1]
    measured = frame.start_sample - frame.index * N + frame.offset_s * W.rate_hz
    assert measured == pytest.approx(offset, abs=0.01)


@pytest.mark.parametrize("fraction", [0.125, 0.25, 0.5, 0.75, 0.875])
@pytest.mark.parametrize("true_delay", [False, True], ids=["synthetic", "true_delay"])
def test_no_fraction_of_a_sample_pulls_the_altitude(true_delay, fraction):
    """At 1500 m 2 % of each half sweep lie past the band's edge, where a delay of a fraction turns the phase."""
    settings = ChannelSettings(snr_db=30.0, start_offset_samples=500 + fraction)
    _, error = errors(play(Programme((1500.0, 3.0), 4), settings, 1, true_delay=true_delay))
    assert error.size == 8 and np.abs(error).max() < 0.15


@pytest.mark.parametrize("offset", [-0.45, 0.0, 0.3])
@pytest.mark.parametrize("waveform", [W, Waveform(centered=False), Waveform(shape="sawtooth_up")])
def test_a_frame_is_checked_against_the_return_of_a_point(waveform, offset):
    finder, offset_s = SweepFinder(waveform, SegmenterSettings(), true_delay=True), offset / waveform.rate_hz
    for altitude_m, rate in ((0.0, 0.0), (100.0, -10.0), (1500.0, 40.0)):
        expected = finder.expected_frame(altitude_m, rate, offset_s)
        at_m = altitude_m + delay_to_altitude_m(offset_s)
        sent = point_return(waveform, at_m, vertical_speed_m_per_s=rate)
        assert abs(np.vdot(expected, sent)) > 0.99 * N**0.5


@pytest.mark.parametrize("snr_db", [10.0, 0.0, -10.0])
def test_weak_signal_is_acquired_as_well(snr_db):
    run = play(Programme((300.0,), 5), ChannelSettings(snr_db=snr_db), 3)
    frame = run.frames[-1]
    measured = frame.start_sample - frame.index * N + frame.offset_s * W.rate_hz
    error = 0.003 * 10 ** (-(snr_db - 20) / 20) + 0.003
    assert measured == pytest.approx(run.channel.latency_samples, abs=error)


def test_noise_alone_is_never_locked_on():
    segmenter = FrameSegmenter(W, Programme())
    rng = np.random.default_rng(1)
    for _ in range(60):
        noise = rng.standard_normal(2 * N, dtype=np.float32).view(np.complex64)
        assert segmenter.push(noise) == []
    assert segmenter.status()["state"] == "acquiring"
    assert segmenter.counters["unlocked_frames"] > 50


def test_whole_chain_of_impairments_leaves_the_altitude_within_metres():
    receiver = {"adc_bits": 12, "full_scale": 40.0, "dc_offset": 0.5, "iq_gain_db": 0.5, "iq_phase_deg": 2.0}
    settings = ChannelSettings(snr_db=10.0, **receiver, jammer_clock_ppm=2.0, jammer_lo_offset_hz=1e3)
    run = play(Programme(LANDING, 5), settings, 6, jammer=Interferer(QpskEmitter(), -10.0, 0.5))
    _, error = errors(run)
    assert error.size == 50 and np.sqrt(np.mean(error**2)) < 1.0


@pytest.mark.parametrize("drops", [DropSettings(), DropSettings(3, 100, 3000, tagged=False)])
def test_ragged_chunks_give_what_one_chunk_gives_bit_for_bit(drops):
    programme = Programme((800.0, 50.0), 40, sync_every_frames=20)
    stream = received(programme, False, 15.0, 3, drops=drops)
    one = FrameSegmenter(W, programme)
    expected = one.push(stream) + one.drain()
    ragged = FrameSegmenter(W, programme)
    rng, got, at = np.random.default_rng(2), [], 0
    while at < stream.size:
        size = int(rng.choice([1, 7, 100, 7499, 7500, 7501, 30_000]))
        got += ragged.push(stream[at : at + size])
        at += size
    got += ragged.drain()
    assert len(got) == len(expected) > 40
    for a, b in zip(got, expected, strict=True):
        assert (a.index, a.start_sample, a.offset_s) == (b.index, b.start_sample, b.offset_s)
        assert a.samples.tobytes() == b.samples.tobytes()
    assert ragged.counters == one.counters


def torn_indices(run: Run) -> set[int]:
    """Sweeps of which a sample is missing, from the channel's own list of gaps."""
    latency = run.channel.latency_samples
    torn: set[int] = set()
    for first, length in run.gaps:
        low, high = np.floor((np.array([first, first + length - 1]) - latency) / N).astype(int)
        torn |= set(range(low, high + 1))
    return torn


def test_a_hundred_tagged_drops_in_five_seconds():
    """Issue 2: every drop counted, lock back within 5 frames with the altitude right, no altitude from a torn frame."""
    programme = Programme(tuple(np.geomspace(1500, 20, 10)), 500)
    run = play(programme, ChannelSettings(snr_db=20.0, drops=DropSettings(100, 100, 5000)), 11)
    counters = run.segmenter.counters
    assert len(run.gaps) == 100
    assert counters["discontinuities"] == 100
    assert counters["lost_samples"] == sum(length for _, length in run.gaps)
    torn = torn_indices(run)
    assert counters["torn"] == len(torn)
    index = set(run.index.tolist())
    assert not index & torn
    assert len(index) == len(run.frames)
    # nothing but torn frames is missing: lock is back with the next whole one
    sent = set(range(8, programme.total_frames))
    assert sent - index == sent & torn
    _, error = errors(run)
    assert error.size >= 5_000 - len(torn)
    assert np.abs(error).max() < 1.0 and np.sqrt(np.mean(error**2)) < 0.5
    assert counters["lock_losses"] == 0


def test_tagged_gap_in_the_preamble_is_survived():
    """Acquisition starts over on what follows; the preamble is longer than one acquisition."""
    programme = Programme((500.0,), 20, preamble_frames=20)
    segmenter = FrameSegmenter(W, programme)
    stream = received(programme, False, 15.0, 7)
    frames = segmenter.push(stream[: 3 * N + 123])
    frames += segmenter.jump(400)
    frames += segmenter.push(stream[3 * N + 523 :]) + segmenter.drain()
    run = Run(frames, segmenter, None, (), [])
    _, error = errors(run)
    assert error.size == 20 and np.abs(error).max() < 0.5


@pytest.mark.parametrize("by_hand", [False, True])
def test_after_a_loss_of_unknown_length_no_altitude_is_taken_for_zero(by_hand):
    """Timing taken anew at 300 m would read every altitude 300 m short; it waits for altitude zero."""
    programme = Programme((300.0,), frames_per_step=60)
    samples = np.concatenate([W.beat_shifted(float(a)) for a in programme.altitude_m(np.arange(60))])
    segmenter = FrameSegmenter(W, None if by_hand else programme)
    segmenter.push(samples[: 30 * N])
    assert segmenter.state == "locked"
    segmenter.restart(30 * N + 1234)
    assert segmenter.push(samples[30 * N + 1234 :]) == []
    assert segmenter.state == "lost" and segmenter.counters["lock_losses"] == 1


def test_time_that_runs_backwards_is_not_trusted():
    programme = Programme((500.0,), 60, sync_every_frames=20)
    segmenter = FrameSegmenter(W, programme)
    stream = received(programme, False, 15.0, 8)
    segmenter.push(stream[: 20 * N])
    segmenter.jump(-1)  # 20 m
    assert not segmenter.status()["locked"]
    assert segmenter.counters["lock_losses"] == 1


UNTAGGED = Programme(tuple(np.geomspace(1500, 20, 6)), 100, sync_every_frames=50)


@pytest.mark.parametrize("span", [(1, 1), (1, 100), (100, 5000), (7000, 8000), (20_000, 40_000)])
def test_untagged_loss_is_noticed_and_never_a_shifted_altitude(span):
    """One lost sample is 20 m with true delays; here it would shift the beats of both sweeps by the same amount.
    Frames are withheld from the loss until a synchronisation section has named the timing again."""
    drops = DropSettings(8, *span, tagged=False)
    run = play(UNTAGGED, ChannelSettings(snr_db=20.0, drops=drops), 1)
    index, error = errors(run)
    assert np.abs(error).max() < 1.0
    assert run.segmenter.counters["discontinuities"] == 0  # nobody told it
    counters = run.segmenter.counters
    assert counters["lock_losses"] >= 1
    assert any(run.unlocked)
    # every frame is counted once; an acquisition skips up to one
    received = len(run.unlocked) - sum(length for _, length in run.gaps) / N
    assert 0 <= received - counters["frames"] - counters["unlocked_frames"] <= 8
    # a section two frames off is still found; longer losses name themselves by rx_time only
    if span[1] <= 5000:
        assert index.size > 100
        assert run.segmenter.counters["acquisitions"] >= 2


def test_without_a_programme_reacquisition_waits_for_the_command():
    """Altitudes moved by hand: the person sets zero and says so."""
    segmenter = FrameSegmenter(W, None, noise=False)
    zero, high = W.beat_shifted(0.0), W.beat_shifted(600.0)
    frames = segmenter.push(np.tile(zero, 10)[100:])
    assert segmenter.status()["locked"] and frames
    segmenter.push(np.tile(high, 5))
    segmenter.push(np.tile(high, 10)[3000:])
    assert not segmenter.status()["locked"]
    segmenter.push(np.tile(zero, 4))
    segmenter.reacquire()
    frames = segmenter.push(np.tile(zero, 10)) + segmenter.drain()
    assert segmenter.status()["locked"]
    result = ALTIMETER.process(np.stack([f.samples for f in frames]), timing_offset_s=frames[0].offset_s)
    np.testing.assert_allclose(result["altitude_m"], 0.0, atol=0.1)


def test_programme_is_preamble_trials_and_synchronisation_in_order():
    programme = Programme((10.0, 20.0, 30.0), 4, preamble_frames=6, sync_every_frames=5, sync_frames=8)
    plan = [0.0] * 6 + [10, 10, 10, 10, 20] + [0.0] * 8 + [20, 20, 20, 30, 30] + [0.0] * 8 + [30, 30]
    index = np.arange(programme.total_frames)
    assert programme.total_frames == len(plan) and programme.trial_frames == 12
    np.testing.assert_array_equal(programme.altitude_m(index), plan)
    np.testing.assert_array_equal(programme.is_trial(index), np.array(plan) > 0)
    assert programme.next_sync(0) == (0, 6)
    assert programme.next_sync(3) == programme.next_sync(7) == (11, 8)
    assert programme.next_sync(12) == (24, 8) and programme.next_sync(25) is None
    np.testing.assert_array_equal(programme.altitude_m([-1, len(plan)]), 0.0)


def test_strong_jammer_after_the_preamble_does_not_shake_the_timing():
    jammer = Interferer(QpskEmitter(), -40.0, 1.0)
    run = play(Programme((400.0,), 40), ChannelSettings(snr_db=10.0), 5, jammer=jammer)
    assert run.segmenter.counters["lock_losses"] == 0 and run.segmenter.counters["acquisitions"] == 1
    assert len(run.frames) >= 47
