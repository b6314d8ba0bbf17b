"""The landing study end to end: rows by seed alone, resumable, any flight, physics that must hold."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import ota_eval
import pytest
from hostile import assert_refused, ended
from pages import assert_whole

from radalt import AltimeterSettings, Waveform, load_scene
from radalt.core.returns.landing import LandingSpec
from radalt.core.scene import parse_scene
from radalt.core.scene.build import segmenter_of
from radalt.evaluation.overlap.study import OverlapStudy
from radalt.evaluation.results.folder import SCHEMA
from radalt.evaluation.results.score import accuracy_limit_m
from radalt.evaluation.simulation import segmented
from radalt.studies.landing import command as landing_command
from radalt.studies.landing import config as landing
from radalt.studies.landing import report as landing_report
from radalt.studies.landing import study as landing_study
from radalt.studies.landing.assumptions import ASSUMPTIONS
from radalt.studies.landing.study import LandingStudy

SMALL = """
seed: 3
methods: [none, blanking]
approach: {frames: 8, sir_db: -15, overlap: 0.3, chunk: 4}
sensitivity_trials: 0
"""


@pytest.fixture
def small(tmp_path, root):
    data, path = root / "flowgraphs" / "landing", tmp_path / "small.yaml"
    files = f"{{files: [{data / 'hilly_n41w089.dt0'}, {data / 'hilly_n41w088.dt0'}]}}"
    path.write_text(f"{SMALL}trajectory: {{file: {data / 'approach_kord_10c.csv'}}}\nterrain: {files}\n")
    return path


def _config(root, **changes):
    config = landing.parse_config({}, folder=str(root / "flowgraphs" / "landing"))
    return replace(config, **{"methods": ("none",), **changes})


def _rows(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_shipped_study_states_the_defaults(root):
    shipped = landing.load_config(root / "flowgraphs" / "landing" / "study.yaml")
    assert shipped == landing.parse_config({}, folder=shipped.folder)
    # what is written next to the results is a study file again
    assert landing.parse_config(landing.config_dict(shipped), folder=shipped.folder) == shipped


def test_a_run_writes_its_folder(small, tmp_path, measured_here, undrawn):
    one = tmp_path / "one"
    assert landing_command.main([str(small), "--out", str(one), "--jobs", "1"]) == 0
    report = json.loads((one / "report.json").read_text())
    assert report["schema"] == SCHEMA and report["seed"] == 3
    assert {p.name for p in one.iterdir()} == {
        *"approach.csv report.json report.md report.html study.yaml run.json points.jsonl .lock".split(),
        *(str(Path(f).with_suffix(kind)) for f in report["figures"] for kind in (".png", ".svg", ".pdf")),
    }
    assert len(report["figures"]) == 2
    assert_whole(one / "report.md", None)
    assert any("onnxruntime was not imported" in line for line in report["left_out"])
    assert all(len(digest) == 64 for digest in report["inputs_sha256"].values())
    # 8 frames: once without interference, once for each of two methods
    assert len(_rows(one / "approach.csv")) == 24


@pytest.mark.parametrize("name", ["landing_terrain", "leakage"])
def test_a_scene_states_the_content_of_its_files_wherever_they_lie(name, tmp_path):
    study = OverlapStudy(replace(load_scene(name), methods=("none",)))
    copies = {}
    for k, (file, path) in enumerate(study.files().items()):
        copies[file] = tmp_path / f"{k}{path.suffix}"
        shutil.copy(path, copies[file])
    moved = study.with_files(copies)
    assert moved.files() == copies and copies
    moved.check()
    stated = study.head()["inputs_sha256"]
    assert moved.head()["inputs_sha256"] == stated and set(stated) == set(copies)
    with next(iter(copies.values())).open("a") as file:
        file.write("\n")
    assert moved.head()["inputs_sha256"] != stated


def test_somebody_elses_flight_works_without_code(small, tmp_path, root, measured_here, undrawn):
    """ADS-B state vectors over the shipped ground: GNSS altitudes, 25 ft steps, a row on the ground."""
    rows = ["time,icao24,lat,lon,velocity,heading,vertrate,onground,baroaltitude,geoaltitude"]
    for k in range(25):
        altitude = round((560.0 - 13.3 * k) / 7.62) * 7.62 - 34.0
        longitude = -88.04 + 0.0043 * k
        rows.append(f"{1700000000 + 5 * k},abc123,41.9662,{longitude:.4f},71,90,-3,false,,{altitude:.2f}")
    rows.append("1700000125,abc123,41.9662,-87.93,60,90,0,true,,")
    path = tmp_path / "adsb.csv"
    path.write_text("\n".join(rows) + "\n")
    files = [str(root / "flowgraphs" / "landing" / f"flat_n41w0{n}.dt0") for n in (89, 88)]
    arguments = [str(small), "--out", str(tmp_path / "out"), "--jobs", "1", "--trajectory", str(path)]
    arguments += ["--altitude-offset-m", "34", "--terrain", *files]
    assert landing_command.main(arguments) == 0
    heights = [float(r["height_m"]) for r in _rows(tmp_path / "out" / "approach.csv")]
    assert max(heights) == pytest.approx(356.0, abs=4.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--terrain", "{flat}/flat_n41w088.dt0"], "does not cover"),
        (["--trajectory", "missing.csv"], "missing.csv"),
        (["--altitude-offset-m", "-300"], "above ground"),
        (["--altitude-offset-m", "2000"], "max_altitude_m"),
        (["--max-gap-s", "0.1"], "max_gap_s"),
        (["{out}/wide.yaml"], "does not fit the rate"),
    ],
)
def test_what_does_not_fit_gets_one_line(small, tmp_path, root, arguments, message):
    (tmp_path / "wide.yaml").write_text(small.read_text() + "interference: {qpsk: {bandwidth_hz: 9.0e+6}}\n")
    flat = root / "flowgraphs" / "landing"
    arguments = [a.format(flat=flat, out=tmp_path) for a in arguments]
    study = [] if arguments[0].endswith(".yaml") else [str(small)]
    out = "--out", tmp_path / "out", "--jobs", "1"
    assert_refused(*ended(landing_command.main, *study, *arguments, *out), message)


# the nadir leaves the western cell at 76.3 s, the footprint some seconds before
WEST = {"trajectory": {"end_s": 76.0}, "terrain": {"files": ["flat_n41w089.dt0"]}}


@pytest.mark.parametrize("way", [["--plan"], ["--out", "run"]])
def test_a_footprint_that_leaves_the_terrain_is_one_line_from_the_plan_on(tmp_path, monkeypatch, way):
    monkeypatch.chdir(tmp_path)
    altitude = {"frames": 1, "landing_frames": 40}
    Path("west.yaml").write_text(json.dumps({"return": "terrain", "altitude": altitude, "landing": WEST}))
    ends = ended(ota_eval.main, "--sim", "--scene", "west.yaml", "--methods", "none", *way)
    assert_refused(*ends, "terrain does not cover 41.9")
    assert not Path("run").exists()


def test_accuracy_bands_in_feet():
    limit = accuracy_limit_m(np.array([20.0, 99.9, 100.1, 500.0, 501.0, 1000.0]) * 0.3048) / 0.3048
    assert limit == pytest.approx([3.0, 3.0, 3.003, 15.0, 25.05, 50.0], rel=1e-3)


def test_frames_have_the_sir_and_sinr_they_state(root):
    config = _config(root, snr_db=12.0)
    samples = config.waveform.samples_per_frame
    silent = landing_study.Truth(np.zeros((40, 1, samples), np.complex64), *[np.full(40, 12.0)] * 5)
    rng = np.random.default_rng(0)
    frames, sir, sinr = landing_study.impaired(config, silent, rng, overlap=0.4, sir_db=-15.0)
    assert 10 * np.log10(np.mean(np.abs(frames) ** 2)) == pytest.approx(-sinr[0], abs=0.02)
    assert sir == pytest.approx(-15.0)
    assert np.mean(np.abs(frames[0, 0]) ** 2 > 5.0) == pytest.approx(0.4, abs=0.01)


def test_doppler_cancels_in_altitude_and_shows_as_vertical_speed(root):
    """A point descending at 3.8 m/s: same altitude as at rest, right vertical speed."""
    config = _config(root, snr_db=30.0, point_target=True, altimeter=AltimeterSettings())
    truth = landing_study.approach_frames(replace(config, approach=landing.ApproachSpec(12)), 0, 12)
    results, _ = landing_study.altitudes(config, truth.frames, "none")
    still = replace(config, doppler=False)
    flat = landing_study.approach_frames(replace(still, approach=landing.ApproachSpec(12)), 0, 12)
    at_rest, _ = landing_study.altitudes(still, flat.frames, "none")
    assert results["valid"].all()
    assert results["altitude_m"] == pytest.approx(at_rest["altitude_m"], abs=0.5)
    # the flare apart, where the altitude is below a range cell, vertical speed follows the trajectory
    assert results["vertical_speed_m_per_s"][:-1] == pytest.approx(truth.climb_m_per_s[:-1], abs=0.6)
    assert np.abs(at_rest["vertical_speed_m_per_s"]).max() < 0.6


def test_extended_ground_costs_metres_and_averaging_wins_them_back(root):
    """The interference-free ceiling: a point is measured to a metre; ground is not, eight sweeps help."""
    rms = {}
    for name, changes in {"point": {"point_target": True}, "ground": {}, "looks": {"looks": 8}}.items():
        config = _config(root, **changes)
        truth = landing_study.trial_frames(config, 24)
        frames, _, _ = landing_study.impaired(config, truth, np.random.default_rng(1))
        results, _ = landing_study.altitudes(config, frames, "none")
        assert results["valid"].all()
        rms[name] = np.sqrt(np.mean((results["altitude_m"] - truth.height_m) ** 2))
    # 24 frames of speckle: the ratio itself scatters by some tenth around 0.7
    assert rms["point"] < 1.5 < rms["looks"] < 0.8 * rms["ground"]


def test_every_assumption_changes_one_thing(root):
    config = _config(root, sensitivity_trials=2, approach=landing.ApproachSpec(0))
    points = LandingStudy(config).points()
    assert [p.assumption for p in points] == [a.name for a in ASSUMPTIONS]
    assert len({a.name for a in ASSUMPTIONS}) == len(ASSUMPTIONS)
    rows = [row for p in points[:3] + points[-3:] for row in LandingStudy(config).measure(p)]
    table = {r["assumption"]: r for r in landing_report.sensitivity(rows)}
    assert table["baseline"]["sir_db"] == -15.0
    assert table["sir_minus_25"]["sir_db"] == -40.0
    assert np.isinf(table["no_interference"]["sir_db"])
    for assumption in ASSUMPTIONS[1:]:
        assert assumption.shift_db or assumption.change(config) != config, assumption.name


def test_live_profile_plays_the_same_echoes(root):
    """What flowgraphs are given by frame index is what the study measures: heights, rates, echoes of unit power."""
    profile = LandingSpec().profile(Waveform(), frames=60, seed=5)
    assert profile.altitude_m[0] > 500 > 2.5 > profile.altitude_m[-1] > 1.9
    result = profile.ground_return(17)
    assert profile.altitude_m[17] == pytest.approx(result.height_m, abs=1e-6)
    powers = [np.mean(np.abs(profile.frame(k)) ** 2) for k in range(60)]
    assert np.mean(powers) == pytest.approx(1.0, abs=0.35)
    with pytest.raises(ValueError, match="at least 2"):
        LandingSpec().profile(Waveform(), frames=1)


@pytest.mark.parametrize("altimeter", [{}, {"max_altitude_m": 1600.0}])
def test_ground_above_the_default_span_loses_no_frame(tmp_path, altimeter):
    """Level at 1,600 m over flat ground, whose far echoes lie beyond its nearest point."""
    rows = "".join(f"{k},{41 + 5e-4 * k},-87.5,1600\n" for k in range(4))
    (tmp_path / "high.csv").write_text("time_s,latitude_deg,longitude_deg,altitude_m\n" + rows)
    files = {"trajectory": {"file": "high.csv"}, "terrain": {"files": [], "flat_m": 0.0}}
    keys = {"return": "terrain", "altitude": {"frames": 1, "landing_frames": 30}, "altimeter": altimeter}
    keys |= {"landing": {"folder": str(tmp_path), **files}, "channel": {"snr_db": 20.0}}
    scene = parse_scene(keys)
    segmenter = segmenter_of(scene)
    frames = [frame for part in segmented(scene, segmenter) for frame in part]
    assert sum(bool(scene.altitude.programme.is_trial(frame.index)) for frame in frames) == 30
    assert segmenter.counters["lock_losses"] == 0
