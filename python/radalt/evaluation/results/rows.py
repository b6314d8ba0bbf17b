"""Rows of a table: which columns it has, and how a value is written and read back."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Columns"]


@dataclass(frozen=True)
class Columns:
    """Columns of one table in their order; those neither text nor whole numbers are floats with nine digits.

    Attributes
    ----------
    names : tuple of str
    text, whole : frozenset of str
        Columns that hold words, and those that hold whole numbers.
    timing : frozenset of str
        Columns that differ from run to run; all others are a function of study, point and seed.
    """

    names: tuple[str, ...]
    text: frozenset[str] = frozenset()
    whole: frozenset[str] = frozenset()
    timing: frozenset[str] = frozenset()

    def row(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """A row as it is kept: these columns, None for what does not exist (missing, NaN, infinite), floats rounded.

        So a row that was just measured and one that was read back are the same digits.
        """
        return {name: self._value(name, values.get(name)) for name in self.names}

    def _value(self, name: str, value: Any) -> Any:
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return "" if name in self.text else None
        if name in self.text:
            return str(value)
        if name in self.whole:
            return int(value)
        return float(f"{float(value):.9g}")

    def csv(self, rows: Iterable[Mapping[str, Any]], *, header: bool = True) -> str:
        """Comma-separated text; what does not exist is an empty field."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        if header:
            writer.writerow(self.names)
        writer.writerows([self._text(name, row.get(name)) for name in self.names] for row in rows)
        return out.getvalue()

    def _text(self, name: str, value: Any) -> str:
        if value is None:
            return ""
        return str(value) if name in self.text or name in self.whole else f"{float(value):.9g}"

    def subset(self, names: Sequence[str]) -> Columns:
        """The same columns, only these and in this order."""
        return Columns(tuple(names), self.text, self.whole, self.timing)
