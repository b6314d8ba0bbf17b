"""The bench: rows are a function of the list, equal to the flowgraph's path, and comparable with stored ones."""

import numpy as np
import pytest
import yaml
from hostile import ended

from radalt.bench import command
from radalt.bench.board import check_rows, stored_rows, verdict
from radalt.bench.entry import Entry, run
from radalt.bench.frames import frames_of
from radalt.bench.lists import find_list, load_list
from radalt.bench.paired import paired
from radalt.bench.rows import read_rows, row_of
from radalt.core.parsing import InputError
from radalt.evaluation.results.rows import bits, unbits
from radalt.evaluation.simulation import run_chain

OWN = """
import numpy as np

def mitigate(frames, waveform):
    return np.clip(frames.real, -20, 20) + 1j * np.clip(frames.imag, -20, 20)
"""


@pytest.mark.parametrize("name", ["standard", "ideal", "evm"])
def test_shipped_lists_hold_cases_whose_seeds_differ(name):
    cases = load_list(name).cases
    assert len(cases) >= 5 and len({case.scene.seed for case in cases}) == len(cases)
    assert all(case.trials >= 36 for case in cases), "fewer frames show no Pd of 0.9"


def test_returns_are_the_same_at_every_level_and_more_frames_extend_them():
    few, many = (load_list("standard", frames=n, only=["tones"]).cases[0] for n in (40, 50))
    high, low = (few.at(level).altitude.programme for level in (-10.0, -40.0))
    assert high == low and high.altitudes_m == many.at(-10.0).altitude.programme.altitudes_m[:40]
    assert few.at(-10.0).seed != few.at(-40.0).seed


@pytest.mark.parametrize(("name", "case"), [("standard", "nr10"), ("ideal", "qpsk_rectangular")])
def test_an_entry_gives_what_the_direct_path_gives(name, case):
    """To the bit, on a transmission that goes on and on frames drawn anew; that path equals the flowgraph."""
    case = load_list(name, frames=8, only=[case]).cases[2]
    scene = case.at(-30.0)
    methods = ("none", "lms", "whitening", "time_frequency", "ofdm_cancel")
    chain = run_chain(scene, methods)
    frames = frames_of(case, -30.0)
    for method in methods:
        direct = chain.results[method]
        direct = direct[scene.altitude.programme.is_trial(direct["frame_index"])]
        mine = run(Entry(method, method), frames).results
        for field in ("frame_index", "valid", "altitude_m", "forced_altitude_m", "ambiguity_db"):
            np.testing.assert_array_equal(mine[field], direct[field])


def test_bits_survive_the_row_and_pairs_are_of_the_same_frames():
    which = np.random.default_rng(1).random(61) < 0.4
    np.testing.assert_array_equal(unbits(bits(which), 61), which)
    curve = [{"sir_db": -5.0 * k, "trials": 61, "right": bits(which)} for k in range(4)]
    better = [row | {"right": bits(which | (np.arange(61) < 20))} for row in curve]
    gain, low, high = paired(better, curve)
    assert gain == pytest.approx(5.0 * 4 * np.mean((np.arange(61) < 20) & ~which)) and low <= gain <= high


def test_stored_rows_are_of_the_list_and_can_be_measured_again():
    """One digest, the list's seeds; rows as stored, which notices a change of emitters, channel, receiver or method."""
    cases, rows = load_list("standard"), read_rows(stored_rows("standard"))
    assert {row["digest"] for row in rows} == {cases.digest}
    by_case = {(case.name, case.overlap): case for case in cases.cases}
    assert {(row["case"], row["overlap"]) for row in rows} == by_case.keys()
    assert all(row["seed"] == by_case[row["case"], row["overlap"]].at(row["sir_db"]).seed for row in rows)
    case = by_case["nr5", 0.6]
    frames = frames_of(case, -30.0)
    for entry in ("none", "whitening", "time_frequency"):
        name = Entry(entry, entry)
        row = row_of((cases.name, cases.digest), case, -30.0, name, frames, run(name, frames))
        where = ("case", "overlap", "sir_db", "entry")
        (old,) = [r for r in rows if all(r[key] == row[key] for key in where)]
        # to the bit on the machine that stored it; last bits of another one may move a frame at the threshold
        for key in ("right", "declared"):
            unlike = unbits(row[key], row["trials"]) != unbits(old[key], old["trials"])
            assert np.count_nonzero(unlike) <= 1
        assert [row[key] for key in ("seed", "trials", "frames_lost")] == [
            old[key] for key in ("seed", "trials", "frames_lost")
        ]
        assert row["rmse_forced_m"] == pytest.approx(old["rmse_forced_m"], rel=0.1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"grids": 1}, "mine.yaml: unknown key 'grids'; allowed: list, title, seed"),
        ({"grid": {"sir_db": "0:-60"}}, "grid.sir_db is '0:-60'; give levels, or first:last:step"),
        ({"cases": {}}, "cases is {}; give a mapping of at least one case"),
        ({"cases": {"a": {"interference": {"tones": {"cout": 3}}}}}, "unknown key 'interference.tones.cout'"),
    ],
)
def test_a_wrong_list_is_one_line(tmp_path, change, said):
    data = yaml.safe_load(find_list("standard").read_text()) | change
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    status, errors = ended(command.main, str(path), "--plan")
    assert status == 2 and said in errors and errors.count("\n") <= 1


def test_an_own_method_enters_and_rows_of_other_frames_are_refused(tmp_path):
    """As a user would: the shipped methods first, then a file of one's own against their rows."""
    (tmp_path / "mine.py").write_text(OWN)
    words = ["standard", "--cases", "tones", "--frames", "8", "--jobs", "1"]
    assert ended(command.main, *words, "--methods", "none,whitening", "--out", tmp_path / "a") == (0, "")
    stored = tmp_path / "a" / "rows.csv"
    own = ["--method-file", f"mine={tmp_path / 'mine.py'}", "--against", stored]
    assert ended(command.main, *words, *own, "--out", tmp_path / "b") == (0, "")
    mine, theirs = read_rows(tmp_path / "b" / "rows.csv"), read_rows(stored)
    assert check_rows(mine, theirs) == (0, sum(r["trials"] for r in mine if r["entry"] == "none"))
    line = verdict(mine, theirs, "mine").splitlines()[0]
    assert line.startswith("mine: ahead of the best shipped method in 0 of 3 cases")
    assert "wrong and valid" in line and "FFTs per frame" in line
    with pytest.raises(InputError, match="cannot be compared"):
        check_rows([row | {"digest": "0"} for row in mine], theirs)
    with pytest.raises(InputError, match="seed or frames differ"):
        check_rows([row | {"seed": 1} for row in mine], theirs)
    status, said = ended(command.main, *words, *own, "--frames", "9", "--out", tmp_path / "c")
    assert status == 2 and "rows of another list, or of other --frames" in said
    flipped = [row | {"right": bits(~unbits(row["right"], 8))} for row in mine]
    with pytest.raises(InputError, match="at most 1 % may"):
        check_rows(flipped, theirs)
