"""The live view: what its blocks draw, its controls at work, and its picture."""

import ast
import json
import os
import sys
import types
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from frames import N, W, white
from gnuradio import blocks, gr, radalt
from PIL import Image
from waiting import ROOT, patient, ran_python

from radalt import Altimeter, AltimeterSettings, load_scene
from radalt.core.altimeter.altimeter import RESULT_DTYPE
from radalt.core.mitigation import METHODS, create
from radalt.core.returns.point import point_return
from radalt.core.scene import parse_scene
from radalt.core.scene.live import RangeProfile, by_hand
from radalt.evaluation.flowgraph.live import StatusLine
from radalt.evaluation.flowgraph.rewrite import load_grc
from radalt.evaluation.flowgraph.run import run_to_end

SHIPPED_METHODS = frozenset(METHODS)  # before any test registers one of its own
LEVEL = AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=0.0)


@pytest.mark.parametrize("altitude_m", [30.0, 299.5, 750.0, 1400.0])
def test_unit_return_peaks_at_its_altitude_at_zero_decibels(altitude_m):
    profile = RangeProfile(W, LEVEL)
    power_db, _ = profile.process(point_return(W, np.array([altitude_m])))
    peak = int(power_db[0].argmax())
    # a cell is 10 m wide and values between cells are interpolated: half a cell, and its straddling loss
    assert abs(profile.altitude_m[peak] - altitude_m) < 6.0
    assert -1.5 < power_db[0, peak] < 0.3


def test_noise_floor_lies_the_processing_gain_below_its_power():
    """White noise of unit power in a cell of one half sweep: 10 log10(1 / (N / 2)) = -35.7 dB over a unit return."""
    profile = RangeProfile(W, LEVEL)
    power_db, _ = profile.process(white(np.random.default_rng(1), 100))
    floor_db = 10 * np.log10(np.mean(10 ** (power_db / 10)))
    assert abs(floor_db - 10 * np.log10(2 / N)) < 1.0


def test_profile_exceeds_the_threshold_where_the_altimeter_detects():
    profile, altimeter = RangeProfile(W, LEVEL), Altimeter(W, LEVEL)
    altitudes = np.linspace(100.0, 1400.0, 200)
    amplitudes = np.tile([0.0, 0.05, 0.075, 0.3], 50)  # nothing, in the noise, at the edge, clear
    frames = amplitudes[:, None] * point_return(W, altitudes) + white(np.random.default_rng(1), 200)
    power_db, threshold_db = profile.process(frames)
    crossed = (power_db > threshold_db).any(axis=1)
    valid = altimeter.process(frames)["valid"]
    assert 0.3 < valid.mean() < 0.8
    # between cells the curves are interpolated, so the edge is not exact
    assert np.mean(crossed == valid) > 0.95
    assert crossed[3::4].all() and not crossed[0::4].all()


def test_altitude_by_hand_starts_after_the_preamble():
    """Timing is taken at altitude zero: an altitude set from the start must not shift it."""
    scene = by_hand(load_scene("paper_qpsk"))
    preamble = scene.altitude.preamble_frames
    top = gr.top_block()
    source = radalt.fmcw_chirp_source(scene, altitude_m=300.0, frames=preamble + 2)
    sink = blocks.vector_sink_c()
    top.connect(source, sink)
    run_to_end(top, time_limit_s=patient(60))
    sweeps = np.array(sink.data()).reshape(-1, N)
    np.testing.assert_allclose(sweeps[:preamble], np.tile(W.beat_shifted(0.0), (preamble, 1)), atol=1e-6)
    np.testing.assert_allclose(sweeps[preamble:], np.tile(W.beat_shifted(300.0), (2, 1)), atol=1e-6)


def test_scene_by_hand_has_no_end_and_nothing_that_needs_one():
    altitude = {"programme_m": [900, 400], "frames": 3, "mode": "true_delay", "vertical_speed_m_per_s": 3}
    channel = {"jammer_clock_ppm": 2.0, "drops": {"count": 1}}
    scene = parse_scene({"altitude": altitude, "channel": channel})
    live = by_hand(scene)
    programme = live.altitude.programme
    late = np.array([programme.total_frames, 10**12])
    assert programme.is_trial(late).all() and (programme.altitude_m(late) == 400.0).all()
    assert live.altitude.mode == "synthetic" and not scene.altitude.programme.is_trial(late).any()
    assert live.channel.drops.count == 0 and live.channel.jammer_clock_ppm == 0.0


@pytest.mark.parametrize("path", sorted((ROOT / "flowgraphs/scenes").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_shipped_scene_can_be_driven_by_hand(path):
    live = by_hand(load_scene(path))
    assert live.altimeter_settings.max_altitude_m >= 300.0  # where the view starts
    assert live.altitude.programme.is_trial(10**9) and live.return_model == "point"


def test_method_is_exchanged_between_frames(monkeypatch):
    monkeypatch.setattr("radalt.blocks.mitigation.read_quality", lambda block, count: None)  # no tags
    scene = load_scene("paper_qpsk")
    frames = (point_return(W, [300.0] * 4) + 2.0 * white(np.random.default_rng(1), 4)).astype(np.complex64)
    block = radalt.mitigation(scene, "whitening")
    out = np.empty_like(frames)
    block.work([frames[:2]], [out[:2]])
    block.set_method("nlms")
    block.work([frames[2:]], [out[2:]])
    np.testing.assert_array_equal(out[:2], create("whitening", W).process(frames[:2]))
    np.testing.assert_array_equal(out[2:], create("nlms", W, independent=True).process(frames[2:]))
    assert block.status()["method"] == "nlms"


def test_simulated_radios_keep_to_the_sample_rate(monkeypatch):
    """With a clock that only moves while the block sleeps, the sleeps add up to the length of the signal."""
    module = sys.modules[radalt.simulated_channel.__module__]
    now = [100.0]
    # the block's alone: threads of other tests may still sleep
    clock = types.SimpleNamespace(monotonic=lambda: now[0], sleep=lambda s: now.__setitem__(0, now[0] + s))
    monkeypatch.setattr(module, "time", clock)
    top = gr.top_block()
    source = blocks.vector_source_c([0j] * (50 * N))
    channel = radalt.simulated_channel(load_scene("paper_qpsk"), jammer=False, realtime=True)
    top.connect(source, channel, blocks.null_sink(gr.sizeof_gr_complex))
    run_to_end(top, time_limit_s=patient(60))
    assert 0.8 * 50 * W.sweep_s < now[0] - 100.0 <= 50 * W.sweep_s


def probed(folder: Path, *arguments: str) -> dict:
    """What the altimeters of the live view measured after each of its controls was moved."""
    quiet = os.environ | {"QT_QPA_PLATFORM": "offscreen", "GR_CONF_LOG_LOG_LEVEL": "warn"}
    done = ran_python(ROOT / "tests/live_probe.py", folder, *arguments, env=quiet, limit_s=150, check=True)
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("PROBE "))
    return json.loads(line.removeprefix("PROBE ")) | {"folder": folder, "printed": done.stdout}


@pytest.fixture(scope="module")
def view(tmp_path_factory) -> dict:
    return probed(tmp_path_factory.mktemp("live"))


def found(altitude_m: float) -> dict:
    """What the probe reports where every altimeter has the altitude."""
    return {"none": 1.0, "tcae": 1.0, "selected": 1.0, "true": altitude_m, "timing": "locked"}


def test_controls_work_while_it_runs(view):
    assert view["errors"] == [] and "stalled" not in view
    for step, altitude_m in (("start", 300.0), ("higher", 700.0), ("radar only", 700.0)):
        assert view[step] | found(altitude_m) == view[step], step
    assert view["method"] == "nlms"


def test_button_takes_timing_anew_at_altitude_zero(view):
    """The bare command takes 700 m for zero: no frame of that timing. The button sends zero first, then 700 m again."""
    assert view["mistimed"]["timing"] == "lost"
    assert view["reacquired"] | found(700.0) == view["reacquired"]
    assert "reacquire: timing taken anew" in view["printed"]


def test_jammer_and_transmitter_are_switched(view):
    """60 dB below the jammer nothing is found without mitigation; without the radar nobody finds anything."""
    assert view["jammed"]["none"] < 0.2
    assert max(view["off"][name] for name in ("none", "tcae", "selected")) < 0.2


def test_status_line_says_what_is_sent_measured_and_lost(view):
    """Once in each state of the controls; Pd of one frame in a hundred or two belongs to the state before."""
    said = {step: view[step]["status"] for step in view if isinstance(view[step], dict)}
    assert "sent: radar at 300 m, qpsk rectangular at SIR -10 dB, overlap 1" in said["start"]
    assert "timing locked" in said["start"] and "Chosen, whitening: <b>" in said["start"]
    assert "Chosen, nlms:" in said["higher"] and "radar at 700 m" in said["higher"]
    assert "timing LOST, no frames: press Reacquire timing" in said["mistimed"]
    assert "FAILURE (no timing)" in said["mistimed"] and "No mitigation -, TCAE -" in said["mistimed"]
    assert "sent: radar at 700 m, no jammer" in said["radar only"]
    assert "nothing (Transmit: Off)" in said["off"]
    assert all("lost: 0 samples, 0 frames" in text for text in said.values())
    # the first line has no time to tell a speed of, and the start may be reached before a second one
    assert "of real time" in said["start"] or "speed -" in said["start"]
    assert all("of real time" in text for step, text in said.items() if step != "start")


def test_window_fits_the_screen_without_scroll_bars(view):
    """The offscreen screen has 800 x 600 pixels; a small laptop's has 1280 x 800."""
    width, height = view["opened"]
    assert 700 <= width <= 800 and 500 <= height <= 600 and view["scroll bars"] == [False, False]


def test_status_names_who_measures_nothing():
    """Three altimeters: all right, a tenth wrong, silent."""

    def altimeter(valid, altitude_m):
        results = np.zeros(1000, dtype=RESULT_DTYPE)
        results["valid"], results["altitude_m"] = valid, altitude_m
        truth_m = np.full(1000, 300.0)
        return SimpleNamespace(latest=lambda count: (results, truth_m), line="NORMAL  300.0 m +/- 2.0 m")

    clock = iter((10.0, 12.0))
    counters = dict(state="locked", locked=True, timing_verified=True, lost_samples=7, dropped_slow=0)
    segmenter = SimpleNamespace(status=lambda: counters, segmenter=SimpleNamespace(sample_counter=0))
    inputs = dict(method="whitening", tx_enable=2, altitude_m=300.0, sir_db=-30.0, overlap=1.0)
    altimeters = dict(
        altimeter_none=altimeter(np.arange(1000) < 50, 300.0),
        altimeter_tcae=altimeter(True, np.where(np.arange(1000) < 100, 900.0, 301.0)),
        altimeter_selected=altimeter(True, 300.0),
    )
    top = SimpleNamespace(frame_segmenter=segmenter, **altimeters, **inputs)
    status = StatusLine(top, load_scene("paper_qpsk"), clock=lambda: next(clock))
    assert "speed -" in status.text()
    segmenter.segmenter.sample_counter = 7_500_000
    text = status.text()
    pd = "No mitigation <b>0.05</b> (0.00), TCAE <b>0.90</b> (0.10), Chosen, whitening: <b>1.00</b> (0.00)"
    assert f"Pd (wrong and valid) in the last second: {pd}" in text
    assert "no altitudes: No mitigation</b>" in text and "0.50 of real time" in text
    assert "lost: 7 samples, 0 frames (slow)</b>" in text and "NORMAL  300.0 m ± 2.0 m" in text
    clock = iter((13.0, 14.0))
    top.method = "none"
    assert "Chosen, no mitigation:" in status.text()
    top.reacquire = SimpleNamespace(running=True)
    text = status.text()
    assert "NORMAL" not in text and 'color:#a00000">REACQUIRING TIMING: 0 m is sent' in text


def test_chooser_offers_every_method():
    data = load_grc(ROOT / "flowgraphs/ota_live.grc")
    (chooser,) = (block["parameters"] for block in data["blocks"] if block["name"] == "method")
    options, labels = (ast.literal_eval(chooser[key]) for key in ("options", "labels"))
    assert set(options) == SHIPPED_METHODS and len(labels) == len(options)


def test_picture_shows_the_view(view):
    picture = Image.open(view["folder"] / "live.png").convert("RGB")
    assert min(picture.size) > 300 and len(picture.getcolors(maxcolors=1 << 24)) > 100


def test_view_runs_on_radios_set_up_in_order_and_touches_none_without_an_enclosure(tmp_path):
    """ota_live itself, on recorded doubles of two B210s: readback printed, common start, altitude right."""
    view = probed(tmp_path, "air")
    assert view["errors"] == [] and "stalled" not in view
    (refused,) = view["refused"]
    assert refused.startswith("transmit refused: 4.2-4.4 GHz is a safety-of-life band")
    assert view["start"] | found(300.0) == view["start"]
    assert "sent: radar at 300 m, qpsk rectangular at SIR -10 dB" in view["start"]["status"]
    assert view["printed"].count("master clock Hz") == 3
    # GRC's template sets the radios as well, before; what counts are the calls from the first clock source on
    calls = [tuple(call) for call in view["calls"] if not call[1].startswith("get_")]
    first = calls.index(("radar Source", "set_clock_source"))
    order = list(dict.fromkeys(call for _, call in calls[first:]))
    first_steps = "set_clock_source set_time_source set_samp_rate set_antenna set_gain set_center_freq"
    assert order == [*first_steps.split(), "set_time_now", "set_start_time", "start"]
    radios = {"radar Sink", "radar Source", "jammer Sink"}
    for call in ("set_start_time", "start"):
        assert sorted(radio for radio, made in calls if made == call) == sorted(radios)
