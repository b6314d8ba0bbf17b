"""Error against run time: paired frames, fronts and break points, and the command that writes the report."""

import json

import error_vs_runtime
import numpy as np
import pytest

from gnuradio.radalt.evaluation.results.journal import Journal, JournalError
from gnuradio.radalt.evaluation.runtime import study as runtime
from gnuradio.radalt.evaluation.runtime.figure import place_labels
from gnuradio.radalt.evaluation.runtime.study import (
    Variant,
    break_point_db,
    measure_errors,
    measure_times,
    pareto,
    summarise_times,
)


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
    points = [(None, 0.0), ("5 tones, all", -40.0)]
    measured = measure_errors(candidates, points, 20, 1, lambda text: None)
    by = {(r["interferer"], r["variant"]): r for rows in measured for r in rows}
    for name in ("clean", "5 tones, all"):
        same = [{k: v for k, v in by[name, label].items() if k != "variant"} for label in ("none", "twin")]
        assert same[0] == same[1]
    assert by["clean", "none"]["pd"] == 1.0
    assert by["5 tones, all", "whitening"]["pd"] > by["5 tones, all", "none"]["pd"] + 0.5


def test_times_are_of_method_and_altimeter_together():
    rounds = list(
        measure_times([Variant("none", "none"), Variant("nlms", "nlms")], (1, 2), 2, lambda text: None)
    )
    assert len(rounds) == 2  # the one that warms up is not among them
    times = summarise_times(rounds)
    by = {(t["variant"], t["batch"]): t for t in times}
    assert len(by) == 4
    for t in times:
        assert 0 <= t["ms_method"] <= t["ms_median"] <= t["ms_p99"]
    assert by["nlms", 1]["ms_method"] > by["none", 1]["ms_method"]  # hundreds of block updates against a copy


@pytest.fixture(scope="module")
def small():
    """A study of two interferers, without the memory, which takes a process a variant."""
    interferers = {k: runtime.INTERFERERS[k] for k in ("QPSK rectangular, 30 %", "5 tones, all")}
    patch = pytest.MonkeyPatch()
    patch.setattr(runtime, "INTERFERERS", interferers)
    patch.setattr("gnuradio.radalt.evaluation.runtime.report.INTERFERERS", interferers)
    patch.setattr(runtime, "measure_memory", lambda variant, batch: 1)
    yield ["--models", "--frames", "6", "--rounds", "2", "--sir-db=-15,-45"]
    patch.undo()


@pytest.fixture(scope="module")
def report(small, tmp_path_factory):
    out = tmp_path_factory.mktemp("runtime")
    assert error_vs_runtime.main([*small, "--out", str(out)]) == 0
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


def test_a_killed_run_goes_on_and_its_errors_are_those_of_one_run(
    small, report, tmp_path, monkeypatch, capsys
):
    """Killed within a point and again within the times: nothing whole is measured twice."""
    arguments = [*small, "--out", str(tmp_path)]
    score, timed = runtime._scored, runtime._timed
    calls = {"scored": 0, "timed": 0}

    def counting(name, function, end):
        def call(*arguments):
            calls[name] += 1
            if calls[name] == end:
                raise KeyboardInterrupt
            return function(*arguments)

        return call

    variants = len(json.loads((report / "error_vs_runtime.json").read_text())["summary"])
    monkeypatch.setattr(runtime, "_scored", counting("scored", score, 2 * variants + 3))
    assert error_vs_runtime.main(arguments) == 130
    assert "--resume" in capsys.readouterr().err
    assert error_vs_runtime.main(arguments) == 2
    assert "add --resume" in capsys.readouterr().err
    assert error_vs_runtime.main([*arguments, "--resume", "--seed", "2"]) == 2
    assert "seed is 1 there and 2 here" in capsys.readouterr().err
    with (tmp_path / "error_vs_runtime.partial").open("a") as file:
        file.write('{"kind": "errors", "interferer": "5 to')  # cut by the kill
    monkeypatch.setattr(runtime, "_timed", counting("timed", timed, 4 * variants + 1))
    assert error_vs_runtime.main([*arguments, "--resume"]) == 130
    monkeypatch.setattr(runtime, "_timed", counting("timed", timed, 0))
    assert error_vs_runtime.main([*arguments, "--resume"]) == 0
    # five points, of them the third begun twice; two rounds, each after one that warms up, and the one that was cut
    assert calls["scored"] == 5 * variants + 3
    assert calls["timed"] == 4 * variants + 1 + 4 * variants
    assert not (tmp_path / "error_vs_runtime.partial").exists()
    one, other = (json.loads((folder / "error_vs_runtime.json").read_text()) for folder in (report, tmp_path))
    assert one["rows"] == other["rows"]


def test_a_journal_keeps_whole_lines_and_says_whose_it_is(tmp_path):
    path = tmp_path / "deep" / "run.partial"
    journal = Journal(path, {"seed": 1, "sirs_db": (1.0, 2.0)}, resume=False)
    journal.add({"kind": "a", "n": 1})
    path.write_text(path.read_text() + '{"kind": "a", "n": 2')
    again = Journal(path, {"seed": 1, "sirs_db": [1, 2]}, resume=True)
    assert again.resumed and again.of("a") == [{"kind": "a", "n": 1}]
    for head, resume, message in (
        ({"seed": 1}, True, "sirs_db"),
        ({"seed": 1, "sirs_db": [1, 2]}, False, "--resume"),
    ):
        with pytest.raises(JournalError, match=message):
            Journal(path, head, resume=resume)
    path.write_text("no journal\n")
    with pytest.raises(JournalError, match="delete it"):
        Journal(path, {}, resume=True)


def test_labels_cover_neither_each_other_nor_points_nor_bars():
    rng = np.random.default_rng(4)
    at = np.concatenate([rng.normal(200.0, 15.0, (14, 2)), rng.uniform(20.0, 380.0, (10, 2))])
    bars = np.concatenate([np.linspace(p, p + [60.0, 0.0], 40) for p in at])
    size = np.array([12.0, 10.0])
    places = place_labels(at, bars, size, (0.0, 0.0, 400.0, 400.0))
    apart = np.abs(places[:, None] - places[None]) / size
    np.fill_diagonal(apart[..., 0], np.inf)
    assert (apart.max(axis=2) >= 1.0).all()
    assert (np.abs(places[:, None] - bars[None]) / size).max(axis=2).min() >= 0.5
    assert (places - size / 2 >= 0.0).all() and (places + size / 2 <= 400.0).all()
