"""`import radalt`: the names one would guess, without GNU Radio, with the flowgraph's own rows."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from frames import W
from hostile import draw_nothing, refused
from waiting import ran_python

import radalt
from radalt.core.channel.settings import DropSettings
from radalt.core.mitigation import METHODS
from radalt.core.scene import parse_scene
from radalt.evaluation import simulation
from radalt.evaluation.overlap.points import changed, sweep_points
from radalt.evaluation.overlap.rows import COLUMNS
from radalt.evaluation.overlap.study import OverlapStudy
from radalt.evaluation.results.rowtable import Table
from radalt.evaluation.simulation import received


def halves(frames, waveform):
    """A method of the user's, as simple as can be."""
    frames *= 0.5
    return frames


@pytest.fixture(scope="module")
def ten_lines(root, tmp_path_factory):
    """Names of examples/ten_lines.py after its run, with fewer points and frames: as printed it takes ten minutes."""
    evaluate, simulate = radalt.evaluate, radalt.simulate
    few = {"sir_db": [-60, -40, -20], "overlap": 1, "altitude_m": [300, 100], "frames": 4, "progress": False}
    few["out"] = tmp_path_factory.mktemp("evaluate") / "run"
    names = {"__name__": "__main__"}
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        patch.setitem(vars(radalt), "evaluate", lambda *a, **k: evaluate(*a, **{**k, **few}))
        patch.setitem(vars(radalt), "simulate", lambda *a, **k: simulate(*a, **{**k, "frames": 20}))
        exec(compile((root / "examples/ten_lines.py").read_text("utf-8"), "ten_lines.py", "exec"), names)
    return names


def test_the_ten_lines_run(ten_lines):
    assert len(ten_lines["report"].break_points()) == 3
    assert np.mean(np.abs(ten_lines["result"]["altitude_m"] - ten_lines["truth_m"]) < 5) > 0.9


def test_the_documented_names_are_the_public_ones(root):
    page = (root / "docs/api/python.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^::: radalt\.(\w+)$", page, re.MULTILINE)) == radalt.__all__
    for name in radalt.__all__:
        assert getattr(radalt, name) is not None
    assert (root / "python/radalt/py.typed").exists()


def test_names_complete_and_an_unknown_one_says_what_there_is():
    assert "nr10" in dir(radalt.scenes) and radalt.scenes.nr10 == "nr10"
    assert tuple(radalt.methods) == tuple(METHODS) and radalt.methods.tcae == "tcae"
    with pytest.raises(AttributeError, match="there is no 'nr11'; there are: .*nr10"):
        radalt.scenes.nr11  # noqa: B018
    with pytest.raises(AttributeError, match="radalt has no 'Altimetre'; it has: Altimeter"):
        radalt.Altimetre  # noqa: B018


WITHOUT = """
import importlib.abc, sys, types
ABSENT = {"gnuradio", "pmt", "fcntl", "resource", "termios", "pwd", "grp", "pebble"}
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ABSENT:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
import subprocess  # which takes msvcrt for a sign of Windows
import signal
del signal.pthread_sigmask
sys.modules["msvcrt"] = types.SimpleNamespace(locking=lambda *a: None, LK_NBLCK=2)  # what Windows has instead of fcntl
import radalt
assert {n for n in dir(radalt) if n[0] != "_"} == set(radalt.__all__)
sys.path.append("../tests")
import hostile
hostile.draw_nothing(types.SimpleNamespace(setattr=setattr))
report = radalt.evaluate("clear", "none", altitude_m=100, frames=4, out=sys.argv[1], progress=False)
radalt.method("hybrid", radalt.Waveform())
assert report.table[0]["pd"] == 1.0 and report.html.is_file()
radalt.AltitudeTracker(radalt.Altimeter(radalt.Waveform()))
try:
    radalt.mitigation
except ImportError as error:
    print(error)
"""


def test_neither_gnu_radio_nor_posix_is_needed(root, tmp_path):
    done = ran_python("-c", WITHOUT, tmp_path / "run", cwd=root / "python", check=True)
    assert re.match(r"radalt.mitigation is a GNU Radio block, and \S+ has no GNU Radio; .*\n$", done.stdout)


@pytest.mark.parametrize(("name", "change"), [("mixture", {"drops": DropSettings(2)}), ("qpsk_impaired", {})])
def test_rows_are_those_of_the_flowgraph_to_the_last_digit(tmp_path, name, change):
    """All nine digits of every column but the times: the same streams, drops, segmenter and batches."""
    scene = radalt.load_scene(name)
    scene = replace(scene, channel=replace(scene.channel, **change))
    small = {"altitudes_m": (400.0, 60.0), "frames": 15, "methods": ("none", "whitening", "nlms")}
    scene = changed(scene, **small, sir_db=(-32.0,), seed=5)
    point = sweep_points(scene)[-1]
    studies = [OverlapStudy(scene, flowgraph=f).begin(tmp_path / str(f)) for f in (True, False)]
    rows = [study.measure(point) for study in studies]
    expected, measured = ([{k: v for k, v in r.items() if k not in COLUMNS.timing} for r in t] for t in rows)
    assert measured == expected
    assert expected[0]["discontinuities"] == 2 * bool(change) and expected[0]["pd"] < 1


def test_simulated_frames_lie_on_the_sweep():
    """Without noise and interference the error is the altimeter's alone, a millimetre; with them the SNR is as said."""
    frames, truth_m = radalt.simulate("clear", altitude_m=[700, 50], frames=7, seed=3)
    assert frames.dtype == np.complex64 and truth_m.tolist() == [700.0] * 4 + [50.0] * 3
    result = radalt.Altimeter(W).process(frames)
    assert np.abs(result["altitude_m"] - truth_m).max() < 0.1
    again, _ = radalt.simulate("clear", altitude_m=[700, 50], frames=7, seed=3)
    assert np.array_equal(frames, again)
    jammed, _ = radalt.simulate("tones", sir_db=-30, overlap=1, altitude_m=100, frames=20, seed=2)
    assert np.mean(np.abs(jammed) ** 2) == pytest.approx(1000 + 1 + 0.1, rel=0.02)


def test_a_function_is_a_method_for_as_long_as_it_is_asked_for(ten_lines):
    frames = np.ones((2, W.samples_per_frame), np.complex64)
    assert np.array_equal(radalt.method(halves, W).process(frames), frames / 2) and frames[0, 0] == 1
    assert "halves" not in METHODS
    assert ten_lines["report"].content["methods"]["my_function"]["model"] == "my_function()"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: radalt.method(lambda f, w: f, W), "has no name for the report"),
        (lambda: radalt.method("witening", W), "method 'witening'; did you mean 'whitening'"),
        (lambda: radalt.evaluate("clear", resume=True), "resume needs out"),
        (lambda: radalt.evaluate("clear", jobs=0), "jobs is 0; it has to be within 1..256"),
        (lambda: radalt.simulate({"interferance": {}}), "did you mean 'interference'"),
        (lambda: radalt.Report(None, {}).html, "in memory; evaluate"),
        (lambda: radalt.method(short, W).process(np.ones((1, 7500))), r"gives complex64 of shape \(1, 3\)"),
        (lambda: radalt.evaluate("clear", ["none"], sir_db=-10), "needs interference"),
        (lambda: radalt.simulate("clear", frames=0), "frames is 0; it has to be at least 1"),
        (lambda: radalt.evaluate("clear", out=5), "out is 5; name a folder"),
        (lambda: radalt.simulate("landing_terrain", frames=10**6), "set altitude.landing_frames"),
    ],
)
def test_what_does_not_fit_is_one_line(call, message, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with refused(ValueError, message):
        call()
    assert not list(tmp_path.iterdir())


def test_a_report_in_memory_has_the_rows_of_a_folder_whatever_numpy_is_told(tmp_path, monkeypatch, undrawn):
    monkeypatch.chdir(tmp_path)
    scene = {"interference": {"nr": {}}, "channel": {"snr_db": 10.0}, "altitude": {"programme_m": [90.0]}}
    given = {"methods": "hybrid", "overlap": 1, "sir_db": [-50, -20], "frames": 4, "progress": False}
    with np.errstate(all="raise"):
        memory = radalt.evaluate(scene, **given)
    assert not list(tmp_path.iterdir())
    folder = radalt.evaluate(scene, **given, out="run")
    same = [name for name in COLUMNS.names if name not in COLUMNS.timing]
    assert [[row[n] for n in same] for row in memory.table] == [[r[n] for n in same] for r in folder.table]
    assert memory.content.keys() | {"figures", "journal", "schema"} == folder.content.keys()
    for report in (memory, folder):
        assert 4 <= len(str(report).splitlines()) <= 10


def test_ctrl_c_is_one_line_that_says_what_is_kept(tmp_path, monkeypatch, capsys):
    measured = iter([None])
    chain = simulation.run_chain
    monkeypatch.setattr(
        "radalt.evaluation.overlap.study.run_chain",
        lambda *a: chain(*a) if next(measured, 1) is None else stop(),
    )
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    few = {"altitude_m": 90, "frames": 2, "snr_db": [10, 20], "progress": False}
    with pytest.raises(KeyboardInterrupt) as stopped:
        radalt.evaluate("clear", "none", **few, out=tmp_path / "run")
    sys.excepthook(stopped.type, stopped.value, stopped.tb)
    line = f"stopped; 1 of 2 points are kept, go on with resume=True and out='{tmp_path}/run'\n"
    assert capsys.readouterr().err == line
    monkeypatch.setattr(OverlapStudy, "check", lambda study: stop())
    with pytest.raises(KeyboardInterrupt, match="^stopped$"):
        radalt.evaluate("clear", "none")


def stop():
    raise KeyboardInterrupt


def short(frames, waveform):
    """A wrong one."""
    return frames[:, :3]


def test_a_report_prints_and_converts(ten_lines):
    report = ten_lines["report"]
    rows = report.to_numpy()
    assert rows["method"].tolist() == ["none", "tcae", "my_function"] * 3 and rows["trials"].dtype == np.int64
    assert set(report.break_points().to_numpy()["method"]) == {"none", "tcae", "my_function"}
    assert str(report.break_points()).startswith("| method | interference |")
    assert str(report.html) in str(report) and "<td>my_function</td>" in report._repr_html_()
    assert radalt.Report.read(report.folder).content == report.content
    assert report.plot().axes[0].get_xlabel().startswith("SIR")


def test_none_is_nan_and_pandas_takes_it_where_it_is():
    table = Table([{"a": None, "b": "x", "c": 1}, {"a": 2.0, "b": "y", "c": 2}])
    assert np.isnan(table.to_numpy()["a"][0]) and table[1:].to_numpy()["c"].tolist() == [2]
    pandas = pytest.importorskip("pandas")
    assert isinstance(table.to_pandas(), pandas.DataFrame)


@pytest.mark.parametrize("channel", [{"jammer_clock_ppm": -20.0}, {"jammer_delay_samples": 7000.5}, {}])
def test_trials_are_the_same_where_the_preamble_before_them_is_left_out(channel):
    """What lies farther back than the channel's memory is not simulated."""
    altitude = {"programme_m": [900.0], "frames": 3, "mode": "true_delay", "preamble_frames": 12}
    qpsk = {"qpsk": {"sir_db": -10.0}}
    scene = parse_scene({"altitude": altitude, "interference": qpsk, "channel": channel})
    frames = scene.altitude.programme.total_frames
    whole, short = (np.concatenate([s for _, s in received(scene, frames, trials_only=t)]) for t in (0, 1))
    trials = 3 * scene.waveform.samples_per_frame
    assert len(short) <= len(whole) - trials
    np.testing.assert_array_equal(short[-trials:], whole[-trials:])
