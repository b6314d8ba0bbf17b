"""GNU Radio blocks: whole or in ragged chunks bit for bit the same, setters on sweep boundaries, messages, errors."""

import json
import re
import threading
import time

import numpy as np
import pmt
import pytest
import zmq
from frames import returns
from gnuradio import blocks, gr, radalt
from waiting import patient, wait_for

from radalt.blocks._frames import frame_tag
from radalt.blocks._guard import raise_stored
from radalt.core.altimeter.altimeter import RESULT_DTYPE, Altimeter
from radalt.core.altimeter.frame_quality import FrameQuality
from radalt.core.channel.simulated import SimulatedChannel
from radalt.core.interference.stream import JammerStream
from radalt.core.mitigation import create
from radalt.core.scene import parse_scene
from radalt.core.scene.live import RangeProfile
from radalt.core.timing.segmenter import Frame, FrameSegmenter
from radalt.evaluation.commands import make_recording

N = 7500
CHUNKS = [977, 7501, 100_000]  # largest number of items a call may produce
QUIET = {"interference": None, "channel": {"snr_db": None}}


def scene_of(**keys):
    """Six short steps of altitude, strong QPSK on half the sweep, unless told otherwise."""
    base = {
        "altitude": {"programme_m": [900.0, 300.0, 40.0], "frames": 4},
        "interference": {"qpsk": {"sir_db": -10.0, "overlap": 0.5}},
        "channel": {"snr_db": 15.0},
        "seed": 7,
    }
    return parse_scene({**base, **keys})


class Ragged(gr.sync_block):
    """Plays an array in chunks of random size, with tags at given items."""

    def __init__(self, data: np.ndarray, seed: int | None, tags: tuple = ()) -> None:
        item = (data.dtype, data.shape[1]) if data.ndim == 2 else data.dtype
        gr.sync_block.__init__(self, "ragged", None, [item])
        self.data, self.at, self.tags = data, 0, list(tags)
        self.rng = None if seed is None else np.random.default_rng(seed)

    def work(self, input_items, output_items) -> int:
        out = output_items[0]
        left = len(self.data) - self.at
        if not left:
            return -1
        count = min(len(out), left)
        if self.rng is not None:
            top = 6 if self.data.ndim == 2 else 20_000
            count = min(count, int(self.rng.integers(1, top)))
        out[:count] = self.data[self.at : self.at + count]
        for offset, key, value in self.tags:
            if self.at <= offset < self.at + count:
                self.add_item_tag(0, offset, key, value)
        self.at += count
        return count


class Collect(gr.sync_block):
    """Keeps what it is given, and the tags; takes ``pause_s`` over every item."""

    def __init__(self, vlen: int = 1, dtype: type = np.complex64, pause_s: float = 0.0) -> None:
        gr.sync_block.__init__(self, "collect", [(dtype, vlen) if vlen > 1 else dtype], None)
        self.parts, self.tags, self.pause_s = [], [], pause_s

    def work(self, input_items, output_items) -> int:
        time.sleep(self.pause_s * len(input_items[0]))
        self.parts.append(input_items[0].copy())
        for tag in self.get_tags_in_window(0, 0, len(input_items[0])):
            self.tags.append((tag.offset, pmt.symbol_to_string(tag.key), pmt.to_python(tag.value)))
        return len(input_items[0])

    @property
    def data(self) -> np.ndarray:
        return np.concatenate(self.parts) if self.parts else np.zeros(0, np.complex64)


class Messages(gr.basic_block):
    """Keeps messages."""

    def __init__(self) -> None:
        gr.basic_block.__init__(self, "messages", None, None)
        self.seen = []
        self.message_port_register_in(pmt.intern("in"))
        self.set_msg_handler(pmt.intern("in"), self.take)

    def take(self, message) -> None:
        self.seen.append(pmt.to_python(message))


def run(*chain, chunk: int = 100_000, also: tuple = (), wires: tuple = ()) -> None:
    """Connect a chain, run it to its end, raise what its blocks have stored."""
    top = gr.top_block()
    top.blocks = (*chain, *also)
    if len(chain) > 1:
        top.connect(*chain)
    for wire in wires:
        message = isinstance(wire[0], tuple) and isinstance(wire[0][1], str)
        (top.msg_connect if message else top.connect)(*wire)
    done = threading.Thread(target=top.run, args=(chunk,), daemon=True)
    done.start()
    done.join(patient(120))
    if done.is_alive():
        top.stop()
        raise TimeoutError("the flowgraph did not end")
    raise_stored(top.blocks)


def source_output(make, chunk: int) -> np.ndarray:
    sink = Collect()
    run(make(), sink, chunk=chunk)
    return sink.data


FREE = {"qpsk": {"pulse": "rrc", "overlap": 0.3, "free_running": True}}
SOURCES = {
    "fmcw_chirp_source": lambda s: radalt.fmcw_chirp_source(s, frames=22),
    "jammer_source": lambda s: radalt.jammer_source(s, frames=22),
    "qpsk": lambda s: radalt.jammer_source(s, {"qpsk": {"overlap": 0.3, "sir_db": -20}}, frames=22),
    "free_running": lambda s: radalt.jammer_source(s, FREE, frames=22),
    "nr": lambda s: radalt.jammer_source(s, {"nr": {}}, overlap=0.7, sir_db=-15, frames=22),
    "tones": lambda s: radalt.jammer_source(s, {"tones": {"count": 3}}, frames=22),
}


@pytest.mark.parametrize("name", SOURCES)
def test_source_is_the_same_in_any_chunks(name):
    scene = scene_of()
    outputs = [source_output(lambda: SOURCES[name](scene), chunk) for chunk in CHUNKS]
    assert outputs[0].size == 22 * N and len({played.tobytes() for played in outputs}) == 1


def test_recording_source_is_the_same_in_any_chunks_at_its_sir(tmp_path):
    scene, meta = scene_of(), tmp_path / "air.sigmf-meta"
    steps = np.random.default_rng(1).uniform(-0.3, 0.3, 60_000)
    make_recording.write(meta, np.exp(2j * np.pi * np.cumsum(steps)), make_recording.RATE_HZ, "noise")

    def make():
        recording = {"file": str(meta), "offset_hz": 0.3e6, "sir_db": -13.0}
        return radalt.jammer_source(scene, {"recording": recording}, frames=22)

    outputs = [source_output(make, chunk) for chunk in CHUNKS]
    assert len({played.tobytes() for played in outputs}) == 1
    frames = outputs[0].reshape(22, N).astype(np.complex128)
    trial = scene.altitude.programme.is_trial(np.arange(22))
    assert not frames[~trial].any()
    np.testing.assert_allclose(10 * np.log10(np.mean(np.abs(frames[trial]) ** 2, axis=1)), 13.0, atol=0.01)
    with pytest.raises(ValueError, match="nothing.sigmf-meta: cannot be read .*make-recording"):
        radalt.jammer_source(scene, {"recording": {"file": "nothing.sigmf-meta"}})


def test_chirp_source_plays_the_programme_sweep_by_sweep():
    scene = scene_of()
    played = source_output(lambda: radalt.fmcw_chirp_source(scene, frames=22), 7501).reshape(22, N)
    programme = scene.altitude.programme
    for index, sweep in enumerate(played):
        np.testing.assert_array_equal(sweep, scene.waveform.beat_shifted(float(programme.altitude_m(index))))


def test_chirp_source_stays_phase_continuous_where_sweeps_are_no_whole_cycles():
    scene = scene_of(waveform={"bandwidth_hz": 7.100123e6, "centered": False})
    played = source_output(lambda: radalt.fmcw_chirp_source(scene, altitude_m=0.0, frames=20), 7501)
    increments = np.angle(played[1:] * np.conj(played[:-1])) / (2 * np.pi)
    position = np.mod(np.arange(played.size - 1) + 0.5, N) / N
    frequency = 7.100123e6 * (1 - np.abs(2 * position - 1)) / 7.5e6
    error = increments - frequency
    assert np.abs(error - np.rint(error)).max() < 1e-5


def pull(block, count: int) -> np.ndarray:
    """Call work by hand, as the scheduler would."""
    out = np.zeros(count, np.complex64)
    assert block.work([], [out]) == count
    return out


def test_live_altitude_takes_effect_at_the_next_sweep():
    scene = scene_of()
    block = radalt.fmcw_chirp_source(scene, altitude_m=100.0)
    told = []
    # a tag needs the scheduler's buffers
    block.add_item_tag = lambda port, offset, key, value: told.append(pmt.to_python(value).tolist())
    pull(block, 8 * N)  # the preamble stays at zero, whatever is set
    np.testing.assert_array_equal(pull(block, N), scene.waveform.beat_shifted(100.0))
    block.set_altitude(700.0)
    np.testing.assert_array_equal(pull(block, N), scene.waveform.beat_shifted(700.0))
    assert told == [[0, 100], [9, 700]]
    np.testing.assert_array_equal(block.altitude_m(np.arange(7, 11)), [0, 100, 700, 700])
    with pytest.raises(ValueError, match="altitude_m is 1000000.0; it has to be within 0.."):
        block.set_altitude(1e6)


def test_live_overlap_and_sir_take_effect_at_the_next_sweep():
    """Of one interferer, and of a scene's stream of several."""
    several = scene_of(interference=[{"qpsk": {"sir_db": -10}}, {"tones": {"count": 2, "sir_db": -16}}])
    one = radalt.jammer_source(scene_of(), {"qpsk": {"sir_db": -10.0}})
    for block, bursts in ((one, 1), (radalt.jammer_source(several), 2)):
        before = pull(block, 10 * N)
        block.set_overlap(0.25)
        block.set_sir_db(-30.0)
        after = pull(block, N)
        assert np.count_nonzero(before[8 * N :]) == 2 * N and np.count_nonzero(after) == bursts * N // 4
        assert 10 * np.log10(np.mean(np.abs(after) ** 2)) == pytest.approx(30.0, abs=0.01)
    np.testing.assert_array_equal(before, transmitted(several, 10)[1])
    with pytest.raises(ValueError, match="overlap is 1.2"):
        block.set_overlap(1.2)


def transmitted(scene, frames: int) -> tuple[np.ndarray, np.ndarray]:
    w, programme = scene.waveform, scene.altitude.programme
    radar = np.concatenate([w.beat_shifted(float(programme.altitude_m(i))) for i in range(frames)])
    stream = JammerStream(w, scene.interference, programme=programme, seed=scene.seed)
    return radar, np.concatenate([stream.next_frame() for _ in range(frames)])


DROPS = {"snr_db": 15.0, "drops": {"count": 3, "min_samples": 100, "max_samples": 3000}}


def through_channel(scene):
    """Sent by radar and jammer; counters and samples of a channel of its own; where it has gaps, and their counters."""
    frames = scene.altitude.programme.total_frames
    radar, jammer = transmitted(scene, frames)
    channel = SimulatedChannel(scene.waveform, scene.channel, seed=scene.seed, frames=frames)
    both = zip(radar.reshape(-1, N), jammer.reshape(-1, N), strict=True)
    pieces = [piece for sent in both for piece in channel.process(*sent)]
    gaps, at, counter = [], 0, None
    for first, samples in pieces:
        if first != counter:
            gaps.append((at, first))
        at, counter = at + samples.size, first + samples.size
    return radar, jammer, pieces, gaps


@pytest.mark.parametrize("seed", [None, 1, 2], ids=["whole", "ragged", "ragged again"])
def test_channel_block_is_the_channel_in_any_chunks_with_rx_time_at_every_gap(seed):
    scene = scene_of(channel=DROPS, altitude={"programme_m": [300.0], "frames": 60})
    radar, jammer, pieces, gaps = through_channel(scene)
    block, sink = radalt.simulated_channel(scene, jammer=True), Collect()
    sources = Ragged(radar, seed), Ragged(jammer, None if seed is None else seed + 10)
    wires = tuple(((source, 0), (block, port)) for port, source in enumerate(sources))
    run(block, sink, chunk=100_000 if seed is None else 5003, also=sources, wires=wires)
    assert sink.data.tobytes() == np.concatenate([samples for _, samples in pieces]).tobytes()
    tags = [(at, round(sum(value) * 7.5e6)) for at, key, value in sink.tags if key == "rx_time"]
    assert tags == gaps and len(gaps) == 4


def segmented(scene, stream, tags, seed, chunk=100_000):
    block, sink, status = radalt.frame_segmenter(scene), Collect(N), Messages()
    source = Ragged(stream, seed, tags)
    run(source, block, sink, chunk=chunk, also=(status,), wires=(((block, "status"), (status, "in")),))
    return block, sink, status


def test_segmenter_block_is_the_segmenter_in_any_chunks():
    scene = scene_of(channel=DROPS, altitude={"programme_m": [300.0, 50.0], "frames": 40})
    _, _, pieces, gaps = through_channel(scene)
    times = [pmt.make_tuple(pmt.from_uint64(0), pmt.from_double(first / 7.5e6)) for _, first in gaps]
    tags = [(at, pmt.intern("rx_time"), time_tag) for (at, _), time_tag in zip(gaps, times, strict=True)]
    reference = FrameSegmenter(scene.waveform, scene.altitude.programme)
    expected, counter = [], 0
    for first, samples in pieces:
        expected += (reference.jump(first - counter) if first != counter else []) + reference.push(samples)
        counter = first + samples.size
    stream = np.concatenate([samples for _, samples in pieces])
    for seed in (None, 3, 4):
        block, sink, status = segmented(scene, stream, tags, seed)
        got = sink.data
        assert len(got) == len(expected)
        assert got.tobytes() == np.stack([f.samples for f in expected]).tobytes()
        named = [value for _, key, value in sink.tags if key == "radalt_frame"]
        flown = scene.altitude.programme.altitude_m
        peaks = np.abs(got.view(np.float32)).max(axis=1)
        assert [tuple(v) for v in named] == [
            (f.index, f.start_sample, f.offset_s, float(flown(f.index)), peak, 0)
            for f, peak in zip(expected, peaks, strict=True)
        ]
        counters = block.status()
        assert {k: counters[k] for k in reference.counters} == reference.counters
        assert counters["discontinuities"] == 3
        last = status.seen[-1]
        assert last["locked"] and last["discontinuities"] == 3 and {"quality_db", "torn"} <= last.keys()


def lines(captured: str) -> list[str]:
    """Warnings in GNU Radio's log."""
    return [line for line in captured.splitlines() if ":warning:" in line]


@pytest.mark.parametrize("tagged", [True, False])
def test_altitude_by_hand_is_followed_by_its_tag_or_one_line_names_the_remedy(tagged, capfd):
    """The chirp source's own example: the segmenter learns from a tag that the programme is not what is sent, which is
    the truth, too. Radios pass no tags."""
    scene = scene_of(interference=None, channel={"snr_db": 10.0})
    source = radalt.fmcw_chirp_source(scene, altitude_m=200.0, frames=200)
    wall = blocks.copy(gr.sizeof_gr_complex)
    wall.set_tag_propagation_policy(gr.TPP_ALL_TO_ALL if tagged else gr.TPP_DONT)
    segmenter, sink = radalt.frame_segmenter(scene), radalt.altimeter_sink(scene)
    run(source, radalt.simulated_channel(scene, jammer=False), wall, segmenter, sink)
    status, results, said = segmenter.status(), sink.results(), lines(capfd.readouterr().out)
    if not tagged:
        assert status["state"] == "lost" and len(said) == 1
        assert "sweep 9 was expected at 900 m and seen near 190 m" in said[0]  # a sample is 20 m
        assert "frame_segmenter.follow(chirp_source.sent), follow_programme False" in said[0]
        return
    assert status["locked"] and status["lock_losses"] == 0 and len(results) >= 197 and said == []
    trials = results[results["frame_index"] >= 8]
    assert trials["valid"].all() and np.abs(trials["altitude_m"] - 200.0).max() < 5.0
    np.testing.assert_array_equal(sink.truth_m(), np.where(results["frame_index"] < 8, 0.0, 200.0))


def test_a_search_that_ends_at_the_programme_is_one_line(capfd):
    """Samples of the user's own: the scene flies 1 m, and 20 m, a resolution cell, are searched."""
    scene = scene_of(interference=None, altitude={"programme_m": [1.0]})
    radalt.frame_segmenter(scene, follow_programme=False)
    (line,) = lines(capfd.readouterr().out)
    assert "altitudes above 19.9862 m" in line and "altimeter.max_altitude_m says how high" in line
    named = scene_of(interference=None, altimeter={"max_altitude_m": 900.0})
    radalt.frame_segmenter(named, follow_programme=False)
    radalt.frame_segmenter(scene)
    assert lines(capfd.readouterr().out) == []


def test_a_second_without_a_sweep_is_one_line(capfd):
    scene = scene_of(interference=None)
    noise = np.random.default_rng(1).standard_normal((1200 * N, 2), np.float32).view(np.complex64)
    segmenter, sink = radalt.frame_segmenter(scene), radalt.altimeter_sink(scene)
    run(Ragged(noise.ravel(), None), segmenter, sink)
    (line,) = lines(capfd.readouterr().out)
    assert "no sweep found in a second of signal" in line and sink.count == 0


def test_a_tag_of_another_program_is_one_line_and_counted(capfd):
    """rx_time, radalt_altitude and radalt_frame of other shapes: the frames are those of the stream without them."""
    scene = scene_of(**QUIET, altitude={"programme_m": [300.0], "frames": 10})
    radar, _ = transmitted(scene, scene.altitude.programme.total_frames)
    far = pmt.make_tuple(pmt.from_uint64(2**60), pmt.from_double(0))
    foreign = pmt.intern("soon"), pmt.from_double(1.0), far
    bad = [(9 * N + k, pmt.intern("rx_time"), value) for k, value in enumerate(foreign)]
    bad += [(9 * N + 9, pmt.intern("radalt_altitude"), pmt.init_f64vector(1, [5.0]))]
    (_, clean, _), (block, sink, _) = (segmented(scene, radar, tags, None) for tags in ([], bad))
    assert sink.data.tobytes() == clean.data.tobytes() and len(sink.data) > 10
    assert block.status()["bad_tags"] == 4
    (line,) = lines(capfd.readouterr().out)
    assert "it is ignored" in line
    frames, tags, _ = frames_with_tags(5)
    altimeter = radalt.altimeter_sink(scene)
    run(Ragged(frames, None, (*tags[:4], (4, pmt.intern("radalt_frame"), pmt.from_long(1)))), altimeter)
    assert list(altimeter.results()["frame_index"]) == [100, 101, 102, 103, -1]


def test_a_second_without_altitudes_is_one_line_and_so_is_their_return(capfd):
    """Method and count are named; a jammed second among seconds of clean frames."""
    scene = scene_of(interference=None, altitude={"programme_m": [300.0], "frames": 10})
    sweep, rng = scene.waveform.beat_shifted(300.0), np.random.default_rng(1)
    sink = radalt.altimeter_sink(scene, method="whitening")
    noise = rng.normal(size=(100, N, 2)).view(complex)[..., 0]
    jammed, clean = (sink.altimeter.process((a * sweep + noise).astype(np.complex64)) for a in (0.0, 1.0))
    for results in (clean, jammed, jammed, clean, clean):
        for _ in range(10):
            sink._watch(results)
    first, second = lines(capfd.readouterr().out)
    assert re.search(r"whitening: \d+ of the last 1000 frames gave an altitude within", first)
    assert second.endswith("whitening: 1000 of the last 1000 frames gave an altitude again")


def test_altitude_by_hand_is_refused_where_the_channel_plays_the_delay(capfd):
    scene = scene_of(altitude={"programme_m": [300.0], "mode": "true_delay"})
    with pytest.raises(ValueError, match="altitude_m is 200, and the scene's altitudes are true delays"):
        radalt.fmcw_chirp_source(scene, altitude_m=200.0)
    radalt.fmcw_chirp_source(scene_of(altitude={"programme_m": [300.0]}), altitude_m=900.0)
    (line,) = lines(capfd.readouterr().out)
    assert "altitude_m 900 m is above the" in line


@pytest.mark.parametrize(("drop", "frames"), [(True, 400), (True, 1000), (False, 600)])
def test_half_a_second_waits_for_a_slow_method_then_whole_frames_are_dropped_and_counted(drop, frames):
    """All comes at once, as after a hold-up: 400 frames lose nothing. In simulation the source waits."""
    scene = scene_of(**QUIET, altitude={"programme_m": [300.0], "frames": frames})
    first = transmitted(scene, 20)[0]
    rest = scene.altitude.programme.total_frames - 22
    radar = np.concatenate([first, np.tile(first[-N:], rest)])
    block, sink = radalt.frame_segmenter(scene, drop_when_slow=drop), Collect(N, pause_s=0.002)
    sink.set_max_noutput_items(4)
    source = Ragged(radar, None)
    # the radio's own ring: the segmenter is not called while the sink works
    source.set_min_output_buffer(256 * N)
    run(source, block, sink)
    status = block.status()
    assert status["locked"] and len(sink.data) + status["dropped_slow"] == status["frames"]
    assert (status["dropped_slow"] > 0) == (drop and frames > 479)


def test_frames_that_find_no_room_keep_their_samples():
    """Where interference hides the sweep frames are held back, and more come out of a call than it took in."""
    scene = scene_of(interference=None, altitude={"programme_m": [300.0], "frames": 500})
    stream = np.tile(transmitted(scene, 20)[0][-N:], 500)
    stream[: 20 * N] = transmitted(scene, 20)[0]
    rng = np.random.default_rng(12)
    stream += 0.1 * rng.standard_normal(2 * stream.size).astype(np.float32).view(np.complex64)
    for first in range(30, 490, 7):
        stream[first * N : (first + 4) * N] *= np.float32(1e-3)
        hidden = rng.standard_normal(8 * N).astype(np.float32).view(np.complex64)
        stream[first * N : (first + 4) * N] += hidden
    reference = FrameSegmenter(scene.waveform, scene.altitude.programme)
    expected = reference.push(stream)
    source = Ragged(stream, None)
    source.set_min_output_buffer(64 * N)  # soon written over
    sink = Collect(N)
    run(source, radalt.frame_segmenter(scene), sink)
    got = sink.data
    assert len(got) >= len(expected) > 450
    assert got[: len(expected)].tobytes() == np.stack([f.samples for f in expected]).tobytes()


def frames_with_tags(count: int) -> tuple[np.ndarray, tuple, np.ndarray]:
    scene = scene_of()
    rng = np.random.default_rng(5)
    frames = returns(rng, count, 17.0)[1].astype(np.complex64)
    offsets = rng.uniform(-0.5, 0.5, count) / 7.5e6
    quality = FrameQuality(scene.waveform, scene.altimeter_settings.max_altitude_m)(frames)
    told = (Frame(100 + i, i * N, frames[i], offsets[i]) for i in range(count))
    tags = (frame_tag(frame, np.nan, q) for frame, q in zip(told, quality, strict=True))
    return frames, tuple((i, pmt.intern("radalt_frame"), tag) for i, tag in enumerate(tags)), offsets


@pytest.mark.parametrize("method", ["none", "lms", "nlms", "whitening", "blanking"])
def test_mitigation_block_is_the_method_in_any_chunks(method):
    scene = scene_of()
    frames, tags, _ = frames_with_tags(25)
    span_m = scene.altimeter_settings.max_altitude_m
    alone = create(method, scene.waveform, max_altitude_m=span_m, independent=scene.independent_frames)
    expected = alone.process(frames)
    for seed in (None, 1):
        block, sink = radalt.mitigation(scene, method), Collect(N)
        run(Ragged(frames, seed, tags), block, sink)
        assert sink.data.tobytes() == expected.tobytes()
        assert [offset for offset, key, _ in sink.tags if key == "radalt_frame"] == list(range(25))
        assert block.milliseconds().shape == (25,) and (block.milliseconds() >= 0).all()
        assert block.status()["frames"] == 25


@pytest.mark.parametrize("seed", [None, 1])
def test_altimeter_sink_gives_the_altimeters_results_and_one_message_a_frame(seed):
    scene = scene_of()
    frames, tags, offsets = frames_with_tags(30)
    frames[7, 3] = np.nan
    altimeter = Altimeter(scene.waveform, scene.altimeter_settings)
    expected = altimeter.process(frames, timing_offset_s=offsets, frame_index=100 + np.arange(30))
    block, sink = radalt.altimeter_sink(scene, method="whitening"), Messages()
    run(Ragged(frames, seed, tags), block, also=(sink,), wires=(((block, "result"), (sink, "in")),))
    assert block.results().tobytes() == expected.tobytes()
    for message, row in zip(sink.seen, expected, strict=True):
        assert message.keys() == {*RESULT_DTYPE.names, "version", "method", "truth_m"}
        assert (message["version"], message["method"]) == (1, "whitening")
        assert message["frame_index"] == row["frame_index"] and message["valid"] == row["valid"]
        np.testing.assert_equal(message["altitude_m"], row["altitude_m"])
    assert sink.seen[7]["reason"] == "not_finite" and sink.seen[6]["reason"] == "ok"


def test_range_profile_shows_every_so_many_frames_in_any_chunks():
    scene = scene_of()
    frames, tags, _ = frames_with_tags(40)
    expected = RangeProfile(scene.waveform, scene.altimeter_settings, 64).process(frames[::7])
    for seed in (None, 1, 2):
        block = radalt.range_profile(scene, points=64, every=7)
        sinks = Collect(64, np.float32), Collect(64, np.float32)
        wires = tuple(((block, i), (sink, 0)) for i, sink in enumerate(sinks))
        run(Ragged(frames, seed, tags), block, also=sinks, wires=wires)
        for sink, wanted in zip(sinks, expected, strict=True):
            assert sink.data.tobytes() == wanted.astype(np.float32).tobytes()


def test_altitude_strip_rolls_and_hides_what_was_not_detected_in_any_chunks():
    altitudes = np.arange(60, dtype=np.float32)
    altitudes[40] = np.nan
    for chunk in (100_000, 7):
        block = radalt.altitude_strip(altitude_m=25.0, inputs=1, points=4, every=20)
        true, chart = sinks = Collect(4, np.float32), Collect(4, np.float32)
        wires = tuple(((block, i), (sink, 0)) for i, sink in enumerate(sinks))
        run(Ragged(altitudes, None), block, chunk=chunk, also=sinks, wires=wires)
        off = block.OFF_CHART_M
        np.testing.assert_array_equal(true.data, [[off, off, off, 25], [off, off, 25, 25], [off, 25, 25, 25]])
        np.testing.assert_array_equal(chart.data, [[off, off, off, 0], [off, off, 0, 20], [off, 0, 20, off]])


def test_results_are_published_over_zmq_as_json():
    scene = scene_of()
    frames, tags, _ = frames_with_tags(20)
    frames[4] = 0
    context = zmq.Context()
    block = radalt.altimeter_sink(scene, method="none", endpoint="tcp://127.0.0.1:*", messages=False)
    endpoint = block._socket.address  # with the port the system chose
    subscriber = context.socket(zmq.SUB)
    subscriber.setsockopt(zmq.SUBSCRIBE, b"")
    subscriber.setsockopt(zmq.RCVTIMEO, int(1000 * patient(20)))
    subscriber.connect(endpoint)
    block._socket.socket.send_string("{}")  # a subscription takes time: repeat until it stands
    wait_for(lambda: subscriber.poll(20) or block._socket.socket.send_string("{}"), "the subscription")
    run(Ragged(frames, 1, tags), block)
    received = []
    while len(received) < 20:
        message = json.loads(subscriber.recv_string())
        if message:
            received.append(message)
    subscriber.close()
    context.term()
    assert [m["frame_index"] for m in received] == list(range(100, 120))
    said, results = [m["altitude_m"] for m in received if m["valid"]], block.results()
    np.testing.assert_array_equal(said, results["altitude_m"][results["valid"]])
    assert received[4]["reason"] == "no_signal" and received[4]["altitude_m"] is None


@pytest.mark.parametrize("block", [radalt.altimeter_sink, radalt.altitude_tracker])
def test_an_endpoint_that_other_machines_reach_is_refused_unless_asked_for(block):
    with pytest.raises(ValueError, match="endpoint is 'tcp://0.0.0.0:.': other machines reach"):
        block(scene_of(), endpoint="tcp://0.0.0.0:*")
    assert block(scene_of(), endpoint="tcp://0.0.0.0:*", network=True).stop()


def test_endpoint_that_is_taken_is_refused_in_one_line():
    holder = zmq.Context.instance().socket(zmq.PUB)
    port = holder.bind_to_random_port("tcp://127.0.0.1")
    with pytest.raises(ValueError, match=f"altimeter_sink.endpoint 'tcp://127.0.0.1:{port}' cannot be bound"):
        radalt.altimeter_sink(scene_of(), endpoint=f"tcp://127.0.0.1:{port}")
    holder.close()


def test_exception_in_a_block_ends_the_flowgraph_and_is_raised_again(capfd):
    """Unguarded it would hang for ever."""
    scene = scene_of()
    block = radalt.frame_segmenter(scene)
    block.segmenter.push = lambda samples: [][1]
    with pytest.raises(IndexError):
        run(radalt.fmcw_chirp_source(scene, frames=200), block, Collect(N))
