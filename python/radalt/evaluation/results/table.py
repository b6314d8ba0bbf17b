"""Markdown tables and their numbers, in one format for every report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeGuard

__all__ = ["DASH", "counted", "interval", "metres", "number", "signed_metres", "table"]

DASH = "\N{EN DASH}"


def table(header: Sequence[str] | str, rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table; the first column and columns of words are flush left, those of numbers flush right.

    ``header``: the columns' names, or one text with " | " between them.
    """
    header = header.split(" | ") if isinstance(header, str) else header
    cells = [[str(cell) for cell in row] for row in rows]
    sides = [_side(column) for column in zip(*cells, strict=True)] if cells else ["---:"] * len(header)
    lines = ["| " + " | ".join(line) + " |" for line in (header, *cells)]
    return "\n".join([lines[0], "|" + "|".join(["---", *sides[1:]]) + "|", *lines[1:]])


def _side(column: Sequence[str]) -> str:
    words = sum(1 if cell.lstrip("*`")[:1].isalpha() else -1 for cell in column if cell not in ("", DASH))
    return "---" if words > 0 or not any(column) else "---:"


def _exists(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def number(value: float | None, digits: int = 2) -> str:
    """Fixed digits, no minus before a zero; a dash for a missing number."""
    return f"{round(value, digits) + 0.0:.{digits}f}" if _exists(value) else DASH


def metres(value: float | None) -> str:
    """Three significant digits, whole metres from 1000 on, without the unit."""
    if not _exists(value):
        return DASH
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.0f}"


def signed_metres(value: float | None) -> str:
    """A bias with its sign, without the unit."""
    return f"{value:+.2f}" if _exists(value) else DASH


def counted(count: int, noun: str) -> str:
    """A number and its noun: ``1 frame``, ``2 frames``."""
    return f"{count} {noun}{'s' * (count != 1)}"


def interval(value: float | None, low: float | None, high: float | None) -> str:
    """A proportion with its 95 % interval: ``0.940 (0.90-0.97)``."""
    if not _exists(value):
        return DASH
    return f"{value:.3f} ({low:.2f}{DASH}{high:.2f})"
