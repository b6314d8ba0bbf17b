"""Copies page, figures and data of a result folder to the stable names that the documentation links to."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from ..results.folder import FolderError

__all__ = ["check_target", "publish"]


def check_target(target: Path) -> None:
    """Check that `publish` can write into a folder, or create it; nothing is written.

    Raises
    ------
    FolderError
        One line. It is raised before the run, since the page is copied after hours of measurement.
    """
    there = next((p for p in (target, *target.absolute().parents) if p.exists()), Path("/"))
    if not there.is_dir():
        raise FolderError(f"--publish {target}: {there} is no folder; name another")
    if not os.access(there, os.W_OK | os.X_OK):
        raise FolderError(f"--publish {target}: {there} may not be written; name another folder")


def publish(result: Path, files: Mapping[str, str], target: Path) -> list[Path]:
    """Copy files of a result folder into ``target`` under other names, and adapt links between them in Markdown.

    Parameters
    ----------
    result : Path
        Folder of a finished run.
    files : mapping of file in it -> name below ``target``
        As `Study.published`.
    target : Path
        Created if missing; files of these names are replaced.

    Raises
    ------
    OSError
        If a file cannot be read or written.
    """
    out = []
    for source, name in files.items():
        if source.endswith(".csv") and not (result / source).exists():
            continue  # a table without rows
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            text = (result / source).read_text(encoding="utf-8")
            path.write_text(_relinked(text, files, PurePosixPath(name).parent), encoding="utf-8")
        else:
            shutil.copyfile(result / source, path)
        out.append(path)
    return out


def _relinked(text: str, files: Mapping[str, str], folder: PurePosixPath) -> str:
    for source, name in files.items():
        text = text.replace(f"]({source})", f"]({PurePosixPath(os.path.relpath(name, folder))})")
    return text
