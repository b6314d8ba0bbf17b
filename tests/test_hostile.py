"""Input that once got a traceback, a hang or a wrong yes: each class of it ends with status 2 and one line."""

import itertools
import os
import signal
import sys
import time
from pathlib import Path

import collect
import gallery
import integrity
import landing_eval
import leaving_out
import make_flowgraphs
import make_landing_data
import make_recording
import ota_eval
import ota_remote
import pytest
import realtime_benchmark
import screenshot
import stability
import yaml
from hostile import assert_refused, ended, measure_here, refused
from waiting import ROOT, end_of, ran, started

import bench
from radalt.bench.rows import read_rows
from radalt.core.mitigation import MitigationError, create, trial_run
from radalt.core.parsing import InputError, load_yaml
from radalt.core.scene import SceneError, load_scene, parse_scene
from radalt.core.waveform import Waveform
from radalt.evaluation.commands import control as control_client
from radalt.evaluation.overlap.points import point_seed, sweep_points

YAML = {
    "twice": ("radio: {attenuation_db: 60}\nradio: {attenuation_db: 3}\n", "'radio' is there twice"),
    "bomb": ("a: &a [x, x]\nb: &b [*a, *a]\n", "line 2: aliases are not read"),
    "brackets": ("name: " + "[" * 3000 + "]" * 3000, "nested too deep"),
    "400 digits": ("seed: 1" + "0" * 400, "at most 19 digits"),
    "float of 400 digits": ("altitude: {frames: 1" + "0" * 400 + ".0}", "altitude.frames is inf"),
    "no int": ('seed: !!int "abc"', "'abc' is no int"),
    "timestamp": ("seed: !!timestamp soon", "could not determine a constructor"),
    "object": ("seed: !!python/object/apply:os.system ['true']", "could not determine a constructor"),
    "sexagesimal": ("altitude: {frames: 1:30}", "altitude.frames is '1:30'"),
    "nul": ('name: "a\\0b"', "control characters"),
    "surrogate": ('name: "\\ud800"', "control characters"),
    "key a list": ("{[a, b]: 2}", "not valid YAML"),
    "long key": ("x" * 5000 + ": 2", "not valid YAML"),
    "frames 1e9": ("altitude: {frames: 1000000000}", "GB of results"),
    "sweep of 1 s": ("waveform: {sweep_s: 1.0}", "GB in a flowgraph's buffers"),
    "empty list of lists": ("sweep: {overlap: [[]]}", "sweep.overlap"),
}


@pytest.mark.parametrize("name", YAML)
def test_hostile_scene_gets_one_line(name, tmp_path):
    text, message = YAML[name]
    path = tmp_path / "it.yaml"
    path.write_text(text)
    status, error = ended(ota_eval.main, "--sim", "--plan", "--scene", path)
    assert_refused(status, error)
    assert message in error


def test_the_strict_reader_reads_what_everybodys_reader_reads_but_for_dates(tmp_path):
    for file in (ROOT / "flowgraphs").glob("**/*.yaml"):
        assert load_yaml(file, what="scene") == yaml.safe_load(file.read_text()), file
    path = tmp_path / "it.yaml"
    path.write_text("name: 2026-11-22\n")
    assert load_scene(path).name == "2026-11-22"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: os.mkfifo(path) or path, "it is a pipe or device"),
        (lambda path: Path("/dev/zero"), "it is a pipe or device"),
        (lambda path: path.parent, "it is a folder"),
        (lambda path: path, "No such file"),
        (lambda path: Path("x" * 5000 + ".yaml"), "name too long"),
        (lambda path: path.write_bytes(b"\xff\xfe") and path, "not text in UTF-8"),
        (lambda path: path.touch() or os.truncate(path, 1 << 30) or path, "MiB are read"),
        (lambda path: path.symlink_to(path) or path, "cannot be read"),
    ],
)
def test_what_is_no_small_regular_file_is_refused_before_it_is_read(make, message, tmp_path):
    path = make(tmp_path / "it.yaml")
    for read in (load_scene, read_rows):
        with refused((SceneError, InputError), f"(?i){message}"):
            read(path)


HOSTILE_NUMBERS = ("abc", "", "nan", "-1e308", "1" * 20, "9" * 5000, "\0")

EVAL = {
    "--frames": ("1000000000", "0", "9" * 30, "9" * 5000, "abc"),
    "--seed": ("9" * 20, "-1"),
    "--sir-db": ("-5000", "0:1e8:1"),
    "--overlap": ("0:1:1e-9", "0:1:1e-320", "0:1:0", ",".join(["1"] * 5000), "nan"),
    "--altitudes": ("1e9", ""),
    "--snr-db": ("1e300",),
    "--methods": ("", "x" * 9999),
    "--scene": ("", "a\0b", "x" * 9999, "/dev/zero"),
    "--model": ("", "/dev/zero", "/"),
    "--method-file": ("/dev/zero", "/"),
    "--replay": ("", "nothing", "/dev/zero"),
    "--nonsense" * 99: (None,),
}


@pytest.mark.parametrize("option", EVAL, ids=lambda o: o[:20])
def test_hostile_option_of_the_evaluation_gets_one_line(option):
    source = [] if option == "--replay" else ["--sim", "--plan"]
    for value in EVAL[option]:
        assert_refused(*ended(ota_eval.main, *source, option if value is None else f"{option}={value}"))


COMMANDS = {
    landing_eval: "--jobs --frames --sensitivity-trials --seed --sir-db --flat-m",
    leaving_out: "--frames --repeats",
    integrity: "--frames --hours --seed",
    realtime_benchmark: "--seconds --overlap --batch",
    gallery: "--seed",
    ota_remote: "--keep-alive-s",
    screenshot: "--sir-db --overlap --frames --time-limit-s",
    make_landing_data: "--glide-deg --start-height-m --speed-m-per-s --step-s --level",
    make_recording: "--antennas --load --snr-db --seed",
    control_client: "--altitude --count",
}
# an altitude that only the server can refuse, and a count of lines to print: both are right for the client
ALLOWED = {(control_client, option, "1" * 20) for option in ("--altitude", "--count")}


OTHERS = {
    landing_eval: (
        "nothing.yaml", "/dev/zero", "--trajectory=/dev/zero", "--terrain=/dev/zero",
        "--methods=" + "x" * 999, "--methods=", "--aircraft=a1b2c3 --dry-run",
        "--frames=0 --sensitivity-trials=0",
    ),
    bench: (
        "nothing.yaml", "/dev/zero", "null --methods=nothing", "null --cases=nothing", "null --frames=0",
        "standard --method-file=m=/dev/zero --confirm", "paper --model=tcae_fc=nothing.onnx", "foreign --cases=dvbt",
    ),
    stability: (
        "--methods=" + "x" * 999, "--groups=", "--models=nothing.onnx", "--methods=none,none",
        "--groups=numbers,numbers",
    ),
    integrity: (
        "--methods=none,none", "--groups=noise,noise", "--methods=" + "x" * 999, "--groups=nothing",
        "--frames=401", "--replay=nothing:1", "--replay=noise:-1", "--replay=noise/0@3:1",
    ),
    collect: ("nothing", "/dev/zero", "a\0b"),
    gallery: ("--out=/dev/null/x.png", "--out=x"),
    realtime_benchmark: ("--methods=nothing", "--methods=none,none", "--scene=/dev/zero", "--scene=a\0b"),
    ota_remote: (
        "--sim --control=tcp://*:6557", "--sim --telemetry=tcp://0.0.0.0:6556", "--sim --control=nonsense",
        "--sim --scene=nothing", "--sim --methods=nothing", "--sim --methods=none,none",
        "--transmit --scene=paper_qpsk",
    ),
    screenshot: ("--scene=nothing", "--method=x';import"),
    make_landing_data: ("--out=/dev/null/x",),
    make_recording: ("--out=/dev/null/x.sigmf-meta", "--out=x.bin"),
    make_flowgraphs: ("--nonsense",),
    control_client: (
        "get --control nonsense", "get --control tcp://127.0.0.1:1", "watch --count=-1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("module", COMMANDS | OTHERS, ids=lambda m: m.__name__)
def test_hostile_number_and_line_of_every_other_command_gets_one_line(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(control_client, "TIMEOUT_MS", 200)
    lines, first = [line.split(" ") for line in OTHERS.get(module, ())], ["get"] * (module is control_client)
    pairs = itertools.product(COMMANDS.get(module, "").split(), HOSTILE_NUMBERS)
    wrong = (pair for pair in pairs if (module, *pair) not in ALLOWED)
    lines += [[*first, "=".join(pair)] for pair in wrong]
    for line in lines:
        assert_refused(*ended(module.main, *line))
    assert module not in COMMANDS or list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("after_s", [0.05, 0.8])
def test_ctrl_c_ends_with_130_and_one_line_at_most(after_s, tmp_path):
    """Whatever is being imported or computed just then."""
    process = started(sys.executable, ROOT / "flowgraphs/ota_eval.py", "--sim", "--plan", cwd=tmp_path)
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, error = end_of(process)
    if "Traceback" in error:  # before the first line of ours, Python itself was being imported
        assert "flowgraphs" not in error or "import _startup" in error
    elif not (after_s < 0.1 and process.returncode == 1 and "flowgraphs" not in error):
        # 1 comes from Python's own start: a module of `site` was being imported, and it says so in its words
        assert process.returncode in (0, 130, -signal.SIGINT)


FOREIGN = {
    "loop": ("while True: pass", "within 1 s; is there a loop without end"),
    "sys.exit": ("import sys; sys.exit(0)", "SystemExit"),
    "os._exit": ("import os; os._exit(0)", "it ended its process (status 0)"),
    "NaN": ("def mitigate(frames, waveform): return frames * float('nan')", "is not finite"),
    "interrupt": ("raise KeyboardInterrupt", "it ended its process"),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_hostile_method_file_gets_one_line_from_the_plan(name, tmp_path, monkeypatch):
    monkeypatch.setattr(trial_run, "LIMIT_S", 30.0 if "loop" not in name else 1.0)
    # what raises has its line without a trial run, too
    if name == "NaN":
        monkeypatch.setenv("RADALT_TRIAL_RUN", "1")
    path = tmp_path / "m.py"
    path.write_text(FOREIGN[name][0])
    status, error = ended(ota_eval.main, "--sim", "--plan", "--methods", "none", "--method-file", path)
    assert_refused(status, error)
    assert FOREIGN[name][1] in error


@pytest.mark.parametrize(
    ("end", "message"),
    [
        ("raise KeyError('x' * 999)", "m.py, line 6: KeyError: 'xxx"),
        ("import os; os._exit(0)", "the worker process ended (exit code 1)"),
    ],
)
def test_a_method_that_fails_in_mid_run_ends_it_with_one_line(end, message, tmp_path, monkeypatch):
    path = tmp_path / "m.py"
    path.write_text(
        "n = 0\ndef mitigate(frames, waveform):\n    global n\n    n += len(frames)\n"
        f"    if n > 20:\n        {end}\n    return frames\n"
    )
    if "os._exit" not in end:  # what it raises is one line wherever it runs
        measure_here(monkeypatch)
    status, error = ended(
        ota_eval.main, "--sim", "--methods", "none", "--method-file", path, "--overlap", "0",
        "--frames", "2", "--jobs", "1", "--out", tmp_path / "out",
    )  # fmt: skip
    assert_refused(status, error)
    assert message in error


def test_hostile_network_is_refused(tmp_path):
    for content in (b"", b"\x08" * 999):
        path = tmp_path / "n.onnx"
        path.write_bytes(content)
        with refused(MitigationError):
            create("tcae", Waveform(), model=str(path))


SMALL_DISK = """
import subprocess, sys
sys.path[:0] = {path!r}
from hostile import assert_refused
from test_engine import Coins, Options, Path, rows_of, run
from test_fuzz import measured_here, resumed
import pytest
patch = pytest.MonkeyPatch()
measured_here(patch)
disk, whole = Path(sys.argv[1]), Path(sys.argv[2])

def mount(*options):
    subprocess.run(["mount", "-t", "tmpfs", *options, "radalt", disk], check=True, timeout=120)

run(Coins(), Options(whole, jobs=1))
ends = []
for pages in range(1, 8):
    mount("-o", f"size={{4 * pages}}k")
    status, error = resumed(disk / "run", False)
    ends.append(status)
    if status:
        assert_refused(status, error)
        assert "cannot be written (No space left on device)" in error, error
        mount("-o", "remount,size=1m")
        status, error = resumed(disk / "run", True)
    assert (status, error) == (0, "") and rows_of(disk / "run") == rows_of(whole), error
    mount("-o", "remount,ro")
    for folder, resume in ((disk / "run", True), (disk / "run", False), (disk / "new", False)):
        status, error = resumed(folder, resume)
        assert_refused(status, error)
        assert "(Read-only file system)" in error, error
    subprocess.run(["umount", disk], check=True, timeout=120)
assert ends[0] == 2 and ends[-1] == 0, ends
"""


def test_a_disk_full_or_read_only_is_one_line_and_nothing_is_lost(tmp_path):
    """Full at each file that a run writes in turn; with more room the run is completed, to the same rows."""
    program, disk = tmp_path / "program.py", tmp_path / "disk"
    disk.mkdir()
    program.write_text(SMALL_DISK.format(path=[str(ROOT / "tests"), *sys.path]), encoding="utf-8")
    script = f'mount -t tmpfs radalt {disk} && umount {disk} || exit 77; exec {sys.executable} {program} "$@"'
    done = ran("unshare", "-rm", "sh", "-c", script, "sh", disk, tmp_path / "whole", limit_s=100)
    # a container may forbid name spaces; without one a full disk cannot be made without filling the machine's own
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("no mounts without privileges here")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_scene_that_is_swapped_while_it_runs_changes_nothing(tmp_path, monkeypatch, undrawn):
    """The run is of the scene that it read, and says so; another content is another run."""
    scene, out = tmp_path / "it.yaml", tmp_path / "run"
    text = "seed: 5\nmethods: [none]\naltitude: {frames: 2}\nsweep: {overlap: [0]}\n"
    scene.write_text(text)
    measure_here(monkeypatch, lambda: scene.write_text(text.replace("5", "6")))
    command = ("--sim", "--scene", scene, "--jobs", "1", "--out", out)
    assert ended(ota_eval.main, *command) == (0, "")
    assert "seed: 6" in scene.read_text() and "seed: 5" in (out / "scene.yaml").read_text()
    assert '"seed": 5' in (out / "run.json").read_text()
    (point,) = sweep_points(parse_scene({"sweep": {"overlap": [0]}}))
    assert f",{point_seed(5, point)}," in (out / "rows.csv").read_text()
    status, error = ended(ota_eval.main, *command, "--resume")
    assert_refused(status, error)
    assert "scene.seed is 5 there and 6 here" in error


def test_a_method_file_that_is_swapped_while_it_runs_ends_the_run(tmp_path, monkeypatch):
    """Every worker reads it anew: the marker says whose rows these are."""
    method, out = tmp_path / "m.py", tmp_path / "run"
    method.write_text("def mitigate(frames, waveform): return frames\n")
    change = "def mitigate(frames, waveform): return 2 * frames\n"
    measure_here(monkeypatch, lambda: method.write_text(change))
    options = ("--methods", "none", "--method-file", method, "--overlap", "0", "--frames", "1", "--jobs", "1")
    status, error = ended(ota_eval.main, "--sim", *options, "--out", out)
    assert_refused(status, error)
    assert "m.py was changed while the run read it" in error
    assert not (out / "points.jsonl").exists()
