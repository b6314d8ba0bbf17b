"""A finished result folder's page, figures and data under the stable names that the documentation links to."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

__all__ = ["publish"]


def publish(result: Path, files: Mapping[str, str], target: Path) -> list[Path]:
    """Copy files of a result folder into ``target`` under other names; links between them in Markdown follow.

    Parameters
    ----------
    result : Path
        Folder of a finished run.
    files : mapping of file in it -> name below ``target``
        As of `Study.published`.
    target : Path
        Made if it is not there; files of these names are replaced.

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
