"""Error against run time: paired frames, fronts and break points, and the command that writes the report."""

import json

import error_vs_runtime
import numpy as np
import pytest

from gnuradio.radalt.evaluation import runtime
from gnuradio.radalt.evaluation.runtime import Variant, break_point_db, measure_errors, measure_times, pareto


def test_nothing_on_the_front_is_beaten_and_everything_off_it_is():
    rng = np.random.default_rng(1)
    points = {str(k): tuple(p) for k, p in enumerate(rng.random((60, 2)))}
    front = pareto(points)
    for label, (cost, loss) in points.items():
        beaten = any(c <= cost and x <= loss for other, (c, x) in points.items() if other != label)
        assert beaten == (label not in front)
    assert front == sorted(front, key=lambda label: points[label][0])


def test_break_point_counts_from_the_top_without_a_gap():
    def row(sir_db, pd):
        return {"sir_db": sir_db, "pd": pd}

    assert break_point_db([row(-30.0, 0.95), row(-10.0, 1.0), row(-20.0, 0.5)]) == -10.0
    assert break_point_db([row(-30.0, 0.9), row(-20.0, 1.0)]) == -30.0
    assert break_point_db([row(-10.0, 0.89)]) is None


def test_all_variants_see_the_same_frames_and_whitening_gains_on_tones():
    candidates = [Variant("none", "none"), Variant("twin", "none"), Variant("whitening", "whitening")]
    rows = [
        r
        for r in measure_errors(candidates, (-40.0,), 20, 1, lambda text: None)
        if r["interferer"] in ("clean", "5 tones, all")
    ]
    by = {(r["interferer"], r["variant"]): r for r in rows}
    for name in ("clean", "5 tones, all"):
        same = [{k: v for k, v in by[name, label].items() if k != "variant"} for label in ("none", "twin")]
        assert same[0] == same[1]
    assert by["clean", "none"]["pd"] == 1.0
    assert by["5 tones, all", "whitening"]["pd"] > by["5 tones, all", "none"]["pd"] + 0.5


def test_times_are_of_method_and_altimeter_together():
    times = measure_times([Variant("none", "none"), Variant("nlms", "nlms")], (1, 2), 2, lambda text: None)
    by = {(t["variant"], t["batch"]): t for t in times}
    assert len(by) == 4
    for t in times:
        assert 0 <= t["ms_method"] <= t["ms_median"] <= t["ms_p99"]
    assert by["nlms", 1]["ms_method"] > by["none", 1]["ms_method"]  # hundreds of block updates against a copy


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    out = tmp_path_factory.mktemp("runtime")
    small = {k: runtime.INTERFERERS[k] for k in ("QPSK rectangular, 30 %", "5 tones, all")}
    patch = pytest.MonkeyPatch()
    patch.setattr(runtime, "INTERFERERS", small)
    patch.setattr("gnuradio.radalt.evaluation.runtime_report.INTERFERERS", small)
    patch.setattr(runtime, "measure_memory", lambda variant, batch: 1)
    arguments = ["--models", "--frames", "6", "--rounds", "2", "--sir-db=-15,-45", "--out", str(out)]
    assert error_vs_runtime.main(arguments) == 0
    patch.undo()
    return out


def test_command_writes_the_whole_report(report):
    data = json.loads((report / "error_vs_runtime.json").read_text())
    by = {s["variant"]: s for s in data["summary"]}
    assert by["none"]["clean"]["pd"] == 1.0
    assert by["none"]["clean"]["rmse_forced_m"] > 0.5 * data["crb_m"]
    assert by["whitening"]["break_point_db"]["5 tones, all"] == -45.0
    assert by["whitening"]["protection_gain_db"]["5 tones, all"] == 30.0
    assert by["none"]["mean_gain_db"] == 0.0
    assert set(data["fronts"]) == {"pooled", "QPSK rectangular, 30 %", "5 tones, all"}
    assert (report / "figures" / "error_vs_runtime.png").stat().st_size > 20_000
    text = (report / "error_vs_runtime.md").read_text()
    assert "## Pareto fronts" in text and "| whitening |" in text


def test_a_model_that_is_not_there_is_one_line(capsys):
    assert error_vs_runtime.main(["--models", "nowhere.onnx", "--frames", "2", "--rounds", "2"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "nowhere.onnx" in error
