"""Study: tracked flights below base stations, behind any methods."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...evaluation.engine.chain_study import ChainStudy
from ...evaluation.engine.study import Point, Run
from ...evaluation.results.chain import Chain
from ...evaluation.results.figure import COLUMN_IN, new_figure, save_figure
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.integrity import Integrity
from ...evaluation.results.page import write_result
from ...evaluation.results.rows import Columns
from ...evaluation.results.style import series_style
from ...evaluation.results.table import number, table
from .tracked import CONFIRMING, FLIGHTS, FRAMES, NR_MS, TRACKED_COLUMNS, fly


@dataclass(frozen=True)
class FlightPoint(Point):
    """A flight, by its kind (in `FLIGHTS`) and number."""

    flight: str = ""
    number: int = 0


@dataclass(frozen=True)
class FlightsStudy(ChainStudy):
    """The table of docs/tracked_flights.md.

    Attributes
    ----------
    methods : tuple of str
    flights : int
        Flights per kind of interference.
    length_s : int
        Duration of a flight.
    seed : int
    """

    methods: tuple[str, ...] = ("whitening", "tcae")
    flights: int = 100
    length_s: int = 2
    seed: int = 271_828

    tables: ClassVar[Mapping[str, Columns]] = {"rows": TRACKED_COLUMNS}
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "tracked_flights.md",
        "rows.csv": "data/tracked_flights.csv",
        "tracked_flights.png": "figures/tracked_flights.png",
    }

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The methods, each with the default altimeter."""
        return tuple(Chain(m, m) for m in self.methods)

    def points(self) -> Sequence[FlightPoint]:
        """A point per flight."""
        return [
            FlightPoint(f"{kind.title}, {number}", self.length_s * FRAMES, flight=name, number=number)
            for name, kind in FLIGHTS.items()
            for number in range(self.flights)
        ]

    def measure(self, point: FlightPoint) -> list[dict[str, Any]]:
        """A row per method and allowed speed."""
        seed = [self.seed, 97, list(FLIGHTS).index(point.flight), point.number, 0]
        return fly(point.flight, self.methods, np.random.default_rng(seed), point.frames)

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `Study`."""
        report = {"tracked": tracked_table(rows["rows"]), "nr_ms": NR_MS}
        draw_flights(rows["rows"], folder.path / "tracked_flights.png")
        values = {"total": sum(map(Integrity.of_row, rows["rows"]), Integrity())}
        return write_result(
            folder, Path(__file__).with_name("flights.md.j2"), run.as_dict(), report | rows, values
        )


def draw_flights(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Pd per frame and availability tracked, by interference and method, at the least allowed speed.

    Availability is the mean over flights with its 95 % interval; the outputs of a flight are not independent.
    """
    least = min(r["allowed_m_per_s"] for r in rows)
    kinds, methods = (list(dict.fromkeys(r[name] for r in rows)) for name in ("flight", "method"))
    figure = new_figure(COLUMN_IN, 0.9 + 0.3 * len(kinds) * (len(methods) + 1))
    axis = figure.subplots()
    names, place = {}, 0
    for kind in kinds:
        place += 1
        axis.text(0.5, place, FLIGHTS[kind].title, ha="center", va="center", fontsize=9)
        for method in methods:
            place += 1
            names[place] = method
            mine = [
                r for r in rows if (r["flight"], r["method"], r["allowed_m_per_s"]) == (kind, method, least)
            ]
            pd = sum(r["correct"] for r in mine) / sum(r["trials"] for r in mine)
            shares = [_after_start(Integrity.of_row(r), 1) for r in mine]
            mean, error = np.mean(shares), np.std(shares) / np.sqrt(len(shares))
            colour = series_style(method, methods)["color"]
            axis.plot([pd, mean], [place, place], color="0.8", lw=2, zorder=1)
            axis.plot(pd, place, "o", color=colour, mfc="white", ms=6)
            axis.errorbar(mean, place, xerr=1.96 * error, fmt="o", color=colour, ms=6, capsize=3)
    axis.set_yticks(list(names), names.values())
    axis.set(
        xlim=(-0.03, 1.03), ylim=(place + 0.6, 0.4), xlabel="hollow: Pd per frame; solid: available, tracked"
    )
    axis.grid(axis="x", color="0.9")
    save_figure(figure, path)


def _after_start(total: Integrity, flights: int) -> float:
    """Availability without the outputs at the start of each flight that cannot have an altitude."""
    return total.availability / (1.0 - CONFIRMING * flights / total.outputs)


def tracked_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Altitudes per frame and tracked, over all flights, by interference, method and allowed speed."""
    lines = []
    where = itemgetter("flight", "method", "allowed_m_per_s")
    for flight, method, allowed in dict.fromkeys(map(where, rows)):
        mine = [r for r in rows if where(r) == (flight, method, allowed)]
        frames, correct, wrong = (
            sum(r[name] for r in mine) for name in ("trials", "correct", "wrong_frames")
        )
        total = sum((Integrity.of_row(r) for r in mine), Integrity())
        there = 1.0 - CONFIRMING * len(mine) / total.outputs
        shares = (
            number(correct / frames, 3),
            number(wrong / frames, 3),
            number(sum(r["best_right"] for r in mine) / total.outputs, 3),
            number((total.rate("computed") - total.rate("wrong_5m")) / there, 3),
            number(_after_start(total, len(mine)), 3),
        )
        first = np.median([np.inf if r["first_s"] is None else r["first_s"] for r in mine])
        about = [FLIGHTS[flight].title, method, f"{allowed:g}"]
        lines.append([*about, *shares, number(first), f"{total.wrong_5m} ({total.bound('wrong_5m'):.3f})"])
    header = ["interference", "method", "allowed, m/s", "Pd per frame", "wrong and valid per frame"]
    tracked = ["best pair", "Pd tracked", "available", "first after, s", "wrong by 5 m (bound)"]
    return table([*header, *tracked], lines)
