"""Frames without a return: every declared altitude is false."""

from collections.abc import Mapping, Sequence

from ...evaluation.results.proportion import clopper_pearson
from ...evaluation.results.rows import grouped
from ...evaluation.results.table import table
from ..rows import Row


def false_altitudes(rows: Sequence[Row], bounds: Mapping[str, float]) -> str:
    """A line per entry: false altitudes, their rate's 95 % interval, the most at one level, and the design's bound.

    ``bounds`` are the false altitudes per frame of white noise that an entry's altimeter has by design, at most.
    """
    lines = []
    for name, mine in grouped(rows, "entry").items():
        false, trials = (sum(row[key] for row in mine) for key in ("detections", "trials"))
        low, high = clopper_pearson(false, trials)
        most = max(mine, key=lambda row: row["detections"] / row["trials"])
        inr = "" if most["sir_db"] is None else f", INR {most['snr_db'] - most['sir_db']:g} dB"
        worst = ""
        if false:
            worst = f"{most['detections']} of {most['trials']} ({most['case']}, {most['overlap']:g}{inr})"
        lines.append([name, f"{false} of {trials}", f"{low:.2g} to {high:.2g}", worst, f"{bounds[name]:.3g}"])
    head = ["entry", "false altitudes", "rate, 95 %", "most at one level", "white noise, by design at most"]
    return table(head, lines)
