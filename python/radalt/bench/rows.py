"""Rows of the bench: one per case, overlap, level and entry, with a bit per frame for paired comparisons."""

from pathlib import Path
from typing import Any

import numpy as np

from ..evaluation.results.rows import Columns, bits
from ..evaluation.results.score import SCORE_COLUMNS, score_frames
from .entry import Entry, Outcome
from .frames import Frames
from .lists import Case

WHERE = ("list", "digest", "case", "overlap", "sir_db", "snr_db", "entry")
COLUMNS = Columns(
    (*WHERE, *SCORE_COLUMNS, "limit_m", "right", "declared", "diverged", "seed", "ms", "ffts"),
    text=frozenset({"list", "digest", "case", "entry", "right", "declared"}),
    whole=frozenset(
        {"trials", "detections", "correct", "forced", "frames_lost", "wrong_far", "diverged", "seed"}
    ),
    timing=frozenset({"ms", "ffts"}),
)
Row = dict[str, Any]


def row_of(names: tuple[str, str], case: Case, entry: Entry, frames: Frames, out: Outcome) -> Row:
    """The row of an entry at a level; ``names`` are the list's name and digest.

    ``sir_db`` is empty without interference; without a return, levels are those of one of unit power.
    """
    results = out.results
    right = results["valid"] & (np.abs(results["altitude_m"] - frames.truth_m) < case.limit_m)
    found = score_frames(results, frames.truth_m, lost=frames.lost, limit_m=case.limit_m)
    scene = frames.scene
    sir_db = scene.sir_db if scene.interference else None
    level = (case.name, case.overlap, sir_db, scene.channel.snr_db, entry.name)
    where = dict(zip(WHERE, (*names, *level), strict=True))
    return COLUMNS.row(
        where
        | found.row()
        | {
            "limit_m": case.limit_m,
            "right": bits(right),
            "declared": bits(results["valid"]),
            "diverged": out.diverged,
            "seed": frames.scene.seed,
            "ms": out.ms,
            "ffts": out.ffts,
        }
    )


def read_rows(path: Path, columns: Columns = COLUMNS) -> list[Row]:
    """`Columns.read` of rows that `radalt bench LIST` wrote."""
    return columns.read(path, "radalt bench LIST")
