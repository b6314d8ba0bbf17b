"""What the rows of a run say: report.json, report.md and the figures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.receiver.cramer_rao import altitude_crb_m
from ...core.scene import Scene
from ..results.folder import ResultFolder
from .figures import draw_error, draw_pd
from .markdown import report_markdown

__all__ = ["BREAK_PD", "break_points", "build_report", "crb_by_snr", "interference_title", "write_report"]

_NAMES = {"overlap": "temporal overlap", "sir_db": "SIR"}
BREAK_PD = 0.9  # DESIGN.md 4: lowest SIR at which Pd is at least this


def write_report(
    folder: ResultFolder,
    rows: Sequence[dict[str, Any]],
    ceiling: Sequence[dict[str, Any]],
    *,
    run: dict[str, Any],
) -> Path:
    """Write the whole result folder from its rows; returns the path of ``report.md``.

    Parameters
    ----------
    folder : ResultFolder
    rows : sequence of dict
        All rows, in canonical order.
    ceiling : sequence of dict
        Rows without interference, one a method and SNR (more are ignored).
    run : dict
        How the run went: ``jobs, points, points_resumed, wall_s, peak_memory_bytes``.
    """
    report = build_report(folder.head, folder.scene, rows, ceiling, run)
    figures = _draw(report, folder.path)
    report["figures"] = [name for name, _ in figures]
    text = report_markdown(report, figures)
    (folder.path / "report.md").write_text(text, encoding="utf-8")
    # last: a complete report.json says that everything else is there
    folder.write(report)
    return folder.path / "report.md"


def _draw(report: dict[str, Any], path: Path) -> list[tuple[str, str]]:
    """Draw against overlap, and against SIR where there are at least three; returns (file, caption)."""
    rows, title = report["rows"], report["title"]
    ceiling = min((c["pd"] for c in report["ceiling"] if c["method"] == "none"), default=None)
    bounds = {b["snr_db"]: b["altitude_crb_m"] for b in report["bounds"]}
    figures = []
    for against, name in (("overlap", "overlap"), ("sir_db", "sir")):
        if against == "sir_db" and not report["break_points"]:
            continue
        figures += [
            (f"pd_vs_{name}.png", f"Probability of correct altitude against {_NAMES[against]}"),
            (
                f"rmse_vs_{name}.png",
                f"Root mean square error of the forced decision against {_NAMES[against]}",
            ),
        ]
        draw_pd(rows, path / figures[-2][0], title=title, ceiling=ceiling, against=against)
        draw_error(rows, path / figures[-1][0], title=title, bounds_m=bounds, against=against)
    return figures


def build_report(
    head: dict[str, Any],
    scene: Scene,
    rows: Sequence[dict[str, Any]],
    ceiling: Sequence[dict[str, Any]],
    run: dict[str, Any],
) -> dict[str, Any]:
    """Content of ``report.json``."""
    factors = {(r["overlap"], r["sir_db"], r["snr_db"]): r["real_time_factor"] for r in rows}
    return head | {
        "complete": True,
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "title": interference_title(scene),
        "interference_notes": [note for i in scene.interference for note in i.emitter.notes],
        "trials_per_point": scene.altitude.programme.trial_frames,
        "rows": list(rows),
        "ceiling": _one_each(ceiling),
        "bounds": crb_by_snr(scene, rows),
        "break_points": break_points(rows),
        "real_time_factor": float(np.median(list(factors.values()))),
        "run": run,
    }


def _one_each(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The first row of each method and SNR: overlap 0 is the same measurement in every panel."""
    first: dict[tuple, dict[str, Any]] = {}
    for row in rows:
        first.setdefault((row["method"], row["snr_db"]), row)
    return list(first.values())


def crb_by_snr(scene: Scene, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Cramer-Rao bound of the altitude, without interference, for every SNR measured; none without noise."""
    return [
        {
            "snr_db": snr,
            "altitude_crb_m": None if snr is None else float(f"{altitude_crb_m(scene.waveform, snr):.6g}"),
        }
        for snr in dict.fromkeys(r["snr_db"] for r in rows)
    ]


def break_points(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Lowest SIR from which on Pd is at least 0.9, by method, interference, overlap and SNR, and the protection gain.

    Only what was measured counts: ``sir_db`` is None where even the highest SIR fails; ``at_most`` says that no
    lower SIR was measured, so that the method may reach further. ``protection_gain_db`` is the distance to no
    mitigation's break point, None where either is unknown or that of no mitigation is only a limit.
    Empty with fewer than three SIRs: two say too little about where something breaks.
    """
    if len({r["sir_db"] for r in rows} - {None}) < 3:
        return []
    groups: dict[tuple, list[dict[str, Any]]] = {}
    for row in rows:
        if row["overlap"] > 0:
            key = (row["interference"], row["overlap"], row["snr_db"], row["method"])
            groups.setdefault(key, []).append(row)
    out = []
    for (interference, overlap, snr, method), mine in groups.items():
        mine = sorted(mine, key=lambda r: -r["sir_db"])
        holds = [r["pd"] is not None and r["pd"] >= BREAK_PD for r in mine]
        count = holds.index(False) if False in holds else len(holds)
        out.append(
            {
                "method": method,
                "interference": interference,
                "overlap": overlap,
                "snr_db": snr,
                "sir_db": mine[count - 1]["sir_db"] if count else None,
                "at_most": count == len(mine),
            }
        )
    for entry in out:
        entry["protection_gain_db"] = _gain(entry, out)
    return out


def _gain(entry: dict[str, Any], entries: Sequence[dict[str, Any]]) -> float | None:
    same = ("interference", "overlap", "snr_db")
    none = next((e for e in entries if e["method"] == "none" and all(e[k] == entry[k] for k in same)), None)
    if none is None or none["sir_db"] is None or none["at_most"] or entry["sir_db"] is None:
        return None
    return none["sir_db"] - entry["sir_db"]


def interference_title(scene: Scene) -> str:
    """What was measured, for figures and headings."""
    text = " + ".join(i.emitter.title(scene.waveform.bandwidth_hz) for i in scene.interference)
    text = text or "no interference"
    snrs = scene.sweep.snr_db or (scene.channel.snr_db,)
    if len(snrs) == 1:
        text += ", no noise" if snrs[0] is None else f", SNR {snrs[0]:g} dB"
    return text
