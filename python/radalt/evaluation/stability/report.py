"""The stability report: what was measured as JSON, CSV, Markdown and one figure."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..overlap.markdown import table
from ..results.folder import versions

__all__ = ["failures", "write_stability_report"]

_GROUPS = {
    "stiff": "Stiff inputs",
    "scene": "Extreme scenes",
    "waveform": "Other sweeps",
    "numbers": "Number range and converters",
}
_COLOURS = {
    "pass": "#009E73",
    "refused": "#BBBBBB",
    "flagged": "#56B4E9",
    "WRONG": "#E69F00",
    "FAIL": "#000000",
}
_SIGNS = {"pass": "", "refused": "r", "flagged": "f", "WRONG": "W", "FAIL": "X"}


def failures(report: dict[str, Any]) -> list[str]:
    """One line for every row that did not pass."""
    out = [
        f"{r['case']}: {r['method']}: {r['verdict']}"
        for r in report["rows"]
        if r["verdict"] in ("WRONG", "FAIL")
    ]
    for name in ("step_limits", "checks"):
        rows = report[name]
        out += [
            f"{r.get('check', 'LMS step limit')}: {r['verdict']}"
            for r in rows
            if r["verdict"].startswith("FAIL")
        ]
    return out


def write_stability_report(
    folder: Path,
    rows: Sequence[dict[str, Any]],
    step_limits: Sequence[dict[str, Any]],
    checks: Sequence[dict[str, Any]],
    *,
    command: str,
) -> dict[str, Any]:
    """Write ``stability.json``, ``.csv``, ``.md`` and ``figures/stability.png``; returns the report."""
    folder.mkdir(parents=True, exist_ok=True)
    network = any(r["method"].startswith("tcae") for r in rows)
    report = {
        "schema": 1,
        "command": command,
        "versions": versions(network),
        "rows": [{k: _plain(v) for k, v in r.items()} for r in rows],
        "step_limits": list(step_limits),
        "checks": [{k: _plain(v) for k, v in c.items()} for c in checks],
    }
    (folder / "stability.json").write_text(
        json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    with (folder / "stability.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(k for r in report["rows"] for k in r)))
        writer.writeheader()
        writer.writerows(report["rows"])
    (folder / "figures").mkdir(exist_ok=True)
    _draw(report, folder / "figures" / "stability.png")
    (folder / "stability.md").write_text(_markdown(report), encoding="utf-8")
    return report


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _markdown(report: dict[str, Any]) -> str:
    rows = report["rows"]
    methods = list(dict.fromkeys(r["method"] for r in rows))
    lines = [
        [m, *(str(sum(r["verdict"] == v for r in rows if r["method"] == m)) for v in _COLOURS)]
        for m in methods
    ]
    parts = [
        "# Stability on stiff and extreme cases",
        f"Made by `{report['command']}`. "
        + ", ".join(f"{k} {v}" for k, v in report["versions"].items())
        + ".",
        _what_it_is(),
        table(["method", *_COLOURS], lines),
        "![Verdict of every case and method](figures/stability.png)",
        "## What did not pass",
        _not_passed(report),
        "## Step size of block LMS against theory",
        "Largest stable step, by bisection, on noise whose spectrum spans the given range, against "
        "2 / (block lambda_max): 32 taps, blocks of 100.",
        table(
            ["spectral spread", "condition number", "theory", "measured", "measured / theory"],
            [
                [
                    f"{r['spread']:.0e}",
                    f"{r['condition']:.2e}",
                    f"{r['theory']:.3e}",
                    f"{r['measured']:.3e}",
                    f"{r['ratio']:.2f}",
                ]
                for r in report["step_limits"]
            ],
        ),
        "## Long runs, determinism, flowgraph",
        table(
            ["check", "value", "bound", "unit", "verdict"],
            [
                [r["check"], _number(r["value"]), _number(r["bound"]), r["unit"], r["verdict"]]
                for r in report["checks"]
            ],
        ),
    ]
    for group, title in _GROUPS.items():
        parts += [f"## {title}", _group_table([r for r in rows if r["group"] == group])]
    return "\n\n".join(parts) + "\n"


def _not_passed(report: dict[str, Any]) -> str:
    """Cases that did not pass, a line for every method."""
    lines = []
    for method in dict.fromkeys(r["method"] for r in report["rows"]):
        bad = [r for r in report["rows"] if r["method"] == method and r["verdict"] in ("WRONG", "FAIL")]
        if bad:
            names = "; ".join(f"{r['case']} ({r['wrong']} of {r['frames']} wrong)" for r in bad)
            lines.append(f"- **{method}**, {len(bad)}: {names}")
    lines += [f"- {line}" for line in failures(report | {"rows": []})]
    return "\n".join(lines) or "Nothing."


def _what_it_is() -> str:
    return (
        "Every case is a handful of frames with a known truth. A row passes if each frame ends in an altitude "
        "within the case's bound or in `valid = false` with a reason, nothing is raised or warned of, and the "
        "clean frame that follows is measured as if nothing had happened before. Wrong altitudes are allowed at "
        "the CFAR's design rate where noise or interference can pass for a return, and nowhere else. *WRONG* is a "
        "wrong altitude declared beyond that; *FAIL* an exception, a clean chain that misses what it has to find, "
        "or a frame after the case that is not right again. *Flagged* methods state that their output carries no "
        "altitude (the paper's LMS, filtered towards the reference: every altitude becomes zero). *Refused* is a "
        "method that says in one line why it does not fit the sweep. *Silenced* frames are those that a method gave up "
        "(`valid = false`, `no_signal`): filters of the reference where the received frame does not bear them out, "
        "networks other than the shipped default where the altitude does not move with a beat-shifted frame (the "
        "shift test, [tcae.md](tcae.md)).\n\n"
        "`output` is the relative error of the cleaned frames against a float64 reference written apart, up to "
        "one factor a frame; `altitude` the difference of altitudes against a float64 transform at the same peak, "
        "where interference leaves one: with noise between the samples the two interpolate different things and "
        "differ by its error."
    )


def _group_table(rows: Sequence[dict[str, Any]]) -> str:
    lines = [
        [
            r["case"] if k == 0 or rows[k - 1]["case"] != r["case"] else "",
            r["method"],
            r["precision"],
            "" if r["condition"] is None else f"{r['condition']:.1e}",
            f"{r['valid']}/{r['frames']}" if r["valid"] is not None else "",
            _number(r["wrong"]),
            _number(r["error_m"]),
            f"{r['bound_m']:g}",
            _number(r["output_error"]),
            _number(r["altitude_float64_m"]),
            {True: "yes", False: "no", None: ""}[r["finite"]],
            _number(r["diverged"]),
            _number(r["silenced"]),
            r["reasons"].replace("|", "/")[:90],
            r["verdict"],
        ]
        for k, r in enumerate(rows)
    ]
    header = [
        "case",
        "method",
        "precision",
        "condition",
        "valid",
        "wrong",
        "worst error / m",
        "bound / m",
        "output",
    ]
    return table([*header, "altitude / m", "finite", "diverged", "silenced", "reasons", "verdict"], lines)


def _number(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.2g}" if isinstance(value, float) else str(value)


def _draw(report: dict[str, Any], path: Path) -> None:
    """A tile for every case and method, in the colour of its verdict and with a letter where it is not a pass."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch, Rectangle

    rows = report["rows"]
    cases = list(dict.fromkeys(r["case"] for r in rows))
    methods = list(dict.fromkeys(r["method"] for r in rows))
    figure = Figure(
        figsize=(4.6 + 0.42 * len(methods), 1.8 + 0.165 * len(cases)), layout="constrained", dpi=160
    )
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for r in rows:
        x, y = methods.index(r["method"]), cases.index(r["case"])
        axis.add_patch(Rectangle((x - 0.46, y - 0.43), 0.92, 0.86, color=_COLOURS[r["verdict"]], lw=0))
        colour = "white" if r["verdict"] == "FAIL" else "black"
        axis.text(x, y, _SIGNS[r["verdict"]], ha="center", va="center", fontsize=6, color=colour)
    axis.set_xlim(-0.5, len(methods) - 0.5)
    axis.set_ylim(len(cases) - 0.5, -0.5)
    axis.set_yticks(range(len(cases)), cases, fontsize=6)
    axis.set_xticks(range(len(methods)), methods, rotation=60, ha="left", fontsize=7)
    axis.xaxis.tick_top()
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)
    names = [v for v in _COLOURS if any(r["verdict"] == v for r in rows)]
    handles = [Patch(color=_COLOURS[v], label=v + (f" ({_SIGNS[v]})" if _SIGNS[v] else "")) for v in names]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(names), fontsize=7, frameon=False)
    figure.savefig(path, metadata={"Software": "gr-radalt"})
