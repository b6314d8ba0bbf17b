"""Whatever comes in, a command ends with a result, or with status 2 and one line; nothing else is a way to end.

The same examples every time; `make fuzz`: others for RADALT_FUZZ_S seconds (default 3600), counted by their ends."""

import contextlib
import hashlib
import json
import os
import shutil
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import ota_eval
import pytest
import sigmf
import yaml
from gnuradio import radalt
from hostile import assert_line, assert_refused, ended, measure_here
from test_engine import Coins, Options, command, rows_of, run
from waiting import ROOT

from radalt.core.parsing import InputError, load_yaml
from radalt.core.radio.recording import RecordingError, open_capture
from radalt.core.scene import SceneError, load_scene, parse_scene, scene_to_mapping

hypothesis = pytest.importorskip("hypothesis", reason="requirements-test.txt has it")
from hypothesis import HealthCheck, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

SECONDS = float(os.environ.get("RADALT_FUZZ_S", 0))
TARGETS = 6
pytestmark = [pytest.mark.timeout(3 * SECONDS)] * bool(SECONDS)


def fuzz(check, examples: int, reached: tuple[str, ...], *strategies) -> None:
    """Run ``check``, which returns how it ended, on examples of the strategies, and tell how many there were; both ends
    have to be reached, or the target is too tame or too wild."""
    ends: Counter = Counter()

    calm = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}

    @settings(max_examples=examples, derandomize=not SECONDS, **calm)
    @given(st.tuples(*strategies))
    def once(values):
        ends[check(*values)] += 1

    last = time.monotonic() + SECONDS / TARGETS
    while once() or time.monotonic() < last:
        pass
    print(f"{check.__qualname__}: {sum(ends.values())} examples, {dict(ends)}")
    assert set(reached) <= set(ends)


# -- values that no reader wants --------------------------------------------------------------------
NUMBERS = st.one_of(
    st.integers(-10, 10),
    st.integers(),
    st.sampled_from([0, -1, 2**31, 2**63, 2**64, 10**20, 10**400, -(10**20), 10**9]),
    st.floats(),
    st.sampled_from([1e308, -1e308, 5e-324, 1e9, 1e-9, 7.5e6, 1e300]),
)
TEXTS = st.one_of(
    st.text(max_size=20),
    st.sampled_from("nan inf 1e999 7.5e6 2026-13-45 1:30 none ../.. /dev/zero <script>| mine$^{x".split()),
    st.sampled_from(["", "a\0b", "x" * 9999, "\ud800", "a\x1b[31m\nb"]),
)
SCALARS = st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS)
KEYS = SCALARS.filter(lambda key: key == key)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)

GIVEN = {
    "interference": [{kind: {}} for kind in ("qpsk", "tones", "nr", "fmcw", "pulsed_radar")],
    "methods": ["none", "whitening", "blanking"],
    "method_options": {"whitening": {"exponent": 0.5}, "blanking": {"window": 64}},
    "sweep": {"overlap": [0, 1], "sir_db": [-10], "snr_db": [10]},
}
WHOLE = scene_to_mapping(parse_scene(GIVEN))


def places(node, path=()):
    """Every place of a mapping, as the way to it."""
    yield path
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield from places(value, (*path, key))


PLACES = [p for p in places(WHOLE) if p]


def holds(node, key) -> bool:
    """Whether a mapping or list has this key or index."""
    if isinstance(node, dict):
        return key in node
    return isinstance(node, list) and isinstance(key, int) and key < len(node)


def changed(whole, changes):
    """A copy with values put in places; a place that an earlier change has taken away stays away."""
    data = json.loads(json.dumps(whole))
    for path, value in changes:
        node = data
        for key in path[:-1]:
            node = node[key] if holds(node, key) else {}
        if isinstance(node, dict) or holds(node, path[-1]):
            node[path[-1]] = value
    return data


CHANGES = st.lists(st.tuples(st.sampled_from(PLACES), VALUES), min_size=1, max_size=3)
LIKELY = st.integers(0, 20) | st.floats(0, 100) | st.booleans() | st.none()
MILD = st.lists(st.tuples(st.sampled_from(PLACES), LIKELY), min_size=1, max_size=2)


def dumped(data) -> str:
    """YAML of whatever Python can say, or something near it."""
    try:
        return yaml.safe_dump(data, allow_unicode=True)
    except (yaml.YAMLError, ValueError, TypeError, UnicodeError):
        return str(data)


def written(path: Path, text: str) -> Path:
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


# -- the targets ------------------------------------------------------------------------------------
def test_scenes(tmp_path):
    """Any value in any place of a whole scene: read, or refused; what is read is read back the same."""
    path = tmp_path / "it.yaml"

    def check(changes):
        written(path, dumped(changed(WHOLE, changes)))
        try:
            scene = load_scene(path)
        except SceneError as error:
            assert_line(str(error).replace(str(path), "it.yaml"))
            return "refused"
        assert parse_scene(scene_to_mapping(scene)) == scene
        return "read"

    fuzz(check, 50, ("read", "refused"), CHANGES | MILD)


SHIPPED = [p.read_text() for p in sorted((ROOT / "flowgraphs/scenes").glob("*.yaml"))]
TOKENS = [*"{}[]'\"|>%#\0\n\t", *"&a |*a|<<: |: |- |? |!!int |!!python/none |1:1".split("|"), "9" * 30]


@st.composite
def broken_text(draw):
    """A shipped scene, cut, doubled and salted."""
    text = draw(st.sampled_from(SHIPPED))
    for _ in range(draw(st.integers(1, 4))):
        at, length = draw(st.integers(0, len(text))), draw(st.integers(0, 40))
        what = draw(st.sampled_from(TOKENS) | st.text(max_size=5) | st.just(text[at : at + length]))
        text = text[:at] + what + text[at + draw(st.sampled_from([0, length])) :]
    return text


def test_yaml(tmp_path):
    """Any text: what is read is what everybody's reader makes of it, but for dates and base 60."""
    path = tmp_path / "it.yaml"

    def check(text):
        written(path, text)
        try:
            data = load_yaml(path, what="scene")
        except InputError as error:
            assert_line(str(error).replace(str(path), "it.yaml"))
            return "refused"
        try:
            load_scene(path)
        except SceneError as error:
            assert_line(str(error).replace(str(path), "it.yaml"))
        if ":" not in str(data) and "-" not in str(data):
            assert yaml.safe_load(path.read_bytes()) == data or data != data
        return "read"

    fuzz(check, 60, ("read", "refused"), broken_text() | st.text(max_size=60))


OPTIONS = ["--overlap", "--sir-db", "--snr-db", "--altitudes", "--frames", "--seed", "--methods", "--scene", "--jobs",
           "--time-limit-s", "--model", "--method-file", "--out"]  # fmt: skip
AXES = st.one_of(
    st.floats(-100, 100).map(str),
    st.lists(st.floats(0, 1), min_size=1, max_size=4).map(lambda v: ",".join(map(str, v))),
    st.tuples(NUMBERS, NUMBERS, NUMBERS).map(
        lambda v: ":".join(format(x, ".6g") if isinstance(x, float) else str(x)[:40] for x in v)
    ),
    st.sampled_from(["none", "whitening,none", "none,none", "paper_qpsk", "clear", "2", "7"]),
    TEXTS.filter(lambda t: t not in ("/dev/zero",)),
)
LINES = st.lists(st.tuples(st.sampled_from(OPTIONS), AXES), min_size=1, max_size=3)


def test_command_lines(tmp_path, monkeypatch):
    """Any option with any value, on top of a small evaluation's."""
    monkeypatch.chdir(tmp_path)

    def check(options):
        words = ["--sim", "--plan", "--methods", "none", *(f"{name}={value}" for name, value in options)]
        status, error = ended(ota_eval.main, *words)
        if status:
            assert_refused(status, error)
            return "refused"
        return "planned"

    fuzz(check, 25, ("planned", "refused"), LINES)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A small recording with everything that ours have in their metadata."""
    folder = tmp_path_factory.mktemp("recording")
    data = folder / "it.sigmf-data"
    np.ones(9000, "<c8").tofile(data)
    scene = scene_to_mapping(parse_scene({}))
    info = {"core:datatype": "cf32_le", "core:sample_rate": 7.5e6, "radalt:scene": scene}
    info["core:extensions"] = [{"name": "radalt", "version": "1.0.0", "optional": True}]
    info |= {"radalt:latency_samples": 3.0, "radalt:full_scale": 1.0, "radalt:calibration_samples": 2.0}
    made = sigmf.SigMFFile(data_file=str(data), global_info=info)
    made.add_capture(0, {"core:frequency": 4.3e9, "core:global_index": 0})
    made.add_annotation(0, 7500, {"core:label": "200 m", "radalt:altitude_m": 200.0})
    made.tofile(str(folder / "it.sigmf-meta"), overwrite=True)
    return folder


def test_recordings(recording, tmp_path):
    """Any value in any place of a recording's metadata, and data that were cut."""
    meta = json.loads((recording / "it.sigmf-meta").read_text())
    scene = "global", "radalt:scene"
    ways = [p for p in places(meta) if p and p[:2] != scene] + [(*scene, "seed")]
    here = tmp_path / "it.sigmf-meta"

    def check(changes, cut):
        data = (recording / "it.sigmf-data").read_bytes()[: 72_000 - cut]
        (tmp_path / "it.sigmf-data").write_bytes(data)
        data_of = changed(meta, changes)
        if isinstance(data_of.get("global"), dict) and "core:sha512" in data_of["global"]:
            data_of["global"]["core:sha512"] = hashlib.sha512(data).hexdigest()
        try:
            text = json.dumps(data_of)
        except (TypeError, ValueError):
            text = str(data_of)
        written(here, text)
        try:
            capture = open_capture(here)
            next(capture.blocks(7.5e6), None)
        except RecordingError as error:
            assert_line(str(error).replace(str(here), "it.sigmf-meta"))
            return "refused"
        return "read"

    keys = st.lists(st.tuples(st.sampled_from(ways), VALUES), max_size=2)
    fuzz(check, 60, ("read", "refused"), keys, st.sampled_from([0, 0, 0, 8, 3, 72_000]))


@pytest.fixture(scope="module")
def spoilable(tmp_path_factory):
    """A small run, its files and its rows."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        measured_here(patch)
        run(Coins(), Options(folder, jobs=1))
    return {name: (folder / name).read_bytes() for name in FILES}


def resumed(folder: Path, resume: bool) -> tuple[int, str]:
    """Status and stderr of the command that runs or resumes the coins."""
    options = Options(folder, resume=resume, jobs=1)
    return ended(lambda _: command.main(Coins(), options, program="coins", dry_run=False))


def measured_here(patch) -> None:
    """Points are measured in this process: a pool would start one an example. Nothing waits for the disk."""
    patch.setattr("radalt.evaluation.results.folder.os.fsync", lambda file: None)
    measure_here(patch)


FILES = ("run.json", "points.jsonl", "rows.csv")


@st.composite
def spoilt(draw):
    """A change of one file: bytes cut, doubled and salted, values put in places, lines in another order, or no file."""
    name = draw(st.sampled_from(FILES))
    kind = draw(st.sampled_from(["bytes", "bytes", "values", "lines", "gone", "folder", "pipe"]))
    at, length = draw(st.floats(0, 1)), draw(st.integers(0, 60))
    salt = draw(st.binary(max_size=6) | st.sampled_from([b"\n", b"7", b"-5", b"NaN", b"[" * 5000, b"\xff"]))
    values = draw(st.lists(st.tuples(st.integers(0, 999), VALUES), min_size=1, max_size=2))
    return name, kind, at, length, salt, values, draw(st.permutations(range(4)))


def spoil(path: Path, kind: str, at: float, length: int, salt: bytes, values: list, order: list[int]) -> None:
    data = path.read_bytes()
    where = int(at * len(data))
    lines = data.splitlines(keepends=True)
    if kind == "bytes":
        path.write_bytes(data[:where] + salt + data[where + length :])
    elif kind == "lines":
        path.write_bytes(b"".join(lines[k % len(lines)] for k in order))
    elif kind == "values":
        # of a table, or after another change
        with contextlib.suppress(TypeError, ValueError, RecursionError):
            whole = json.loads(data) if path.name == "run.json" else [json.loads(line) for line in lines]
            ways = [p for p in places(whole) if p]
            whole = changed(whole, [(ways[k % len(ways)], value) for k, value in values])
            entries = whole if isinstance(whole, list) else [whole]
            written(path, "".join(json.dumps(entry) + "\n" for entry in entries))
    else:
        path.unlink()
        if kind == "folder":
            path.mkdir()
        elif kind == "pipe":
            os.mkfifo(path)


def test_resumed_folders(spoilable, tmp_path, monkeypatch):
    """Whatever became of a run's files: its true rows, or one line."""
    measured_here(monkeypatch)

    def check(*changes):
        folder = tmp_path / "run"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for name, data in spoilable.items():
            (folder / name).write_bytes(data)
        for name, *change in changes:
            if (folder / name).is_file():
                spoil(folder / name, *change)
        status, error = resumed(folder, True)
        if status:
            assert_refused(status, error)
            return "refused"
        assert rows_of(folder) == spoilable["rows.csv"]
        return "resumed"

    fuzz(check, 50, ("resumed", "refused"), spoilt(), spoilt())


# -- messages --------------------------------------------------------------------------------------
JSON = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=6,
)
REQUESTS = st.one_of(
    st.lists(st.binary(max_size=50), max_size=3),
    st.fixed_dictionaries(
        {"version": st.just(1) | JSON, "command": st.sampled_from("get set stop reacquire".split()) | JSON},
        optional={k: NUMBERS | JSON for k in ("altitude_m", "overlap", "sir_db")}
        | {"methods": st.lists(st.sampled_from(["none", "tcae"]) | st.text()) | JSON, "other": JSON},
    ).map(lambda data: [json.dumps(data).encode()]),
)


def test_control_messages():
    """Every message gets a reply: a state, or an error of one line."""
    chirp = SimpleNamespace(manual_altitude_m=0.0, set_altitude=lambda m: None)
    sink = SimpleNamespace(active=True, count=3)
    segmenter = SimpleNamespace(has_heard=True, status=dict, reacquire=lambda: None)
    jammer = SimpleNamespace(set_overlap=lambda x: None, set_sir_db=lambda x: None)
    scene = parse_scene({"interference": {"qpsk": {}}})
    top = SimpleNamespace(chirp_source=chirp, altimeter_none=sink, frame_segmenter=segmenter)
    top.jammer_source, top.stop = jammer, lambda: None
    control = radalt.remote_control(top, scene, "", "")

    def check(parts):
        reply = json.loads(control._answer(parts))
        assert reply["version"] == 1
        if reply["ok"]:
            assert reply["state"]["frames"] == {"none": 3}
            return "done"
        assert_line(reply["error"])
        return "refused"

    fuzz(check, 150, ("done", "refused"), REQUESTS)
    assert control.errors == 0
