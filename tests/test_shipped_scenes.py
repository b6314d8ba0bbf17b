"""Shipped scenes: each loads, plays at its SIR through the jammer block, and runs to a report."""

import numpy as np
import pytest
from gnuradio import radalt
from test_blocks import Collect, run

from radalt.core.scene import SceneError, load_scene, parse_scene
from radalt.evaluation.overlap.points import OverlapPoint
from radalt.evaluation.overlap.study import OverlapStudy, capture_name

SCENES = ("nr5", "nr10", "tones", "mixture", "faa_mask", "fmcw", "qpsk_shaped", "paper_qpsk")
FRAMES = 12


def played(source) -> np.ndarray:
    """(frames, N) what a finite source block puts out."""
    sink = Collect()
    run(source, sink)
    return sink.data.reshape(-1, 7500)


def test_every_shipped_scene_has_points_to_measure(root):
    for path in sorted((root / "flowgraphs/scenes").glob("*.yaml")):
        assert OverlapStudy(load_scene(path)).points(), path.name


def test_a_landing_over_terrain_is_not_tracked_and_says_why():
    study = OverlapStudy(load_scene("landing_terrain"), tracked=True)
    with pytest.raises(SceneError, match="--tracked: frames of a landing over terrain are apart in time"):
        study.check()


def test_the_page_replays_a_recording_by_the_name_that_it_gets(root):
    point = OverlapPoint.at(0.5, -10.0, 10.0, 150)
    page = (root / "docs/results.md").read_text(encoding="utf-8")
    assert f"--replay results/mine/captures/{capture_name(point)}.sigmf-meta " in page


@pytest.mark.parametrize("name", SCENES)
def test_jammer_block_plays_the_scene_at_its_total_sir_and_stays_silent_in_the_preamble(name):
    scene = load_scene(name).at(overlap=0.6, sir_db=-20.0)
    frames = played(radalt.jammer_source(scene, frames=FRAMES))
    power = np.mean(np.abs(frames.astype(np.complex128)) ** 2, axis=1)
    preamble = scene.altitude.preamble_frames
    assert not power[:preamble].any()
    # windows of a free-running emitter are not those of the radar: each frame has parts of two
    within = 2.0 if any(one.free_running for one in scene.interference) else 0.01
    np.testing.assert_allclose(10 * np.log10(power[preamble:]), 20.0, atol=within)


def test_faa_mask_states_interference_to_noise_and_sir():
    scene = parse_scene({"interference": {"faa_91_220": {"altitude_ft": 200}}})
    report = scene.interference[0].emitter.report()
    assert scene.interference[0].sir_db == pytest.approx(report.sir_db)
    (note,) = scene.interference[0].emitter.notes(7.5e6)
    assert f"I/N {report.i_over_n_db:+.1f} dB" in note
    assert f"SIR {report.sir_db:+.1f} dB" in note


def test_faa_mask_keeps_its_level_through_multipath():
    direct, from_block = (
        parse_scene({"interference": {"faa_91_220": {"altitude_ft": 200} | more}}).interference[0]
        for more in ({}, {"fading": {}})
    )
    assert from_block.sir_db == direct.sir_db
