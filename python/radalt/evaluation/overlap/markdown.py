"""Tables of the main study's report; its prose is in ``report.md.j2``."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..results.integrity import Integrity
from ..results.page import render
from ..results.score import pool
from ..results.table import DASH, counted, interval, listed, metres, number, signed_metres, table
from .finding import by_pd, lead, most_wrong, paired, said_of_pd
from .panels import Row, common, panels, series_of, spread, with_interference

_TRACKED = ("wrong_5m", "misleading", "hazardous")
NOT_MEASURED = "not measured"


def report_markdown(report: dict[str, Any], figures: Sequence[tuple[str, str]]) -> str:
    """report.md from the content of report.json; ``figures`` are (file, caption)."""
    rows = report["rows"]
    tables = {
        "pd_tables": pd_tables(rows),
        "error_tables": _by_panel(rows, _errors),
        "glance": glance([*rows, *report["ceiling"]]),
        "ceiling_table": _ceiling(report),
        "method_table": _methods(report),
        "break_points": _break_points(report),
        "tracked_table": tracked_table(report["tracked"]),
    }
    # the segmenter's counters are equal for all methods
    lost = sum(r["frames_lost"] for r in rows if r["method"] == rows[0]["method"])
    values = report | tables | {"figures": figures, "frames_lost": lost, "summary": summary(report)}
    values["verdict"] = verdict(rows, report["source"], report["scene"]["waveform"])
    return render(Path(__file__).with_name("report.md.j2"), **values)


def summary(report: dict[str, Any]) -> str:
    """What was run, in a sentence."""
    altitude = report["scene"]["altitude"]
    heights = altitude["programme_m"]
    return (
        f"{report['title']}; {counted(len(heights), 'altitude')} from {max(heights):g} m to {min(heights):g} m, "
        f"{counted(altitude['frames'], 'frame')} at each: {counted(report['trials_per_point'], 'trial')} per point and "
        f"method. Source: {report['source']}, seed {report['seed']}."
    )


def verdict(rows: Sequence[Row], source: str, waveform: dict[str, Any]) -> str:
    """What rows say: the methods that share the lead, how far the next is, the most wrong altitudes, the reach."""
    measured = [r for r in with_interference(rows) if r["trials"]]
    rows = common(rows)
    where = "all overlaps above 0" if len(rows) == len(measured) else "the points that every method has"
    total, worst = most_wrong(rows)
    wrong = f"{listed([f'`{name}`' for name in worst]) or 'every method'}, {total.wrong} of {total.trials}"
    if not total.wrong:
        wrong = f"none of {total.trials} of any method"
    best, after = lead(rows)
    found, apart = paired(rows, best[0], after) if after else None, ""
    if found is not None:
        frames, difference, low, high = found
        whose = f"`{best[0]}` " * (len(best) > 1)
        level = f"{difference:.3f} ({low:.3f} to {high:.3f})"
        apart = f", {whose}{level} above `{after}` on the same {frames} frames"
    return (
        f"**{said_of_pd(rows, mark='`')}** over {where}{apart}. "
        f"Most wrong and valid: {wrong} (95 % bound {100 * total.wrong_bound:.2g} %). "
        f"{'Simulated' if source == 'simulated' else 'Off the air'}, with a sweep of "
        f"{waveform['bandwidth_hz'] / 1e6:g} MHz and samples before the mixer."
    )


def against(rows: Sequence[Row], best: str) -> str:
    """Table of a series against every other, paired on the frames that both have."""
    lines = []
    for name in by_pd(rows):
        found = paired(rows, best, name)
        if name != best:
            shown = [NOT_MEASURED] * 2
            if found is not None:
                frames, difference, low, high = found
                level = f"{difference:+.3f} ({low:+.3f} to {high:+.3f})"
                shown = [str(frames), level if any(found[1:]) else "no frame differs"]
            lines.append([best, name, *shown])
    return table(["A", "B", "frames of both", "Pd of A less that of B"], lines)


def _pd(row: Row) -> str:
    return interval(row["pd"], row["pd_low"], row["pd_high"])


def pd_tables(rows: Sequence[Row]) -> str:
    """A heading and a table of Pd for each panel; a key ``series`` overrides ``method``."""
    return _by_panel(rows, _pd)


def _errors(row: Row) -> str:
    text = f"{metres(row['rmse_detected_m'])} / {metres(row['rmse_forced_m'])}"
    low, high = row.get("rmse_low_m"), row.get("rmse_high_m")
    return text if low is None or high is None else f"{text} ({metres(low)}{DASH}{metres(high)})"


def _by_panel(rows: Sequence[Row], cell: Callable[[Row], str]) -> str:
    """A heading and a table for each panel, a line for each overlap."""
    out = []
    for title, mine in panels(rows):
        series = series_of(mine)
        lines = []
        for overlap in sorted({r["overlap"] for r in mine}):
            at = {name: r for name, of in series.items() for r in of if r["overlap"] == overlap}
            cells = (cell(at[name]) if name in at else NOT_MEASURED for name in series)
            lines.append([f"{overlap:g}", spread(at.values()), *cells])
        out += [f"### {title}", table(["overlap", "trials", *series], lines)]
    return "\n\n".join(out)


def glance(rows: Sequence[Row]) -> str:
    """Pd and wrong and valid altitudes per series over all overlaps of a panel above 0; Pd at overlap 0; cost."""
    split = panels(with_interference(rows))
    lines = []
    for name, mine in series_of(rows).items():
        cells = []
        for _, panel in split:
            total = pool(series_of(panel).get(name, []))
            cells += (
                [
                    number(total.pd, 3),
                    number(total.pd_3pct, 3),
                    f"{total.wrong / total.trials:.4f}",
                    f"{total.wrong_bound:.4f}",
                ]
                if total.trials
                else [NOT_MEASURED] * 4
            )
        # at overlap 0 one measurement serves all panels
        clear = pool(list({r["snr_db"]: r for r in mine if not r["overlap"]}.values()))
        times = [t for r in with_interference(mine) if (t := r["ms_per_frame_median"]) is not None]
        lines.append(
            [
                name,
                *cells,
                number(clear.pd, 3) if clear.trials else NOT_MEASURED,
                number(float(np.median(times)), 2) if times else NOT_MEASURED,
            ]
        )
    header = [f"{name}, {title}" for title, _ in split for name in ("Pd", "5 m or 3 %", "wrong", "bound")]
    return table(["method", *header, "Pd at overlap 0", "ms per frame"], lines)


def tracked_table(rows: Sequence[Row]) -> str:
    """Integrity of the tracked outputs per method, over all overlaps of a panel above 0."""
    lines = []
    for title, mine in panels(with_interference(rows)):
        for method, of in series_of(mine).items():
            total = sum(map(Integrity.of_row, of), Integrity())
            shares = [number(total.availability, 3), number(total.continuity, 3)]
            counts = [f"{getattr(total, name)} ({total.bound(name):.4f})" for name in _TRACKED]
            lines.append([title, method, total.outputs, *shares, *counts])
    header = ["panel", "method", "outputs", "availability", "continuity", "wrong by 5 m", "misleading"]
    return table([*header, "hazardous"], lines)


def _ceiling(report: dict[str, Any]) -> str:
    bounds = {b["snr_db"]: b["altitude_crb_m"] for b in report["bounds"]}
    lines = [
        [
            row["method"],
            "no noise" if row["snr_db"] is None else f"{row['snr_db']:g}",
            row["trials"],
            _pd(row),
            metres(row["rmse_detected_m"]),
            signed_metres(row["bias_m"]),
            metres(bounds.get(row["snr_db"])),
        ]
        for row in report["ceiling"]
    ]
    header = ["method", "SNR / dB", "trials", "Pd", "RMSE / m", "bias / m", "Cramér-Rao bound / m"]
    return table(header, lines)


def _break_points(report: dict[str, Any]) -> list[list[str]]:
    return [
        [
            *(e["method"], e["interference"], f"{e['overlap']:g}"),
            f"{e['text']} ({e['low_db']:.1f} to {e['high_db']:.1f})",
            e["protection_gain"] or DASH,
        ]
        for e in report["break_points"]
    ]


def _methods(report: dict[str, Any]) -> str:
    """Times, divergence and model of every method."""
    lines = []
    for method, mine in series_of(report["rows"]).items():
        medians = [r["ms_per_frame_median"] for r in with_interference(mine)]
        worst = max(r["ms_per_frame_p99"] for r in mine)
        known = report["methods"].get(method, {})
        model = f"{known['model']} `{known['sha256'][:12]}`" if "sha256" in known else ""
        model += " (placeholder)" if known.get("placeholder") else ""
        diverged = sum(r["diverged_frames"] for r in mine)
        lines.append([method, f"{np.median(medians):.2f}", f"{worst:.2f}", diverged, model])
    header = ["method", "median ms per frame", "99th percentile, worst point", "frames diverged", "model"]
    return table(header, lines)
