"""Pages that are made from the code are what the code says, and their programs run."""

import importlib.util
import os
import re
import subprocess
import sys

import pytest
import yaml


@pytest.fixture(scope="module")
def reference(root):
    """The file that `tools/make_scene_reference.py` writes, and what it would write now."""
    path = root / "tools/make_scene_reference.py"
    spec = importlib.util.spec_from_file_location("make_scene_reference", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.PAGE, module.page()


def test_the_scene_reference_is_what_the_code_gives(reference):
    page, made = reference
    assert page.read_text(encoding="utf-8") == made, "run: .venv/bin/python tools/make_scene_reference.py"


def test_every_key_of_every_shipped_scene_is_in_the_reference(root, reference):
    known = set(re.findall(r"^\| `([\w.]+)`", reference[1], re.MULTILINE))
    known = {part for key in known for part in key.split(".")}
    for file in (root / "flowgraphs/scenes").glob("*.yaml"):
        scene = yaml.safe_load(file.read_text())
        for section, value in scene.items():
            keys = (
                value if isinstance(value, dict) and section not in ("interference", "method_options") else {}
            )
            assert set(keys) <= known, file.name


def test_the_first_flowgraph_measures_more_with_whitening_than_without(root):
    """QPSK at -28 dB over half the sweep: no mitigation loses frames, whitening next to none."""
    env = os.environ | {"PYTHONPATH": str(root / "python"), "GR_CONF_LOG_LOG_LEVEL": "warn"}
    done = subprocess.run(
        [sys.executable, str(root / "examples/first_flowgraph.py")],
        env=env, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pattern = r"^(\w+) +(\d+) frames, declared (\d+), within 5 m (\d+)$"
    rows = {
        name: [int(n) for n in numbers] for name, *numbers in re.findall(pattern, done.stdout, re.MULTILINE)
    }
    assert set(rows) == {"none", "whitening"}
    assert rows["none"][0] == rows["whitening"][0] == 120
    assert rows["none"][2] < 100 < rows["whitening"][2]


def test_every_page_is_in_the_site(root):
    named = set(re.findall(r"- ([\w./-]+\.md)$", (root / "mkdocs.yml").read_text(), re.MULTILINE))
    assert named == {str(page.relative_to(root / "docs")) for page in (root / "docs").rglob("*.md")}


def test_links_and_programs_that_pages_name_are_there(root):
    """As `make docs` checks them, which needs MkDocs."""
    for page in (root / "docs").rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        for link in re.findall(r"\]\(([^)#:\s]+)(?:#[\w-]*)?\)", text):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
        for snippet in re.findall(r'^--8<-- "(.+)"$', text, re.MULTILINE):
            assert (root / snippet).is_file(), f"{page.name}: {snippet}"
