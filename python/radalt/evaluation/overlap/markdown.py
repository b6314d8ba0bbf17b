"""Tables of the main study's report; its prose is in ``report.md.j2``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from ..results.integrity import Integrity
from ..results.page import render
from ..results.score import pool
from ..results.table import DASH, interval, metres, number, signed_metres, table
from .altitudes import groups
from .figures import panels

__all__ = ["every_row", "glance", "pd_tables", "report_markdown", "spread", "summary", "tracked_table"]


def report_markdown(
    report: dict[str, Any],
    figures: Sequence[tuple[str, str]],
    altitudes: Sequence[dict[str, Any]] = (),
) -> str:
    """report.md from the content of report.json; ``figures`` are (file, caption)."""
    rows = report["rows"]
    tables = {
        "pd_tables": "\n\n".join(pd_tables(rows)),
        "error_tables": "\n\n".join(_error_tables(rows)),
        "glance": table(*glance(rows)),
        "ceiling_table": _ceiling(report),
        "method_table": _methods(report),
        "break_points": _break_points(report),
        "tracked_table": tracked_table(report["tracked"]),
        "altitude_tables": "\n\n".join(_altitude_tables(altitudes)),
    }
    # the segmenter's counters are equal for all methods
    lost = sum(r["frames_lost"] for r in rows if r["method"] == rows[0]["method"])
    values = report | tables | {"figures": figures, "frames_lost": lost, "summary": summary(report)}
    return render(Path(__file__).with_name("report.md.j2"), **values)


def summary(report: dict[str, Any]) -> str:
    """Summary of the run in a paragraph."""
    altitude, waveform = report["scene"]["altitude"], report["scene"]["waveform"]
    heights = altitude["programme_m"]
    text = f"{report['title']}. {report['scene']['description']}".rstrip(". ") + "."
    return (
        f"{text} Radar: {waveform['bandwidth_hz'] / 1e6:g} MHz sweep in {waveform['sweep_s'] * 1e3:g} ms at "
        f"{waveform['carrier_hz'] / 1e9:g} GHz, {waveform['rate_hz'] / 1e6:g} MS/s. "
        f"{len(heights)} altitudes from {max(heights):g} m to {min(heights):g} m "
        f"({altitude['mode'].replace('_', ' ')}), {altitude['frames']} frames at each: "
        f"{report['trials_per_point']} trials per point and method. Source: {report['source']}. Seed {report['seed']}."
    )


def every_row(rows: Sequence[dict[str, Any]]) -> str:
    """A heading and a table of all rows."""
    header = [
        "method",
        "interference",
        "overlap",
        "SIR / dB",
        "SNR / dB",
        "trials",
        "Pd (95 % interval)",
        "wrong",
    ]
    header += [
        "its bound",
        "RMSE detected / m",
        "RMSE forced / m",
        "bias / m",
        "peak to sidelobe / dB",
        "ms per frame",
    ]
    lines = [
        [
            *(r["method"], r["interference"]),
            *(number(r[name], 2) for name in ("overlap", "sir_db", "snr_db")),
            r["trials"],
            interval(r["pd"], r["pd_low"], r["pd_high"]),
            r["detections"] - r["correct"],
            number(r["wrong_bound"], 4),
            *(metres(r[name]) for name in ("rmse_detected_m", "rmse_forced_m", "bias_m")),
            number(r["peak_to_sidelobe_db"], 1),
            number(r.get("ms_per_frame_median"), 3),
        ]
        for r in rows
    ]
    return f"## Every row\n\nThe same rows, with more columns, are in rows.csv.\n\n{table(header, lines)}\n"


def pd_tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A heading and a table of Pd for each panel; a key ``series`` overrides ``method``."""
    return _by_panel(rows, lambda row: interval(row["pd"], row["pd_low"], row["pd_high"]))


def _error_tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    return _by_panel(rows, _errors)


def _errors(row: dict[str, Any]) -> str:
    text = f"{metres(row['rmse_detected_m'])} / {metres(row['rmse_forced_m'])}"
    low, high = row.get("rmse_low_m"), row.get("rmse_high_m")
    return text if low is None or high is None else f"{text} ({metres(low)}{DASH}{metres(high)})"


def _altitude_tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A heading and a table of Pd by altitude for each panel, over all overlaps above 0."""
    rows = [r for r in rows if r["overlap"] > 0] or rows
    out = []
    for title, mine in panels(rows):
        methods = list(dict.fromkeys(r["method"] for r in mine))
        known = groups(mine, "altitude_low_m", "altitude_high_m", "method")
        lines = []
        for low, high in sorted({key[:2] for key in known}):
            of = [known[low, high, method] for method in methods]
            name = f"{low:g}" if low == high else f"{low:g}{DASH}{high:g}"
            lines.append([name, spread(of), *(interval(r["pd"], r["pd_low"], r["pd_high"]) for r in of)])
        out += [f"### {title}", table(["altitude / m", "trials", *methods], lines)]
    return out


def glance(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and lines: Pd and rate of wrong and valid altitudes per method, over all overlaps of a panel above 0."""
    split = panels([r for r in rows if r["overlap"] > 0] or rows)
    lines = []
    for method in dict.fromkeys(r["method"] for r in rows):
        cells = []
        for _, mine in split:
            total = pool([r for r in mine if r["method"] == method])
            wrong = total.wrong / total.trials if total.trials else 0.0
            cells += [number(total.pd, 3), f"{wrong:.4f}", f"{total.wrong_bound:.4f}"]
        lines.append([method, *cells])
    header = [f"{name}, {title}" for title, _ in split for name in ("Pd", "wrong", "bound")]
    return ["method", *header], lines


def tracked_table(rows: Sequence[dict[str, Any]]) -> str:
    """Integrity of the tracked outputs per method, over all overlaps of a panel above 0."""
    shown = [r for r in rows if r["overlap"] > 0] or rows
    lines = []
    for title, mine in panels(shown):
        for method in dict.fromkeys(r["method"] for r in mine):
            total = sum((Integrity.of_row(r) for r in mine if r["method"] == method), Integrity())
            counts = [[getattr(total, name), f"{total.bound(name):.4f}"] for name in _TRACKED]
            lines.append(
                [
                    *(title, method, total.outputs, number(total.availability, 3)),
                    number(total.continuity, 3),
                    *(f"{count} ({bound})" for count, bound in counts),
                ]
            )
    header = ["panel", "method", "outputs", "availability", "continuity", "wrong by 5 m", "misleading"]
    return table([*header, "hazardous"], lines)


_TRACKED = ("wrong_5m", "misleading", "hazardous")


def _by_panel(rows: Sequence[dict[str, Any]], cell: Callable[[dict[str, Any]], str]) -> list[str]:
    out = []
    for title, mine in panels(rows):
        series = list(dict.fromkeys(r.get("series", r["method"]) for r in mine))
        lines = []
        for overlap in sorted({r["overlap"] for r in mine}):
            at = {r.get("series", r["method"]): r for r in mine if r["overlap"] == overlap}
            lines.append(
                [f"{overlap:g}", spread(at.values()), *(cell(at[s]) if s in at else "" for s in series)]
            )
        out += [f"### {title}", table(["overlap", "trials", *series], lines)]
    return out


def spread(rows: Iterable[dict[str, Any]]) -> str:
    """Number of trials of the rows: one number, or the smallest and the largest."""
    trials = sorted({r["trials"] for r in rows})
    return f"{trials[0]}" if len(trials) == 1 else f"{trials[0]}{DASH}{trials[-1]}"


def _ceiling(report: dict[str, Any]) -> str:
    bounds = {b["snr_db"]: b["altitude_crb_m"] for b in report["bounds"]}
    lines = [
        [
            row["method"],
            "no noise" if row["snr_db"] is None else f"{row['snr_db']:g}",
            row["trials"],
            interval(row["pd"], row["pd_low"], row["pd_high"]),
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
            e["method"],
            e["interference"],
            f"{e['overlap']:g}",
            f"{e['text']} ({e['low_db']:.1f} to {e['high_db']:.1f})",
            e["protection_gain"] or DASH,
        ]
        for e in report["break_points"]
    ]


def _methods(report: dict[str, Any]) -> str:
    """Times, divergence and model of every method."""
    lines = []
    for method in dict.fromkeys(r["method"] for r in report["rows"]):
        mine = [r for r in report["rows"] if r["method"] == method]
        medians = sorted(r["ms_per_frame_median"] for r in mine)
        diverged = [r for r in mine if r["diverged_frames"]]
        worst = max((r["ms_per_frame_p99"] for r in mine), default=0.0)
        known = report["methods"].get(method, {})
        where = f"{sum(r['diverged_frames'] for r in diverged)} frames" if diverged else "none"
        if diverged:
            low = min(r["overlap"] for r in diverged)
            sirs = sorted({r["sir_db"] for r in diverged if r["sir_db"] is not None})
            where += f", from overlap {low:g} on" if low else ""
            where += " at " + ", ".join(f"{s:g}" for s in sirs) + " dB SIR" if sirs else ""
        model = f"{known['model']} `{known['sha256'][:12]}`" if "sha256" in known else ""
        model += " (placeholder)" if known.get("placeholder") else ""
        lines.append([method, f"{medians[len(medians) // 2]:.2f}", f"{worst:.2f}", where, model])
    header = ["method", "median ms per frame", "99th percentile, worst point", "diverged", "model"]
    return table(header, lines)
