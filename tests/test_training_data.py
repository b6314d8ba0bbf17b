"""Training examples and the evaluation of models: reproducible, from the core. Needs no PyTorch."""

import itertools
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform

W = Waveform()


@pytest.fixture(scope="module")
def data(root):
    """The module `training/data.py`, which is no part of the package."""
    sys.path.insert(0, str(root / "training"))
    import data

    yield data
    sys.path.remove(str(root / "training"))
    del sys.modules["data"]


def test_an_example_is_a_function_of_seed_and_index(data):
    config = data.CONFIGS["paper"]
    first, again = (data.example(config, W, 20, 7) for _ in range(2))
    np.testing.assert_array_equal(first[0], again[0])
    assert not np.array_equal(first[0], data.example(config, W, 20, 8)[0])
    assert not np.array_equal(first[0], data.example(config, W, 21, 7)[0])


def test_paper_set_has_the_papers_size_and_a_validation_part_of_its_own(data):
    config = data.CONFIGS["paper"]
    assert (config.size, config.validation, config.sir_db) == (50_000, 10_000, (-20.0, 0.0))
    _, clean, altitude_m, _ = next(data.validation_batches(config, W, 2))
    received, wanted, altitude = data.example(config, W, config.seed, 50_000)
    np.testing.assert_array_equal(clean[0, 0], wanted.real)
    assert altitude_m[0] == altitude


def test_clean_part_is_the_cores_return(data):
    """Without echoes the target is the core's delayed sweep, up to its carrier phase."""
    config = replace(data.CONFIGS["paper"], max_vertical_speed_m_per_s=0.0)
    _, clean, altitude_m = data.example(config, W, 1, 3)
    wanted = point_return(W, np.array([altitude_m]))[0]
    coherence = abs(np.vdot(wanted, clean)) / 7500
    assert coherence == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("kind", ["tones", "qpsk_rectangular"])
@pytest.mark.parametrize("sir_db", [-30.0, 3.0])
def test_interference_has_its_sir_over_the_whole_frame(data, kind, sir_db):
    config = replace(
        data.CONFIGS["paper"],
        kinds=((kind, 1.0),),
        counts=(0.0, 1.0),
        sir_db=(sir_db, sir_db),
        snr_db=(80.0, 80.0),
    )
    for index in range(4):
        received, clean, _ = data.example(config, W, 5, index)
        extra = np.mean(np.abs(received.astype(complex) - clean) ** 2)
        assert -10 * np.log10(extra) == pytest.approx(sir_db, abs=0.02)


def test_extended_return_keeps_unit_power(data):
    config = replace(data.CONFIGS["paper"], multipath=0.0, extended=1.0)
    _, clean, _ = data.example(config, W, 2, 0)
    assert np.mean(np.abs(clean) ** 2) == pytest.approx(1.0, rel=1e-5)


def test_every_epoch_holds_every_example_once_in_its_own_order(data):
    config = replace(data.CONFIGS["paper"], size=8, validation=0)
    epochs = [batch[2] for batch in itertools.islice(data.batches(config, W, 8), 2)]
    np.testing.assert_array_equal(np.sort(epochs[0]), np.sort(epochs[1]))
    assert not np.array_equal(epochs[0], epochs[1])
    # resumed after half an epoch, the second half comes
    resumed = next(data.batches(config, W, 4, first=4))[2]
    np.testing.assert_array_equal(resumed, epochs[0][4:])


def test_content_hash_tells_sets_apart(data):
    config = data.CONFIGS["paper"]
    assert data.content_hash(config, W, 2) == data.content_hash(config, W, 2)
    assert data.content_hash(config, W, 2) != data.content_hash(replace(config, snr_db=(4.0, 20.0)), W, 2)


def test_a_coarse_converter_leaves_its_levels(data):
    """Every frame through 1 to 8 bits: at most 256 values on a rail, and no example without a return in it."""
    config = replace(data.CONFIGS["heard"], converter=1.0, counts=(1.0,))
    levels = set()
    for index in range(30):
        received, clean, _ = data.example(config, W, 5, index)
        values = np.unique(np.concatenate([received.real, received.imag]))
        levels.add(values.size)
        assert values.size <= 256
        assert abs(np.vdot(clean, received)) > 0.3 * np.linalg.norm(clean) * np.linalg.norm(received)
    assert min(levels) == 2


def test_configurations_without_a_converter_keep_their_description(data):
    """The recorded hash of the paper's set holds its description; a field added later must not change it."""
    assert "converter" not in data.description(data.CONFIGS["paper"])
    assert "converter" in data.description(data.CONFIGS["heard"])


@pytest.fixture(scope="module")
def evaluate(data):
    """The module `training/evaluate.py`."""
    import evaluate

    yield evaluate
    del sys.modules["evaluate"], sys.modules["evaluate_report"]


def test_a_method_leaves_a_case_after_two_levels_at_which_it_has_failed(evaluate, root):
    chains = tuple(evaluate.chain_of(name, root / "models") for name in ("none", "lms"))
    study = evaluate.MethodStudy(chains, trials=4)
    point = next(p for p in study.points() if p.name == "tones, overlap 1")
    rows = [evaluate.COLUMNS.row(row) for row in study.measure(point)]
    by_method = {m: [r for r in rows if r["method"] == m] for m in ("none", "lms")}
    # block LMS never has the altitude; without a method tones are borne to some -24 dB
    assert [r["sir_db"] for r in by_method["lms"]] == [0.0, -2.5]
    assert -40 < by_method["none"][-1]["sir_db"] < -22.5
    for mine in by_method.values():
        assert [r["pd"] < 0.3 for r in mine[-2:]] == [True, True]
    ((case, broken),) = evaluate.break_points(rows).items()
    assert case == ("tones", 1.0) and broken["lms"].mark == ">=" and -30 < broken["none"].sir_db < -18
    assert [evaluate.COLUMNS.row(row) for row in study.measure(point)] == rows


def test_the_evaluation_writes_its_folder_and_resumes(root, tmp_path):
    out = tmp_path / "out"
    command = [
        sys.executable,
        str(root / "training" / "evaluate.py"),
        "--out",
        str(out),
        "--methods",
        "none,whitening",
    ]
    command += ["--trials", "0", "--clean-trials", "3"]
    environment = {"PYTHONPATH": str(root / "python"), "PATH": "", "OMP_NUM_THREADS": "1"}

    def run(*more):
        done = subprocess.run(
            [*command, *more], capture_output=True, text=True, timeout=300, check=False, env=environment
        )
        return done.returncode, done.stderr

    assert run() == (0, "")
    report = json.loads((out / "report.json").read_text())
    rows = (out / "rows.csv").read_bytes()
    assert len(report["rows"]) == 2 * 10 and report["models"] == {}
    assert {r["interferer"] for r in report["rows"]} >= {
        "clean",
        "qpsk_rectangular_sinr_-15",
        "nr5, extended",
    }
    assert "| none | 1.000" in (out / "report.md").read_text()
    journal = (out / "points.jsonl").read_bytes()
    (out / "points.jsonl").write_bytes(journal[: int(0.6 * len(journal))])
    assert run("--resume") == (0, "")
    assert (out / "rows.csv").read_bytes() == rows
    code, error = run("--resume", "--clean-trials", "4")
    assert code == 2 and error.count("\n") == 1 and "special_trials is 3 there and 4 here" in error
