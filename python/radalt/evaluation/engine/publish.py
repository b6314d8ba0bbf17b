"""Copies page, figures and data of a result folder to the stable names that the documentation links to."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path


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
