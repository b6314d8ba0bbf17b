"""Stability report: counts of verdicts, rows that did not pass, one figure; every row is in rows.csv."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...core.interference.evm import EMITTERS
from ...core.mitigation import METHODS
from ...evaluation.engine.study import Run, Study
from ...evaluation.results.figure import new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.rows import TEXT, WHOLE, Columns, grouped
from ...evaluation.results.table import table

_GROUPS = {
    "stiff": "stiff inputs",
    "scene": "extreme scenes",
    "waveform": "other sweeps",
    "numbers": "number range and converters",
    "front_end": "compression and intermodulation",
}
_COLOURS = {
    "pass": "#A6DBC9",
    "refused": "#D0D0D0",
    "flagged": "#9CCBEB",
    "WRONG": "#E69F00",
    "FAIL": "#D55E00",
}
_COUNTED = ("rows", *_COLOURS, "frames", "declared", "wrong_frames", "silenced")
BY_GROUP = Columns(
    ("group", "chain", *_COUNTED, "worst_error_m", "worst_output"), TEXT - {"declared"}, WHOLE | {"declared"}
)


def failures(tables: Mapping[str, Sequence[dict[str, Any]]]) -> list[str]:
    """One line for every row that did not pass, of the tables of `StabilityStudy`."""
    rows = [r for r in tables["rows"] if r["verdict"] in ("WRONG", "FAIL")]
    steps = [r for r in tables["step_limits"] if r["verdict"] == "FAIL"]
    checks = [r for r in tables["checks"] if r["verdict"].startswith("FAIL")]
    return [
        *(f"{r['case']}: {r['chain']}: {r['verdict']}" for r in rows),
        *(f"LMS step limit at spread {r['spread']:.0e}: FAIL" for r in steps),
        *(f"{r['check']}: {r['verdict']}" for r in checks),
    ]


def write_report(
    folder: RunFolder, study: Study, tables: Mapping[str, Sequence[dict[str, Any]]], run: Run
) -> Path:
    """Write the figure, ``groups.csv``, ``report.md`` and ``report.json``; returns the page."""
    rows = tables["rows"]
    _draw(rows, folder.path / "figures" / "stability.png")
    folder.write_text("groups.csv", BY_GROUP.csv(by_group(rows)))
    chains = grouped(rows, "chain")
    lines = [[chain, mine[0]["precision"], *_verdicts(mine)] for chain, mine in chains.items()]
    values = {
        "counts": table(["chain", "precision", "rows", *_COLOURS], lines),
        "failed_checks": len(failures(tables | {"rows": []})),
        "group_table": _group_table(rows),
        "not_passed": _not_passed(tables),
        "step_table": _step_table(tables["step_limits"]),
        "check_table": _check_table(tables["checks"]),
    }
    report = {**tables, "failures": failures(tables)}
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), report, values)


def _verdicts(rows: Sequence[dict[str, Any]]) -> list[int]:
    return [len(rows), *(sum(r["verdict"] == v for r in rows) for v in _COLOURS)]


def by_group(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row of `BY_GROUP` for each group of cases and each chain."""
    return [
        BY_GROUP.row({"group": group, "chain": chain} | _summed(mine))
        for group in _GROUPS
        for chain, mine in grouped((r for r in rows if r["group"] == group), "chain").items()
    ]


def _summed(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Rows as one: sums of counts, the largest errors."""
    counts = dict(zip(("rows", *_COLOURS), _verdicts(rows), strict=True))
    summed = {"frames": "frames", "declared": "valid", "wrong_frames": "wrong", "silenced": "silenced"}
    largest = {"worst_error_m": "error_m", "worst_output": "output_error"}
    sums = {name: sum(r[key] or 0 for r in rows) for name, key in summed.items()}
    known = {name: [r[key] for r in rows if r[key] is not None] for name, key in largest.items()}
    return counts | sums | {name: max(values, default=None) for name, values in known.items()}


def _group_table(rows: Sequence[dict[str, Any]]) -> str:
    """One line per group, all chains together."""
    lines = []
    for group, title in _GROUPS.items():
        mine = [r for r in rows if r["group"] == group]
        if mine:
            s = _summed(mine)
            frames = [f"{s['declared']} of {s['frames']}", s["wrong_frames"], s["silenced"]]
            lines.append([title, len({r["case"] for r in mine}), *(s[v] for v in _COLOURS), *frames])
    return table(["group", "cases", *_COLOURS, "declared", "wrong", "silenced"], lines)


def _not_passed(tables: Mapping[str, Sequence[dict[str, Any]]]) -> str:
    """Lines of the cases and chains that did not pass, then of the checks; empty if all passed."""
    bad = [r for r in tables["rows"] if r["verdict"] in ("WRONG", "FAIL")]
    found = [r["reasons"] if r["wrong"] is None else f"{r['wrong']} of {r['frames']} wrong" for r in bad]
    lines = [[r["chain"], r["case"], what] for r, what in zip(bad, found, strict=True)]
    lines.sort(key=lambda line: line[0])
    for line in failures(tables | {"rows": []}):
        check, _, verdict = line.rpartition(": ")
        chain, _, case = check.rpartition(": ")
        lines.append([chain, case, verdict])
    return table(["chain", "case", "found"], lines) if lines else ""


def _step_table(rows: Sequence[dict[str, Any]]) -> str:
    shown = {"spread": ".0e", "condition": ".2e", "theory": ".3e", "measured": ".3e", "ratio": ".2f"}
    lines = [[format(r[name], form) for name, form in shown.items()] for r in rows]
    return table("spectral spread | condition number | theory | measured | measured / theory", lines)


def _check_table(rows: Sequence[dict[str, Any]]) -> str:
    """A line per check, its methods together."""
    checks: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for row in rows:
        method, _, check = row["check"].partition(": ")
        known = method in METHODS
        checks.setdefault(check if known else row["check"], []).append((method if known else "", row))
    lines = []
    for check, mine in checks.items():
        found = [row for _, row in mine]
        methods = ", ".join(f"`{m}` {r['verdict']}" for m, r in mine if m and r["verdict"] != "pass")
        verdict = "pass" if all(r["verdict"] == "pass" for r in found) else methods or found[0]["verdict"]
        many = len(found) if mine[0][0] else ""
        lines.append([check, many, _span(found, "value"), _span(found, "bound"), found[0]["unit"], verdict])
    return table("check | methods | value | bound | unit | verdict", lines)


def _span(rows: Sequence[dict[str, Any]], name: str) -> str:
    """The one value, or the smallest and the largest."""
    ends = {_brief(end([r[name] for r in rows if r[name] is not None], default=None)) for end in (min, max)}
    return " to ".join(sorted(ends, key=lambda text: float(text or 0)))


def _brief(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def _draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """A bar for every chain and group, divided by verdict, with the number of cases that passed."""
    from matplotlib.patches import Patch

    chains = grouped(rows, "chain")
    groups = [group for group in _GROUPS if any(r["group"] == group for r in rows)]
    figure = new_figure(7.0, 1.7 + 0.25 * len(chains))
    axes = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axis, group in zip(axes, groups, strict=True):
        for y, mine in enumerate(chains.values()):
            count, *found = _verdicts([r for r in mine if r["group"] == group])
            left = 0.0
            for share, colour in zip(found, _COLOURS.values(), strict=True):
                axis.barh(y, share / max(count, 1), left=left, color=colour, height=0.8)
                left += share / max(count, 1)
            axis.text(0.5, y, f"{found[0]} of {count}", ha="center", va="center", fontsize=8)
        axis.set_title(textwrap.fill(_GROUPS[group], 15), fontsize=9)
        axis.set_xticks([])
        axis.set_yticks(range(len(chains)), chains, fontsize=9)
        axis.tick_params(length=0)
        axis.spines[:].set_visible(False)
    axis.invert_yaxis()  # of all
    wrong = [chain for chain, mine in chains.items() if any(r["verdict"] in ("WRONG", "FAIL") for r in mine)]
    finding = f"{_verdicts(rows)[1]} of {len(rows)} pass; wrong altitudes: {', '.join(wrong) or 'none'}"
    figure.suptitle(f"{finding}\n{EMITTERS}, unless called ideal", fontsize=9)
    handles = [Patch(color=colour, label=verdict) for verdict, colour in _COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=9, frameon=False)
    save_figure(figure, path)
