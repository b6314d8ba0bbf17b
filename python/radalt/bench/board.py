"""The board: an entry of one's own among the stored rows of the shipped methods."""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

from ..core.mitigation import METHODS
from ..core.parsing import InputError
from ..core.paths import share_dir
from ..evaluation.results.rows import unbits
from ..evaluation.results.score import pool
from ..evaluation.results.table import table
from .paired import curves, held, paired
from .rows import Row

_UNLIKE = 0.01  # largest share of frames that ``none`` may judge unlike the stored rows: last bits of other machines
_LIVE_FFTS = 40.0  # cost that keeps up with frames of 1 ms: method and altimeter, two cores, FFT of 40 us


def stored_rows(name: str) -> Path:
    """File of the stored rows of a shipped list. Raises InputError where there is none."""
    path = share_dir() / "bench" / "rows" / f"{name}.csv"
    if not path.is_file():
        raise InputError(
            f"list {name}: no stored rows of shipped methods; run some of them first, and name their rows.csv "
            "with --against"
        )
    return path


def check_rows(mine: Sequence[Row], stored: Sequence[Row]) -> tuple[int, int]:
    """(frames that ``none`` judges unlike the stored rows, frames compared).

    Raises `InputError` if the rows are of another list, another seed, or ``none`` is missing or differs in more than
    1 % of the frames.
    """
    digests = [{row["digest"] for row in rows} for rows in (mine, stored)]
    if digests[0] != digests[1] or len(digests[0]) != 1:
        raise InputError(
            f"rows of list {', '.join(sorted(digests[0]))} and of list {', '.join(sorted(digests[1]))} cannot be "
            "compared; run the list as it is, with its frames"
        )
    level = itemgetter("case", "overlap", "sir_db")
    theirs = {level(row): row for row in stored if row["entry"] == "none"}
    unlike = compared = 0
    for row in (row for row in mine if row["entry"] == "none"):
        other = theirs.get(level(row))
        if other is None:
            continue
        if other["seed"] != row["seed"] or other["trials"] != row["trials"]:
            raise InputError(
                f"{row['case']} at {row['sir_db']} dB: seed or frames differ from the stored row's"
            )
        count = row["trials"]
        unlike += int((unbits(row["right"], count) != unbits(other["right"], count)).sum())
        compared += count
    if not compared or unlike > _UNLIKE * compared:
        raise InputError(
            f"`none` differs from the stored rows in {unlike} of {compared} frames, at most 1 % may; "
            "use the version that made them, or run all methods anew"
        )
    return unlike, compared


def verdict(mine: Sequence[Row], stored: Sequence[Row], name: str) -> str:
    """Where an entry stands: one line, and a table of its paired differences.

    The best stored entry of a case is the one that holds most decibels there; both are given over the same frames.
    """
    ours, theirs = curves(row for row in mine if row["entry"] == name), curves(stored)
    lines, ahead, behind = [], 0, 0
    for where, by in ours.items():
        curve = by[name]
        if len(curve) < 2:
            raise InputError(
                f"{where[0]}: one level of {name} gives no decibels held; give the grid two or more"
            )
        shipped = {entry: held(rows) for entry, rows in theirs[where].items() if entry in METHODS}
        best = max(shipped, key=lambda entry: shipped[entry])
        gain, over_none = paired(curve, theirs[where][best]), paired(curve, theirs[where]["none"])
        ahead, behind = ahead + (gain[1] > 0), behind + (gain[2] < 0)
        cells = [f"{held(curve):.1f}", f"{best} {shipped[best]:.1f}", _interval(gain), _interval(over_none)]
        lines.append([f"{where[0]}, {where[1]:g}", *cells])
    rows = [row for by in ours.values() for row in by[name]]
    total, ffts = pool(rows), sorted(row["ffts"] for row in rows)[len(rows) // 2]
    live = "runs live" if ffts <= _LIVE_FFTS else "does not run live"
    head = (
        f"{name}: ahead of the best shipped method in {ahead} of {len(lines)} cases, level in "
        f"{len(lines) - ahead - behind}, behind in {behind}; wrong and valid {total.wrong} of {total.trials} "
        f"(95 %: at most {total.wrong_bound:.2g}); {ffts:.0f} FFTs per frame, {live}"
    )
    names = ["case, overlap", "held / dB", "best shipped", "over it / dB (95 %)", "over none / dB (95 %)"]
    return f"{head}\n\n{table(names, lines)}"


def _interval(gain: tuple[float, float, float]) -> str:
    return f"{gain[0]:+.1f} ({gain[1]:+.1f} to {gain[2]:+.1f})"
