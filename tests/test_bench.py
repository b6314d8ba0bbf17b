"""The bench: rows are a function of the list, equal to the flowgraph's path, and comparable with stored ones."""

import functools
import itertools
import os
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hostile import assert_refused, ended
from pages import assert_whole

from radalt.bench import command
from radalt.bench.board import check_rows, stored_rows, verdict
from radalt.bench.entry import Entry, run
from radalt.bench.frames import frames_of
from radalt.bench.lists import find_list, load_list
from radalt.bench.paired import paired
from radalt.bench.rows import COLUMNS, read_rows, row_of
from radalt.bench.turns import TURN_COLUMNS
from radalt.bench.views import break_points, false_altitudes, levels, summaries, summary_table, turns_table
from radalt.core.altimeter.altimeter import Reason
from radalt.core.mitigation import METHODS
from radalt.core.parsing import InputError
from radalt.evaluation.results.rows import bits, unbits

pytestmark = pytest.mark.usefixtures("measured_here", "undrawn")
SHIPPED = tuple(METHODS)  # before other tests name methods of their own
SAME = [name for name in COLUMNS.names if name not in COLUMNS.timing]
TEXTBOOK = (slice(0, 6), slice(6, 9), slice(9, 11))  # columns of a table: without mitigation, whitening, tcae
OPEN = ("standard", "ideal")  # lists without entries of their own: any method is compared there
OWN = """
import numpy as np

def mitigate(frames, waveform):
    return np.clip(frames.real, -20, 20) + 1j * np.clip(frames.imag, -20, 20)
"""
TURNS = read_rows(stored_rows("runtime").parent / "turns/runtime.csv", TURN_COLUMNS)
shipped = functools.cache(lambda name: read_rows(stored_rows(name)))
LISTS = sorted(path.stem for path in find_list("standard").parent.glob("*.yaml"))


@pytest.mark.parametrize("name", LISTS)
def test_shipped_lists_hold_cases_whose_seeds_differ(name):
    cases = load_list(name)
    assert cases.name == name and cases.title and cases.cases
    assert len({case.scene.seed for case in cases.cases}) == len(cases.cases)
    assert all(case.trials >= 36 for case in cases.cases), "fewer frames show no Pd of 0.9"
    assert [Entry.of(entry, keys, name).method for entry, keys in cases.entries.items()] or name in OPEN


def test_no_seed_of_a_list_occurs_where_methods_are_made():
    """Not in training, tests, tools or code: what is developed on a list's frames has no result on them."""
    seeds = [yaml.safe_load(find_list(name).read_text())["seed"] for name in LISTS]
    assert len(set(seeds)) == len(seeds)
    numbers = re.compile(rf"\b({'|'.join(map(str, seeds))})\b")
    root = find_list("standard").parents[1]
    rooms = [root / part for part in ("training", "tests", "tools", "python", "flowgraphs")]
    made = [file for room in rooms for file in room.rglob("*") if file.suffix in (".py", ".yaml", ".csv")]
    assert [f.name for f in made if numbers.search(f.read_text("utf-8").replace("_", ""))] == []


def test_returns_are_the_same_at_every_level_and_more_frames_extend_them():
    few, many = (load_list("standard", frames=n, only=["tones"]).cases[0] for n in (40, 50))
    high, low = (few.at(level).altitude.programme for level in (-10.0, -40.0))
    assert high == low and high.altitudes_m == many.at(-10.0).altitude.programme.altitudes_m[:40]
    assert few.at(-10.0).seed != few.at(-40.0).seed


def test_bits_survive_the_row_and_pairs_are_of_the_same_frames():
    which = np.random.default_rng(1).random(61) < 0.4
    np.testing.assert_array_equal(unbits(bits(which), 61), which)
    curve = [{"sir_db": -5.0 * k, "trials": 61, "right": bits(which)} for k in range(4)]
    better = [row | {"right": bits(which | (np.arange(61) < 20))} for row in curve]
    gain, low, high = paired(better, curve)
    assert gain == pytest.approx(5.0 * 4 * np.mean((np.arange(61) < 20) & ~which)) and low <= gain <= high


@pytest.mark.parametrize("name", sorted(path.stem for path in stored_rows("standard").parent.glob("*.csv")))
def test_stored_rows_are_of_their_list(name):
    cases, rows = load_list(name), shipped(name)
    assert {row["digest"] for row in rows} == {cases.digest} and {row["list"] for row in rows} == {name}
    seeds = {(c.name, c.overlap): {c.at(level).seed for level in c.levels_db} for c in cases.cases}
    assert {(row["case"], row["overlap"]) for row in rows} == seeds.keys()
    assert all(row["seed"] in seeds[row["case"], row["overlap"]] for row in rows)


@pytest.mark.parametrize(
    ("page", "name", "view"),
    [
        ("methods", "standard", lambda rows, names: summary_table(summaries(rows, names))),
        ("sweeps", "sweeps", break_points),
        ("error_vs_runtime", "runtime", lambda rows, names: summary_table(summaries(rows, names, TURNS))),
        ("error_vs_runtime", "runtime", lambda *_: turns_table(TURNS)),
        ("landing", "landing", lambda rows, names: summary_table(summaries(rows, names))),
        *(("detection", "detection", lambda rows, names, k=k: levels(rows, names[k])) for k in TEXTBOOK),
    ],
)
def test_a_page_has_the_table_of_the_stored_rows(root, page, name, view):
    rows = shipped(name)
    made = view(rows, list(dict.fromkeys(row["entry"] for row in rows)))
    assert made in (root / f"docs/{page}.md").read_text("utf-8")


def test_stored_rows_can_be_measured_again():
    """Rows as stored, which notices a change of emitters, channel, receiver or method."""
    cases, rows = load_list("standard"), shipped("standard")
    by_case = {(case.name, case.overlap): case for case in cases.cases}
    case = by_case["nr5", 0.6]
    frames = frames_of(case, -30.0)
    for entry in ("none", "whitening", "time_frequency"):
        name = Entry(entry, entry)
        row = row_of((cases.name, cases.digest), case, name, frames, run(name, frames))
        where = ("case", "overlap", "sir_db", "entry")
        (old,) = [r for r in rows if all(r[key] == row[key] for key in where)]
        # to the bit on the machine that stored it; last bits of another one may move a frame at the threshold
        for key in ("right", "declared"):
            assert np.sum(unbits(row[key], row["trials"]) != unbits(old[key], old["trials"])) <= 1
        assert all(row[key] == old[key] for key in ("seed", "trials", "frames_lost"))
        assert row["rmse_forced_m"] == pytest.approx(old["rmse_forced_m"], rel=0.1)


@pytest.mark.parametrize("level_db", [-10.0, -45.0])
def test_a_slow_sweep_at_twice_the_rate_of_its_bandwidth_loses_no_frame(level_db):
    """Where 10 m/s move the beat by three samples of delay, and a sweep's peak is two samples wide."""
    case = load_list("sweeps", frames=12, only=["1M_tones"], salt="test").cases[1]
    assert frames_of(case, level_db).lost == 0


def frames_at(tmp_path, level_db, **keys):
    """Frames of one case of a list written here."""
    case = {"interference": {"qpsk": {"pulse": "rrc"}}} | keys.pop("case", {})
    keys |= {"extends": "standard", "seed": 5, "overlap": [1.0], "cases": {"one": case}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(keys))
    (one,) = load_list(tmp_path / "own.yaml", frames=8).cases
    return frames_of(one, level_db)


@pytest.mark.parametrize(
    ("grid", "level_db", "power"),
    [
        ({"sir_db": [-20.0]}, -20.0, 1.0 + 100.0 + 0.1),
        ({"sinr_db": [-20.0]}, -20.0, 1.0 + 100.0),
        ({"inr_db": [30.0]}, 30.0, 1.0 + 100.0 + 0.1),
        ({"snr_db": [-10.0]}, -10.0, 1.0 + 1.0 + 10.0),
    ],
)
def test_a_level_is_a_ratio_of_powers(tmp_path, grid, level_db, power):
    """Return 1; noise 0.1 unless the axis is its; interference as the axis says, 1 of a scene at 0 dB."""
    case = {"interference": {"qpsk": {"pulse": "rrc", "sir_db": 0.0}}}
    frames = frames_at(tmp_path, level_db, grid=grid, case=case)
    assert np.mean(np.abs(frames.samples[frames.trial]) ** 2) == pytest.approx(power, rel=0.02)


def test_without_a_return_every_declared_altitude_is_false(tmp_path):
    """Noise and interference alone, also in the flowgraph's path; the timing is that of the preamble."""
    frames = frames_at(tmp_path, 20.0, grid={"inr_db": [20.0]}, base={"return": "none"})
    power = np.mean(np.abs(frames.samples) ** 2, axis=1)
    assert power[frames.trial] == pytest.approx(0.1 + 10.0, rel=0.1) and power[~frames.trial][0] > 1.0
    assert frames.lost == 0 and np.isinf(frames.truth_m).all()
    out = run(Entry("none", "none"), frames)
    out.results["valid"][:2], out.results["altitude_m"][:2] = True, 700.0
    case = load_list("null", only=["tones"]).cases[0]
    row = row_of(("null", "0"), case, Entry("none", "none"), frames, out)
    assert row["detections"] >= 2 and row["correct"] == 0 and row["wrong_far"] == row["detections"]
    assert f"| none | {row['detections']} of 8 |" in false_altitudes([row], {"none": 0.0155})


def test_entries_have_their_own_altimeter_and_take_turns(tmp_path):
    """Through the command: memory and start-up of each, the textbook's altitudes, a page without gaps."""
    out, methods = tmp_path / "a", "none,none_hann"
    words = ["runtime", "--cases", "clean,tones", "--frames", "36", "--jobs", "1", "--methods", methods]
    assert ended(command.main, *words, "--out", out) == (0, "")
    assert_whole(out / "report.md", None)
    page = (out / "report.md").read_text("utf-8")
    assert "## Cost" in page and "](break_points.png)" in page and "| none_hann |" in page
    clean = {r["entry"]: r["rmse_forced_m"] for r in read_rows(out / "rows.csv") if r["case"] == "clean"}
    assert clean["none_hann"] > 1.2 * clean["none"]  # a taper costs accuracy
    words = ["detection", "--cases", "tones", "--frames", "36", "--jobs", "1", "--methods", "none,textbook"]
    assert ended(command.main, *words, "--out", tmp_path / "b") == (0, "")
    pd = {r["entry"]: r["pd"] for r in read_rows(tmp_path / "b" / "rows.csv")}
    assert min(pd.values()) > 0.6  # at -26 dB, where both still find most


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"grids": 1}, "mine.yaml: unknown key 'grids'; allowed: list, title, seed"),
        ({"grid": {"sir_db": [0], "snr_db": [0]}}, "grid has sir_db and snr_db; give one of them"),
        ({"grid": {"sinr_db": [20]}}, "mixture: grid.sinr_db 20 is not below channel.snr_db 10; lower it"),
        ({"cases": {"a": {"like": "b"}, "b": {"like": "a"}}}, "mine.yaml: a: like is"),
        ({"extends": "nothing"}, "list 'nothing': no such file, and no shipped list; there are detection"),
        ({"entries": {"a": {"method": "b"}}}, "entries.a: no method 'b'; there are none, lms"),
        ({"extends": "ideal"}, "mine.yaml: extends ideal: unknown key 'extends'"),
        ({"overlap": []}, "overlap is []; give one within 0..1, or a list of them"),
        ({"cases": {"a": {"interference": {"tones": {"cout": 3}}}}}, "unknown key 'interference.tones.cout'"),
    ],
)
def test_a_wrong_list_is_one_line(tmp_path, change, said):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(find_list("standard").read_text()) | change))
    assert_refused(*ended(command.main, path, "--plan"), said)


def test_an_own_method_enters_and_rows_of_other_frames_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("RADALT_TRIAL_RUN", "1")  # the business of test_hostile
    (tmp_path / "mine.py").write_text(OWN)
    few = {"extends": "standard", "seed": 5, "overlap": [1.0], "grid": {"sir_db": [-10, -20, -30, -40]}}
    few["cases"] = {"tones": {"interference": {"tones": {"count": 5}}}}
    (tmp_path / "few.yaml").write_text(yaml.safe_dump(few))
    words = [tmp_path / "few.yaml", "--cases", "tones", "--frames", "8", "--jobs", "1"]
    assert ended(command.main, *words, "--methods", "none,whitening", "--out", tmp_path / "a") == (0, "")
    stored = tmp_path / "a" / "rows.csv"
    own = ["--method-file", f"mine={tmp_path / 'mine.py'}", "--against", stored]
    assert ended(command.main, *words, *own, "--out", tmp_path / "b") == (0, "")
    mine, theirs = read_rows(tmp_path / "b" / "rows.csv"), read_rows(stored)
    assert check_rows(mine, theirs) == (0, sum(r["trials"] for r in mine if r["entry"] == "none"))
    line = "mine: ahead of the best shipped method in 0 of 1 case.*wrong and valid.*FFTs per frame"
    assert re.match(line, verdict(mine, theirs, "mine"))
    unlike = ({"digest": "0"}, "cannot be compared"), ({"seed": 1}, "seed or frames differ")
    bits = ({"right": "ff"}, "at most 1 % may"), ({"trials": 10**13}, "a bit per trial")
    for wrong, said in unlike + bits:
        (tmp_path / "edited.csv").write_text(COLUMNS.csv([row | wrong for row in mine]))
        with pytest.raises(InputError, match=said):
            check_rows(read_rows(tmp_path / "edited.csv"), theirs)
    assert ended(command.main, *words, "--stored", "--against", stored, "--out", tmp_path / "d") == (0, "")
    assert (tmp_path / "d" / "rows.csv").read_bytes() == stored.read_bytes()
    for more in ((*own, "--frames", "9"), ("--plan", "--frames", "9", "--against", stored)):
        ends = ended(command.main, *words, *more, "--out", tmp_path / "c")
        assert_refused(*ends, "rows of another list, or of other --frames")


def test_every_method_gives_through_the_flowgraph_what_it_gives_here(tmp_path):
    """To the bit, on a transmission that goes on and on frames drawn anew, with returns drawn per frame."""
    entries = dict.fromkeys(SHIPPED) | {"hann": {"method": "none", "altimeter": {"window": "hann"}}}
    keys = {"extends": "standard", "seed": 5, "overlap": [1.0], "grid": {"sir_db": [-30.0]}}
    keys["entries"] = entries
    emitters = {"goes on": {"nr": {"evm": "typical", "free_running": True}}, "anew": {"qpsk": {}}}
    keys["cases"] = {name: {"interference": emitter} for name, emitter in emitters.items()}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(keys))
    rows = []
    for via in ("direct", "flowgraph"):
        words = ["--frames", "4", "--jobs", "1", "--via", via, "--out", tmp_path / via]
        assert ended(command.main, tmp_path / "own.yaml", *words) == (0, "")
        rows.append([[row[k] for k in SAME] for row in read_rows(tmp_path / via / "rows.csv")])
    assert rows[0] == rows[1] and len(rows[0]) == 2 * len(entries)


def test_what_is_ambiguous_is_wrong_nearly_as_often_as_right():
    """A standard case at two levels; docs/detection.md has all 21 at four (`RADALT_AMBIGUOUS=4`, `-s`)."""
    levels = int(os.environ.get("RADALT_AMBIGUOUS", "0"))
    counts = {}
    for case in load_list("standard").cases[0 if levels else -1 :]:
        case = replace(case, scene=replace(case.scene, seed=77001234))
        for level_db in case.levels_db[4::7][: levels or 2]:
            frames = frames_of(case, level_db)
            for method, allowed in itertools.product(("none", "whitening", "tcae"), (20.0, 150.0)):
                entry = Entry(method, method, altimeter=(("max_vertical_speed_m_per_s", allowed),))
                found = run(entry, frames).results
                right = np.abs(found["forced_altitude_m"] - frames.truth_m) < case.limit_m
                valid, could = found["valid"], found["reason"] == Reason.AMBIGUOUS
                each = right.size, valid & right, valid & ~right, could & right, could & ~right
                counts[method, allowed] = counts.get((method, allowed), 0) + np.array([*map(np.sum, each)])
    for (method, allowed), (trials, right, wrong, *could) in counts.items():
        shares = np.array([right + could[0], right, wrong + could[1], wrong]) / trials
        print(f"| {method} | {allowed:g} m/s | " + " | ".join(f"{share:.3f}" for share in shares) + " |")
        assert shares[3] <= 0.02
    could = sum(found[3:] for found in counts.values())
    assert could[1] >= 0.4 * could[0] > 0
