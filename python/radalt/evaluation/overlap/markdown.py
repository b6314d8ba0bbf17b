"""report.md: the tables of a report for people. Everything in it comes from report.json."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from .figures import panels

__all__ = ["pd_tables", "report_markdown", "table"]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column is a label, the others are numbers."""
    lines = ["| " + " | ".join(header) + " |", "|---" + "|---:" * (len(header) - 1) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


def report_markdown(report: dict[str, Any], figures: Sequence[tuple[str, str]]) -> str:
    """The whole of report.md from the content of report.json; ``figures`` are (file, caption)."""
    scene, rows = report["scene"], report["rows"]
    parts = [f"# {report['name']}: Pd against overlap", _summary(report), *report["interference_notes"]]
    parts += _warnings(report)
    parts += [f"![{caption}]({name})" for name, caption in figures]
    parts += ["## Probability of correct altitude", _what_pd_is(), *pd_tables(rows)]
    parts += ["## Error", _what_rmse_is(), *_error_tables(rows)]
    parts += ["## Without interference", _ceiling(report)]
    if report["break_points"]:
        parts += ["## Break points", _break_points(report)]
    parts += ["## Methods", _methods(report)]
    parts += ["## What was left out", "\n".join(f"- {item}" for item in report["left_out"]) or "Nothing."]
    parts += ["## Run", _run(report, scene)]
    return "\n\n".join(parts) + "\n"


def _summary(report: dict[str, Any]) -> str:
    altitude, waveform = report["scene"]["altitude"], report["scene"]["waveform"]
    heights = altitude["programme_m"]
    text = f"{report['title']}. {report['scene']['description']}".rstrip(". ") + "."
    return (
        f"{text} Radar: {waveform['bandwidth_hz'] / 1e6:g} MHz sweep in {waveform['sweep_s'] * 1e3:g} ms at "
        f"{waveform['carrier_hz'] / 1e9:g} GHz, {waveform['rate_hz'] / 1e6:g} MS/s. "
        f"{len(heights)} altitudes from {max(heights):g} m to {min(heights):g} m "
        f"({altitude['mode'].replace('_', ' ')}), {altitude['frames']} frames at each: "
        f"{report['trials_per_point']} trials a point and method. Source: {report['source']}. Seed {report['seed']}."
    )


def _warnings(report: dict[str, Any]) -> list[str]:
    out = []
    for method, known in report["methods"].items():
        if known.get("placeholder"):
            out.append(
                f"**The model of {method} ({known['model']}) is a placeholder:** it was not trained for this case, and "
                "its rows show that the path works, not what the method can do."
            )
    lost = sum(r["frames_lost"] for r in _one_method(report["rows"]))
    if lost:
        out.append(
            f"**{lost} frames never came out of the segmenter** (lost samples or lost lock). They are in no Pd; "
            "column `frames_lost` of rows.csv has them point by point."
        )
    return out


def _one_method(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the first method: the segmenter's counters are the same for all."""
    return [r for r in rows if r["method"] == rows[0]["method"]]


def _what_pd_is() -> str:
    return (
        "Correct: the CFAR declares it, both half sweeps agree, and the altitude is within 5 m of the truth; no "
        "detection counts against it. In brackets the 95 % Wilson interval. SIR is averaged over the whole sweep, "
        "so a shorter burst at the same SIR is stronger while it lasts."
    )


def _what_rmse_is() -> str:
    return "Metres: over detections / over all trials with a forced decision. A dash: nothing was detected."


def pd_tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A heading and a table of Pd for each panel; ``series`` overrides ``method`` where it is there."""

    def cell(row: dict[str, Any]) -> str:
        if row["pd"] is None:
            return "\N{EN DASH}"
        return f"{row['pd']:.3f} ({row['pd_low']:.2f}\N{EN DASH}{row['pd_high']:.2f})"

    return _by_panel(rows, cell)


def _error_tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    def cell(row: dict[str, Any]) -> str:
        return f"{_metres(row['rmse_detected_m'])} / {_metres(row['rmse_forced_m'])}"

    return _by_panel(rows, cell)


def _metres(value: float | None) -> str:
    return "\N{EN DASH}" if value is None else f"{value:.3g}"


def _by_panel(rows: Sequence[dict[str, Any]], cell: Any) -> list[str]:
    out = []
    for title, mine in panels(rows):
        series = list(dict.fromkeys(r.get("series", r["method"]) for r in mine))
        lines = []
        for overlap in sorted({r["overlap"] for r in mine}):
            at = {r.get("series", r["method"]): r for r in mine if r["overlap"] == overlap}
            trials = sorted({r["trials"] for r in at.values()})
            count = f"{trials[0]}" if len(trials) == 1 else f"{trials[0]}\N{EN DASH}{trials[-1]}"
            lines.append([f"{overlap:g}", count, *(cell(at[s]) if s in at else "" for s in series)])
        out += [f"### {title}", table(["overlap", "trials", *series], lines)]
    return out


def _ceiling(report: dict[str, Any]) -> str:
    bounds = {b["snr_db"]: b["altitude_crb_m"] for b in report["bounds"]}
    lines = []
    for row in report["ceiling"]:
        snr = row["snr_db"]
        lines.append(
            [
                row["method"],
                "no noise" if snr is None else f"{snr:g}",
                str(row["trials"]),
                f"{row['pd']:.3f} ({row['pd_low']:.2f}\N{EN DASH}{row['pd_high']:.2f})"
                if row["trials"]
                else "",
                _metres(row["rmse_detected_m"]),
                _metres(row["bias_m"]),
                _metres(bounds.get(snr)),
            ]
        )
    header = [
        "method",
        "SNR / dB",
        "trials",
        "Pd",
        "RMSE / m",
        "bias / m",
        "Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound / m",
    ]
    return (
        "The ceiling of the chain: the same scene at overlap 0, where no jammer chain is built. The bound is that of "
        "two independent beats of a point target in white noise (Rife and Boorstyn 1974).\n\n"
        + table(header, lines)
    )


def _break_points(report: dict[str, Any]) -> str:
    def sir(entry: dict[str, Any]) -> str:
        if entry["sir_db"] is None:
            return "above all measured"
        return ("\N{LESS-THAN OR EQUAL TO} " if entry["at_most"] else "") + f"{entry['sir_db']:g}"

    def gain(entry: dict[str, Any]) -> str:
        if entry["protection_gain_db"] is None:
            return ""
        return (
            "\N{GREATER-THAN OR EQUAL TO} " if entry["at_most"] else ""
        ) + f"{entry['protection_gain_db']:g}"

    lines = [
        [e["method"], e["interference"], f"{e['overlap']:g}", sir(e), gain(e)] for e in report["break_points"]
    ]
    header = ["method", "interference", "overlap", "break-point SIR / dB", "protection gain / dB"]
    return "Lowest SIR, of those measured, down to which Pd is at least 0.9 throughout.\n\n" + table(
        header, lines
    )


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
    header = ["method", "median ms a frame", "99th percentile, worst point", "diverged", "model"]
    return (
        "Time is CPU time of the method's own thread; a frame lasts "
        f"{report['scene']['waveform']['sweep_s'] * 1e3:g} ms.\n\n" + table(header, lines)
    )


def _run(report: dict[str, Any], scene: dict[str, Any]) -> str:
    run = report["run"]
    lines = [
        f"- {run['points']} points in {run['wall_s']:.0f} s with {run['jobs']} worker processes"
        + (f", {run['points_resumed']} of them from an earlier start" if run["points_resumed"] else ""),
        f"- real-time factor {report['real_time_factor']:.2f} (seconds of signal a second, median over points, each "
        "flowgraph beside the other workers')",
        f"- peak memory {run['peak_memory_bytes'] / 2**20:.0f} MiB, all processes together",
        "- " + ", ".join(f"{name} {version}" for name, version in report["versions"].items()),
        "- rows.csv: every row; scene.yaml: the scene as used; report.json: all of this (schema "
        f"{report['schema']})",
    ]
    return "\n".join(lines)
