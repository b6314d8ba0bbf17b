"""Copies page, figures and data of a result folder to the stable names that the documentation links to."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from ..results.folder import FolderError


def check_target(target: Path) -> None:
    """Raise FolderError, one line, if `publish` cannot write into a folder or create it.

    It is called before the run, since the page is copied after hours of measurement.
    """
    there = next(p for p in (target, *target.absolute().parents) if p.exists())
    if not there.is_dir():
        raise FolderError(f"--publish {target}: {there} is no folder; name another")
    if not os.access(there, os.W_OK | os.X_OK):
        raise FolderError(f"--publish {target}: {there} may not be written; name another folder")


def publish(result: Path, files: Mapping[str, str], target: Path) -> list[Path]:
    """Copy files of a finished run into ``target``, by `Study.published`; links between them follow in Markdown.

    A table without rows has no file. Files of these names are replaced.
    """
    out = []
    for source, name in files.items():
        if source.endswith(".csv") and not (result / source).exists():
            continue
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(result / source, path)
        if path.suffix == ".md":
            text = path.read_text(encoding="utf-8")
            for other, its_name in files.items():
                text = text.replace(f"]({other})", f"]({os.path.relpath(its_name, Path(name).parent)})")
            path.write_text(text, encoding="utf-8")
        out.append(path)
    return out
