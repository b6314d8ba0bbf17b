"""The package lists its blocks from its folder and imports each on first use only."""

from pathlib import Path

from waiting import ran_python

STATEMENTS = """
import sys
import gauge
assert {"chirp_source", "range_sink", "__version__"} <= set(dir(gauge)) and "core" not in dir(gauge)
assert gauge.core.__name__ == "gauge.core"
try: gauge.chrip_source
except AttributeError as error: assert str(error).endswith("; blocks: chirp_source, range_sink"), error
assert not {name for name in sys.modules if name.startswith("gauge.blocks.")}
gauge.chirp_source
assert "gauge.blocks.chirp_source" in sys.modules and "gauge.blocks.range_sink" not in sys.modules
"""
WAYS = (
    "import gauge; block = gauge.chirp_source",
    "import gauge; gauge.chirp_source; block = gauge.chirp_source",
    "from gauge import chirp_source as block",
    "import gauge.blocks.chirp_source; block = gauge.chirp_source",
    "from gauge.blocks.chirp_source import chirp_source; import gauge; block = gauge.chirp_source",
)


def test_blocks_are_listed_imported_on_use_and_classes_however_they_were_first_imported(root, tmp_path):
    """A copy of the package's __init__.py with two blocks of its own."""
    package = tmp_path / "gauge"
    for room in ("blocks", "core"):
        (package / room).mkdir(parents=True)
        (package / room / "__init__.py").write_text("")
    (package / "__init__.py").write_text((root / "python/radalt/__init__.py").read_text())
    for name in ("chirp_source", "range_sink"):
        (package / "blocks" / f"{name}.py").write_text(f"class {name}: pass\n")
    (package / "blocks/_shared.py").write_text("")
    ran_python("-c", STATEMENTS, cwd=tmp_path, check=True)
    for way in WAYS:
        done = ran_python("-c", way + "; print(block)", cwd=tmp_path)
        assert done.stdout == "<class 'gauge.blocks.chirp_source.chirp_source'>\n", (way, done.stderr)


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
    assert ran_python("-c", statements, cwd=root / "python", check=True).stdout.strip() == ""


def test_every_block_is_a_class_of_gnu_radio_and_has_a_description_for_the_companion(root: Path):
    from gnuradio import radalt

    files = {file.stem for file in (root / "python/radalt/blocks").glob("[!_]*.py")}
    assert files <= set(dir(radalt)) and not files & set(radalt.__all__)
    assert {name for name in files if not isinstance(getattr(radalt, name), type)} == set()
    described = {file.name for file in (root / "grc").glob("*.block.yml")}
    assert described == {f"radalt_{name}.block.yml" for name in files}


def test_the_code_does_not_grow(root: Path):
    """Ceilings only fall: what is added has to be deleted elsewhere."""
    ran_python(root / "tools/count_lines.py", check=True)
