"""Rows of a table: columns, and conversion of values to and from text."""

import csv
import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ...core.parsing import InputError, read_text

_MOST_BYTES = 256 << 20  # largest file of rows: 400,000 of the widest
# Columns of words and of whole numbers, in every table: a name is the same quantity in all (docs/columns.md).
TEXT = frozenset(
    "assumption built case cause chain check declared digest entry events failed first ground group interference "
    "interferer kind list mechanisms method modules precision profile reasons replay right scene source stanford unit "
    "verdict".split()
)
WHOLE = frozenset(
    "FAIL WRONG batch computed correct detections discontinuities diverged diverged_frames failures finite "
    "flagged followed forced frame_index frames frames_lost hazardous hazardous_events interruptions known_limit "
    "levels lock_losses memory_bytes misleading misleading_events model_bytes near outputs parts pass reason "
    "recovered refused rows runs seed silenced trials turn unalerted unbounded valid wrong wrong_20m wrong_5m "
    "wrong_accuracy wrong_far wrong_frames".split()
)


def bits(which: np.ndarray) -> str:
    """(n,) bool as hexadecimal digits."""
    return np.packbits(which).tobytes().hex()


def unbits(text: str, count: int) -> np.ndarray:
    """(count,) bool of hexadecimal digits."""
    return np.unpackbits(np.frombuffer(bytes.fromhex(text), np.uint8), count=count).astype(bool)


def grouped(rows: Iterable[Any], *names: str) -> dict[Any, list[Any]]:
    """Rows by the value of a column, or by the values of several, in the order of the first of each."""
    found: dict[Any, list[Any]] = {}
    for row in rows:
        found.setdefault(itemgetter(*names)(row), []).append(row)
    return found


@dataclass(frozen=True)
class Columns:
    """Columns of one table in order; columns that are neither text nor whole numbers are floats of nine digits."""

    names: tuple[str, ...]
    text: frozenset[str] = TEXT
    whole: frozenset[str] = WHOLE
    # columns that differ from run to run; all others are a function of study, point and seed
    timing: frozenset[str] = frozenset()

    def row(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """A row with these columns, None for missing, NaN and infinite values, floats rounded.

        A measured row and a row from a file therefore have equal digits.
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
        """Comma-separated text; missing values are empty fields."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerows([self.names] if header else [])
        writer.writerows([self._text(name, row.get(name)) for name in self.names] for row in rows)
        return out.getvalue()

    def read(self, path: Path, command: str) -> list[dict[str, Any]]:
        """Rows of a CSV file that a command wrote. Raises InputError, one line, where it has other columns."""
        text = read_text(path, most_bytes=_MOST_BYTES, what="rows", remedy=f"make them with {command}")
        reader = csv.DictReader(io.StringIO(text, newline=""))
        try:
            if tuple(reader.fieldnames or ()) == self.names:
                return [self.row({k: v or None for k, v in row.items()}) for row in reader]
        except (ValueError, csv.Error) as error:
            raise InputError(f"{path}: not readable as rows ({error}); make them with {command}") from None
        raise InputError(f"{path}: other columns than those of its rows; make them with {command}")

    def _text(self, name: str, value: Any) -> str:
        if value is None:
            return ""
        return str(value) if name in self.text or name in self.whole else f"{float(value):.9g}"
