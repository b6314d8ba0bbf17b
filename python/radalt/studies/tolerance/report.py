"""Page and figure of the tolerance campaign."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from ...core.deramp.profile import Profile, load_profile
from ...core.interference.emitters.faa_91_220 import MAX_ALTITUDE_FT, pfd_dbw_per_m2_mhz
from ...evaluation.engine.study import Run
from ...evaluation.results.figure import new_figure, save_figure, say
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.page import write_result
from ...evaluation.results.table import DASH, table
from .criteria import CRITERIA, HIGHEST_DBM, RUN_IN
from .interferers import INTERFERERS
from .study import ToleranceStudy

MARGIN_DB = 6.0  # safety margin that compatibility studies add
# Okabe and Ito's colours and a marker, in the order of the interferers
_STYLES = (
    ("#000000", "o"), ("#E69F00", "s"), ("#0072B2", "D"), ("#009E73", "^"), ("#D55E00", "v"), ("#CC79A7", "P"),
    ("#56B4E9", "X"), ("#8C6D31", "*"), ("#7F7F7F", "h"),
)  # fmt: skip


@dataclass(frozen=True)
class Pooled:
    """Break-point of one interferer, method and altitude over all seeds.

    Attributes
    ----------
    mean, half : float
        Mean, and half width of the 95 % interval (Student's t; at least the bisection's 0.5 dB), in dBm at the port;
        NaN if no seed has a break-point.
    open : int
        Number of seeds without a break-point.
    highest : int
        Highest level searched.
    clean : bool
        Whether the altimeter works without interference.
    density, margin : float
        The mean as dBm/MHz at the port, and in dB above Table 1 (NaN where that does not apply).
    first : str
        Criteria that failed first in any seed.
    """

    mean: float
    half: float
    open: int
    highest: int
    clean: bool
    density: float
    margin: float
    first: str


def pooled(rows: Sequence[Mapping[str, Any]], highest_dbm: int = HIGHEST_DBM) -> Pooled:
    """Pooled rows of one interferer, method and altitude, searched up to a level."""

    def mean(name: str) -> float:
        values = [r[name] for r in rows if r.get(name) is not None]
        return float(np.mean(values)) if values else float("nan")

    levels = np.array([r["break_dbm"] for r in rows if r.get("break_dbm") is not None])
    clean = not any(r["first"].startswith("without interference") for r in rows)
    half = 0.5
    if levels.size > 1:
        t = float(special.stdtrit(levels.size - 1, 0.975))
        half = max(half, t * float(levels.std(ddof=1)) / np.sqrt(levels.size))
    words = dict.fromkeys(word for r in rows for word in r["first"].split() if word in CRITERIA)
    return Pooled(
        mean=float(levels.mean()) if levels.size else float("nan"),
        half=half,
        open=sum(r["first"] == "none" for r in rows),
        highest=highest_dbm,
        clean=clean,
        density=mean("break_dbm_per_mhz"),
        margin=mean("margin_db"),
        first=", ".join(words),
    )


def _groups(rows: Sequence[Mapping[str, Any]], profile: Profile) -> dict[tuple[str, str, float], Pooled]:
    """(method, interferer, altitude) -> break-point."""
    found: dict[tuple[str, str, float], list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault((row["method"], row["interferer"], row["altitude_ft"]), []).append(row)
    return {key: pooled(same, INTERFERERS[key[1]].highest_dbm(profile)) for key, same in found.items()}


def write_report(
    folder: RunFolder, study: ToleranceStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write ``report.md``, ``report.json`` and the figure; returns the page."""
    profile = load_profile(study.profile)
    groups = _groups(rows["rows"], profile)
    table_1 = float(pfd_dbw_per_m2_mhz(profile.carrier_hz))
    figures = {method: figure_name(study, method) for method in study.methods}
    for method, name in figures.items():
        save_figure(draw(profile, study, groups, method), folder.path / name)
    values = {
        "profile": profile,
        "study": study,
        "duration_s": study.outputs * profile.output_s,
        "figures": figures,
        "break_tables": {m: _break_table(study, groups, m) for m in study.methods},
        "margin_table": _margin_table(study, groups),
        "gain_table": _gain_table(study, groups),
        "number_table": _number_table(profile),
        "criteria": CRITERIA,
        "margin_db": MARGIN_DB,
        "table_1": table_1,
        "table_1_at_port": table_1 - profile.flux_dbw_per_m2_mhz(0.0),
        "dash": DASH,
        "run_in": RUN_IN,
    }
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), rows, values)


def _level(found: Pooled) -> str:
    if not found.clean:
        return "fails without interference"
    if found.open and np.isnan(found.mean):
        return f"> {found.highest}"
    open_end = f" ({found.open} open)" if found.open else ""
    return f"{found.mean:.1f} ± {found.half:.1f}{open_end}, {found.density:.1f}"


def _break_table(study: ToleranceStudy, groups: Mapping[tuple[str, str, float], Pooled], method: str) -> str:
    header = ["interferer", *(f"{feet:g} ft" for feet in study.altitudes_ft), "first to fall"]
    lines = []
    for name in study.interferers:
        found = [groups[method, name, feet] for feet in study.altitudes_ft]
        words = dict.fromkeys(w for f in found for w in f.first.split(", ") if w)
        lines.append([INTERFERERS[name].title, *map(_level, found), ", ".join(words) or DASH])
    return table(header, lines)


def _margin_table(study: ToleranceStudy, groups: Mapping[tuple[str, str, float], Pooled]) -> str:
    """Margin to Table 1 at the altitudes where it applies, without and with 6 dB."""
    low = [feet for feet in study.altitudes_ft if feet <= MAX_ALTITUDE_FT]
    if not low:
        return ""
    lines = []
    for name in study.interferers:
        cells = [INTERFERERS[name].title]
        for feet in low:
            for method in study.methods:
                margin = groups[method, name, feet].margin
                cells.append(DASH if np.isnan(margin) else f"{margin:+.1f} / {margin - MARGIN_DB:+.1f}")
        lines.append(cells)
    return table(["interferer", *(f"{feet:g} ft, {m}" for feet in low for m in study.methods)], lines)


def _gain_table(study: ToleranceStudy, groups: Mapping[tuple[str, str, float], Pooled]) -> str:
    """Gain in dB of each method over none."""
    others = [m for m in study.methods if m != "none"]
    if not others or "none" not in study.methods:
        return ""
    lines = []
    for name in study.interferers:
        for method in others:
            cells = [f"{INTERFERERS[name].title}, {method}"]
            for feet in study.altitudes_ft:
                without, with_it = groups["none", name, feet], groups[method, name, feet]
                if np.isnan(without.mean):
                    cells.append(DASH)
                elif with_it.open and np.isnan(with_it.mean):
                    cells.append(f"> {with_it.highest - without.mean:+.0f}")
                else:
                    cells.append(f"{with_it.mean - without.mean:+.1f}")
            lines.append(cells)
    return table(["interferer, method", *(f"{feet:g} ft" for feet in study.altitudes_ft)], lines)


def _number_table(profile: Profile) -> str:
    lines = [
        [f"`{name}`", f"{getattr(profile, name):g}", level, source]
        for name, (level, source) in profile.standing.items()
    ]
    return table(["number", "value", "standing", "source"], lines)


def figure_name(study: ToleranceStudy, method: str) -> str:
    """File of a method's figure; that of the first is the one to publish."""
    return "tolerance.png" if method == study.methods[0] else f"tolerance_{method}.png"


def draw(
    profile: Profile, study: ToleranceStudy, groups: Mapping[tuple[str, str, float], Pooled], method: str
) -> Any:
    """Break-points over altitude as densities at the port, with the density that Table 1 allows in the band."""
    figure = new_figure(4.8, 4.8)
    axis = figure.subplots()
    for k, name in enumerate(study.interferers):
        colour, marker = _STYLES[k % len(_STYLES)]
        found = [groups[method, name, feet] for feet in study.altitudes_ft]
        y = np.array([f.density for f in found])
        title, pairs = INTERFERERS[name].title, zip(study.altitudes_ft, found, strict=True)
        style = {"color": colour, "marker": marker, "markersize": 5, "linewidth": 1.3, "capsize": 2}
        axis.errorbar(study.altitudes_ft, y, yerr=[f.half for f in found], label=title, **style)
        say(axis, study.altitudes_ft, y, [f"{title}, {feet:g} ft: {_level(f)}" for feet, f in pairs])
    low = min(study.altitudes_ft)
    if low < MAX_ALTITUDE_FT:
        rule = float(pfd_dbw_per_m2_mhz(profile.carrier_hz)) - profile.flux_dbw_per_m2_mhz(0.0)
        axis.plot([low, MAX_ALTITUDE_FT], [rule, rule], color="#444444", linewidth=2.5, linestyle=(0, (4, 2)))
        words, place = "14 CFR 91.220(b),\nin band", {"textcoords": "offset points", "fontsize": 8}
        axis.annotate(words, (low, rule), (2, -5), color="#444444", verticalalignment="top", **place)
    axis.set_xscale("log")
    axis.set_xticks(study.altitudes_ft, [f"{feet:,g}" for feet in study.altitudes_ft])
    axis.minorticks_off()
    axis.grid(True, linewidth=0.4, alpha=0.5)
    axis.set_xlabel("altitude, ft")
    axis.set_ylabel("power density at the port, dBm/MHz")
    mitigation = "without mitigation" if method == "none" else f"with {method}"
    axis.set_title(f"{mitigation}: usable below the line", fontsize=10)
    figure.legend(
        *axis.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8, frameon=False
    )
    return figure
