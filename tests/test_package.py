"""The package lists its blocks from its folder and imports each on first use only."""

import subprocess
import sys
from pathlib import Path

import pytest

BLOCK = "class {name}:\n    pass\n"


@pytest.fixture
def run_in_package(root: Path, tmp_path: Path):
    """Run statements against a copy of the package's __init__.py that has blocks of its own."""
    package = tmp_path / "gauge"
    package.mkdir()
    (package / "__init__.py").write_text((root / "python/radalt/__init__.py").read_text())
    for room in ("blocks", "core"):
        (package / room).mkdir()
        (package / room / "__init__.py").write_text("")
    for name in ("chirp_source", "range_sink"):
        (package / "blocks" / f"{name}.py").write_text(BLOCK.format(name=name))
    (package / "blocks/_shared.py").write_text("")

    def run(statements: str) -> str:
        command = [sys.executable, "-c", statements]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return run


def test_listing_shows_blocks_before_they_are_imported(run_in_package):
    listing = run_in_package("import gauge; print(*dir(gauge))").split()
    assert {"chirp_source", "range_sink", "core", "__version__"} <= set(listing)


def test_using_one_block_imports_no_other(run_in_package):
    loaded = run_in_package("import gauge, sys; gauge.chirp_source; print(*sorted(sys.modules))").split()
    assert "gauge.blocks.chirp_source" in loaded
    assert "gauge.blocks.range_sink" not in loaded


@pytest.mark.parametrize(
    "statements",
    [
        "import gauge; block = gauge.chirp_source",
        "import gauge; gauge.chirp_source; block = gauge.chirp_source",
        "from gauge import chirp_source as block",
        "import gauge.blocks.chirp_source; block = gauge.chirp_source",
        "from gauge.blocks.chirp_source import chirp_source; import gauge; block = gauge.chirp_source",
    ],
)
def test_block_name_is_the_class_however_it_was_first_imported(run_in_package, statements):
    assert run_in_package(statements + "; print(block)") == "<class 'gauge.blocks.chirp_source.chirp_source'>"


def test_subpackage_is_an_attribute(run_in_package):
    assert run_in_package("import gauge; print(gauge.core.__name__)") == "gauge.core"


def test_unknown_block_is_named_with_those_there_are(run_in_package):
    statements = "import gauge\ntry: gauge.chrip_source\nexcept AttributeError as error: print(error)"
    assert run_in_package(statements).endswith("; blocks: chirp_source, range_sink")


def test_package_and_core_load_nothing_but_numpy_and_scipy(root: Path):
    """core is pure NumPy/SciPy, so that training and sweeps need no GNU Radio."""
    modules = [
        ".".join(file.relative_to(root / "python").with_suffix("").parts).removesuffix(".__init__")
        for file in sorted((root / "python/radalt/core").rglob("*.py"))
    ]
    statements = (
        f"import importlib, sys; [importlib.import_module(name) for name in {['radalt', *modules]}]\n"
        "print(*sorted({'gnuradio', 'onnxruntime', 'matplotlib', 'zmq'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", statements]
    done = subprocess.run(
        command, cwd=root / "python", capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_every_block_is_a_class_of_gnu_radio(root: Path):
    from gnuradio import radalt

    files = {file.stem for file in (root / "python/radalt/blocks").glob("[!_]*.py")}
    assert files <= set(dir(radalt)) and not files & set(radalt.__all__)
    for name in files:
        assert isinstance(getattr(radalt, name), type), f"{name}.py defines no class {name}"


def test_every_block_has_a_description_for_the_companion_and_no_other(root: Path):
    described = {file.name.removesuffix(".block.yml") for file in (root / "grc").glob("*.block.yml")}
    assert described == {f"radalt_{file.stem}" for file in (root / "python/radalt/blocks").glob("[!_]*.py")}
