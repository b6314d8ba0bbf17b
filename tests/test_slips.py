"""Losses of samples that nobody marks: no altitude may be wrong in silence, whatever the programme.

More streams: ``RADALT_SLIP_STREAMS=2000``; through GNU Radio's block ``RADALT_SLIP_BLOCK_STREAMS``, --timeout=0."""

import os
import threading
from dataclasses import dataclass

import numpy as np
import pmt
import pytest
from frames import N, W, measured, noise
from gnuradio import blocks, gr, radalt
from waiting import patient

from radalt import Altimeter, AltimeterSettings, load_scene
from radalt.blocks._frames import time_tag
from radalt.core.channel.settings import ChannelSettings
from radalt.core.channel.simulated import SimulatedChannel
from radalt.core.interference.placement import interference_frames
from radalt.core.programme import Programme
from radalt.core.scene import parse_scene
from radalt.core.timing.segmenter import Frame, FrameSegmenter

ALTIMETER = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=30.0))
STREAMS = int(os.environ.get("RADALT_SLIP_STREAMS", "24"))
BLOCK_STREAMS = int(os.environ.get("RADALT_SLIP_BLOCK_STREAMS", "2"))
NOTICE_FRAMES = 50
WRONG_M = 5.0


@dataclass
class Stream:
    """A run as it comes from the radio: samples, and the losses (first sample, length, tagged) among them."""

    programme: Programme
    true_delay: bool
    by_hand: bool
    samples: np.ndarray
    losses: list[tuple[int, int, bool]]


def received(programme: Programme, true_delay: bool, snr_db: float, seed: int, **more) -> np.ndarray:
    """What the simulated channel delivers of a programme; ``more`` are further settings of it."""
    total = programme.total_frames + 3
    settings, flown = ChannelSettings(snr_db=snr_db, **more), programme if true_delay else None
    channel = SimulatedChannel(W, settings, seed=seed, true_delay=flown, frames=total)
    sweeps: dict[float, np.ndarray] = {}
    out = []
    for block in range(total):
        altitude = 0.0 if true_delay else float(programme.altitude_m(block))
        if altitude not in sweeps:
            sweeps[altitude] = W.beat_shifted(altitude)
        out += [samples for _, samples in channel.process(sweeps[altitude])]
    return np.concatenate(out)


def random_stream(seed: int) -> Stream:
    """Steps of 1 to 130 frames, with and without synchronisation, 0 to 15 dB; one to three losses, some tagged."""
    rng = np.random.default_rng([seed, 0x511B])
    true_delay = bool(rng.random() < 0.5)
    by_hand = not true_delay and bool(rng.random() < 0.4)
    step = int(rng.choice([1, 2, 3, 5, 15, 40, 130]))
    count = max(1, 130 // step)
    if rng.random() < 0.6:
        altitudes = rng.uniform(0.0, 1400.0, count)
    else:  # steps that are whole samples, which a loss can imitate
        altitudes = np.clip(300 + np.cumsum(rng.choice([-140, -60, -20, 3, 20, 60, 140], count)), 10.0, 1400)
    programme = Programme(
        altitudes_m=tuple(float(a) for a in np.round(altitudes, 2)),
        frames_per_step=step,
        sync_every_frames=int(rng.choice([0, 0, 30, 60])),
        vertical_speed_m_per_s=float(rng.choice([0.0, 10.0])) if true_delay else 0.0,
    )
    samples = received(programme, true_delay, float(rng.uniform(0.0, 15.0)), seed)
    losses, at = [], 0
    for first in np.sort(rng.integers(25 * N, samples.size - 8 * N, int(rng.integers(1, 4)))):
        whole = N * int(rng.integers(1, 4))
        length = int(rng.choice([rng.integers(1, 10), rng.integers(1, N), whole - rng.integers(12), whole]))
        if first >= at:
            losses.append((int(first), length, bool(rng.random() < 0.3)))
            at = first + length
    if rng.random() < 0.2:
        bad = int(rng.integers(20, samples.size // N - 5)) * N
        samples[bad : bad + N + 100] = np.nan
    return Stream(programme, true_delay, by_hand, samples, losses)


@dataclass
class Seen:
    """A frame that came out, and what was known of the timing then: verified, losses noticed so far."""

    frame: Frame
    verified: bool
    noticed: int


def noticed(segmenter: FrameSegmenter) -> int:
    """Losses without a tag that the segmenter has told of."""
    return segmenter.counters["lock_losses"] + segmenter.counters["index_corrections"]


def segmented(stream: Stream, seed: int) -> tuple[list[Seen], FrameSegmenter]:
    """The class alone, in random chunks."""
    rng = np.random.default_rng([seed, 0xC])
    segmenter = FrameSegmenter(W, None if stream.by_hand else stream.programme, true_delay=stream.true_delay)
    if stream.by_hand:
        segmenter.follow(stream.programme.at)
    seen: list[Seen] = []

    def keep(frames: list[Frame]) -> None:
        seen.extend(Seen(f, segmenter.timing_verified, noticed(segmenter)) for f in frames)

    at = 0
    for first, length, tagged in (*stream.losses, (stream.samples.size, 0, False)):
        while at < first:
            count = min(first - at, int(rng.integers(1, 3 * N)))
            keep(segmenter.push(stream.samples[at : at + count]))
            at += count
        if tagged:
            keep(segmenter.jump(length))
        at = first + length
    keep(segmenter.drain())
    return seen, segmenter


def silently_wrong(stream: Stream, seen: list[Seen], in_all: int, results: np.ndarray | None = None):
    """Frames (index, error) with a valid altitude more than 5 m off, of which no status spoke within 50 frames."""
    if not seen:
        return []
    results = measured([s.frame for s in seen], ALTIMETER) if results is None else results
    index = results["frame_index"]
    error = np.abs(results["altitude_m"] - stream.programme.altitude_m(index))
    wrong = results["valid"] & stream.programme.is_trial(index) & (error > WRONG_M)
    out = []
    for k in np.nonzero(wrong)[0]:
        later = [s.noticed for s in seen[k : k + NOTICE_FRAMES]]
        if len(later) < NOTICE_FRAMES:
            later.append(in_all)
        if seen[k].verified and max(later) == seen[k].noticed:
            out.append((int(index[k]), float(error[k])))
    return out


@pytest.mark.parametrize("batch", range(8))
def test_no_random_loss_leaves_an_altitude_wrong_in_silence(batch):
    released = told = 0
    for seed in range(batch, STREAMS, 8):
        stream = random_stream(seed)
        seen, segmenter = segmented(stream, seed)
        assert silently_wrong(stream, seen, noticed(segmenter)) == [], f"stream {seed}"
        released, told = released + len(seen), told + noticed(segmenter)
    assert released > 0 and told > 0  # frames came, and losses were noticed


def lossy(programme: Programme, length: int, *, true_delay: bool = False, by_hand: bool = False) -> Stream:
    """One untagged loss in frame 60."""
    samples = received(programme, true_delay, 10.0, 3)
    return Stream(programme, true_delay, by_hand, samples, [(60 * N + 1234, length, False)])


def test_a_loss_of_nearly_a_frame_with_two_frames_a_step_is_noticed():
    """7,493 samples in true delay: every frame is seen 7 samples late, at the altitude of the one after."""
    altitudes = tuple(np.random.default_rng(1).uniform(100.0, 1400.0, 60))
    stream = lossy(Programme(altitudes, frames_per_step=2), 7493, true_delay=True)
    seen, segmenter = segmented(stream, 1)
    assert silently_wrong(stream, seen, noticed(segmenter)) == []
    assert segmenter.counters["lock_losses"] == 1 and segmenter.state == "lost"


@pytest.mark.parametrize("length", [1, 3, 7493, 4000])
def test_a_loss_by_hand_is_noticed_where_it_is_known_what_is_sent(length):
    """Without that knowledge three samples are sixty metres more, and nothing else."""
    programme = Programme((300.0,), frames_per_step=130)
    seen, segmenter = segmented(lossy(programme, length, by_hand=True), 2)
    assert segmenter.counters["lock_losses"] == 1
    assert max(s.frame.index for s in seen) <= 61
    deaf = FrameSegmenter(W)
    deaf.push(np.delete(received(programme, False, 10.0, 3), slice(60 * N, 60 * N + 3))[: 130 * N])
    assert deaf.counters["lock_losses"] == 0 and not deaf.timing_verified  # and says that it does not know


def test_a_frame_lost_by_hand_shows_at_a_step_of_two_and_a_half_samples():
    """The step of 50 m lies just beyond what the matched filters reach, which see its flank two samples away."""
    stream = lossy(Programme((10.0, 60.0), frames_per_step=65), N, by_hand=True)
    seen, segmenter = segmented(stream, 4)
    assert silently_wrong(stream, seen, noticed(segmenter)) == []
    assert segmenter.counters["lock_losses"] == 0


def test_hidden_sweeps_leave_the_timing_unverified():
    """Nothing can be noticed in frames that do not show the sweep: the status says so after fifty."""
    programme = Programme((300.0,), frames_per_step=130)
    samples = received(programme, False, 10.0, 4)
    hide(samples, 40, samples.size // N)
    segmenter = FrameSegmenter(W, programme)
    segmenter.push(samples[: 80 * N])
    assert segmenter.timing_verified
    segmenter.push(samples[80 * N :])
    assert segmenter.state == "locked" and not segmenter.timing_verified
    assert segmenter.status()["unverified_frames"] > NOTICE_FRAMES


def hide(samples: np.ndarray, first: int, last: int) -> None:
    """Noise 40 dB above the return in frames ``first`` to ``last`` - 1."""
    samples[first * N : last * N] += noise(np.random.default_rng(6), last - first, -40.0).reshape(-1)


@pytest.mark.parametrize("length, shown_again", [(3, 70), (3, 73), (4000, 71), (4000, 72), (N, 70), (N, 73)])
def test_a_loss_that_interference_hid_lets_no_wrong_altitude_through(length, shown_again):
    """Of hidden frames one in four is looked at, whichever of them the first is that shows the sweep again."""
    programme = Programme((300.0, 500.0, 800.0), frames_per_step=40)
    stream = lossy(programme, length)
    hide(stream.samples, 40, shown_again)
    seen, segmenter = segmented(stream, 5)
    shown = [s for s in seen if s.frame.start_sample >= shown_again * N - length]
    for result in measured([s.frame for s in shown], ALTIMETER) if shown else ():
        error_m = abs(result["altitude_m"] - programme.altitude_m(result["frame_index"]))
        assert not result["valid"] or error_m < WRONG_M
    assert segmenter.counters["lock_losses"] == 1


@pytest.mark.parametrize("shown_again", [68, 88])
def test_whole_frames_lost_while_hidden_count_from_the_first_frame_that_shows_again(shown_again):
    """Three frames lost in frame 60; each is found where frames are judged that were not looked at when they came."""
    programme = Programme((300.0, 500.0, 800.0, 400.0, 900.0, 300.0, 700.0), frames_per_step=20)
    stream = lossy(programme, 3 * N, by_hand=True)
    hide(stream.samples, 40, shown_again)
    seen, segmenter = segmented(stream, 5)
    assert segmenter.counters["index_corrections"] == 1
    assert segmenter.counters["lock_losses"] == segmenter.counters["unlocked_frames"] == 0
    ahead = [s.frame.index - s.frame.start_sample // N for s in seen]
    shown = [s.frame.start_sample >= (shown_again - 3) * N for s in seen]
    assert {a - ahead[0] for a, after in zip(ahead, shown, strict=True) if after} == {3}


@pytest.mark.parametrize("glimpse", range(64, 68))
def test_every_hidden_frame_comes_out_once(glimpse):
    """Whichever frame shows the sweep in between, those not looked at are judged then, and none twice."""
    programme = Programme((300.0,), frames_per_step=100)
    samples = received(programme, False, 10.0, 4)
    hide(samples, 40, glimpse)
    hide(samples, glimpse + 3, 90)
    seen, segmenter = segmented(Stream(programme, False, False, samples, []), 5)
    indices = [s.frame.index for s in seen]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    assert len(indices) >= 95 and segmenter.counters["lock_losses"] == 0


class TestThroughTheBlock:
    """The same streams through GNU Radio, tags as the radio sets them; every other one lacks the tag of its start."""

    @pytest.mark.parametrize("seed", range(BLOCK_STREAMS))
    def test_no_random_loss_leaves_an_altitude_wrong_in_silence(self, seed):
        stream = random_stream(10_000 + seed)
        p = stream.programme
        altitude = {"programme_m": list(p.altitudes_m), "frames": p.frames_per_step}
        altitude |= {"mode": "true_delay" if stream.true_delay else "synthetic"}
        altitude |= {n: getattr(p, n) for n in ("sync_every_frames", "vertical_speed_m_per_s")}
        scene = parse_scene({"altitude": altitude})
        pieces, tags, at, sample = [], [], 0, 0
        if seed % 2 == 0:
            tags.append(gr.tag_utils.python_to_tag((0, pmt.intern("rx_time"), time_tag(0, W.rate_hz))))
        for first, length, tagged in (*stream.losses, (stream.samples.size, 0, False)):
            pieces.append(stream.samples[at:first])
            sample += first - at
            at = first + length
            if tagged:  # the radio's clock counts what the host lost, marked or not
                counter = sample + sum(lost for _, lost, marked in stream.losses if marked and _ <= first)
                tag = sample, pmt.intern("rx_time"), time_tag(counter, W.rate_hz)
                tags.append(gr.tag_utils.python_to_tag(tag))
        source = blocks.vector_source_c(np.concatenate(pieces), False, 1, tags)
        block = radalt.frame_segmenter(scene, follow_programme=not stream.by_hand)
        if stream.by_hand:
            block.follow(p.at)
        seen: list[Seen] = []
        push, jump, restart = block.segmenter.push, block.segmenter.jump, block.segmenter.restart

        def keep(frames: list[Frame]) -> list[Frame]:
            known = block.segmenter
            if frames and not (seen and seen[-1].frame is frames[-1]):  # a jump may be a restart
                seen.extend(Seen(f, known.timing_verified, noticed(known)) for f in frames)
            return frames

        def in_pieces(samples: np.ndarray) -> list[Frame]:
            # a large bite holds a loss and what tells of it: what was known when is seen frame by frame
            return [f for k in range(0, samples.size, N) for f in keep(push(samples[k : k + N]))]

        block.segmenter.push = in_pieces
        block.segmenter.jump = lambda lost: keep(jump(lost))
        block.segmenter.restart = lambda counter: keep(restart(counter))
        top = gr.top_block()
        sink = radalt.altimeter_sink(scene, messages=False)
        top.connect(source, block, sink)
        runner = threading.Thread(target=top.run, daemon=True)
        runner.start()
        runner.join(patient(120))
        assert not runner.is_alive() and getattr(block, "error", None) is None
        assert seen
        results = sink.results()  # of what the block handed on, by the altimeter behind it
        assert [s.frame.index for s in seen] == list(results["frame_index"])
        assert silently_wrong(stream, seen, noticed(block.segmenter), results) == []


@pytest.mark.parametrize("name, overlap", [("paper_qpsk", 0.1), ("nr10", 0.6), ("fmcw", 0.1), ("fmcw", 0.05)])
def test_bursts_of_interference_are_no_slip(name, overlap):
    """At SIR -28 dB they hide the sweep, and show a piece of it at many delays: 136 of 150 frames were lost by that."""
    programme = Programme(altitudes_m=(200.0, 400.0, 600.0, 800.0, 1000.0), frames_per_step=30)
    samples = received(programme, False, 10.0, 4)
    count, first = samples.size // N, programme.preamble_frames
    rng = np.random.default_rng([5, *name.encode(), int(100 * overlap)])
    scene = load_scene(name).at(overlap=overlap, sir_db=-28.0)
    total = {"total_sir_db": scene.total_sir_db}
    jam = interference_frames(scene.interference, count - first, N, W.rate_hz, rng, **total)
    samples[first * N : count * N] += jam.astype(np.complex64).reshape(-1)
    segmenter = FrameSegmenter(W, programme)
    frames = len(segmenter.push(samples)) + len(segmenter.drain())
    assert segmenter.counters["lock_losses"] == 0
    assert frames >= 0.99 * count
