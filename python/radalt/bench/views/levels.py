"""Pd, wrong and valid altitudes and errors at every level, for lists of a few."""

from collections.abc import Sequence

from ...evaluation.results.table import metres, number, table
from ..rows import Row

_MOST = 40  # lines up to which a table is of use


def levels(rows: Sequence[Row], entries: Sequence[str]) -> str:
    """A line per case and level: Pd / wrong and valid, per cent / RMSE of forced decisions; "" for too many lines."""
    places: dict[tuple[str, float, float | None, float | None], dict[str, Row]] = {}
    for row in rows:
        place = row["case"], row["overlap"], row["sir_db"], row["snr_db"]
        places.setdefault(place, {})[row["entry"]] = row
    if not 0 < len(places) <= _MOST:
        return ""
    lines = []
    for (case, overlap, sir_db, snr_db), by in places.items():
        where = [case, f"{overlap:g}", number(sir_db, 1), number(snr_db, 1)]
        lines.append([*where, *(_cell(by.get(name)) for name in entries)])
    return table(["case", "overlap", "SIR / dB", "SNR / dB", *entries], lines)


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    wrong = 100 * (row["detections"] - row["correct"]) / row["trials"]
    return f"{row['pd']:.2f} / {wrong:.1f} / {metres(row['rmse_forced_m'])}"
