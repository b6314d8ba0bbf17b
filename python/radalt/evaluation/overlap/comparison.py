"""Comparison of two runs: settings, versions, and significant differences of results.

Every method and point of both runs has two tests: of Pd, and of the rate of altitudes declared and wrong, each by
Fisher's exact test (two-sided) on the counts. The p-values are corrected by Holm's method over all tests: without any
true difference, at most 5 % of comparisons report one. Runs with equal seeds share their random numbers, which makes
the test conservative: it may miss a difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..results.folder import flatten
from ..results.proportion import wilson_interval
from ..results.table import DASH, table
from .pooling import PoolError, Run, read_run
from .rows import COLUMNS

__all__ = ["Comparison", "compare", "comparisons", "holm"]

LEVEL = 0.05  # family-wise error rate of all comparisons
_KEY = ("method", "interference", "overlap", "sir_db", "snr_db")
_MOST_SETTINGS = 60  # most lines in the table of settings


@dataclass(frozen=True)
class Comparison:
    """Comparison of one method at one point in one measure.

    Attributes
    ----------
    key : tuple
        Method, interference, overlap, SIR and SNR in dB.
    measure : str
        ``"Pd"`` or ``"wrong"``.
    first, second : (int, int)
        Events and trials of each run.
    p : float
        Two-sided p-value of Fisher's exact test.
    corrected : float
        p-value after Holm's correction over all comparisons.
    """

    key: tuple[Any, ...]
    measure: str
    first: tuple[int, int]
    second: tuple[int, int]
    p: float
    corrected: float = 1.0

    @property
    def difference(self) -> tuple[float, float, float]:
        """Rate of the second run less the first's, and its 95 % interval (Newcombe's hybrid score interval)."""
        (a, n), (b, m) = self.first, self.second
        (low_a, high_a), (low_b, high_b) = wilson_interval(a, n), wilson_interval(b, m)
        one, other = a / n, b / m
        down = np.hypot(other - low_b, high_a - one)
        up = np.hypot(high_b - other, one - low_a)
        return other - one, other - one - down, other - one + up


def holm(p: Sequence[float]) -> list[float]:
    """p-values with Holm's correction for multiple tests, in the order given.

    S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Stat. 6, 1979.

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    order = np.argsort(p)
    steps = np.asarray(p, dtype=float)[order] * np.arange(len(p), 0, -1)
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return out.tolist()


def comparisons(a: Run, b: Run) -> list[Comparison]:
    """Comparisons in both measures of every method and point of both runs, in the order of the first.

    Raises
    ------
    PoolError
        If they have none in common; one line.
    """
    from scipy.stats import fisher_exact

    found = []
    for one, other in _pairs(a, b):
        for measure, events in (("Pd", _correct), ("wrong", _wrong)):
            first, second = (events(one), one["trials"]), (events(other), other["trials"])
            counts = [[k, n - k] for k, n in (first, second)]
            key = tuple(one[k] for k in _KEY)
            found.append(Comparison(key, measure, first, second, float(fisher_exact(counts)[1])))
    if not found:
        raise PoolError(
            f"{a.folder} and {b.folder} have no method and point in common; compare runs of one sweep"
        )
    corrected = holm([c.p for c in found])
    return [
        Comparison(c.key, c.measure, c.first, c.second, c.p, p) for c, p in zip(found, corrected, strict=True)
    ]


def _correct(row: dict[str, Any]) -> int:
    return row["correct"]


def _wrong(row: dict[str, Any]) -> int:
    return row["detections"] - row["correct"]


def _by_key(run: Run) -> dict[tuple, dict[str, Any]]:
    return {tuple(row[k] for k in _KEY): row for row in run.report["rows"] if row["trials"]}


def _pairs(a: Run, b: Run) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    others = _by_key(b)
    for key, row in _by_key(a).items():
        if key in others:
            yield row, others[key]


def compare(first: str | Path, second: str | Path) -> str:
    """Differences between two result folders of ota_eval, as Markdown.

    Raises
    ------
    FolderError, PoolError
        One line.
    """
    a, b = read_run(first), read_run(second)
    found = comparisons(a, b)
    parts = [
        f"# {a.folder} and {b.folder}",
        "## Settings and versions",
        _settings(a, b),
        "## Results",
        _verdict(a, b, found),
    ]
    beyond = [c for c in found if c.corrected <= LEVEL]
    if beyond:
        parts.append(_table(beyond))
    return "\n\n".join(parts)


def _settings(a: Run, b: Run) -> str:
    left, right = (
        flatten({k: r.report[k] for k in ("source", "seed", "scene", "methods", "versions")}) for r in (a, b)
    )
    differing = [
        [key, *(DASH if side.get(key) is None else str(side[key]) for side in (left, right))]
        for key in dict.fromkeys([*left, *right])
        if left.get(key) != right.get(key)
    ]
    if not differing:
        return "None differs."
    text = table(["setting", a.folder, b.folder], differing[:_MOST_SETTINGS])
    more = len(differing) - _MOST_SETTINGS
    return text + (f"\n\n{more} more differ; scene.yaml of both folders has them." if more > 0 else "")


def _verdict(a: Run, b: Run, found: Sequence[Comparison]) -> str:
    pairs = list(_pairs(a, b))
    own = [n for n in COLUMNS.names if n not in COLUMNS.timing and n != "seed"]
    same = sum(all(x[n] == y[n] for n in own) for x, y in pairs)
    text = f"{len(pairs)} rows in both, {same} of them with the same digits."
    only = [len(_by_key(r)) - len(pairs) for r in (a, b)]
    if any(only):
        text += f" {only[0]} rows are in {a.folder} alone, {only[1]} in {b.folder} alone."
    if a.report["seed"] == b.report["seed"] and a.report["source"] == b.report["source"] == "simulated":
        text += (
            " Both have the same seed, so much of chance is common to them and the test is conservative;"
            " with another --seed they would be independent."
        )
    beyond = [c for c in found if c.corrected <= LEVEL]
    by_chance = sum(c.p <= LEVEL for c in found)
    text += (
        f"\n\n{len(found)} comparisons by Fisher's exact test, two-sided (Pd, and altitudes declared and wrong),"
        f" corrected by Holm's method: **{len(beyond)} differ beyond chance** (corrected p at most {LEVEL:g})."
        f" Uncorrected, {by_chance} have p at most {LEVEL:g}; chance alone gives up to {LEVEL * len(found):.0f}."
    )
    return text


def _table(found: Sequence[Comparison]) -> str:
    lines = []
    for c in found:
        method, interference, overlap, sir_db, snr_db = c.key
        far, low, high = c.difference
        lines.append(
            [
                method,
                interference,
                f"{overlap:g}",
                *(DASH if v is None else f"{v:g}" for v in (sir_db, snr_db)),
                c.measure,
                *(f"{k} of {n}" for k, n in (c.first, c.second)),
                f"{far:+.3f} ({low:+.3f} to {high:+.3f})",
                f"{c.corrected:.2g}",
            ]
        )
    header = ["method", "interference", "overlap", "SIR / dB", "SNR / dB", "measure", "first", "second"]
    return table([*header, "difference (95 % interval)", "corrected p"], lines)
