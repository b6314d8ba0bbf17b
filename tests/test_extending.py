"""The examples of docs/design.md are what they say: an interferer, a method, a radio, an altimeter profile, a study."""

import csv
import os
import re
import shutil

import pytest
import yaml
from waiting import ROOT, ran_python

from radalt.core.deramp.profile import load_profile
from radalt.studies.tolerance import command as tolerance

EVAL = ROOT / "flowgraphs/ota_eval.py"
EXAMPLES = ("interferer", "method", "radio", "study")
PLUGINS = EXAMPLES[:3]  # a study is run, not registered


@pytest.fixture(scope="module")
def outside(root, tmp_path_factory):
    """A folder with the page's code blocks as modules, and the environment in which every program knows them."""
    folder = tmp_path_factory.mktemp("outside")
    page = (root / "docs/design.md").read_text(encoding="utf-8")
    for name in EXAMPLES:
        section = re.search(rf"^## Add an? {name}$(.*?)^## ", page, re.MULTILINE | re.DOTALL)[1]
        code, *command = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
        (folder / f"my_{name}.py").write_text(code)
        for text in command:
            (folder / f"my_{name}_command.py").write_text(text.replace("from .study", f"from my_{name}"))
    plugins = ",".join(f"my_{name}" for name in PLUGINS)
    path = os.pathsep.join([str(folder), str(root / "python")])
    return folder, os.environ | {"RADALT_PLUGINS": plugins, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}


def run(env, *command, check=True):
    return ran_python(*command, env=env, limit_s=100, check=check)


def written(folder, **scene):
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    return str(path)


def test_interferer_and_method_go_through_the_flowgraph_in_a_worker(root, outside, tmp_path):
    folder, env = outside
    altitude, hopper = {"programme_m": [300.0, 60.0], "frames": 4}, {"dwell_s": 20e-6, "sir_db": -20.0}
    scene = written(tmp_path, altitude=altitude, interference={"hopper": hopper})
    out = tmp_path / "run"
    arguments = ("--sim", "--scene", scene, "--methods", "none,clipper", "--overlap", "0,0.5", "--jobs", "1")
    run(env, EVAL, *arguments, "--out", out)
    rows = list(csv.DictReader((out / "rows.csv").open()))
    assert {(r["method"], r["interference"]) for r in rows} == {("none", "hopper"), ("clipper", "hopper")}
    clear = {r["method"]: float(r["pd"]) for r in rows if float(r["overlap"]) == 0}
    assert clear == {"none": 1.0, "clipper": 1.0}
    assert "hopper" in (out / "report.md").read_text(encoding="utf-8")


def test_radio_sets_what_a_scene_may_ask_of_it(root, outside, tmp_path):
    _, env = outside
    radio = {"device": "x310_ubx", "master_clock_hz": 187.5e6, "enclosure": "cabled", "attenuation_db": 60.0}
    plan = run(env, EVAL, "--check", "--scene", written(tmp_path, radio=radio))
    assert "radar X310" in plan.stdout and "divided by 25 to 7.5 MS/s" in plan.stdout
    scene = written(tmp_path, radio=radio | {"radar_tx_gain_db": 40.0})
    refused = run(env, EVAL, "--check", "--scene", scene, check=False)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "radio.radar_tx_gain_db is 40; it has to be within 0..31.5" in refused.stderr


def test_altimeter_profile_is_read_and_flown(root, tmp_path, measured_here, undrawn):
    """What the file does not say is the base's, next to which it lies."""
    page = (root / "docs/design.md").read_text(encoding="utf-8")
    section = page.split("## Add an altimeter profile")[1].split("\n## ")[0]
    file = tmp_path / "my_altimeter.yaml"
    file.write_text(re.search(r"```yaml\n(.*?)```", section, re.DOTALL)[1])
    shutil.copy(root / "flowgraphs/altimeters/fmcw_150mhz.yaml", tmp_path)
    profile = load_profile(file)
    assert (profile.bandwidth_hz, profile.period_s, profile.gain_dbi) == (100e6, 5e-3, 12.0)
    assert profile.noise_figure_db == load_profile("fmcw_150mhz").noise_figure_db
    assert profile.provenance["gain_dbi"][0] == "assumed"
    words = "--interferers tone --altitudes-ft 200 --outputs 20 --seeds 1 --method none --jobs 1".split()
    assert tolerance.main([*words, "--profile", str(file), "--out", str(tmp_path / "run")]) == 0
    assert "my_altimeter" in (tmp_path / "run/report.md").read_text(encoding="utf-8")


def test_study_runs_on_the_engine(outside, tmp_path):
    """Pd falls with the SNR."""
    _, env = outside
    main = "from my_study_command import main\nif __name__ == '__main__': raise SystemExit(main())\n"
    (tmp_path / "noise.py").write_text(main)
    done = run(env, tmp_path / "noise.py", "--out", tmp_path / "run", "--jobs", "1")
    assert "SNR -24 dB: Pd" in done.stdout
    pd = [float(row["pd"]) for row in csv.DictReader((tmp_path / "run/rows.csv").open())]
    assert pd == sorted(pd) and pd[0] < 0.3 and pd[-1] > 0.8
    assert "| -24.0 |" in (tmp_path / "run/report.md").read_text(encoding="utf-8")


def test_a_plugin_that_is_not_there_is_named_in_one_line(root, outside):
    done = run(outside[1] | {"RADALT_PLUGINS": "nowhere"}, EVAL, "--sim", "--plan", check=False)
    assert done.returncode == 2
    assert "RADALT_PLUGINS names 'nowhere', which cannot be imported (ModuleNotFoundError" in done.stderr
    assert done.stderr.count("\n") == 1
