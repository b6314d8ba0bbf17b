"""The wheel: pure Python for any Python, without GNU Radio; `tools/test-wheel.sh` tries it in bare environments.

Here it is unpacked and used with the packages of these tests, nothing of the source tree on any path."""

import os
import zipfile
from pathlib import Path

import pytest
from waiting import ran_python

WITHOUT_GNU_RADIO = """
import importlib.abc, sys
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.startswith(("gnuradio.gr", "pmt")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
"""


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    ran_python("-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=root, check=True)
    (file,) = folder.iterdir()
    return file


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory) -> Path:
    """What pip makes of it, but for the script `radalt`."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def python(site: Path, folder: Path, *words: str, more: tuple[Path, ...] = ()) -> str:
    """What a program says that ends with status 0."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "GRC_", "RADALT"))}
    env = kept | {"PYTHONPATH": os.pathsep.join(map(str, (site, *more)))}
    return ran_python(*words, cwd=folder, env=env, limit_s=150, check=True).stderr


def test_it_is_pure_small_and_whole(root, wheel):
    assert wheel.name.endswith("-py3-none-any.whl") and wheel.stat().st_size < 5_000_000
    names = set(zipfile.ZipFile(wheel).namelist())
    package = {str(f.relative_to(root / "python")) for f in (root / "python/radalt").rglob("*.*")}
    data = {f"radalt/share/{f.relative_to(root)}" for f in (root / "flowgraphs").rglob("*.yaml")}
    data |= {f"radalt/share/models/{name}.onnx" for name in ("tcae", "any_sweep")}
    wanted = {name for name in package if "__pycache__" not in name} | data | {"gnuradio/radalt/__init__.py"}
    assert wanted <= names
    assert not [name for name in names if name.startswith("gnuradio/") and name not in wanted]


def test_it_measures_and_commands_say_what_they_need(site, tmp_path):
    code = f"""{WITHOUT_GNU_RADIO}
import radalt
assert radalt.__file__.startswith({str(site)!r}), radalt.__file__
point = dict(sir_db=-30, overlap=1, altitude_m=100, frames=4)
assert len(radalt.evaluate("nr5", ["none", "tcae"], **point, progress=False).table) == 2
from radalt.evaluation import programs
assert programs.main(["eval", "--sim"]) == programs.main(["remote", "--sim"]) == 2
"""
    lines = python(site, tmp_path, "-c", code).splitlines()
    assert len(lines) == 2
    assert all("has no GNU Radio 3.10, which this command needs" in line for line in lines)
    assert all("radalt.evaluate in Python" in line for line in lines)


def test_another_version_is_named_in_one_line(site, tmp_path):
    other = tmp_path / "older"
    (other / "radalt").mkdir(parents=True)
    (other / "radalt/__init__.py").write_text('__version__ = "0.0.7"\n')
    words = ("-m", "radalt", "collect", "--help")
    assert python(site, tmp_path, *words) == ""
    said = python(site, tmp_path, *words, more=(other,))
    assert said.count("\n") == 1
    assert f"0.0.7 is installed in {other / 'radalt'}; remove one of them" in said
    assert "0.0.7 is installed" in python(site, tmp_path, "-c", "import gnuradio.radalt", more=(other,))
