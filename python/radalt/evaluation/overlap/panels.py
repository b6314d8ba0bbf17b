"""Panels of tables and figures: rows that differ in the horizontal axis and the series alone."""

from collections.abc import Iterable, Sequence
from typing import Any

from ..results.rows import grouped
from ..results.table import DASH

Row = dict[str, Any]


def panels(rows: Sequence[Row], against: str = "overlap") -> list[tuple[str, list[Row]]]:
    """Rows grouped by all values but the horizontal axis, with titles of what differs between panels.

    ``against`` is ``"overlap"`` or ``"sir_db"``; for the latter rows without interference are left out.
    """
    drawn = (r for r in rows if against == "overlap" or (r["overlap"] > 0 and r["sir_db"] is not None))
    found = grouped(drawn, "interference", "sir_db" if against == "overlap" else "overlap", "snr_db")
    many = [len({key[k] for key in found}) > 1 for k in range(3)]
    out = []
    for (interference, middle, snr), mine in found.items():
        name = "no interference" if interference == "none" else interference.replace("_", " ")
        parts = [name] if many[0] or middle is None else []
        if middle is not None:
            parts += [f"SIR {_minus(middle)} dB" if against == "overlap" else f"overlap {middle:g}"]
        parts += [f"SNR {_minus(snr)} dB" if snr is not None else "no noise"] if many[2] else []
        out.append((", ".join(parts), mine))
    return out


def _minus(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def series_of(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Rows by series: a key ``series`` overrides ``method``."""
    return grouped(({"series": row["method"]} | row for row in rows), "series")


def swept_axes(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """(column, word in file names) of the horizontal axes of rows with trials: overlap, and SIR from three SIRs on.

    An axis with a single value is left out if the other one has several; the swept one comes first.
    """
    overlaps, sirs = {r["overlap"] for r in rows}, {r["sir_db"] for r in rows if r["overlap"] > 0} - {None}
    by_overlap, by_sir = ("overlap", "overlap"), ("sir_db", "sir")
    if len(overlaps) < 2 and len(sirs) > 1:
        return [by_sir]
    if len(sirs) < 3:
        return [by_overlap]
    return [by_sir, by_overlap] if len(overlaps - {0.0}) < 2 else [by_overlap, by_sir]


def with_interference(rows: Sequence[Row]) -> list[Row]:
    """Rows at overlaps above 0, or all where there are none."""
    return [row for row in rows if row["overlap"] > 0] or list(rows)


def common(rows: Sequence[Row]) -> list[Row]:
    """Rows with trials above overlap 0, of the points that every series has; of all points where none is common."""
    rows = [row for row in with_interference(rows) if row["trials"]]
    names = ("interference", "overlap", "sir_db", "snr_db")
    by_series = [{tuple(row[name] for name in names) for row in mine} for mine in series_of(rows).values()]
    shared = set.intersection(*by_series)
    return [row for row in rows if tuple(row[name] for name in names) in shared] or rows


def spread(rows: Iterable[Row]) -> str:
    """Number of trials of the rows: one number, or the smallest and the largest."""
    trials = sorted({row["trials"] for row in rows})
    return f"{trials[0]}" if len(trials) == 1 else f"{trials[0]}{DASH}{trials[-1]}"
