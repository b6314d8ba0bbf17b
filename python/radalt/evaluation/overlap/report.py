"""Report of a run's rows: report.json, report.md and the figures."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...core.altimeter.cramer_rao import altitude_crb_m
from ...core.scene import Scene
from ..engine.study import Run
from ..flowgraph import FlowgraphError
from ..results.break_point import break_point_of, protection_gain
from ..results.folder import RunFolder
from ..results.page import write_page
from ..results.rows import grouped
from .altitudes import with_intervals
from .figures import draw_cost, draw_error, draw_error_cdf, draw_pd, draw_pd_by_altitude, draw_wrong
from .finding import said_of_pd
from .markdown import report_markdown
from .panels import Row, swept_axes, with_interference

_NAMES = {"overlap": "temporal overlap", "sir_db": "SIR"}


def write_report(
    folder: RunFolder,
    scene: Scene,
    rows: Mapping[str, Sequence[Row]],
    run: Run,
    *,
    left_out: Sequence[str] = (),
) -> Path:
    """Write the result folder from its rows by table, as in `build_report`; returns the path of ``report.md``."""
    report = build_report(folder.head, scene, rows, run, left_out=left_out)
    text = "# the scene as used, with all defaults and what the command line changed\n"
    text += yaml.safe_dump(folder.head["scene"], sort_keys=False)
    folder.write_text("scene.yaml", text)
    altitudes = _altitudes(rows)
    figures = _draw(report, folder.path)
    figures[1:1] = draw_cost(report["rows"], folder.path)
    figures += _draw_altitudes(report, altitudes, folder.path)
    report["figures"] = [name for name, _ in figures]
    page = write_page(folder, report_markdown(report, figures), report["run"])
    folder.write_report(report)
    return page


def _draw(report: dict[str, Any], path: Path) -> list[tuple[str, str]]:
    """Draw against what was swept (`swept_axes`); returns (file, caption)."""
    rows, title = [row for row in report["rows"] if row["trials"]], report["title"]
    ceiling = min((c["pd"] for c in report["ceiling"] if c["method"] == "none" and c["trials"]), default=None)
    bounds = {b["snr_db"]: b["altitude_crb_m"] for b in report["bounds"]}
    figures = []
    for against, name in swept_axes(rows):
        pd, error, wrong = (f"{what}_vs_{name}.png" for what in ("pd", "rmse", "wrong"))
        draw_pd(rows, path / pd, settings=title, ceiling=ceiling, against=against)
        draw_error(rows, path / error, settings=title, bounds_m=bounds, against=against)
        draw_wrong(rows, path / wrong, settings=title, against=against)
        figures += [
            (pd, f"Probability of correct altitude against {_NAMES[against]}"),
            (error, f"Root mean square error of the forced decision against {_NAMES[against]}"),
            (wrong, f"Rate of wrong altitudes that were called valid against {_NAMES[against]}"),
        ]
    return figures


def _draw_altitudes(report: dict[str, Any], altitudes: Sequence[Row], path: Path) -> list[tuple[str, str]]:
    """Pd by altitude and the distribution of errors, over all overlaps above 0; returns (file, caption)."""
    rows = with_interference(altitudes)
    if not rows:
        return []
    title, settings = said_of_pd(report["rows"]), report["title"]
    draw_pd_by_altitude(rows, path / "pd_vs_altitude.png", title=title, settings=settings)
    draw_error_cdf(rows, path / "error_cdf.png", settings=settings)
    return [
        ("pd_vs_altitude.png", "Probability of correct altitude by altitude, over all overlaps above 0"),
        ("error_cdf.png", "Distribution of the forced decision's error, over all overlaps above 0"),
    ]


def _altitudes(tables: Mapping[str, Sequence[Row]]) -> list[Row]:
    return [row for row in tables.get("altitudes", ()) if row["trials"]]


def build_report(
    head: dict[str, Any],
    scene: Scene,
    tables: Mapping[str, Sequence[Row]],
    run: Run,
    *,
    left_out: Sequence[str] = (),
) -> dict[str, Any]:
    """Content of ``report.json`` from the rows by table, in canonical order.

    ``ceiling`` has the rows without interference, one per method and SNR (more are ignored; by default those of
    overlap 0); ``altitudes`` those by altitude (`ALTITUDE_COLUMNS`), without which there are no intervals of RMSE;
    ``tracked`` those of the tracker's outputs.

    Raises FlowgraphError, one line, if no point has a frame.
    """
    if not any(row["trials"] for row in tables["rows"]):
        raise FlowgraphError(
            "no frame: timing not acquired, or lost before the trials "
            f"({max(r['lock_losses'] for r in tables['rows'])} times at most in a point); is the sweep received at "
            "altitude zero, and nothing stronger (leakage: docs/leakage.md)?"
        )
    rows = with_intervals(tables["rows"], _altitudes(tables))
    ceiling = tables.get("ceiling") or [row for row in rows if row["overlap"] == 0]
    once: dict[tuple[str, float | None], Row] = {}
    for row in ceiling:  # overlap 0 is one measurement for all panels
        once.setdefault((row["method"], row["snr_db"]), row)
    factors = {(r["overlap"], r["sir_db"], r["snr_db"]): r["real_time_factor"] for r in rows}
    return head | {
        "kind": "run",
        "name": scene.name,
        "seed": scene.seed,
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "title": _interference_title(scene),
        "interference_notes": [
            note for i in scene.interference for note in i.emitter.notes(scene.waveform.rate_hz)
        ],
        "trials_per_point": scene.altitude.programme.trial_frames,
        "rows": list(rows),
        "ceiling": list(once.values()),
        "tracked": list(tables.get("tracked", ())),
        "left_out": list(left_out),
        "bounds": _crb_by_snr(scene, rows),
        "break_points": break_points(rows),
        "real_time_factor": float(np.median(list(factors.values()))),
        "run": run.as_dict(),
    }


def _crb_by_snr(scene: Scene, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Cramer-Rao bound of the altitude without interference, by SNR; none without noise."""
    snrs = dict.fromkeys(r["snr_db"] for r in rows)
    known = {snr: float(f"{altitude_crb_m(scene.waveform, snr):.6g}") for snr in snrs if snr is not None}
    return [{"snr_db": snr, "altitude_crb_m": known.get(snr)} for snr in snrs]


def break_points(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Break-point and protection gain by interference, overlap, SNR and method (`results.break_point`).

    Empty with fewer than three SIRs, which do not locate a break-point.
    """
    if len({r["sir_db"] for r in rows} - {None}) < 3:
        return []
    names = ("interference", "overlap", "snr_db", "method")
    curves = grouped((row for row in rows if row["overlap"] > 0), *names)
    found = {key: break_point_of(mine) for key, mine in curves.items()}
    out = []
    for key, broken in found.items():
        none = found.get((*key[:3], "none"))
        gain = None if none is None or key[3] == "none" else protection_gain(none, broken)
        out.append(
            dict(zip(names, key, strict=True))
            | vars(broken)
            | {
                "text": str(broken),
                "protection_gain_db": None if gain is None or gain.mark == "?" else gain.db,
                "protection_gain": "" if gain is None else str(gain),
            }
        )
    return out


def _interference_title(scene: Scene) -> str:
    """Title of the interference, for figures and headings."""
    text = " + ".join(i.emitter.title(scene.waveform.bandwidth_hz) for i in scene.interference)
    text = text or "no interference"
    snrs = scene.sweep.snr_db or (scene.channel.snr_db,)
    if len(snrs) == 1:
        text += ", no noise" if snrs[0] is None else f", SNR {snrs[0]:g} dB"
    return text
