"""Rows of a landing study on disk: appended as they are measured, complete points survive a killed run."""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .points import COLUMNS

__all__ = ["RowFile", "read_rows"]

TEXT = ("point", "kind", "method", "variant")
WHOLE = ("rows", "valid", "reason", "trials", "detections", "correct", "forced_trials", "diverged_frames")


def _format(column: str, value: Any) -> str:
    if value is None:
        return ""
    if column in TEXT or column in WHOLE:
        return str(value)
    return f"{float(value):.9g}"


def _parse(column: str, text: str) -> Any:
    if column in TEXT:
        return text
    if text == "":
        return None
    return int(text) if column in WHOLE else float(text)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of every complete point in a file; a missing file has none. A torn last line is left out."""
    if not path.is_file():
        return []
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        text = file.read()
    # the last line counts only with its end: a cut inside a number leaves a shorter, valid number
    for raw in csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1], newline="")):
        if None in raw or any(raw.get(c) is None for c in COLUMNS):
            continue
        rows.append({c: _parse(c, raw[c]) for c in COLUMNS})
    have = Counter(row["point"] for row in rows)
    return [row for row in rows if have[row["point"]] == row["rows"]]


class RowFile:
    """``rows.csv`` of a run.

    Parameters
    ----------
    path : Path
        The file; what it holds of complete points is kept, the rest is cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = read_rows(path)
        self._rewrite()

    @property
    def points(self) -> set[str]:
        """Names of the points that are there."""
        return {row["point"] for row in self.rows}

    def append(self, rows: Sequence[dict[str, Any]]) -> None:
        """Add a point's rows and push them to the disk."""
        text = self._text(rows)
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        # read back what was written, so that a fresh and a resumed run report from the same digits
        self.rows += [{c: _parse(c, _format(c, row.get(c))) for c in COLUMNS} for row in rows]

    def sort(self, order: Sequence[str]) -> None:
        """Put the rows in the order of their points, whatever order they were measured in."""
        rank = {name: k for k, name in enumerate(order)}
        self.rows.sort(key=lambda row: rank.get(row["point"], len(rank)))
        self._rewrite()

    def _text(self, rows: Sequence[dict[str, Any]], header: bool = False) -> str:
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        if header:
            writer.writerow(COLUMNS)
        writer.writerows([_format(c, row.get(c)) for c in COLUMNS] for row in rows)
        return out.getvalue()

    def _rewrite(self) -> None:
        fresh = self.path.with_suffix(".tmp")
        fresh.write_text(self._text(self.rows, header=True), encoding="utf-8")
        fresh.replace(self.path)
