"""Paths of scenes, flowgraphs and models: in the source tree, in a wheel, or where CMake installed them."""

import importlib
import os
import re
import sys
from pathlib import Path
from types import ModuleType


def share_dir() -> Path:
    """The folder that holds ``flowgraphs/``, ``bench/`` and ``models/``.

    The repository root in the source tree, ``share`` within the package in a wheel, ``<prefix>/share/gr-radalt`` where
    CMake installed it. Raises `FileNotFoundError`, with the places, if there is none.
    """
    package = Path(__file__).resolve().parents[1]
    candidates = [package.parents[1], package / "share"]
    candidates += [parent / "share" / "gr-radalt" for parent in package.parents]
    candidates.append(Path(sys.prefix) / "share" / "gr-radalt")
    for candidate in candidates:
        if (candidate / "flowgraphs" / "scenes").is_dir():
            return candidate
    raise FileNotFoundError(
        f"gr-radalt's flowgraphs and models are neither in {candidates[0]} nor in a share/gr-radalt above {package}; "
        "reinstall the module"
    )


def remedy(*packages: str) -> str:
    """How to install missing Python packages, for a message."""
    if (share_dir() / "requirements.txt").is_file():
        return "run 'make setup' and use .venv/bin/python"
    names = " ".join(packages)
    return f"'make install' brings it along; without: {sys.executable} -m pip install --user {names}"


def extra(name: str) -> ModuleType:
    """An optional package; raises InputError, one line that says how to install it, where it is missing."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        from .parsing import InputError  # needs NumPy, which a wrong Python lacks

        raise InputError(
            f"this needs the package {name}, which {sys.executable} lacks; {remedy(name)}"
        ) from None


def say_other_installation() -> None:
    """Print one line on stderr where Python's path holds another version of this package; once, workers included.

    Programs of the source tree put it first on the path and print nothing.
    """
    package = Path(__file__).resolve().parents[1]
    if "RADALT_VERSIONS" in os.environ or (package.parents[1] / "requirements.txt").is_file():
        return
    os.environ["RADALT_VERSIONS"] = version = _version(package / "__init__.py")
    for entry in dict.fromkeys(sys.path):
        other = Path(entry or ".", "radalt").resolve()
        found = _version(other / "__init__.py") if other != package else ""
        if found not in ("", version):
            print(
                f"radalt {version} of {package} runs, and {found} is installed in {other}; remove one of them",
                file=sys.stderr,
            )
            return


def _version(file: Path) -> str:
    """``__version__`` of a package's file; empty where it cannot be read."""
    try:
        found = re.search(r'^__version__ = "(.+)"$', file.read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        return ""
    return found[1] if found else ""


def no_gnu_radio() -> str:
    """Message of a command that needs GNU Radio under a Python that has none."""
    if (share_dir() / "requirements.txt").is_file():
        return f"{sys.executable} has no GNU Radio; run 'make setup' and use .venv/bin/python"
    return (
        f"{sys.executable} has no GNU Radio 3.10, which this command needs; install it and use its Python, or measure "
        "without a flowgraph: radalt.evaluate in Python"
    )


def model_path(name: str) -> Path:
    """A shipped model by file name."""
    return share_dir() / "models" / name


def scene_names() -> list[str]:
    """Names of the shipped scenes."""
    return sorted(file.stem for file in (share_dir() / "flowgraphs" / "scenes").glob("*.yaml"))


def scene_path(name: str | Path) -> Path:
    """A scene by path, or by the bare name of a shipped scene."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    return share_dir() / "flowgraphs" / "scenes" / f"{name}.yaml"
