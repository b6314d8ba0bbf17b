"""Paired comparison of two entries on the same frames."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..evaluation.results.rows import unbits
from .rows import Row

_DRAWS = 1000  # resamplings of the frames, for an interval of 95 %

Curves = dict[tuple[str, float], dict[str, list[Row]]]


def level_db(row: Row) -> float:
    """Level of a row on the axis of its case: the SIR, or the SNR where nothing interferes."""
    level: float = row["snr_db"] if row["sir_db"] is None else row["sir_db"]
    return level


def curves(rows: Iterable[Row]) -> Curves:
    """Rows by (case, overlap) and entry, highest level first; levels that were not run, and clean cases, are absent."""
    out: Curves = {}
    for row in sorted(rows, key=lambda r: -level_db(r)):
        out.setdefault((row["case"], row["overlap"]), {}).setdefault(row["entry"], []).append(row)
    clean = [
        where
        for where, by in out.items()
        if all(len(curve) == 1 and curve[0]["sir_db"] is None for curve in by.values())
    ]
    return {where: by for where, by in out.items() if where not in clean}


def held(curve: Sequence[Row]) -> float:
    """`held_db` of a curve over its own frames."""
    return float(held_db(curve, np.arange(curve[0]["trials"])[None])[0])


def held_db(curve: Sequence[Row], draws: np.ndarray) -> np.ndarray:
    """(n,) decibels held: the sum over levels of Pd times the step from the one above, for (n, trials) drawn frames.

    A level that was not run counts as 0, the first one has the second one's step. Unlike a break-point, a running
    minimum, it has no bias where Pd stays just above its limit.
    """
    levels = [level_db(row) for row in curve]
    steps = np.diff([2 * levels[0] - levels[1], *levels]) if len(levels) > 1 else [0.0]
    total = np.zeros(len(draws))
    for row, step in zip(curve, steps, strict=True):
        right = unbits(row["right"], row["trials"])
        total += abs(step) * right[np.minimum(draws, row["trials"] - 1)].mean(axis=1)
    return total


def paired(ours: Sequence[Row], theirs: Sequence[Row], seed: int = 0) -> tuple[float, float, float]:
    """`held_db` of ours less theirs on the same frames, with its 95 % interval over resampled frames.

    Raises ValueError unless both curves begin at the same two levels.
    """
    levels = [[level_db(row) for row in curve[:2]] for curve in (ours, theirs)]
    if levels[0] != levels[1] or len(levels[0]) < 2:
        raise ValueError(
            f"levels {levels[0]} and {levels[1]} dB cannot be paired; run both on one grid of two or more"
        )
    count = ours[0]["trials"]
    drawn = np.random.default_rng(seed).integers(0, count, (_DRAWS, count))
    draws = np.concatenate([np.arange(count)[None], drawn])
    gain = held_db(ours, draws) - held_db(theirs, draws)
    low, high = np.percentile(gain[1:], [2.5, 97.5])
    return float(gain[0]), float(low), float(high)
