"""Stability: stiff, extreme and broken frames end in a right altitude or in none, and the judge can say otherwise."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from frames import W, white
from pages import assert_whole

from radalt import Altimeter, AltimeterSettings, load_scene
from radalt.core.altimeter.altimeter import Reason
from radalt.core.interference.placement import interference_frames
from radalt.core.mitigation import create
from radalt.core.mitigation.base import Mitigation
from radalt.core.returns.point import point_return
from radalt.evaluation.engine.options import Options
from radalt.evaluation.engine.run import run
from radalt.evaluation.engine.study import Run
from radalt.evaluation.results.chain import Chain
from radalt.evaluation.results.folder import RunFolder
from radalt.studies.stability import cases, checks
from radalt.studies.stability.judge import judge, judge_all
from radalt.studies.stability.report import failures, write_report
from radalt.studies.stability.study import StabilityStudy, compared_chains


def not_passed(rows):
    bad = (r for r in rows if r["verdict"] not in ("pass", "refused"))
    return [f"{r['case']}: {r['chain']}: {r['verdict']} {r['reasons']}" for r in bad]


@pytest.mark.parametrize("method", ["whitening", "nlms"])  # the run below judges "none"
def test_number_range_and_converters(method):
    """Zeros, denormals, NaN, infinity, 1e38, one bit: no exception, no wrong altitude, the next frame right again."""
    assert not not_passed(judge_all(cases.number_cases(), compared_chains([method])))


@pytest.mark.parametrize(
    "made",
    [cases._altitude_cases, cases._speed_cases, lambda: islice(cases.waveform_cases(), 6), cases.stiff_cases],
    ids=["altitudes", "speeds", "sweeps", "stiff inputs"],
)
def test_extreme_altitudes_speeds_sweeps_and_stiff_inputs(made):
    """Of the sweeps 10 us to 10 ms, 6.7 to 20 MHz, B T_h not whole; the command has 0.1 to 200 MHz and 100 ms."""
    assert not not_passed(judge_all(made(), compared_chains(["none", "whitening"])))


@pytest.mark.parametrize("speed", [220.0, 250.0, 300.0, -300.0])
def test_a_speed_beyond_dopplers_reach_is_invalid_with_a_reason(speed):
    """Paired with a side lobe of the other half sweep it was a valid altitude 12 to 25 m off."""
    frame = point_return(W, 500.0, vertical_speed_m_per_s=speed)[None]
    result = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=150.0)).process(frame)[0]
    assert not result["valid"]
    assert result["reason"] == Reason.SWEEPS_DISAGREE


def test_shipped_network_keeps_altitudes_without_noise_and_makes_nothing_of_nothing():
    """Above an SNR of 50 dB it lost three altitudes of four, and made up one in six, before it was given a dither."""
    altitudes = np.linspace(30.0, 1400.0, 12)
    network = create("tcae", W)
    altimeter = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=0.0))
    result = altimeter.process(network.process(point_return(W, altitudes)))
    assert np.abs(result["altitude_m"] - altitudes).max() < 5.0
    assert not network.process(np.zeros((2, W.samples_per_frame), np.complex64)).any()


def test_what_the_network_leaves_of_nothing_is_no_line_that_stays():
    """Interference 70 dB above the noise, no return: a dither that every frame shared stood at 56 m for seconds."""
    rng, network = np.random.default_rng(70), create("tcae", W)
    altimeter = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=0.0))
    nr5 = load_scene("nr5").at(overlap=1.0, sir_db=-70.0)
    frames = white(rng, 96) + interference_frames(nr5.interference, 96, W.samples_per_frame, W.rate_hz, rng)
    spectra = altimeter.spectra(network.process(frames.astype(np.complex64)))
    cells = altimeter.significance(spectra)
    together = (cells.power / cells.level).mean(axis=0).sum(axis=0)  # 2 where all is alike
    assert together.max() < 5.0


def test_lms_steps_are_stable_to_two_over_lambda_max():
    rows = [checks.step_limit(spread) for spread in (1.0, 1e6)]
    assert rows[1]["condition"] > 1e5
    for row in rows:
        assert 0.7 < row["ratio"] < 1.5


def test_phase_and_timing_after_1e11_samples():
    rows = list(checks.long_run_rows())
    assert [r["check"] for r in rows if r["verdict"] == "FAIL"] == []


def test_broken_frames_in_a_running_flowgraph():
    assert checks.flowgraph_row("whitening")["verdict"] == "pass"


def test_a_block_that_fails_in_the_flowgraph_is_a_row_that_says_why(monkeypatch, capfd):
    def fail(self, *args, **kwargs):
        raise FloatingPointError("as it was")

    monkeypatch.setattr("radalt.core.mitigation.whitening.Whitening.process_into", fail)
    monkeypatch.setattr(checks, "create", lambda name, waveform: create("none", waveform))
    row = checks.flowgraph_row("whitening")
    assert (row["value"], row["verdict"]) == (None, "FAIL as it was")


@pytest.fixture
def case():
    return next(c for c in cases.number_cases() if c.name == "8-bit converter")


def test_a_wrong_truth_is_a_wrong_altitude(case):
    lie = replace(case, truth_m=case.truth_m + 50.0)
    row = judge(lie, Chain("none", "none"))
    assert (row["verdict"], row["wrong"]) == ("FAIL", 4)
    assert judge(lie, Chain("whitening", "whitening"))["verdict"] == "WRONG"


class Grudge(Mitigation):
    """Silent for ever after its first batch."""

    name = "grudge"

    def _clean(self, batch):
        return batch * (self.frames == len(batch))


class Overflow(Mitigation):
    name = "overflow"

    def _clean(self, batch):
        return batch * np.float32(1e30) * np.float32(1e30)


@pytest.mark.parametrize("method", [Grudge, Overflow])
def test_a_method_that_keeps_a_grudge_or_overflows_fails(case, method, monkeypatch):
    monkeypatch.setattr("radalt.evaluation.results.chain.create", lambda name, w, **_: method(w))
    assert judge(case, Chain("bad", "bad"))["verdict"] == "FAIL"


def test_report_names_what_did_not_pass_and_counts_the_rest(case, tmp_path):
    bad = replace(case, truth_m=case.truth_m + 50.0)
    study = StabilityStudy(compared_chains(["none"]))
    rows = [{"group": "numbers"} | row for row in judge_all([case, bad], study.chains)]
    tables = {"rows": rows, "step_limits": [], "checks": []}
    folder = RunFolder(tmp_path, {"study": "StabilityStudy", "versions": {"radalt": "0"}})
    write_report(folder, study, tables, Run(1, 2, 0, 1.0, 1, ".venv/bin/python flowgraphs/stability.py"))
    assert failures(tables) == ["8-bit converter: none: FAIL"]
    page = (tmp_path / "report.md").read_text()
    assert "| none | 8-bit converter | 4 of 4 wrong |" in page
    assert "| none | float32 | 2 | 1 | 0 | 0 | 0 | 1 |" in page
    assert (tmp_path / "figures" / "stability.png").stat().st_size > 5000


def test_a_run_judges_each_case_once_and_its_page_is_whole(tmp_path, measured_here, undrawn):
    study = StabilityStudy(compared_chains(["none"]), ("numbers",), ("none",))
    points = study.points()
    assert len({p.name for p in points}) == len(points)
    page = run(study, Options(tmp_path, jobs=1))
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert [line.split(",")[1] for line in lines[1:3]] == ["all zeros", "a constant"]
    assert len(lines) == 1 + len(list(cases.number_cases()))
    assert_whole(page, None)
    text = page.read_text()
    assert "Nothing." in text and "a process of 2 threads" in text and "[rows.csv](rows.csv)" in text
