"""Paired comparison of two entries on the same frames."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..evaluation.results.rows import unbits
from .rows import Row

_DRAWS = 1000  # resamplings of the frames, for an interval of 95 %

Curves = dict[tuple[str, float], dict[str, list[Row]]]


def curves(rows: Iterable[Row]) -> Curves:
    """Rows by (case, overlap) and entry, highest SIR first; levels that were not run are absent."""
    out: Curves = {}
    for row in sorted((r for r in rows if r["sir_db"] is not None), key=lambda r: -r["sir_db"]):
        out.setdefault((row["case"], row["overlap"]), {}).setdefault(row["entry"], []).append(row)
    return out


def held_db(curve: Sequence[Row], draws: np.ndarray, step_db: float) -> np.ndarray:
    """(n,) decibels held: the sum over levels of Pd times the step, for (n, trials) resampled frames.

    A level that was not run counts as 0. Unlike a break-point, a running minimum, it has no bias where Pd stays just
    above its limit.
    """
    total = np.zeros(len(draws))
    for row in curve:
        total += unbits(row["right"], row["trials"])[np.minimum(draws, row["trials"] - 1)].mean(axis=1)
    return step_db * total


def paired(ours: Sequence[Row], theirs: Sequence[Row], seed: int = 0) -> tuple[float, float, float]:
    """`held_db` of ours less theirs on the same frames, with its 95 % interval over resampled frames.

    Raises ValueError unless both curves begin at the same two levels.
    """
    levels = [[row["sir_db"] for row in curve[:2]] for curve in (ours, theirs)]
    if levels[0] != levels[1] or len(levels[0]) < 2:
        raise ValueError(
            f"levels {levels[0]} and {levels[1]} dB cannot be paired; run both on one grid of two or more"
        )
    count, step_db = ours[0]["trials"], levels[0][0] - levels[0][1]
    drawn = np.random.default_rng(seed).integers(0, count, (_DRAWS, count))
    draws = np.concatenate([np.arange(count)[None], drawn])
    gain = held_db(ours, draws, step_db) - held_db(theirs, draws, step_db)
    low, high = np.percentile(gain[1:], [2.5, 97.5])
    return float(gain[0]), float(low), float(high)
