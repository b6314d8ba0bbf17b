"""Methods of your own: in an embedded block, as a file, as a network."""

import json
import re
from dataclasses import replace
from pathlib import Path

import make_flowgraphs
import numpy as np
import ota_eval
import pytest
from frames import N, W
from gnuradio import gr
from hostile import ended, refused, write_scene
from waiting import ROOT, patient

from radalt import load_scene
from radalt.core.mitigation import MitigationError, create
from radalt.core.returns.point import point_return
from radalt.evaluation.flowgraph.generate import Prepared, generate, prepare, save_as_companion
from radalt.evaluation.flowgraph.rewrite import load_grc
from radalt.evaluation.flowgraph.run import load_class, run_point, run_to_end
from radalt.evaluation.overlap.study import OverlapStudy

FLOWGRAPHS = ROOT / "flowgraphs"
OWN = FLOWGRAPHS / "own_method.py"

FRAMES = point_return(W, np.array([200.0, 400.0, 900.0])).astype(np.complex64)


@pytest.fixture(autouse=True)
def untried(monkeypatch):
    """A method of a file is tried next to this process first: the business of test_hostile."""
    monkeypatch.setenv("RADALT_TRIAL_RUN", "1")


def small_scene(**changes):
    """The paper's case where no mitigation breaks, 12 frames."""
    scene = load_scene("paper_qpsk").at(overlap=1.0, sir_db=-28.0)
    altitude = replace(scene.altitude, programme_m=(900.0, 400.0), frames=6)
    return replace(scene, altitude=altitude, **changes)


def method(folder: Path, source: str) -> Path:
    path = folder / "mine.py"
    path.write_text(source)
    return path


def test_function_of_a_file_cleans_the_frames(tmp_path):
    path = method(tmp_path, "def mitigate(frames, waveform):\n    return frames * waveform.sweep_s\n")
    custom = create("custom", W, file=path)
    np.testing.assert_allclose(custom.process(FRAMES), FRAMES * 1e-3, rtol=1e-6)
    status = custom.status()
    assert (status["method"], status["model"], status["frames"]) == ("custom", "mine.py", 3)


def test_class_of_a_file_keeps_its_state_until_it_is_reset(tmp_path):
    source = (
        "from radalt.core.mitigation import Mitigation\n"
        "class Counting(Mitigation):\n"
        "    def reset(self):\n"
        "        super().reset()\n"
        "        self.seen = 0\n"
        "    def _clean(self, batch):\n"
        "        self.seen += len(batch)\n"
        "        return batch * self.seen\n"
    )
    custom = create("custom", W, file=method(tmp_path, source))
    # the check on loading left no trace
    np.testing.assert_array_equal(custom.process(FRAMES[:1]), FRAMES[:1])
    np.testing.assert_array_equal(custom.process(FRAMES[:2]), FRAMES[:2] * 3)
    custom.reset()
    np.testing.assert_array_equal(custom.process(FRAMES[:1]), FRAMES[:1])


HEAD = "def mitigate(frames, waveform):\n    "


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("def mitigate(frames, waveform:\n    pass\n", r"mine.py, line 1: SyntaxError"),
        ("import nowhere_to_be_found\n", r"mine.py, line 1: ModuleNotFoundError: No module named"),
        ("\n{}return frames + gain\n", r"mine.py, line 3: NameError: name 'gain'"),
        ("def mitigate(frames):\n    return frames\n", r"mine.py: TypeError: .*positional argument"),
        ("{}return frames[:, 1:]\n", r"shape \(1, 7499\); expected .*\(1, 7500\)"),
        ("{}return None\n", r"gives object of shape \(\); expected complex"),
        ("import numpy as np\n{}return np.abs(frames)\n", "gives float32 of shape .*; expected complex"),
        ("gain = 2\n", r"it needs a function mitigate\(frames, waveform\) or one subclass of Mitigation"),
    ],
    ids="syntax import name arguments shape nothing real empty".split(),
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path, source, said):
    with refused(MitigationError, said):
        create("custom", W, file=method(tmp_path, source.format(HEAD)))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The simulated flowgraph with a method from a file, and what it measured."""
    folder = tmp_path_factory.mktemp("plain")
    scene = small_scene(method_options={"custom": {"file": str(OWN)}})
    prepared = prepare(scene, ["none", "lms", "whitening", "tcae", "custom"], folder)
    return scene, run_point(prepared, scene, time_limit_s=patient(60)).results


def run_flowgraph(data: dict, scene, folder: Path, names: list[str]) -> dict[str, np.ndarray]:
    """Results of the altimeters of any flowgraph."""
    known = {block["name"] for block in data["blocks"]}
    parameters = {"scene_file": str(write_scene(scene, folder / "scene.yaml"))}
    parameters |= {
        key: value for key, value in {"drop_when_slow": 0, "sir_db": "scene"}.items() if key in known
    }
    top = load_class(Prepared(generate(data, folder)))(**parameters)
    run_to_end(top, time_limit_s=patient(60))
    return {name: getattr(top, f"altimeter_{name}").results() for name in names}


def same(first: np.ndarray, second: np.ndarray) -> None:
    assert len(first) > 12
    for field in first.dtype.names:
        np.testing.assert_array_equal(first[field], second[field], err_msg=field)


def test_embedded_block_measures_what_the_file_does(plain, tmp_path):
    """bring_your_own.grc, its block and the file hold the same method, and the shipped ones stand next to it."""
    scene, results = plain
    data = load_grc(FLOWGRAPHS / "bring_your_own.grc")
    own = run_flowgraph(data, scene, tmp_path, ["mine", "none", "whitening", "tcae"])
    same(own["mine"], results["custom"])
    for name in ("none", "whitening", "tcae"):
        same(own[name], results[name])
    assert results["custom"]["valid"].sum() > results["none"]["valid"].sum()


def test_embedded_method_is_ten_lines():
    data = load_grc(FLOWGRAPHS / "bring_your_own.grc")
    (block,) = (b for b in data["blocks"] if b["id"] == "epy_block")
    code = block["parameters"]["_source_code"].split('"""')[2]
    assert len([line for line in code.splitlines() if line.strip()]) <= 10


def test_shipped_flowgraphs_are_the_mechanical_ones():
    """After a change of ota_b210.grc or ota_live.grc: `make flowgraphs`."""
    for name, data in make_flowgraphs.made().items():
        file = load_grc(FLOWGRAPHS / name)
        assert sorted(file["connections"]) == sorted(data["connections"]), name
        blocks = {block["name"]: block for block in file["blocks"]}
        assert blocks.keys() == {block["name"] for block in data["blocks"]}
        for block in data["blocks"]:
            written = blocks[block["name"]]
            # the companion adds the parameters that have their defaults
            assert written["parameters"] | block["parameters"] == written["parameters"], (name, block["name"])
            assert written["states"] | block["states"] == written["states"] and written["id"] == block["id"]


@pytest.mark.parametrize("path", sorted(FLOWGRAPHS.glob("*.grc")), ids=lambda path: path.stem)
def test_saving_a_shipped_flowgraph_in_the_companion_changes_no_line(path, tmp_path):
    """Saving what was opened; so that a word that a user changes is one line of a diff."""
    data = load_grc(path)
    if data["metadata"]["grc_version"] != gr.version():
        # the companion of that version wrote the shipped files; another adds its own parameters
        pytest.skip(f"another GNU Radio has other parameters: {gr.version()}")
    save_as_companion(data, tmp_path / path.name)
    # the companion's memory of an embedded block's ports, in no fixed order
    cache = re.compile(r"    _io_cache: .*?(?=    bus_sink:)", re.DOTALL)
    before, after = (cache.sub("", file.read_text()) for file in (path, tmp_path / path.name))
    assert after == before


def proto(number: int, *content: bytes | str | int) -> bytes:
    """One field of a protobuf message: an integer, or text, bytes and messages."""
    if isinstance(content[0], int):
        return varint(number << 3) + varint(content[0])
    body = b"".join(part.encode() if isinstance(part, str) else part for part in content)
    return varint(number << 3 | 2) + varint(len(body)) + body


def varint(value: int) -> bytes:
    low, high = value & 127, value >> 7
    return bytes([low | 128]) + varint(high) if high else bytes([low])


def network(path: Path, *operators: str, samples: int = W.samples_per_frame, contract: bool = True) -> Path:
    """An ONNX file of operators without weights, one behind the other."""
    shape = b"".join(proto(1, proto(1, size) if size else proto(2, "n")) for size in (None, 2, samples))
    kind = proto(2, proto(1, proto(1, 1), proto(2, shape)))  # float32
    named = enumerate(operators)
    nodes = (proto(1, proto(1, f"x{k}"), proto(2, f"x{k + 1}"), proto(4, name)) for k, name in named)
    ends = proto(11, proto(1, "x0"), kind) + proto(12, proto(1, f"x{len(operators)}"), kind)
    about = {"frame_samples": N, "layout": "iq_channels_first", "normalisation": "joint_rms"}
    about |= {"rate_hz": W.rate_hz, "centered": 1}
    props = (proto(14, proto(1, f"radalt_{k}"), proto(2, str(v))) for k, v in about.items() if contract)
    graph = proto(7, *nodes, proto(2, "g"), ends)
    path.write_bytes(proto(1, 8) + graph + proto(8, proto(2, 13)) + b"".join(props))
    return path


@pytest.mark.parametrize("first", [True, False])
def test_a_network_in_two_files_is_the_joined_one(first, tmp_path):
    whole = network(tmp_path / "whole.onnx", "Tanh", "Neg")
    encoder = network(tmp_path / "c++.onnx", "Tanh", contract=first)
    parts = encoder, network(tmp_path / "d.onnx", "Neg", contract=not first)
    frames = FRAMES + 0.5 * np.roll(FRAMES, 1, axis=0)  # of one return each, they would pass as they are
    options = {"batch": 2, "shift_check": False}
    joined, split = (create("tcae", W, model=m, **options) for m in (whole, "+".join(map(str, parts))))
    np.testing.assert_array_equal(split.process(frames), joined.process(frames))
    assert split.status()["model"] == "c++.onnx+d.onnx"
    network(parts[1], "Abs", contract=not first)
    other = create("tcae", W, model=split.model, **options)
    assert other.status()["sha256"] != split.status()["sha256"]
    assert (other.process(frames) != joined.process(frames)).any(axis=1).all()


def test_both_files_of_a_network_are_watched_and_shipped(tmp_path):
    parts = network(tmp_path / "e.onnx", "Tanh"), network(tmp_path / "d.onnx", "Neg")
    own = {"paper": {"method": "tcae", "model": "+".join(map(str, parts))}}
    study = OverlapStudy(small_scene(methods=("none", "paper"), method_options=own))
    assert set(study.files().values()) == set(parts)
    moved = {name: path.parent / "there" / path.name for name, path in study.files().items()}
    assert study.with_files(moved).files() == moved


@pytest.mark.parametrize(
    ("decoder", "message"),
    [
        (None, "d.onnx does not exist; name one with --model"),
        ({"samples": 100}, "encoder gives tensor.float. .* decoder takes .* name the files of one network"),
        ({"contract": False}, "lacks the metadata radalt_frame_samples"),
    ],
)
def test_two_files_that_are_no_network_are_refused(decoder, message, tmp_path):
    network(tmp_path / "e.onnx", "Tanh", contract=False)
    if decoder is not None:
        network(tmp_path / "d.onnx", "Neg", **decoder)
    with pytest.raises(MitigationError, match=message):
        create("tcae", W, model=f"{tmp_path}/e.onnx+{tmp_path}/d.onnx")


def test_several_own_methods_are_rows_of_their_own(root, tmp_path, measured_here, undrawn):
    words = "--sim --overlap 1 --sir-db=-28 --altitudes 300 --frames 4 --jobs 1 --methods none".split()
    words += ["--model", f"mine={root / 'models/any_sweep.onnx'}", "--out", tmp_path / "run"]
    words += ["--method-file", f"notch={OWN}", "--method-file", OWN]
    assert ended(ota_eval.main, *words) == (0, "")
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    rows = {row["method"]: row for row in report["rows"]}
    assert set(rows) == {"none", "mine", "notch", "custom"}
    assert rows["notch"]["correct"] == rows["custom"]["correct"]
    assert report["methods"]["mine"]["model"] == "any_sweep.onnx"
    assert len(report["methods"]["notch"]["sha256"]) == 64
