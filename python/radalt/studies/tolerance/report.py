"""Page and figures of the tolerance campaign."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from ...core.deramp.profile import Profile, load_profile
from ...core.interference.emitters.faa_91_220 import MAX_ALTITUDE_FT
from ...evaluation.engine.study import Run
from ...evaluation.results.figure import new_figure, save_figure, say
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.labels import name_curves
from ...evaluation.results.page import write_result
from ...evaluation.results.rows import grouped as rows_by
from ...evaluation.results.table import DASH, table
from .criteria import CRITERIA, HIGHEST_DBM, RUN_IN
from .interferers import INTERFERERS, MECHANISMS
from .study import ToleranceStudy

MARGIN_DB = 6.0  # safety margin that compatibility studies add
# Thresholds of one FMCW altimeter under 5G in dBm, by the abstract of Aerospace 2025, 12(1), 16: 1 to 6 and -4 to 0
PUBLISHED_DBM = {"nr100_3930": (-4.0, 6.0, "one altimeter, measured (Aerospace 2025)")}
# Okabe and Ito's colours and a marker, in the order of the interferers
STYLES = [*zip("#0072B2 #000000 #D55E00 #009E73 #CC79A7 #7F7F7F".split(), "Dov^Ph", strict=True)]


@dataclass(frozen=True)
class Pooled:
    """Break-point of one interferer, method and altitude over all seeds.

    - ``mean``, ``half``: mean, and half width of the 95 % interval (Student's t; at least the bisection's 0.5 dB), in
      dBm at the port; NaN if no seed has a break-point
    - ``flux``, ``margin``: the mean as power flux density in dBW/m^2/MHz, and in dB above Table 1 (NaN where that
      does not apply)
    """

    mean: float
    half: float
    open: int  # number of seeds without a break-point
    highest: int  # highest level searched
    clean: bool  # whether the altimeter works without interference
    flux: float
    margin: float
    first: str  # criteria that failed first in any seed


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
        flux=mean("break_dbw_per_m2_mhz"),
        margin=mean("margin_db"),
        first=", ".join(words),
    )


# profile, mechanisms, method, interferer, altitude
Groups = Mapping[tuple[str, str, str, str, float], Pooled]


def grouped(rows: Sequence[Mapping[str, Any]], profiles: Sequence[Profile]) -> Groups:
    """Break-points over all seeds."""
    by_name = {p.name: p for p in profiles}
    found = rows_by(rows, "profile", "mechanisms", "method", "interferer", "altitude_ft")
    return {k: pooled(same, INTERFERERS[k[3]].highest_dbm(by_name[k[0]])) for k, same in found.items()}


def write_report(
    folder: RunFolder, study: ToleranceStudy, rows: Mapping[str, list[dict[str, Any]]], run: Run
) -> Path:
    """Write ``report.md``, ``report.json`` and the figure; returns the page."""
    profiles = [load_profile(name) for name in study.profiles]
    groups = grouped(rows["rows"], profiles)
    figures = {method: figure_name(study, method) for method in study.methods}
    for method, name in figures.items():
        save_figure(draw(profiles, study, groups, method), folder.path / name)
    values = {
        "verdict": _verdict(groups, study.methods[0]),
        "profiles": profiles,
        "study": study,
        "figures": figures,
        "break_tables": {m: _break_table(profiles, study, groups, m) for m in study.methods},
        "margin_table": _margin_table(profiles, study, groups),
        "mechanism_table": _mechanism_table(profiles, study, groups) if study.decompose else "",
        "unlock_table": _unlock_table(profiles, study, rows["rows"]),
        "gain_table": _gain_table(profiles, study, groups),
        "number_tables": {p.name: _number_table(p) for p in profiles},
        "criteria": CRITERIA,
        "margin_db": MARGIN_DB,
        "dash": DASH,
        "run_in": RUN_IN,
    }
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), rows, values)


def _verdict(groups: Groups, method: str) -> str:
    """The altimeter that breaks first, and how many break-points are below what Table 1 asks for."""
    known = {k: f for k, f in groups.items() if k[1:3] == ("all", method) and not np.isnan(f.mean)}
    if not known:
        return "**No break-point was found up to the highest level.** Simulated."
    profile, *_, name, feet = first = min(known, key=lambda key: known[key].mean)
    margins = [f.margin for f in known.values() if not np.isnan(f.margin)]
    return (
        f"**`{profile}` breaks first, at {known[first].mean:.1f} dBm at its port, under {INTERFERERS[name].title} at "
        f"{feet:,g} ft** ({known[first].first}). {sum(m < 0 for m in margins)} of {len(margins)} are below "
        "what 14 CFR 91.220(b) Table 1 asks for. Simulated; the altimeters are fitted models."
    )


def _level(found: Pooled | None) -> str:
    """Mean power in dBm at the port with its interval, without flux."""
    if found is None:
        return "beyond the span"
    if not found.clean:
        return "fails without interference"
    if found.open and np.isnan(found.mean):
        return f"> {found.highest}"
    open_end = f" ({found.open} open)" if found.open else ""
    return f"{found.mean:.1f} ± {found.half:.1f}{open_end}"


def _feet(study: ToleranceStudy) -> list[str]:
    return [f"{feet:,g} ft" for feet in study.altitudes_ft]


def _break_table(profiles: Sequence[Profile], study: ToleranceStudy, groups: Groups, method: str) -> str:
    lines = []
    for p, name in product(profiles, study.interferers):
        found = [groups.get((p.name, "all", method, name, feet)) for feet in study.altitudes_ft]
        cells = [_level(f) + (f", {f.flux:.1f}" if f and not np.isnan(f.flux) else "") for f in found]
        words = dict.fromkeys(w for f in found if f for w in f.first.split(", ") if w)
        lines.append([f"{p.name}, {INTERFERERS[name].title}", *cells, ", ".join(words) or DASH])
    return table(["altimeter, interferer", *_feet(study), "first to fall"], lines)


def _margin_table(profiles: Sequence[Profile], study: ToleranceStudy, groups: Groups) -> str:
    """Margin to Table 1 at the altitudes where it applies, without and with 6 dB."""
    low = [feet for feet in study.altitudes_ft if feet <= MAX_ALTITUDE_FT]
    lines = []
    for p, name in product(profiles, study.interferers):
        cells = [f"{p.name}, {INTERFERERS[name].title}", f"{study.asked(p, INTERFERERS[name]):g}"]
        for feet, method in product(low, study.methods):
            f = groups.get((p.name, "all", method, name, feet))
            known = f is not None and not np.isnan(f.margin)
            cells.append(f"{f.margin:+.1f} / {f.margin - MARGIN_DB:+.1f}" if known else DASH)
        lines.append(cells)
    header = ["altimeter, interferer", "Table 1, dBW/m²/MHz"]
    header += [f"{feet:g} ft, {m}" for feet, m in product(low, study.methods)]
    return table(header, lines) if low else ""


def _mechanism_table(profiles: Sequence[Profile], study: ToleranceStudy, groups: Groups) -> str:
    """What every mechanism costs: break-point with it alone, and what switching it off gains in dB."""
    lines = []
    for p, name, method, mechanism in product(profiles, study.interferers, study.methods, MECHANISMS):
        keys = ((p.name, f"without {mechanism}", method, name, feet) for feet in study.altitudes_ft)
        if not any(key in groups for key in keys):
            continue
        cells = [f"{p.name}, {INTERFERERS[name].title}, {method}", mechanism]
        for feet in study.altitudes_ft:
            alone, without, whole = (
                groups.get((p.name, case, method, name, feet))
                for case in (f"alone {mechanism}", f"without {mechanism}", "all")
            )
            cells.append(f"{_level(alone) if alone else DASH} / {_gained(whole, without)}")
        lines.append(cells)
    return table(["altimeter, interferer, method", "mechanism", *_feet(study)], lines)


def _unlock_table(
    profiles: Sequence[Profile], study: ToleranceStudy, rows: Sequence[Mapping[str, Any]]
) -> str:
    """Loop loss at each altitude, and that at which a criterion falls without interference."""
    lines = []
    for p in profiles:
        cells = []
        for feet in study.altitudes_ft:
            mine = [r for r in rows if (r["profile"], r["altitude_ft"]) == (p.name, feet)]
            lost = [r["unlock_loss_db"] for r in mine if r.get("unlock_loss_db") is not None]
            cells.append(f"{mine[0]['loop_loss_db']:.1f} / {min(lost):.1f}" if lost else DASH)
        lines.append([p.name, *cells])
    return table(["altimeter", *_feet(study)], lines)


def _gained(without: Pooled | None, with_it: Pooled | None) -> str:
    """How far a break-point has moved up, in dB."""
    if without is None or with_it is None or np.isnan(without.mean):
        return DASH
    if with_it.open and np.isnan(with_it.mean):
        return f"> {with_it.highest - without.mean:+.0f}"
    return f"{with_it.mean - without.mean:+.1f}"


def _gain_table(profiles: Sequence[Profile], study: ToleranceStudy, groups: Groups) -> str:
    """Gain in dB of each method over none."""
    others = [m for m in study.methods if m != "none"]
    if not others or "none" not in study.methods:
        return ""
    lines = []
    cases = ("all", "without compression") if study.decompose else ("all",)
    for p, name, method, case in product(profiles, study.interferers, others, cases):
        keys = [[(p.name, case, m, name, feet) for m in ("none", method)] for feet in study.altitudes_ft]
        words = f"{p.name}, {INTERFERERS[name].title}, {method}" + (f", {case}" if case != "all" else "")
        lines.append([words, *(_gained(*map(groups.get, k)) for k in keys)])
    return table(["altimeter, interferer, method", *_feet(study)], lines)


def _number_table(profile: Profile) -> str:
    lines = [
        [f"`{name}`", f"{getattr(profile, name):g}", level, source]
        for name, (level, source) in profile.provenance.items()
    ]
    return table(["number", "value", "provenance", "source"], lines)


def figure_name(study: ToleranceStudy, method: str) -> str:
    """File of a method's figure; that of the first is the one to publish."""
    return "tolerance.png" if method == study.methods[0] else f"tolerance_{method}.png"


def draw(profiles: Sequence[Profile], study: ToleranceStudy, groups: Groups, method: str) -> Any:
    """Break-points in dBm over altitude, a panel per interferer, with Table 1 and published thresholds."""
    columns = min(3, len(study.interferers))
    rows = -(-len(study.interferers) // columns)
    figure = new_figure(1.2 + 2.4 * columns, 1.4 + 2.3 * rows)
    axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)).ravel()
    for axis, name in zip(axes, study.interferers, strict=False):
        kind = INTERFERERS[name]
        for p, (colour, marker) in zip(profiles, STYLES, strict=False):
            pairs = [(feet, groups.get((p.name, "all", method, name, feet))) for feet in study.altitudes_ft]
            pairs = [(feet, f) for feet, f in pairs if f is not None]
            feet, y = [feet for feet, _ in pairs], np.array([f.mean for _, f in pairs])
            style = {"color": colour, "marker": marker, "markersize": 5, "linewidth": 1.3, "capsize": 2}
            axis.errorbar(feet, y, yerr=[f.half for _, f in pairs], label=p.name, **style)
            beyond = [(x, f.highest) for x, f in pairs if f.open and np.isnan(f.mean)]
            axis.plot(*zip(*beyond, strict=True) if beyond else ([], []), "^", color=colour, mfc="none", ms=6)
            say(axis, feet, y, [f"{p.name}, {kind.title}, {x:g} ft: {_level(f)} dBm" for x, f in pairs])
        if name in PUBLISHED_DBM:
            low, high, words = PUBLISHED_DBM[name]
            axis.axhspan(low, high, color="#56B4E9", alpha=0.35, linewidth=0)
            axis.axhline(high, color="#56B4E9", linewidth=1, label=words)
        p, low = profiles[0], min(study.altitudes_ft)
        if low < MAX_ALTITUDE_FT and not np.isnan(asked := study.asked(p, kind)):
            rule = asked - kind.flux_dbw_per_m2_mhz(p, 0.0)
            style = {"color": "#444444", "linewidth": 2.5, "label": "14 CFR 91.220(b) Table 1"}
            axis.plot([low, MAX_ALTITUDE_FT], [rule, rule], **style)
        axis.set_title(kind.title, fontsize=9)
        axis.set_xscale("log")
        axis.set_xlim(0.8 * min(study.altitudes_ft), 1.25 * max(study.altitudes_ft))
        axis.set_xlabel("altitude, ft", fontsize=9)
        axis.set_xticks(study.altitudes_ft, [f"{feet:,g}" for feet in study.altitudes_ft], rotation=60)
        axis.minorticks_off()
        axis.grid(True, linewidth=0.4, alpha=0.5)
    for axis in axes[len(study.interferers) :]:
        axis.remove()
    figure.supylabel("mean power at the port, dBm", fontsize=9)
    finding = _verdict(groups, method).split("**")[1].replace("`", "")
    figure.suptitle(textwrap.fill(finding, 40 * columns), fontsize=10.5)
    mitigation = "without mitigation" if method == "none" else f"with {method}"
    figure.supxlabel(
        f"usable below the line, {mitigation}; 95 % intervals; an arrow: holds to the highest level",
        fontsize=8.5,
    )
    name_curves(figure, axes[: len(study.interferers)], size=7.5)
    return figure
