"""Figure of the study of single frames: altitudes declared beside the textbook's, and false altitudes in noise."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...core.interference.evm import EMITTERS
from ...evaluation.results.figure import new_figure, save_figure

_OURS, _TEXTBOOK, _WRONG = "#0072B2", "#E69F00", "#D55E00"  # Okabe and Ito
_EMITTERS = f"{EMITTERS}, but for paper_qpsk, which is ideal"
_ALLOWED_M_PER_S = 20.0  # vertical speed allowed in the rows shown: the altimeter's default


def draw(
    rows: Sequence[dict[str, Any]], null: Sequence[dict[str, Any]], path: Path, emitters: str = _EMITTERS
) -> None:
    """Shares of frames by case, ours and the textbook's, above false altitudes per frame of noise by method."""
    rows = [r for r in rows if r["allowed_m_per_s"] == _ALLOWED_M_PER_S]
    noise = [r for r in null if r["scene"] == "none" and r["allowed_m_per_s"] == _ALLOWED_M_PER_S]
    figure = new_figure(4.6, 2.6 + 0.24 * len(rows))
    above, below = figure.subplots(2, height_ratios=[max(2, len(rows)), 3])
    for y, r in enumerate(rows):
        above.plot([r["declared"], r["textbook_declared"]], [y, y], color="0.7", lw=1, zorder=1)
    for key, colour, marker, label in (
        ("declared", _OURS, "o", "right"),
        ("textbook_declared", _TEXTBOOK, "s", "right, textbook"),
        ("wrong", _WRONG, "x", "wrong"),
    ):
        above.plot([r[key] for r in rows], range(len(rows)), marker, color=colour, ms=5, label=label)
    above.set_yticks(range(len(rows)), [case_name(r) for r in rows], fontsize=8)
    above.invert_yaxis()
    above.set(xlim=(-0.03, 1.03), xlabel="share of frames, with a return")
    for y, r in enumerate(noise):
        below.errorbar(
            r["rate"], y, xerr=[[r["rate"] - r["low"]], [r["high"] - r["rate"]]],
            fmt="o", color=_WRONG, ms=5, capsize=3,
        )  # fmt: skip
        below.axvline(r["bound"], color="0.4", ls="--", lw=0.9)
    below.set_yticks(range(len(noise)), [r["method"] for r in noise], fontsize=8)
    below.set_ylim(len(noise) - 0.4, -0.6)
    below.set_xlim(left=0.0)
    below.set_xlabel("false altitudes per frame, noise alone\n(dashed: design)")
    for axis in (above, below):
        axis.grid(axis="x", alpha=0.3)
    handles = above.get_legend_handles_labels()
    figure.legend(
        *handles,
        loc="outside upper center",
        ncols=3,
        fontsize=9,
        frameon=False,
        title=emitters,
        title_fontsize=9,
    )
    save_figure(figure, path)


def case_name(row: dict[str, Any]) -> str:
    """Method and interference of a row."""
    level = f"SNR {row['snr_db']:g}" if row["scene"] == "none" else f"{row['scene']} {row['sir_db']:g}"
    return f"{row['method']}, {level} dB"
