"""Rows of the bench: one per case, overlap, level and entry, with a bit per frame for paired comparisons."""

import itertools
from pathlib import Path
from string import hexdigits
from typing import Any

from ..core.parsing import InputError
from ..evaluation.results.rows import Columns
from ..evaluation.results.score import BITS, SCORE_COLUMNS, frame_columns
from .entry import Entry, Outcome
from .frames import Frames
from .lists import Case

WHERE = ("list", "digest", "case", "overlap", "sir_db", "snr_db", "entry")
COLUMNS = Columns(
    (*WHERE, *SCORE_COLUMNS, "limit_m", *BITS, "diverged", "seed", "ms", "ffts"),
    timing=frozenset({"ms", "ffts"}),
)
Row = dict[str, Any]


def row_of(names: tuple[str, str], case: Case, entry: Entry, frames: Frames, out: Outcome) -> Row:
    """The row of an entry at a level; ``names`` are the list's name and digest.

    ``sir_db`` is empty without interference; without a return, levels are those of one of unit power.
    """
    scene, limit_m = frames.scene, case.limit_m
    sir_db = scene.sir_db if scene.interference else None
    level = (case.name, case.overlap, sir_db, scene.channel.snr_db, entry.name)
    where = dict(zip(WHERE, (*names, *level), strict=True))
    found = frame_columns(out.results, frames.truth_m, lost=frames.lost, limit_m=limit_m)
    facts = {"limit_m": limit_m, "diverged": out.diverged, "seed": scene.seed, "ms": out.ms, "ffts": out.ffts}
    return COLUMNS.row(where | found | facts)


def read_rows(path: Path, columns: Columns = COLUMNS) -> list[Row]:
    """`Columns.read` of rows that `radalt bench LIST` wrote, with a bit per trial."""
    rows = columns.read(path, "radalt bench LIST")
    for row, name in itertools.product(rows, BITS if set(BITS) <= set(columns.names) else ()):
        if len(row[name]) != -(-(row["trials"] or 0) // 8) * 2 or not set(row[name]) <= set(hexdigits):
            raise InputError(f"{path}: {name} is not a bit per trial; make the rows with radalt bench LIST")
    return rows
