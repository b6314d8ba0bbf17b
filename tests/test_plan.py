"""The planner: what a scene leaves out is not built and not imported, and changes no result."""

import csv

import ota_eval
import pytest
from pages import assert_whole

from radalt.core.paths import share_dir
from radalt.core.scene import parse_scene
from radalt.evaluation.engine.options import Options
from radalt.evaluation.engine.run import run
from radalt.evaluation.flowgraph.plan import make_plan
from radalt.evaluation.flowgraph.rewrite import JAMMER_SINK, RADAR_SINK, load_grc, prune
from radalt.studies.leaving_out import study as leaving_out
from radalt.studies.leaving_out.report import summarise


def scene(**data):
    return parse_scene({"altitude": {"programme_m": [300.0, 20.0], "frames": 3}, **data})


@pytest.mark.parametrize("name", ["QPSK, whitening", *leaving_out.CHECKED])
def test_left_out_parts_change_no_bit_of_the_results(name):
    """Against the flowgraph with every method's chain and, where nothing interferes, a jammer that sends nothing."""
    pruned, full = (leaving_out.run_once(name, 2, built) for built in ("pruned", "all"))
    assert pruned["digest"] == full["digest"] and pruned["declared"] == full["declared"] > 0


def test_the_report_says_what_was_saved_and_that_nothing_changed(tmp_path, undrawn):
    study = leaving_out.LeavingOutStudy(frames=2, repeats=1, scenes=("no interference, whitening",))
    made = run(study, Options(tmp_path))
    assert_whole(made, None)
    page = made.read_text()
    assert "| no interference, whitening | none, whitening |" in page and "| yes |" in page
    assert page.split("imported of onnxruntime")[1].count("| none |") == 1
    rows = {row["built"]: row for row in csv.DictReader((tmp_path / "rows.csv").open())}
    assert "onnxruntime" in rows["all"]["modules"] and rows["pruned"]["modules"] == ""
    assert int(rows["pruned"]["memory_bytes"]) < int(rows["all"]["memory_bytes"])
    row = {"scene": "no interference, whitening", "cpu_s": 1.0, "memory_bytes": 1, "frames": 1, "modules": ""}
    changed = [row | {"built": built, "digest": built} for built in ("pruned", "all")]
    assert [s["identical"] for s in summarise(changed, 2)] == [False]


def test_without_interference_there_is_no_jammer_chain_and_no_second_radio():
    clear = make_plan(scene(), ("none",))
    jammed = make_plan(scene(interference={"qpsk": {}}), ("none",))
    silent = make_plan(scene(interference={"qpsk": {"overlap": 0.0}}), ("none",))
    assert (clear.radios, jammed.radios, silent.radios) == (1, 2, 1)
    data = prune(load_grc(share_dir() / "flowgraphs" / "ota_b210.grc"), ("none",), False)
    state = {b["name"]: b["states"]["state"] for b in data["blocks"]}
    assert state[JAMMER_SINK] == state["jammer_source"] == "disabled"
    assert state[RADAR_SINK] == "enabled"


def test_beat_band_decimation_and_fft_follow_the_highest_altitude():
    scenes = [scene(altitude={"programme_m": [top], "frames": 1}) for top in (100.0, 15_000.0)]
    low, high = (make_plan(one, ("none",)).altimeter for one in scenes)
    assert (low.settings.min_altitude_m, low.settings.max_altitude_m) == (0.0, 100.0)
    assert low.search_hz[1] < high.search_hz[1] / 50
    assert low.decimation > high.decimation and low.fft_size < high.fft_size


def test_doppler_is_searched_where_the_scene_flies_it():
    still = scene()
    climbing = scene(altitude={"programme_m": [300.0], "mode": "true_delay", "vertical_speed_m_per_s": -40.0})
    allowed = [one.altimeter_settings.max_vertical_speed_m_per_s for one in (still, climbing)]
    few, more = (make_plan(one, ("none",)).altimeter.doppler_cells for one in (still, climbing))
    assert allowed == [0.0, 40.0] and more > few
    assert scene(altimeter={"max_altitude_m": 900.0}).altimeter_settings.max_altitude_m == 900.0


def test_plan_is_printed_and_nothing_runs(capsys):
    assert ota_eval.main(["--sim", "--plan", "--scene", "clear", "--methods", "none"]) == 0
    text = capsys.readouterr().out
    assert "jammer source and second B210: the scene has no interference" in text
    assert "onnxruntime: no network among the methods" in text
    assert "radios on the air: 1" in text
