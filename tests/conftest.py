"""What every test stands on: the module importable in-tree, one thread a library, and GNU Radio present."""

import os
import shutil
import signal
import sys
from pathlib import Path

import pytest
from waiting import ROOT, crowd

# Before NumPy is first imported: tests run side by side, and BLAS threads would only get in their way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# On CI pytest writes out how two values differ. Of frames, millions of bytes, that takes longer than any limit.
os.environ.pop("CI", None)
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # or each program under test compiles the package again

# A script's `make test &` starts with Ctrl-C ignored, and hands that on. A terminated run ends what it has started.
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.default_int_handler)

# `radalt` and `gnuradio.radalt` from python/, programs as modules from the other folders.
sys.path[:0] = [str(ROOT / name) for name in ("python", "flowgraphs", "tools", "training")]

from hostile import draw_nothing, measure_here  # noqa: E402 - found by the line above


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config) -> None:
    """The watchdog's limit holds for a machine that does nothing else: it grows with what this one has to do."""
    if getattr(config.option, "timeout", 0) is None:
        config.option.timeout = float(config.getini("timeout")) * crowd()


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart() -> None:
    """Say in one line what is wrong with this interpreter, where every test would say it in thirty."""
    try:
        from gnuradio import gr  # noqa: F401 - the import is the check
    except (ImportError, SystemError) as error:
        # SystemError: GNU Radio's bindings under a NumPy they were not built for.
        reason = f"{sys.executable} cannot import gnuradio ({error}); run the tests with `make test`"
        pytest.exit(reason, returncode=2)


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the source tree."""
    return ROOT


@pytest.fixture
def browser(tmp_path: Path) -> list[str] | None:
    """Command of a headless Chromium with a profile of its own; None without one: 300 MB are no part of the set-up."""
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    flags = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    return program and [program, *flags]


@pytest.fixture
def measured_here(monkeypatch) -> None:
    """Points are measured in this process: starting another takes longer than most points do."""
    measure_here(monkeypatch)


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Figures are files without a picture: to draw them takes longer than a small run does."""
    draw_nothing(monkeypatch)


@pytest.fixture(scope="module", autouse=True)
def shipped_methods_again():
    """Methods that a file's tests name or register end with it: which file comes next in a process is chance."""
    from radalt.core import mitigation

    tables = mitigation.METHODS, mitigation._NAMED
    before = [dict(table) for table in tables]
    yield
    for table, was in zip(tables, before, strict=True):
        table.clear()
        table.update(was)
