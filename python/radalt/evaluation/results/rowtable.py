"""Rows as a printable table with conversion to NumPy and pandas."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from .table import DASH, table

if TYPE_CHECKING:
    import pandas


class Table(Sequence[Mapping[str, Any]]):
    """Rows with equal columns; missing values (no noise, no detection) are None.

    ``shown``: printed columns; default all.

    Examples
    --------
    >>> print(Table([{"method": "none", "pd": 0.5}]))
    | method | pd |
    |---|---:|
    | none | 0.5 |
    """

    def __init__(self, rows: Sequence[Mapping[str, Any]], shown: Sequence[str] = ()) -> None:
        self._rows = tuple(rows)
        self.columns: tuple[str, ...] = tuple(self._rows[0]) if self._rows else ()
        self._shown = [name for name in shown if name in self.columns] or self.columns

    @overload
    def __getitem__(self, index: int) -> Mapping[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> "Table": ...
    def __getitem__(self, index: int | slice) -> "Mapping[str, Any] | Table":
        return self._rows[index] if isinstance(index, int) else Table(self._rows[index], self._shown)

    def __len__(self) -> int:
        return len(self._rows)

    def _lines(self) -> list[list[str]]:
        return [[_text(row.get(name)) for name in self._shown] for row in self._rows]

    def __str__(self) -> str:
        return table(self._shown, self._lines()) if self._rows else "no rows"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """HTML for notebooks."""
        head = "".join(f"<th>{escape(name)}</th>" for name in self._shown)
        lines = ["".join(f"<td>{escape(cell)}</td>" for cell in line) for line in self._lines()]
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"

    def to_numpy(self) -> np.ndarray:
        """(rows,) structured array: words as strings, whole numbers as int64, all else as float64 with NaN for None."""
        columns = {name: _column([row.get(name) for row in self._rows]) for name in self.columns}
        out = np.empty(len(self._rows), dtype=[(name, values.dtype) for name, values in columns.items()])
        for name, values in columns.items():
            out[name] = values
        return out

    def to_pandas(self) -> "pandas.DataFrame":
        """The table as a pandas ``DataFrame``; raises ImportError without pandas."""
        import pandas

        return pandas.DataFrame({name: self.to_numpy()[name] for name in self.columns})


def _text(value: Any) -> str:
    if value is None or value == "":
        return DASH
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _column(values: Sequence[Any]) -> np.ndarray:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    if values and all(isinstance(value, int) for value in values):
        return np.array(values, dtype=np.int64)
    return np.array(values, dtype=np.float64)  # None is NaN
