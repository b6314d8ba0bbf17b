"""Where scenes, flowgraphs and models lie: in the source tree, or where CMake installed them."""

from __future__ import annotations

import sys
from pathlib import Path

__all__ = ["model_path", "remedy", "scene_path", "share_dir"]


def share_dir() -> Path:
    """The folder that holds ``flowgraphs/`` and ``models/``.

    In the source tree that is the repository root; installed, ``<prefix>/share/gr-radalt`` of the prefix the package
    lies under.

    Raises
    ------
    FileNotFoundError
        If neither exists; names both places.
    """
    package = Path(__file__).resolve().parents[1]
    candidates = [package.parents[1]]
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
    """What to do about Python packages that are missing, for a message: in the source tree, or installed."""
    if (share_dir() / "requirements.txt").is_file():
        return "run 'make setup' and use .venv/bin/python"
    names = " ".join(packages)
    return f"'make install' brings it along; without: {sys.executable} -m pip install --user {names}"


def model_path(name: str) -> Path:
    """A shipped model by file name."""
    return share_dir() / "models" / name


def scene_path(name: str | Path) -> Path:
    """A scene by path, or by the bare name of a shipped scene."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    return share_dir() / "flowgraphs" / "scenes" / f"{name}.yaml"
