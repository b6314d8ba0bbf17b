"""Error against run time: paired frames, fronts and gains, and the command that writes the report."""

import json

import error_vs_runtime
import numpy as np
import pytest
from pages import assert_whole

from radalt.evaluation.results.chain import Chain
from radalt.studies.runtime import study as runtime
from radalt.studies.runtime.figure import pareto
from radalt.studies.runtime.study import RuntimeStudy

TONES = "5 tones, all"
CHAINS = ("none", "whitening", "none, centroid")


def test_nothing_on_the_front_is_beaten_and_everything_off_it_is():
    rng = np.random.default_rng(1)
    points = {str(k): tuple(p) for k, p in enumerate(rng.random((60, 2)))}
    front = pareto(points)
    for label, (cost, loss) in points.items():
        beaten = any(c <= cost and x <= loss for other, (c, x) in points.items() if other != label)
        assert beaten == (label not in front)
    assert front == sorted(front, key=lambda label: points[label][0])


def test_all_chains_see_the_same_frames_and_whitening_gains_on_tones():
    chains = (Chain("none", "none"), Chain("twin", "none"), Chain("whitening", "whitening"))
    study = RuntimeStudy(chains, (-40.0,), frames=20, interferers=(TONES,))
    points = [p for p in study.points() if p.table == "rows"]
    by = {(r["interferer"], r["chain"]): r for p in points for r in study.measure(p)}
    for name in ("clean", TONES):
        same = [{k: v for k, v in by[name, label].items() if k != "chain"} for label in ("none", "twin")]
        np.testing.assert_equal(*same)  # where nothing was detected there is no mean
    assert by["clean", "none"]["pd"] == 1.0
    assert by[TONES, "whitening"]["pd"] > by[TONES, "none"]["pd"] + 0.5


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Of the command, with two interferers, three chains, each of which takes a process, and no network."""
    out = tmp_path_factory.mktemp("runtime")
    arguments = ["--models", "--frames", "6", "--rounds", "2", "--sir-db=-15,-45"]
    arguments += ["--interferers", "QPSK rectangular, 30 %", TONES]
    chains = [c for c in runtime.compared_chains(()) if c.label in CHAINS]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runtime, "compared_chains", lambda models: (*chains, *models))
        assert error_vs_runtime.main([*arguments, "--out", str(out / "run")]) == 0
    return out


@pytest.mark.timeout(300)  # a process per chain, for its memory
def test_command_writes_the_whole_report(report, browser):
    data = json.loads((report / "run" / "report.json").read_text())
    by = {s["chain"]: s for s in data["summary"]}
    assert by["none"]["clean"]["pd"] == 1.0
    assert by["none"]["clean"]["rmse_forced_m"] > 0.5 * data["crb_m"]
    broken = by["whitening"]["break_points"][TONES]
    assert (broken["sir_db"], broken["mark"]) == (-45.0, "<=")
    gain = by["whitening"]["protection_gains"][TONES]
    assert gain["mark"] == ">=" and 0 < gain["db"] < 30.0  # no mitigation holds at -15 dB and breaks below
    assert by["none"]["mean_gain"] == {"db": 0.0, "mark": "", "text": "0.0"}
    for times in (s["times"][batch] for s in data["summary"] for batch in ("1", "8")):
        assert 0 <= times["ms_method"] <= times["ms_median"] <= times["ms_p99"]
    assert set(data["fronts"]) == {"pooled", "QPSK rectangular, 30 %", TONES}
    assert all(s["memory_bytes"] >= 0 for s in data["summary"])
    assert (report / "run" / "figures" / "error_vs_runtime.png").stat().st_size > 20_000
    assert_whole(report / "run/report.md", browser)
    text = (report / "run" / "report.md").read_text()
    assert "## Pareto fronts" in text and "| whitening |" in text
    assert ".venv/bin/python flowgraphs/error_vs_runtime.py --models --interferers" in text
