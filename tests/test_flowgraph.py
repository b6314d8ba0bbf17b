"""The flowgraphs: rewritten mechanically, valid for GNU Radio's own compiler, and right when they run."""

import ast
import functools
import inspect
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from gnuradio import gr, radalt
from hostile import write_scene
from waiting import ROOT, patient, ran, ran_python

from radalt.core.altimeter.altimeter import Altimeter
from radalt.core.scene import load_scene, parse_scene
from radalt.evaluation.flowgraph import FlowgraphError
from radalt.evaluation.flowgraph.generate import Prepared, _platform, generate, grc_dirs, prepare
from radalt.evaluation.flowgraph.rewrite import load_grc, prune, simulate
from radalt.evaluation.flowgraph.run import load_class, run_point, run_to_end

FLOWGRAPHS = sorted((ROOT / "flowgraphs").glob("*.grc"))
B210, SIM = (ROOT / f"flowgraphs/{name}.grc" for name in ("ota_b210", "ota_sim"))
DESCRIPTIONS = sorted((ROOT / "grc").glob("*.block.yml"))
UHD = {"radar_usrp_sink", "radar_usrp_source", "jammer_usrp_sink"}
GATES = {"radar_gate", "jammer_gate"}
RADIOS_ALONE = {"import_interlock", "import_levels", "set_up_radios", "transmit", "transmit_interlock"}


grc = functools.cache(load_grc)  # nobody changes it in place


# -- the rewrite ------------------------------------------------------------------------------------------------------
def test_only_what_stands_for_radios_differs():
    """Every other block, its parameters, state: equal, but that nothing is dropped. Every other connection: equal."""
    b210 = grc(B210)
    simulated = simulate(b210)
    dropping = next(b for b in simulated["blocks"] if b["name"] == "drop_when_slow")
    assert dropping["parameters"].pop("value") == "0"
    dropping["parameters"]["value"] = "1"
    before = {block["name"]: block for block in b210["blocks"]}
    after = {block["name"]: block for block in simulated["blocks"]}
    gone = UHD | GATES | RADIOS_ALONE
    assert before.keys() - after.keys() == gone
    assert after.keys() - before.keys() == {"simulated_channel"}
    for name in before.keys() - gone:
        one, other = before[name], after[name]
        told = [b["parameters"] | ({"comment": ""} if b["id"] == "note" else {}) for b in (one, other)]
        assert (one["id"], one["states"]["state"]) == (other["id"], other["states"]["state"])
        assert told[0] == told[1]
        assert one["states"]["coordinate"] == other["states"]["coordinate"]
    kept = [c for c in b210["connections"] if not (UHD | GATES) & set(c)]
    assert [c for c in simulated["connections"] if "simulated_channel" not in c] == kept
    assert sorted(c for c in simulated["connections"] if "simulated_channel" in c) == [
        ["chirp_source", "0", "simulated_channel", "0"],
        ["jammer_source", "0", "simulated_channel", "1"],
        ["simulated_channel", "0", "frame_segmenter", "0"],
    ]
    options, others = b210["options"]["parameters"], simulated["options"]["parameters"]
    assert {k for k in options if options[k] != others[k]} == {"id", "title", "description"}
    assert "B210" not in yaml.safe_dump(simulated) and "uhd" not in yaml.safe_dump(simulated)
    assert simulated["metadata"] == b210["metadata"]


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_nothing_but_a_gate_feeds_a_transmitter(path):
    """And of the shipped flowgraphs those for radios alone have one."""
    data, radios = grc(path), path.stem in ("ota_b210", "ota_live")
    sinks = {b["name"] for b in data["blocks"] if "sink" in b["id"] and "uhd" in b["id"]}
    assert sinks == ({"radar_usrp_sink", "jammer_usrp_sink"} if radios else set())
    fed = [(source, sink) for source, _, sink, _ in data["connections"] if sink in sinks]
    assert sorted(fed) == sorted((sink.replace("usrp_sink", "gate"), sink) for sink in sinks)
    gates = {(b["id"], b["parameters"]["transmit"]) for b in data["blocks"] if b["name"] in GATES}
    assert gates == ({("radalt_transmit_gate", "bool(transmit)")} if radios else set())


def test_prune_disables_what_the_scene_does_not_need_and_nothing_else():
    simulated = simulate(grc(B210))
    pruned = prune(simulated, ["none", "whitening"], jammer=False)
    disabled = {b["name"] for b in pruned["blocks"] if b["states"]["state"] == "disabled"}
    before = {b["name"] for b in simulated["blocks"] if b["states"]["state"] == "disabled"}
    methods = {"lms", "lms_reference_input", "nlms", "blanking", "tcae"}
    chains = {f"{kind}_{m}" for m in methods for kind in ("mitigation", "altimeter")}
    assert disabled - before == chains | {"jammer_source"}
    assert prune(simulated, ["none", "whitening", *methods], jammer=True) == simulated


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_flowgraph_validates_compiles_and_imports(path, tmp_path):
    """The compiler refuses a missing block and an error; importing proves what validity does not."""
    module = generate(grc(path), tmp_path)
    top = load_class(Prepared(module))
    assert module.stem == path.stem and issubclass(top, gr.top_block)
    assert {"scene_file", "seed"} <= inspect.signature(top.__init__).parameters.keys()


# -- descriptions -----------------------------------------------------------------------------------------------------
def rendered(key: str, **values: str):
    """Constructor, callbacks and errors of a block named ``it`` as the compiler has them, and the block."""
    graph = _platform(*grc_dirs()).make_flow_graph()
    scene = graph.new_block("variable")
    scene.params["id"].set_value("scene")
    scene.params["value"].set_value("__import__('radalt.core.scene', fromlist=['Scene']).Scene()")
    block = graph.new_block(key)
    block.params["id"].set_value("it")
    for name, value in values.items():
        block.params[name].set_value(value)
    graph.rewrite()
    errors = [m for e, m in graph.iter_error_messages() if "Port is not connected" not in m]
    return block.templates.render("make"), block.get_callbacks(), errors, block


@pytest.mark.parametrize("path", DESCRIPTIONS, ids=lambda p: p.name.removesuffix(".block.yml"))
def test_description_fits_the_class_and_makes_the_block_for_every_option(path, tmp_path, monkeypatch):
    """The constructor and callbacks that the compiler writes are run, for the defaults and for every choice."""
    monkeypatch.chdir(tmp_path)  # a recorder writes next to where it runs
    key = path.name.removesuffix(".block.yml")
    cls = getattr(radalt, key.removeprefix("radalt_"))
    make, callbacks, _, block = rendered(key)
    call = ast.parse(make.strip(), mode="eval").body
    assert ast.unparse(call.func) == f"radalt.{cls.__name__}"
    arguments = [None] * len(call.args)
    inspect.signature(cls.__init__).bind(None, *arguments, **{k.arg: None for k in call.keywords})
    for callback in callbacks:
        called = ast.parse(callback.strip(), mode="eval").body
        assert ast.unparse(called.func.value) == "self.it"
        method = getattr(cls, called.func.attr)
        inspect.signature(method).bind(None, *called.args, **{k.arg: None for k in called.keywords})
    assert block.category[0] == "[RadAlt]" or "RadAlt" in str(block.category)
    text = " ".join(block.documentation.get("", "").lower().split())
    # the block's page explains each
    for parameter in yaml.safe_load(path.read_text(encoding="utf-8"))["parameters"]:
        assert parameter["label"].partition(" (")[0].lower() in text, parameter["label"]
    assert ast.parse(block.templates.render("imports"))
    choices = [(n, p.options) for n, p in block.params.items() if p.dtype == "enum" and n != "type"]
    scene = load_scene("paper_qpsk")
    for case in [{}, *({name: option} for name, options in choices for option in options)]:
        make, callbacks, errors, _ = rendered(key, **case)
        assert errors == []
        if key == "radalt_sigmf_source":
            continue  # needs a recording; made where recordings are tested
        holder = gr.top_block()
        holder.it = eval(make, {"radalt": radalt, "scene": scene, "self": holder})  # noqa: S307 - what the compiler writes
        for callback in callbacks:
            eval(callback, {"self": holder})  # noqa: S307
        if hasattr(holder.it, "close"):  # an endpoint is for one at a time
            holder.it.close()


# -- running ----------------------------------------------------------------------------------------------------------
WHOLE_SPAN = {"programme_m": np.geomspace(1500, 3, 10).tolist(), "frames": 5}
LANDING = {"programme_m": [1200.0, 400.0, 60.0], "frames": 6, "vertical_speed_m_per_s": -60.0}


def scene_of(**keys):
    return parse_scene({"altitude": WHOLE_SPAN, "channel": {"snr_db": 20.0}, "methods": ["none"]} | keys)


def flown(prepared, scene):
    return run_point(prepared, scene, time_limit_s=patient(120))


@pytest.fixture(scope="module")
def clear(tmp_path_factory):
    """The flowgraph without a jammer chain, generated once."""
    return prepare(scene_of(), ["none"], tmp_path_factory.mktemp("clear"))


@pytest.fixture(scope="module")
def jammed(tmp_path_factory):
    """The flowgraph with its jammer chain."""
    scene = scene_of(interference={"qpsk": {"sir_db": -10.0}})
    return prepare(scene, ["none", "whitening", "lms"], tmp_path_factory.mktemp("jammed"))


@pytest.mark.parametrize(
    ("altitude", "leakage_db", "seed"),
    [
        (WHOLE_SPAN | {"mode": "synthetic"}, None, 1),
        (WHOLE_SPAN | {"mode": "true_delay"}, None, 2),
        (LANDING | {"mode": "true_delay"}, -20.0, 1),
    ],
    ids=["synthetic", "true delay", "landing with leakage"],
)
def test_altitude_and_speed_are_right_from_three_metres_to_fifteen_hundred(clear, altitude, leakage_db, seed):
    """No interference, 20 dB SNR, unknown start offset with its fraction: RMSE below 0.5 m."""
    scene = scene_of(altitude=altitude, channel={"snr_db": 20.0, "leakage_db": leakage_db}, seed=seed)
    assert scene.channel.start_offset_samples is None  # drawn
    programme, rows = scene.altitude.programme, flown(clear, scene).results["none"]
    rows = rows[programme.is_trial(rows["frame_index"])]
    assert rows.size == altitude["frames"] * len(altitude["programme_m"])
    error = rows["altitude_m"] - programme.altitude_m(rows["frame_index"])
    assert np.sqrt(np.mean(error**2)) < 0.5  # NaN, a frame without altitude, would fail as well
    # where the latency splits a frame's true delay, one frame a step mixes two altitudes' Doppler
    assert np.median(np.abs(rows["vertical_speed_m_per_s"] - programme.vertical_speed_m_per_s)) < 1.0


def test_same_seed_same_rows_and_another_seed_others(jammed):
    scene = scene_of(interference={"qpsk": {"sir_db": -24.0, "overlap": 0.6}}, seed=5)
    runs = [flown(jammed, one).results for one in (scene, scene, replace(scene, seed=6))]
    for method in jammed.methods:
        first, again, other = (results[method].tobytes() for results in runs)
        assert first == again != other


def test_jammer_chain_at_overlap_zero_is_bit_identical_to_none(clear, jammed):
    scene = scene_of(interference={"qpsk": {"sir_db": -20.0}}, seed=4).at(overlap=0.0)
    without = flown(clear, replace(scene, interference=())).results["none"]
    assert len(without) >= 58 and flown(jammed, scene).results["none"].tobytes() == without.tobytes()


def test_scene_without_network_or_jammer_imports_no_onnxruntime(clear, tmp_path):
    """the scene decides what is built, and what is not built is not imported; scipy.signal alone takes 40 MB."""
    scene = write_scene(scene_of(), tmp_path / "scene.yaml")
    statements = (
        f"import sys; sys.path[:0] = [{str(ROOT / 'python')!r}, {str(clear.module.parent)!r}]\n"
        f"import {clear.module.stem} as module\n"
        f"top = module.{clear.module.stem}(scene_file={str(scene)!r}); top.run()\n"
        "unwanted = {'onnxruntime', 'matplotlib', 'zmq', 'dted', 'torch', 'scipy.signal', 'scipy.optimize',\n"
        "    'PyQt5', 'gnuradio.uhd'}\n"
        "print('loaded', *sorted(unwanted & set(sys.modules)))"
    )
    done = ran_python("-c", statements, check=True)
    assert done.stdout.strip().splitlines()[-1] == "loaded"


def test_error_in_a_block_comes_out_of_the_run_as_it_was(clear, monkeypatch, capfd):
    def fail(self, *args, **kwargs):
        raise FloatingPointError("as it was")

    monkeypatch.setattr(Altimeter, "process", fail)
    with pytest.raises(FloatingPointError, match="as it was"):
        flown(clear, scene_of())


def test_run_beyond_its_time_is_stopped_and_says_so(clear):
    altitude = {"programme_m": [300.0], "frames": 20_000}
    with pytest.raises(FlowgraphError, match="did not end within 0.5 s"):
        run_point(clear, scene_of(altitude=altitude), time_limit_s=0.5)


def test_ctrl_c_while_it_waits_lets_every_block_come_to_its_end():
    """Blocks need a while, as one does that waits for another process; the program goes on to close what they use."""
    stopped, ended = threading.Event(), []

    def wait():
        stopped.wait(30)  # what never stops it fails, and the test with it
        time.sleep(0.3)
        ended.append(True)

    block = types.SimpleNamespace(work=None, error=None)
    top = types.SimpleNamespace(block=block, start=lambda: None, wait=wait, stop=stopped.set)
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        run_to_end(top, poll_s=5.0)
    assert ended


# -- the companion's Run button ---------------------------------------------------------------------------------------
def run_button(module: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A generated program, started as the shipped flowgraphs' option *Run Command* says."""
    command = grc(SIM)["options"]["parameters"]["run_command"]
    words = shlex.split(command.format(python=shlex.quote(sys.executable), filename=shlex.quote(str(module))))
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'python'}:{os.environ.get('PYTHONPATH', '')}"}
    return ran(*words, *arguments, env=environment)


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_run_button_of_every_flowgraph_is_the_one_that_is_tested_here(path):
    command = grc(path)["options"]["parameters"]["run_command"]
    assert command == "{python} -u -m radalt.evaluation.flowgraph.companion {filename}"


def test_run_button_answers_a_wrong_scene_with_one_line(tmp_path):
    module = generate(grc(SIM), tmp_path)
    scene = tmp_path / "wrong.yaml"
    scene.write_text("altitude: {frames: -3}\n")
    done = run_button(module, "--scene-file", str(scene))
    assert done.returncode == 2
    assert done.stderr.splitlines() == [f"ota_sim: {scene}: altitude.frames -3 has to be at least 1"]


def test_run_button_ends_with_1_and_a_line_where_a_block_fails(tmp_path):
    module = tmp_path / "failing.py"
    module.write_text(
        "import numpy as np\n"
        "from gnuradio import blocks, gr\n"
        "from radalt.blocks._guard import guarded\n"
        "class broken(gr.sync_block):\n"
        "    def __init__(self):\n"
        "        gr.sync_block.__init__(self, 'broken', [np.complex64], None)\n"
        "    @guarded\n"
        "    def work(self, input_items, output_items):\n"
        "        raise ValueError('the third rail is missing')\n"
        "top, sink = gr.top_block(), broken()\n"  # a block of Python lives as long as its object
        "top.connect(blocks.null_source(8), sink)\n"
        "top.run()\n"
    )
    done = run_button(module)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "failing: the third rail is missing"
