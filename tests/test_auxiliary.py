"""Two receive channels: what the second one receives as well is taken out, and a return never with it."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio import radalt as gr_radalt
from test_blocks import Collect, run

import radalt
from radalt.core.scene import parse_scene
from radalt.core.scene.build import segmenter_of
from radalt.core.timing.auxiliary_samples import AuxiliarySamples
from radalt.evaluation.flowgraph.generate import generate, prepare, shipped
from radalt.evaluation.flowgraph.rewrite import prune, with_second_channel
from radalt.evaluation.flowgraph.run import run_point
from radalt.evaluation.simulation import both_received, run_chain

W = radalt.Waveform()
EMITTERS = {
    "nr": {"channel_bandwidth_hz": 1e7, "cell_id": 77, "frame_count": 2, "evm": 0.03},
    "qpsk": {"evm": 0.03},
    "tones": {"count": 5},
}
IDEAL = {"ripple_db": 0.0, "image_db": None, "third_order_db": None, "adc_bits": 0}


def two_channels(kind="nr", frames=20, sir_db=-50.0, cancel=None, channel=None, **auxiliary):
    """A scene whose one emitter both antennas receive."""
    return parse_scene(
        {
            "interference": {kind: EMITTERS[kind] | {"free_running": True, "sir_db": sir_db}},
            "altitude": {"drawn": {"frames": frames}},
            "altimeter": {"max_altitude_m": 1500.0, "max_vertical_speed_m_per_s": 20.0},
            "channel": {"start_offset_samples": 3000, "jammer_delay_samples": 0.4} | (channel or {}),
            "auxiliary": auxiliary,
            "auxiliary_cancel": cancel or {},
        }
    )


def in_beam(isolation_db):
    """An emitter in the return's direction: both antennas receive it as they receive the return."""
    same = {"gain_db": -isolation_db, "delay_s": 0.0, "phase_deg": 0.0}
    return {"isolation_db": isolation_db, "ripple_db": 0.0, "directions": same}


def measured(scene, seed=1):
    """A canceller that has seen eight frames without interference, and both channels with it, and the truth."""
    scene = replace(scene, seed=seed)
    canceller = radalt.AuxiliaryCancel(W, scene.auxiliary_cancel)
    calm, _ = radalt.simulate(scene, overlap=0.0, frames=8, auxiliary=True)
    np.testing.assert_array_equal(canceller.process(calm[:, 0], calm[:, 1]), calm[:, 0])
    both, truth_m = radalt.simulate(scene, auxiliary=True)
    return canceller, both[:, 0], both[:, 1], truth_m


def judged(frames, truth_m):
    """Shares of right and of wrong valid altitudes."""
    result = radalt.Altimeter(W).process(np.ascontiguousarray(frames))
    right = np.abs(result["altitude_m"] - truth_m) < 5.0
    return np.mean(result["valid"] & right), np.mean(result["valid"] & ~right)


@pytest.mark.parametrize("overlap", [0.3, 1.0])
@pytest.mark.parametrize("kind", list(EMITTERS))
def test_any_modulation_from_one_direction_is_taken_out_at_minus_50_db(kind, overlap):
    canceller, first, second, truth_m = measured(two_channels(kind).at(overlap=overlap))
    assert judged(first, truth_m)[0] < 0.5
    assert judged(canceller.process(first, second), truth_m) == (1.0, 0.0)


def test_taps_deepen_the_null_and_a_longer_path_difference_needs_more():
    """Residual of a delay: (2 pi tau f)^2, at 3 ns -28 dB over the band with one tap."""

    def depth_db(reach_s, delay_s):
        scene = two_channels(cancel={"reach_s": reach_s}, **IDEAL, directions={"delay_s": delay_s})
        canceller, first, second, _ = measured(scene)
        power = [np.mean(np.abs(x[:, 8:-8]) ** 2) for x in (first, canceller.process(first, second))]
        return 10 * np.log10(power[0] / power[1])

    assert 26.0 < depth_db(0.0, 3e-9) < 30.0
    assert 16.0 < depth_db(0.0, 10e-9) < 20.0
    assert depth_db(1.07e-6, 10e-9) > depth_db(0.5e-6, 10e-9) > 28.0


@pytest.mark.parametrize("stated_db", [10.0, 40.0])
@pytest.mark.parametrize("true_db", [0.0, 6.0, 12.0, 40.0])
def test_an_emitter_in_the_beam_makes_nothing_wrong_whatever_isolation_is_stated(true_db, stated_db):
    before, after = [], []
    for kind, sir_db in (("nr", -12.0), ("nr", -25.0), ("nr", -40.0), ("qpsk", -40.0)):
        scene = two_channels(kind, 12, sir_db, {"isolation_db": stated_db}, **in_beam(true_db))
        canceller, first, second, truth_m = measured(scene)
        before.append(judged(first, truth_m))
        after.append(judged(canceller.process(first, second), truth_m))
    right, wrong = (np.array(after) - before).T
    assert (wrong <= 0).all() and (right >= -0.1).all()


@pytest.mark.parametrize(("true_db", "works"), [(0.0, False), (8.0, False), (12.0, True), (20.0, True)])
def test_the_isolation_is_measured_and_below_10_db_the_canceller_is_off_and_says_so(true_db, works):
    canceller, first, second, _ = measured(two_channels(isolation_db=true_db, cancel={"isolation_db": 40.0}))
    assert abs(canceller.isolation_db - true_db) < 2.0
    cleaned = canceller.process(first, second)
    assert canceller.cancelled == (len(first) if works else 0)
    assert works or np.array_equal(cleaned, first)
    assert ("below 10" in canceller.status()["off"]) != works


def test_without_a_measurement_frames_pass():
    _, first, second, _ = measured(two_channels())
    canceller = radalt.AuxiliaryCancel(W)
    calm, _ = radalt.simulate(two_channels(isolation_db=60.0), overlap=0.0, frames=4, auxiliary=True)
    # a channel without an antenna has little noise, and no line
    canceller.process(calm[:, 0], 1e-3 * calm[:, 1])
    np.testing.assert_array_equal(canceller.process(first, second), first)
    assert "not measured" in canceller.status()["off"]


def test_an_isolation_that_falls_in_flight_is_found_where_a_return_stands_out():
    canceller = measured(two_channels(isolation_db=30.0))[0]
    _, first, second, _ = measured(two_channels(sir_db=-15.0, **in_beam(6.0)), seed=2)
    np.testing.assert_array_equal(canceller.process(first, second), first)
    assert abs(canceller.isolation_db - 6.0) < 2.0
    fallen = canceller.isolation_db
    calm, _ = radalt.simulate(two_channels(isolation_db=30.0), overlap=0.0, frames=8, auxiliary=True)
    canceller.process(calm[:, 0], calm[:, 1])  # the line of one frame may be an interferer's: 1 dB for each
    assert canceller.isolation_db == pytest.approx(fallen + 8.0)


@pytest.mark.parametrize("kind", ["tones", "qpsk"])
def test_the_edge_of_a_bursts_spectrum_is_no_return(kind):
    """Dechirped, a burst fills a part of the cells: the isolation would be the interferer's, -6 dB, and frames pass."""
    for seed in range(3):
        canceller, first, second, truth_m = measured(two_channels(kind, sir_db=-30.0).at(overlap=0.3), seed)
        assert judged(canceller.process(first, second), truth_m) == (1.0, 0.0)
        assert canceller.isolation_db > 15.0


@pytest.mark.parametrize("snr_db", [0.0, 10.0, 30.0])
def test_clean_frames_pass_to_the_bit(snr_db):
    scene = two_channels(frames=60, channel={"snr_db": snr_db}).at(overlap=0.0)
    canceller, first, second, _ = measured(scene)
    np.testing.assert_array_equal(canceller.process(first, second), first)


@pytest.mark.parametrize("fault", ["dead", "nan", "one_nan", "noise", "misaligned", "huge"])
def test_a_second_channel_that_is_of_no_use_changes_nothing(fault):
    canceller, first, second, _ = measured(two_channels())
    noise = np.random.default_rng(1).standard_normal((*second.shape, 2)).astype(np.float32)
    second = {
        "dead": np.zeros_like(second),
        "nan": np.full_like(second, np.nan),
        "one_nan": np.where(np.arange(W.samples_per_frame) == 5, np.complex64(np.nan), second),
        "noise": noise.view(np.complex64)[..., 0],
        "misaligned": np.roll(second, 60, axis=1),
        "huge": second * np.float32(1e30),
    }[fault]
    np.testing.assert_array_equal(canceller.process(first, second), first)


def test_the_first_channel_is_that_of_a_scene_with_one_to_the_bit():
    scene = two_channels(**IDEAL)
    both, _ = radalt.simulate(scene, auxiliary=True)
    alone, _ = radalt.simulate(replace(scene, auxiliary=None))
    np.testing.assert_array_equal(both[:, 0], alone)


@pytest.mark.parametrize("tagged", [True, False])
def test_the_second_channel_is_cut_at_the_frames_of_the_first_across_lost_samples(tagged):
    """With the return alone, at isolation 0 and without noise, both channels are the same."""
    drops = {"count": 3, "tagged": tagged}
    silent = two_channels(frames=80, isolation_db=0.0, **IDEAL, channel={"snr_db": None, "drops": drops})
    scene = silent.at(overlap=0.0)
    segmenter, expected, cut = segmenter_of(scene), 0, 0
    kept = AuxiliarySamples(segmenter)
    for counter, first, second in both_received(scene, 80):
        before = segmenter.jump(counter - expected) if tagged else []
        rows = list(kept.cut(before))
        kept.push(second)
        frames = segmenter.push(first)
        for frame, row in zip([*before, *frames], [*rows, *kept.cut(frames)], strict=True):
            np.testing.assert_array_equal(row, frame.samples)
            cut += 1
        expected = counter + first.size
    assert segmenter.counters["discontinuities"] == (3 if tagged else 0) and cut > 30


def test_directions_add_up_to_the_sir_and_each_has_its_own_gain():
    scene = parse_scene(
        {
            "interference": [{"qpsk": {"sir_db": -20.0}}, {"tones": {"sir_db": -10.0}}],
            "auxiliary": {"directions": [{"gain_db": -80.0}, {"gain_db": 6.0}], **IDEAL},
            "channel": {"jammer_delay_samples": 0.4},
        }
    )
    both, _ = radalt.simulate(scene, sir_db=-30.0, frames=20, auxiliary=True)
    power_db = 10 * np.log10(np.mean(np.abs(both) ** 2, axis=(0, 2)))
    np.testing.assert_allclose(power_db, [30.0, 30.0 - 10.4 + 6.0], atol=0.3)


def test_the_flowgraph_gives_the_rows_of_the_direct_path(tmp_path):
    """To the bit, across lost samples: the segmenter cuts both inputs by one counter, `auxiliary_cancel` cleans."""
    scene = two_channels(frames=40, channel={"drops": {"count": 1}})
    methods = ("none", "whitening")
    played, direct = run_point(prepare(scene, methods, tmp_path), scene), run_chain(scene, methods)
    for method in methods:
        for field in ("frame_index", "valid", "altitude_m", "forced_altitude_m"):
            np.testing.assert_array_equal(played.results[method][field], direct.results[method][field])
    assert played.results["none"]["valid"].mean() > 0.9


def test_flowgraphs_have_one_jammer_and_the_channels_that_the_scene_has(tmp_path):
    radios = generate(with_second_channel(prune(shipped(), ("none",), True)), tmp_path).read_text()
    assert "channels=[0, 1]" in radios.replace("list(range(0,2))", "[0, 1]") and '"A:A A:B"' in radios
    with pytest.raises(ValueError, match="one receive channel"):
        gr_radalt.simulated_channel(radalt.load_scene("clear"), auxiliary=True)
    directions = {"directions": [{}, {"gain_db": 0.0}]}
    two = parse_scene({"interference": [{"tones": {}}, {"qpsk": {}}], "auxiliary": directions})
    with pytest.raises(ValueError, match="jammer has one antenna"):
        gr_radalt.simulated_channel(two, auxiliary=True)


def test_the_block_hands_on_tags_with_the_quality_of_what_is_left():
    scene = two_channels(frames=12)
    segmenter = gr_radalt.frame_segmenter(scene, auxiliary=True)
    channel = gr_radalt.simulated_channel(scene, auxiliary=True)
    jammer = gr_radalt.jammer_source(scene, frames=23)
    cancel, sink = gr_radalt.auxiliary_cancel(scene), Collect(W.samples_per_frame)
    second = [((jammer, 0), (channel, 1)), ((channel, 1), (segmenter, 1)), ((segmenter, 1), (cancel, 1))]
    run(gr_radalt.fmcw_chirp_source(scene, frames=23), channel, segmenter, cancel, sink, wires=tuple(second))
    assert cancel.status()["cancelled"] == 12
    peaks = np.abs(sink.data.view(np.float32)).max(axis=1)
    np.testing.assert_allclose([value[4] for _, _, value in sink.tags], peaks, rtol=1e-6)
