"""The whole live path from the command line: tiny sweeps through the real flowgraph, and what it refuses."""

import csv
import sys
from pathlib import Path

import collect
import ota_eval
import pytest
from hostile import assert_refused, ended
from waiting import ran_python

from radalt.core.scene import load_scene
from radalt.evaluation.overlap.rows import COLUMNS
from radalt.evaluation.results.folder import read_report

SWEEP = "--methods none,whitening,lms --overlap 0,0.5,1 --sir-db=-28 --altitudes 600,40 --frames 3".split()


def stable(folder: Path) -> list[list[str]]:
    """rows.csv as text, without the timing columns."""
    lines = list(csv.reader((folder / "rows.csv").read_text(encoding="utf-8").splitlines()))
    keep = [k for k, name in enumerate(lines[0]) if name not in COLUMNS.timing]
    return [[line[k] for k in keep] for line in lines]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One uninterrupted run in a process of its own, as users start it, its output next to it."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    done = ran_python(ota_eval.__file__, "--sim", *SWEEP, "--out", folder, "--jobs", 1, check=True)
    return folder, done.stdout, done.stderr


def test_a_run_ends_with_the_whole_result_folder(whole):
    folder, out, err = whole
    report = read_report(folder)
    assert report["source"] == "simulated"
    wanted = [(overlap, method) for overlap in (0.0, 0.5, 1.0) for method in ("none", "whitening", "lms")]
    assert [(r["overlap"], r["method"]) for r in report["rows"]] == wanted
    for row in report["rows"]:
        assert (row["trials"], row["frames_lost"], row["lock_losses"]) == (6, 0, 0)
    for name in ("report.md", "scene.yaml", *report["figures"]):
        assert (folder / name).stat().st_size > 500
    used = load_scene(folder / "scene.yaml")
    assert used.altitude.programme_m == (600.0, 40.0) and used.sweep.sir_db == (-28.0,)
    assert report["versions"]["gnuradio"].startswith("3.10") and "onnxruntime" not in report["versions"]
    assert any("onnxruntime" in item for item in report["left_out"])
    assert report["real_time_factor"] > 0 and report["run"]["peak_memory_bytes"] < 3 << 30
    # plain lines where there is no terminal, nothing else next to them
    assert sum(line.startswith("[") for line in out.splitlines()) == 3 and err == ""


def test_the_rows_make_sense(whole):
    rows = {(r["method"], r["overlap"]): r for r in read_report(whole[0])["rows"]}
    assert rows["none", 0.0]["correct"] == rows["whitening", 0.0]["correct"] == 6
    assert rows["none", 0.0]["rmse_detected_m"] < 0.5
    by_altitude = list(csv.DictReader((whole[0] / "altitudes.csv").read_text(encoding="utf-8").splitlines()))
    assert len(by_altitude) == 2 * len(rows)
    for (method, overlap), row in rows.items():
        mine = [r for r in by_altitude if (r["method"], float(r["overlap"])) == (method, overlap)]
        assert [sum(int(r[c]) for r in mine) for c in ("trials", "correct")] == [6, row["correct"]]
        assert row["rmse_forced_m"] is None or row["rmse_low_m"] <= row["rmse_forced_m"] <= row["rmse_high_m"]
    # block LMS leaves its stable region under strong interference, and says so
    assert rows["lms", 0.0]["diverged_frames"] == 0 < rows["lms", 1.0]["diverged_frames"]
    assert rows["whitening", 1.0]["ms_per_frame_median"] > 0


def test_a_folder_with_a_run_is_refused_in_one_line(whole):
    before = (whole[0] / "rows.csv").read_bytes()
    refused = ended(ota_eval.main, "--sim", *SWEEP, "--out", whole[0])
    assert_refused(*refused, "holds a run already; add --resume")
    assert (whole[0] / "rows.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("--sim --overlap 1.2", "--overlap: sweep.overlap holds 1.2; overlaps have to be within 0..1"),
        ("--sim --methods none,magic", "methods names 'magic'; allowed: none, lms"),
        ("--sim --altitudes 90000", "90000 exceeds"),
        ("--sim --scene clear --overlap 0.5", "needs interference, and the scene has none"),
        ("--sim --model no_such.onnx", "no_such.onnx does not exist"),
        ("", "0 of 2 B210s found; connect them (uhd_find_devices lists what is there), or add --sim"),
    ],
)
def test_what_does_not_fit_is_one_line_and_code_2(monkeypatch, tmp_path, arguments, expected):
    monkeypatch.chdir(tmp_path)
    status, error = ended(ota_eval.main, *arguments.split())
    assert_refused(status, error, expected)
    assert error.startswith("ota_eval: ")
    assert not list(tmp_path.iterdir())  # nothing is left behind


def test_a_tracked_run_has_the_same_rows_and_scores_a_slow_flight(whole, tmp_path, measured_here, undrawn):
    """Ten outputs at each of two altitudes; the first three after a step confirm the track. No noise to be wrong in."""
    folder = tmp_path / "tracked"
    options = "--methods none,whitening,lms --overlap 0 --sir-db=-28 --altitudes 600,40 --frames 3 --jobs 1"
    assert ota_eval.main(["--sim", *options.split(), "--tracked", "--out", str(folder)]) == 0
    report = read_report(folder)
    assert stable(folder)[1:] == [row for row in stable(whole[0])[1:] if row[2] == "0"]
    rows = {row["method"]: row for row in report["tracked"]}
    assert set(rows) == {"none", "whitening", "lms"}
    for method in ("none", "whitening"):
        assert rows[method]["outputs"] == 20 and rows[method]["computed"] >= 12
        assert rows[method]["misleading"] == rows[method]["hazardous"] == 0 < rows[method]["hazardous_bound"]
    # towards the reference altitudes are filtered to zero
    assert rows["lms"]["computed"] < rows["none"]["computed"]
    assert "| none | 20 |" in (folder / "report.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("program", ["ota_eval.py", "collect.py"])
def test_the_wrong_python_is_one_line_and_code_2(root, program):
    # without site packages this very interpreter has neither GNU Radio nor NumPy
    done = ran_python("-S", root / "flowgraphs" / program, "--sim" if program == "ota_eval.py" else "x")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and sys.executable in done.stderr and "make setup" in done.stderr


def test_runs_of_several_seeds_are_collected_by_the_command(whole, tmp_path, measured_here, undrawn):
    again = tmp_path / "again"
    options = "--overlap", "1", "--seed", "2", "--out", str(again), "--jobs", "1"
    assert ota_eval.main(["--sim", *SWEEP, *options]) == 0
    assert read_report(again)["ceiling"][0]["overlap"] == 0  # measured though it is not in the sweep
    assert {r["overlap"] for r in read_report(again)["rows"]} == {1.0}
    assert ended(collect.main, whole[0], again, "--out", tmp_path / "all") == (0, "")
    pooled = {(r["method"], r["overlap"]): r for r in read_report(tmp_path / "all")["rows"]}
    assert pooled["none", 1.0]["trials"] == 12 and pooled["none", 0.5]["trials"] == 6
