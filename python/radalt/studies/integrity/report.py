"""Page of the integrity campaign: pooled cases, every hazardous output, two figures."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from ...evaluation.engine.study import Run
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.integrity import Integrity
from ...evaluation.results.page import write_result
from ...evaluation.results.rows import grouped
from ...evaluation.results.score import Score, clopper_pearson_bound
from ...evaluation.results.table import DASH, number, table
from .cases import ATTITUDES, BLOCK, KINDS, LONG, STRATA, WAVEFORM, case_of, stratum_of
from .columns import BY_KIND, EVENTS, FRAMES, POOLED, ROWS
from .study import IntegrityStudy

Row = Mapping[str, Any]
_START = 2  # outputs at the start of a flight that cannot have an altitude: three confirm a track
_BANDS_M = 0.0, 100.0, 300.0, 1000.0, 1500.0  # altitudes by which rates are given
_LISTED = 200  # most flights with hazardous outputs in the page; events.csv has all


def _after_start(total: Integrity, flights: int) -> float:
    """Availability without the first outputs of each flight, before a track can be confirmed."""
    outputs = total.outputs - _START * flights
    return (total.computed - total.unbounded) / outputs if outputs > 0 else float("nan")


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows as one: sums of counts, their rates and bounds, median time to the first output, longest time to alert."""
    total = sum((Integrity.of_row(r) for r in rows), Integrity())
    frames = Score(**{name: sum(r[name] for r in rows) for name in FRAMES})
    first = [r["first_s"] for r in rows if r["first_s"] is not None]
    alert = [r["alert_s"] for r in rows if r["alert_s"] is not None]
    ground = all(case_of(r["case"]).ground for r in rows)
    return {
        **rows[0],
        **total.row(),
        "parts": len(rows),
        "after_start": _after_start(total, len(rows)),
        "first_s": float(np.median(first)) if first else None,
        "alert_s": max(alert, default=None),
        **{
            name: sum(r[name] for r in rows)
            for name in ("unalerted", "misleading_events", "hazardous_events")
        },
        "largest_m": max(r["largest_m"] or 0.0 for r in rows),
        "altitude_m": float(np.mean([r["altitude_m"] or np.nan for r in rows])),
        "ms_per_frame": float(np.mean([r["ms_per_frame"] for r in rows])),
        **{name: getattr(frames, name) for name in FRAMES},
        "pd": frames.pd if ground else None,
        "pd_3pct": frames.pd_3pct if ground else None,
        "wrong": frames.wrong,
        "wrong_bound": frames.wrong_bound,
    }


def pooled(rows: Iterable[Row], *names: str) -> list[dict[str, Any]]:
    """`summarise` of all rows that share the values of columns, in the order of the first of each."""
    return [summarise(mine) for mine in grouped(rows, *names).values()]


def events_of(rows: Sequence[Row], study: IntegrityStudy) -> list[dict[str, Any]]:
    """A row of `EVENTS` for every hazardous output."""
    out = []
    for row in rows:
        for event in (row["events"] or "").split():
            values = dict(zip(EVENTS.names[4:9], event.split(","), strict=True))
            numbers = {k: float(v) if v else None for k, v in values.items()}
            where = {"replay": f"{row['case']}:{study.seed}:{row['batch']}", "seed": study.seed}
            where["cause"] = case_of(row["case"]).known
            out.append(EVENTS.row({**row, **numbers, **where}))
    return out


def write_report(
    folder: RunFolder, study: IntegrityStudy, tables: Mapping[str, Sequence[Row]], run: Run
) -> Path:
    """Write figures, tables, ``report.md`` and ``report.json``; returns the page."""
    from .figures import draw_land, draw_sir, draw_stanford

    rows = tables["rows"]
    # a flight in two files counts once; of those without an altitude nothing shows that they are the same
    same = [name for name in ROWS.names if name not in ROWS.timing]
    earlier = study.earlier()
    each = enumerate([*earlier, *rows])
    flown = [*{(*map(row.get, same), row["largest_m"] or k): row for k, row in each}.values()]
    by_case = pooled(rows, "case", "method")
    events = events_of(rows, study)
    by_kind = _by_kind(rows)
    folder.write_text("cases.csv", POOLED.csv(map(POOLED.row, by_case)))
    folder.write_text("kinds.csv", BY_KIND.csv(map(BY_KIND.row, by_kind)))
    folder.write_text("events.csv", EVENTS.csv(events))
    folder.write_text("flights.csv", ROWS.csv(flown))
    draw_stanford(rows, folder.path / "figures" / "integrity_stanford.png")
    draw_sir(rows, folder.path / "figures" / "integrity_sir.png")
    land = pooled((r for r in flown if r["kind"] == "land"), "case", "method")
    draw_land(land, folder.path / "figures" / "integrity_land.png")
    short = [r for r in by_kind if r["kind"] not in LONG]
    default = "tcae" if "tcae" in study.methods else study.methods[-1]
    further = [r for r in earlier if r["kind"] not in LONG and not case_of(r["case"]).known_limit]
    report = {"headline": _headline(rows, by_case, default), "hazardous": len(events), "events": events}
    values = {
        "flight_s": study.frames * WAVEFORM.sweep_s,
        "hours": _hours_of([r for r in flown if r["kind"] in LONG]),
        "hours_table": _hours_table(flown),
        "hours_behind": {
            m: _hours_of([r for r in flown if r["method"] == m])["hours"] for m in study.methods
        },
        "further": {method: _claim(mine) for method, mine in grouped(further, "method").items()},
        "attitude_table": _attitude_table(land),
        "kind_table": _kind_table([r for r in short if not r["known_limit"]]),
        "outside_table": _kind_table([r for r in short if r["known_limit"]]),
        "unavailable_table": _unavailable_table(by_case, default),
        "event_table": _event_table(events),
        "flights_listed": _LISTED,
        "flights_with_events": len({(e["replay"], e["cause"]) for e in events}),
        "above": _above,
    }
    return write_result(folder, Path(__file__).with_name("report.md.j2"), run.as_dict(), report, values)


def _above(bound: float) -> str:
    """A bound of two digits that holds: rounded up; a dash for none."""
    if np.isnan(bound):
        return DASH
    step = 10.0 ** (np.floor(np.log10(bound)) - 1.0)
    return f"{np.ceil(bound / step - 1e-9) * step:.1e}"


def _per_altitude(total: Integrity) -> float:
    """95 % bound of the share of hazardous ones among the altitudes given; NaN without any."""
    return clopper_pearson_bound(total.hazardous, total.computed) if total.computed else np.nan


def _claim(rows: Sequence[Row]) -> dict[str, Any]:
    """Outputs and flights, hazardous ones of each, 95 % bounds; outputs of a flight are not independent.

    Methods fly the same flights: a bound per output, and per altitude given, is that of the worst method alone.
    """
    total = sum((Integrity.of_row(r) for r in rows), Integrity())
    each = [sum(map(Integrity.of_row, mine), Integrity()) for mine in grouped(rows, "method").values()]
    given = [_per_altitude(one) for one in each if one.computed]
    flights = {(r["case"], r["batch"]) for r in rows}
    wrong = {(r["case"], r["batch"]) for r in rows if r["hazardous"]}
    return {
        "outputs": total.outputs,
        "silent": total.outputs - total.computed,
        "hazardous": total.hazardous,
        "bound": max((one.bound("hazardous") for one in each), default=1.0),
        "given_bound": max(given, default=np.nan),
        "flights": len(flights),
        "hazardous_flights": len(wrong),
        "flight_bound": clopper_pearson_bound(len(wrong), len(flights)),
    }


def _hours_of(rows: Sequence[Row]) -> dict[str, Any]:
    """Flights, hours, availability, events, and the 95 % bound of hazardous events per hour, of independent events."""
    total = sum((Integrity.of_row(r) for r in rows), Integrity())
    hours = total.outputs * BLOCK * WAVEFORM.sweep_s / 3600.0
    events = {name: sum(r[f"{name}_events"] for r in rows) for name in ("misleading", "hazardous")}
    most = float(stats.chi2.ppf(0.95, 2 * events["hazardous"] + 2)) / 2.0
    return {
        "flights": len(rows),
        "hours": hours,
        "given": total.computed,
        "given_bound": _per_altitude(total),
        "available": _after_start(total, len(rows)),
        **events,
        "hazardous_flights": sum(r["hazardous_events"] > 0 for r in rows),
        "most": most,
        "bound": most / hours if hours else np.inf,
        "largest_m": max((r["largest_m"] or 0.0 for r in rows), default=0.0),
        "minutes": float(np.mean([r["ms_per_frame"] for r in rows])) * 60.0 if rows else np.nan,
    }


def _weighted(strata: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """`_hours_of` all strata, availability and bound weighted by their shares of the time in the air."""
    shares = np.array([STRATA[name][0] for name in strata])
    shares /= shares.sum()
    each = [_hours_of(rows) for rows in strata.values()]
    total = _hours_of([row for rows in strata.values() for row in rows])
    per_hour = max(share / one["hours"] for share, one in zip(shares, each, strict=True))
    available = float(shares @ [one["available"] for one in each])
    return total | {"available": available, "bound": total["most"] * per_hour, "given_bound": np.nan}


def _hours_table(rows: Sequence[Row]) -> str:
    """A line per stratum and method inside the claim, and for all; then per altitude, of the long flights."""
    inside = [r for r in rows if not case_of(r["case"]).known_limit]
    lines = []

    def line(name: str, method: str, share: str, h: Mapping[str, Any]) -> None:
        counts = h["misleading"], h["hazardous"], h["hazardous_flights"]
        shown = number(h["bound"], 1), _above(h["given_bound"])
        rest = number(h["largest_m"], 1), number(h["minutes"], 0)
        flown = h["flights"], number(h["hours"], 2), number(h["available"], 3)
        lines.append([name, method, share, *flown, *counts, *shown, *rest])

    for method, mine in grouped(inside, "method").items():
        strata = {name: [r for r in mine if stratum_of(case_of(r["case"])) == name] for name in STRATA}
        strata = {name: found for name, found in strata.items() if found}
        for name, found in strata.items():
            line(name, method, f"{STRATA[name][0]:g}", _hours_of(found))
        line("**all, as flown**", method, "", _hours_of(mine))
        line("**all, weighted**", method, "", _weighted(strata))
    for low, high in zip(_BANDS_M, _BANDS_M[1:], strict=False):
        if mine := [r for r in rows if r["kind"] in LONG and low <= r["altitude_m"] < high]:
            line(f"land and points, {low:g} to {high:g} m", "none", "", _hours_of(mine))
    header = "stratum | method | share | flights | hours | available | misleading events | hazardous events"
    header += " | flights with one | bound per hour | per altitude | largest error / m | CPU min per hour"
    return table(header, lines)


def _attitude_table(land: Sequence[Row]) -> str:
    """A line per attitude over land."""
    lines = []
    for attitude in ATTITUDES:
        mine = [r for r in land if r["case"].endswith(f"/{attitude}")]
        if mine:
            h = _hours_of(mine)
            frames = Score(**{name: sum(r[name] for r in mine) for name in FRAMES})
            least = min(mine, key=lambda r: r["after_start"])
            worst = f"{number(least['after_start'])} {least['case'].split('/')[1]}"
            shares = number(h["available"], 3), worst, number(h["largest_m"], 1)
            lines.append([attitude, *shares, number(frames.pd), number(frames.pd_3pct)])
    return table("attitude | available | least | largest error / m | Pd per frame | 5 m or 3 %", lines)


def _headline(rows: Sequence[Row], by_case: Sequence[Row], default: str) -> dict[str, Any]:
    """Numbers of the first paragraph: claims of all methods and of the default one, and availability."""
    inside = [r for r in rows if not case_of(r["case"]).known_limit]
    names = {r["case"] for r in _visible(by_case, default)}
    seen = [r for r in rows if r["method"] == default and r["case"] in names]

    def share(mine: Sequence[Row]) -> dict[str, float]:
        total = sum((Integrity.of_row(r) for r in mine), Integrity())
        return {"all": total.availability, "after_start": _after_start(total, len(mine))}

    return {
        "default": default,
        "cases": len({r["case"] for r in rows}),
        "cases_inside": len({r["case"] for r in inside}),
        "inside": _claim(inside),
        "of_default": _claim([r for r in inside if r["method"] == default]),
        "all": _claim(rows),
        "visible_cases": len(names),
        "availability": share(seen),
        "availability_jammed": share([r for r in seen if r["kind"] == "jammed"]),
    }


def _visible(by_case: Sequence[Row], default: str) -> list[Row]:
    """Cases in which the default method has a Pd per frame of one half or more."""
    return [r for r in by_case if r["method"] == default and (r["pd"] or 0.0) >= 0.5]


def _unavailable_table(by_case: Sequence[Row], default: str) -> str:
    """A line per kind with visible cases (`_visible`) of which less than 0.99 is available after the start."""
    lines = []
    for kind, what in KINDS.items():
        seen = [r for r in _visible(by_case, default) if r["kind"] == kind]
        poor = [r for r in seen if not r["after_start"] >= 0.99]
        if poor:
            failures, unbounded = (sum(r[name] for r in poor) for name in ("failures", "unbounded"))
            silent = sum(r["outputs"] - r["computed"] for r in poor) - failures
            least = min(poor, key=lambda r: r["after_start"])
            worst = f"{number(least['after_start'])} in `{least['case']}`"
            lines.append([what, f"{len(poor)} of {len(seen)}", worst, failures, silent, unbounded])
    header = "case | below 0.99 after the start | least | failure | no computed data | beyond the alert limit"
    return table(header, lines) if lines else ""


def _rate(value: float) -> str:
    return f"{value:.1e}" if value else "0"


def _by_kind(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """`summarise` by kind and method, separately inside and outside the claim."""
    known = (r | {"known_limit": case_of(r["case"]).known_limit} for r in rows)
    found = pooled(known, "kind", "known_limit", "method")
    return sorted(found, key=lambda r: (list(KINDS).index(r["kind"]), r["known_limit"]))


def _kind_table(found: Sequence[Row]) -> str:
    """A line per kind, its methods side by side; empty without rows."""
    methods, lines = dict.fromkeys(r["method"] for r in found), []
    for kind, of in grouped(found, "kind").items():
        at = {r["method"]: r for r in of}
        mine = [at[m] for m in methods]
        given = [_per_altitude(Integrity.of_row(r)) for r in mine if r["computed"]]
        bounds = _above(max(r["hazardous_bound"] for r in mine)), _above(max(given, default=np.nan))
        counts = (sum(r[name] for r in mine) for name in ("misleading", "hazardous"))
        available, pd = (" / ".join(number(r[name]) for r in mine) for name in ("after_start", "pd"))
        wrong = " / ".join(_rate(r["wrong"] / r["trials"] if r["trials"] else 0.0) for r in mine)
        lines.append([KINDS[kind], mine[0]["parts"], available, *counts, *bounds, pd, wrong])
    header = "case | flights | available after the start | misleading | hazardous | bound per output | per altitude"
    return table(f"{header} | Pd per frame | wrong per frame", lines) if lines else ""


def _event_table(events: Sequence[Row]) -> str:
    """A line per flight: outputs of each method, frames, the worst error, the words that replay it."""
    events = sorted(events, key=lambda e: bool(e["cause"]))  # those at no stated limit first
    lines = []
    for (replay, cause), mine in list(grouped(events, "replay", "cause").items())[:_LISTED]:
        errors = [abs(e["altitude_m"] - e["truth_m"]) for e in mine if e["truth_m"] is not None]
        frames = [e["frame_index"] for e in mine]
        methods = dict.fromkeys(e["method"] for e in mine)
        outputs = ", ".join(f"{m} {sum(e['method'] == m for e in mine)}" for m in methods)
        worst = number(max(errors), 1) if errors else "no return"
        level = number(max(e["protection_level_m"] for e in mine), 1)
        where = f"`{replay}`", outputs, f"{min(frames)}{DASH}{max(frames)}"
        lines.append([*where, worst, level, cause or "**none stated**"])
    return table("case:seed:batch | outputs of | frames | worst error / m | level / m | stated limit", lines)
