"""gnuradio-companion itself, under a display without a screen, opens every flowgraph whole and tidy."""

import json
import os
import shutil
import sysconfig
from itertools import combinations
from pathlib import Path

import pytest
import yaml
from gnuradio import gr
from waiting import ROOT, ran

from radalt.evaluation.flowgraph import generate

FLOWGRAPHS = sorted((ROOT / "flowgraphs").glob("*.grc"))
SECTIONS_FROM = 216  # below options, parameters and variables


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    """Every flowgraph of the module in one companion, with the environment of `make grc`, by file name; the simulated
    bench and the radios' are run."""
    folder, first = tmp_path_factory.mktemp("home"), ["ota_sim.grc", "ota_b210.grc"]
    paths = [Path(shutil.copy(path, folder)) for path in FLOWGRAPHS]
    if (kept := Path.home() / ".cache/grc_gnuradio").is_dir():  # the blocks' descriptions, read before
        shutil.copytree(kept, folder / ".cache/grc_gnuradio")
    paths.sort(key=lambda path: (path.name not in first, path.name == first[1]))
    environment = os.environ | {
        "HOME": str(folder),
        "PYTHONPATH": f"{ROOT / 'python'}:{sysconfig.get_path('purelib')}",
        "GRC_BLOCKS_PATH": str(ROOT / "grc"),
        "GR_CONF_GRC_XTERM_EXECUTABLE": "/dev/null",
        # GNU Radio's own, and not what may be installed of ours
        "GR_CONF_GRC_GLOBAL_BLOCKS_PATH": f"{gr.prefix()}/share/gnuradio/grc/blocks",
    }
    probe = ["/usr/bin/python3", ROOT / "tests/companion_probe.py", "--run", "2", *paths]
    done = ran("xvfb-run", "-a", *probe, cwd=folder, env=environment, limit_s=100)
    lines = [line for line in done.stdout.splitlines() if line.startswith("PROBE ")]
    assert len(lines) == 1, f"the companion ended with {done.returncode}\n{done.stdout}\n{done.stderr}"
    report = json.loads(lines[0].removeprefix("PROBE "))
    pages = {Path(page["file"]).name: page for page in report["pages"]}
    return pages | {"consoles": dict(zip(first, report["consoles"], strict=True))}


def on_file(path: Path) -> dict:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def overlaps(first: list[float], second: list[float]) -> bool:
    """Whether two boxes (left, top, right, bottom) come nearer than half a grid step, 4 pixels."""
    across = min(first[2], second[2]) - max(first[0], second[0])
    down = min(first[3], second[3]) - max(first[1], second[1])
    return across > -4 and down > -4


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_all_blocks_are_there_found_and_right(seen, path):
    data, page = on_file(path), seen[path.name]
    named = [b["name"] for b in data["blocks"]]
    assert sorted(b["name"] for b in page["blocks"]) == sorted([*named, data["options"]["parameters"]["id"]])
    assert page["connections"] == len(data["connections"])
    assert [b["name"] for b in page["blocks"] if b["dummy"]] == page["errors"] == []


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_boxes_do_not_overlap(seen, path):
    blocks = seen[path.name]["blocks"]
    pairs = [(a["name"], b["name"]) for a, b in combinations(blocks, 2) if overlaps(a["box"], b["box"])]
    assert pairs == []


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_wires_cross_no_box_and_no_label(seen, path):
    page = seen[path.name]
    boxes = [(b["name"], *b["inner"]) for b in page["blocks"]] + page["labels"]
    crossed = [
        (" - ".join(ends), name)
        for ends, points in page["wires"]
        for name, left, top, right, bottom in boxes
        if name not in ends and any(left < x < right and top < y < bottom for x, y in points)
    ]
    assert crossed == []


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_sections_have_titles(seen, path):
    """A numbered note heads each section, above everything it stands for."""
    notes = [b for b in on_file(path)["blocks"] if b["id"] == "note"]
    titles = sorted(b["parameters"]["note"] for b in notes)
    assert len(titles) >= 3
    assert [title.split(".")[0] for title in titles] == [str(1 + i) for i in range(len(titles))]
    assert all(len(title) <= 27 for title in titles), "the companion cuts longer text off"
    top = min(b["states"]["coordinate"][1] for b in notes)
    assert top >= SECTIONS_FROM
    kinds = ("radalt_", "uhd_", "epy_", "blocks_")
    signal = [b for b in on_file(path)["blocks"] if b["id"].startswith(kinds)]
    assert all(b["states"]["coordinate"][1] > top for b in signal)


def test_button_on_the_simulated_bench_shows_the_scores(seen):
    console = seen["consoles"]["ota_sim.grc"]
    assert ">>> Done" in console and "Traceback" not in console
    rows = [line.split() for line in console.splitlines()]
    pd = {row[1][:-1]: float(row[0]) for row in rows if len(row) == 5 and row[3] == "of"}
    assert list(pd) == ["none", "lms", "lms_reference_input", "nlms", "whitening", "blanking", "tcae"]
    # the first run tells the methods apart, and loses no frame
    assert pd["none"] < 0.5 < 0.9 < pd["whitening"] and pd["tcae"] > 0.95
    assert all(row[4] == "150" for row in rows if len(row) == 5 and row[3] == "of")
    assert "dropped_slow 0," in console


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_a_wrong_scene_is_the_first_error_of_a_flowgraph(path):
    """As the companion lists them; in the simulated bench it is the only one."""
    platform = generate._platform(*generate.grc_dirs())
    data, graph = on_file(path), platform.make_flow_graph()
    (scene,) = (block for block in data["blocks"] if block["name"] == "scene_file")
    scene["parameters"]["value"] = '"nope"'
    graph.import_data(data)
    graph.rewrite()
    graph.validate()
    first, *others = [message for _, message in graph.iter_error_messages()]
    assert "nope.yaml: cannot be read" in first and "give a YAML file or a shipped scene's name" in first
    if path.stem in ("ota_sim", "bring_your_own"):
        assert others == []


def test_button_transmits_nothing_by_default(seen):
    """As shipped, with gr-uhd itself: the interlock ends the run before a radio is looked for."""
    console = seen["consoles"]["ota_b210.grc"]
    assert "\nota_b210: transmit refused: 4.2-4.4 GHz is a safety-of-life band" in console
    assert "(return code 2)" in console  # one line, and an end that tells
    assert "Traceback" not in console and "No devices found" not in console


def test_make_grc_sets_this_environment():
    """What the tests above set by hand is what the target hands to the companion."""
    made = ran("make", "-n", "grc", "FLOWGRAPH=it.grc", cwd=ROOT).stdout.replace("\\\n", " ").splitlines()
    (line,) = (line for line in made if line.endswith(" it.grc"))
    assert f'PYTHONPATH="{ROOT}/python:' in line and f'GRC_BLOCKS_PATH="{ROOT}/grc' in line
    assert "GR_CONF_GRC_XTERM_EXECUTABLE=/dev/null" in line
