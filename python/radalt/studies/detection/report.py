"""Page of the study of single frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...evaluation.engine.study import Run
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.proportion import mcnemar
from ...evaluation.results.table import number, table
from .figure import case_name, draw
from .study import DetectionStudy


def write_report(
    folder: RunFolder, study: DetectionStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write the figure, ``report.md`` and ``report.json``; returns the page."""
    draw(rows["rows"], rows["null"], folder.path / "figures" / "detection.png")
    tables = {"return_table": return_table(rows["rows"]), "null_table": null_table(rows["null"])}
    noise = [row for row in rows["null"] if row["scene"] == "none"]
    tables["noise_worst"] = max(noise, key=lambda row: row["rate"], default=None)
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), rows, tables)


def return_table(rows: Sequence[dict[str, Any]]) -> str:
    """Pd declared and forced, RMSE, wrong and valid, ours and the textbook's, and frames that only one has right."""
    found = ("declared / forced", "RMSE, m", "wrong")
    header = ["method, interference", "allowed, m/s", *found, *(f"textbook: {word}" for word in found)]
    header += ["declared by one alone", "forced by one alone"]
    return table(header, [_line(row) for row in rows])


def _line(row: dict[str, Any]) -> list[str]:
    cells = []
    for whose in ("", "textbook_"):
        cells.append(f"{number(row[whose + 'declared'], 3)} / {number(row[whose + 'forced'], 3)}")
        cells += [number(row[whose + "rmse_m"]), number(row[whose + "wrong"], 3)]
    for name in ("declared_alone", "forced_alone"):
        ours, theirs = row[name], row["textbook_" + name]
        chance = mcnemar(ours, theirs)
        cells.append(f"{ours} : {theirs}, p {'< 0.01' if chance < 0.01 else number(chance)}")
    return [case_name(row), f"{row['allowed_m_per_s']:g}", *cells]


def null_table(rows: Sequence[dict[str, Any]]) -> str:
    """False altitudes per frame by method and allowed speed: in noise, in all interference, in its worst case."""
    header = [
        "method", "allowed, m/s", "noise alone", "interference alone, all cases", "worst case", "its rate", "bound",
    ]  # fmt: skip
    lines = []
    for method, speed in dict.fromkeys((r["method"], r["allowed_m_per_s"]) for r in rows):
        mine = [r for r in rows if (r["method"], r["allowed_m_per_s"]) == (method, speed)]
        noise = [r for r in mine if r["scene"] == "none"]
        jammed = [r for r in mine if r["scene"] != "none"]
        worst = max(jammed, key=lambda r: r["rate"], default=None)
        total = sum(r["frames"] for r in jammed)
        lines.append(
            [
                method,
                f"{speed:g}",
                number(noise[0]["rate"], 4) if noise else number(None),
                number(sum(r["false"] for r in jammed) / total, 4) if jammed else number(None),
                f"{worst['scene']}, INR {worst['inr_db']:g} dB, overlap {worst['overlap']:g}"
                if worst
                else "",
                f"{worst['rate']:.4f} ({worst['low']:.4f}..{worst['high']:.4f})" if worst else "",
                number(mine[0]["bound"], 4),
            ]
        )
    return table(header, lines)
