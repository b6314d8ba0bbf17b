"""Break-points with their intervals, a line per case."""

from collections.abc import Sequence

from ...evaluation.results.break_point import break_point_of
from ...evaluation.results.table import table
from ..paired import curves
from ..rows import Row

_LEAST_FRAMES = 36  # frames below which no Pd can be shown to be 0.9: 36 of 36 have a lower bound of 0.904


def break_points(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """Table of break-points of the cases that have three levels or more; too few frames give no break-point."""
    lines = []
    for (case, overlap), by in curves(rows).items():
        levels = {(row["sir_db"], row["snr_db"]) for curve in by.values() for row in curve}
        if len(levels) < 3:
            continue
        axis = "snr_db" if any(sir is None for sir, _ in levels) else "sir_db"
        cells = []
        for name in entries:
            found = by.get(name)
            if not found or found[0]["trials"] < _LEAST_FRAMES:
                cells.append("")
                continue
            at = break_point_of(found, axis)
            cells.append(f"{at} ({at.low_db:.1f} to {at.high_db:.1f})")
        if any(cells):
            lines.append([case, f"{overlap:g}", *cells])
    return table(["case", "overlap", *entries], lines) if lines else ""
