"""The live path's own accounts: CPU by block, latency, drops; frames that skip the network; no result by batch."""

import json
import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
import realtime_benchmark
from frames import W, white
from pages import assert_whole
from waiting import patient, wait_for

from radalt import load_scene
from radalt.core.mitigation import create
from radalt.studies.realtime.study import OutsideWatch, at_rate, fly_benchmark, long_scene, prepare_benchmark

PLAIN = {"batch": 1, "skip_clean": False, "own_process": False}


@pytest.mark.parametrize("realtime", [False, True])
def test_every_frame_is_measured_or_counted_as_dropped(tmp_path, realtime):
    scene = load_scene("paper_qpsk")
    scene = long_scene(replace(scene, altitude=replace(scene.altitude, programme_m=(200.0,))), 0.4)
    assert scene.altitude.programme.trial_frames == 400
    prepared = prepare_benchmark(scene, ("none", "whitening"), tmp_path, realtime=realtime, **PLAIN)
    result = fly_benchmark(prepared, scene, realtime=realtime, time_limit_s=patient(50))
    total = scene.altitude.programme.total_frames
    for count in result.frames.values():
        assert total <= count + result.dropped_frames <= total + 3
    assert {"chirp_source", "simulated_channel", "frame_segmenter", "altimeter_none"} <= result.cpu_s.keys()
    assert result.real_time_factor > 0
    if realtime:
        for latency in result.latency_ms.values():
            # a frame waits for the next one to confirm its timing: 1 ms, less what the chunks bring together
            assert latency.size > 0.9 * (total - result.dropped_frames)
            assert (latency > 0).all()
    else:
        assert result.dropped_frames == 0
        assert not any(latency.size for latency in result.latency_ms.values())


def test_at_a_wider_rate_frames_are_kept_and_what_is_not_is_counted(tmp_path):
    """Rings of long frames hold several."""
    scene = long_scene(at_rate(load_scene("clear"), 56e6), 0.2)
    prepared = prepare_benchmark(scene, ("none",), tmp_path, realtime=True, **PLAIN)
    result = fly_benchmark(prepared, scene, realtime=True, time_limit_s=patient(50))
    total = scene.altitude.programme.total_frames
    assert result.frames["none"] > 10
    assert total <= result.frames["none"] + result.dropped_frames <= total + 3


def test_the_command_prints_and_writes_what_it_measured(tmp_path, capsys, undrawn):
    arguments = "--seconds 0.4 --methods none --free-only --tracked --out".split()
    code = realtime_benchmark.main([*arguments, str(tmp_path / "run")])
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == str(tmp_path / "run" / "report.md")
    numbers = json.loads((tmp_path / "run" / "report.json").read_text())["runs"]["as fast as it goes"]
    assert code == (0 if numbers["real_time_factor"] >= 1.0 else 1)
    assert numbers["calls"]["frame_segmenter"] > 0
    assert_whole(tmp_path / "run/report.md", None)
    words = "real-time factor,frame_segmenter,calls per frame,blocks that copy"
    assert all(word in printed for word in (*words.split(","), "tracker_none", "dropped", "memory"))
    assert realtime_benchmark.main(["--scene", "no_such_scene"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_core_that_is_held_up_from_outside_is_seen():
    watch = OutsideWatch()
    held = watch._watchers[0].pid
    wait_for(lambda: len(os.listdir(f"/proc/{held}/task")) == 2, "the watcher's second thread")
    time.sleep(patient(0.1))
    os.kill(held, signal.SIGSTOP)
    time.sleep(0.2)
    os.kill(held, signal.SIGCONT)
    outside = watch.end()
    assert outside.longest_ms[0] > 150
    assert outside.total_ms[0] >= outside.longest_ms[0]
    assert len(outside.longest_ms) == len(os.sched_getaffinity(0))


def test_clean_frames_skip_the_network_and_others_do_not():
    method = create("tcae", W, skip_clean=True)
    always = create("tcae", W)
    clean = (W.beat_shifted(250.0) + 0.3 * white(np.random.default_rng(1), 3)).astype(np.complex64)
    interfered = clean.copy()
    interfered[1, 1000:3000] += 8.0
    out = method.process(interfered)
    assert method.status()["skipped_frames"] == 2
    assert out[0].tobytes() == interfered[0].tobytes()
    assert out[2].tobytes() == interfered[2].tobytes()
    assert out[1].tobytes() == always.process(interfered[1:2])[0].tobytes()
    assert always.status()["skipped_frames"] == 0
