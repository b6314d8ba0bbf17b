"""Pd over the level with 95 % intervals, a panel per case and overlap; of many, at the largest overlap alone."""

from collections.abc import Sequence
from pathlib import Path

from ...evaluation.overlap.figures import draw_pd
from ..lists import CaseList
from ..paired import curves, level_db
from ..rows import Row

_PANELS = 15  # panels of a figure: the first ones; the table has all
_LINES = 8  # entries in a panel


def draw_curves(rows: Sequence[Row], entries: Sequence[str], path: Path, cases: CaseList) -> None:
    """The figure; nothing is written where no case has three levels. Without interference, the level is the SNR."""
    found = {at: by for at, by in curves(rows).items() if max(map(len, by.values())) >= 3}
    if len(found) > _PANELS:
        fullest = {case: max(overlap for name, overlap in found if name == case) for case, _ in found}
        found = {at: by for at, by in found.items() if at[1] == fullest[at[0]]}
    shown = list(found.values())[:_PANELS]
    names = [name for name in entries if any(name in by for by in shown)][:_LINES]
    every = [row for name in names for by in shown for row in by.get(name, ())]
    of = [row | {"method": row["entry"], "sir_db": level_db(row), "snr_db": None} for row in every]
    titled = {name: title for title, name in {c.title: c.name for c in cases.cases}.items()}  # one per title
    if of:
        drawn = [row | {"interference": titled.get(row["case"], row["case"])} for row in of]
        draw_pd(drawn, path, title=cases.title, against="sir_db")
