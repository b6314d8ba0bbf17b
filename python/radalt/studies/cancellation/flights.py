"""Flights below base stations alone: many, and longer, behind the methods that are asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...evaluation.engine.study import Point, Run, Study
from ...evaluation.results.chain import Chain, seconds_per_frame
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.integrity import Integrity
from ...evaluation.results.page import write_pages
from ...evaluation.results.rows import Columns
from ...evaluation.results.table import number, table
from .cases import WAVEFORM
from .tracked import CONFIRMING, FLIGHTS, FRAMES, NR_MS, TRACKED_COLUMNS, fly

__all__ = ["FlightPoint", "FlightsStudy", "tracked_table"]


@dataclass(frozen=True)
class FlightPoint(Point):
    """A flight: its kind (of `FLIGHTS`) and its number."""

    flight: str = ""
    number: int = 0


@dataclass(frozen=True)
class FlightsStudy(Study):
    """The table of docs/tracked_flights.md.

    Attributes
    ----------
    methods : tuple of str
    flights : int
        Per kind of interference.
    length_s : int
        Of a flight.
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
    }

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return vars(self) | {"chains": {m: Chain(m, m).head(WAVEFORM) for m in self.methods}}

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a method does not fit the default sweep."""
        self.head()

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
        report = folder.head | {"run": run.as_dict(), "tracked": tracked_table(rows["rows"]), "nr_ms": NR_MS}
        page = write_pages(folder, Path(__file__).with_name("flights.md.j2"), report)
        folder.write_report(report | {"rows": list(rows["rows"])})
        return page

    def seconds(self, point: FlightPoint) -> float:
        """See `Study`."""
        settings = Chain("none", "none").settings
        return point.frames * (0.002 + sum(seconds_per_frame(m, WAVEFORM, settings) for m in self.methods))

    def rehearsal(self) -> tuple[tuple[Study, FlightPoint], ...]:
        """See `Study`."""
        return ((self, dataclasses.replace(self.points()[0], frames=80)),)


def tracked_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Per-frame altitudes and the tracker's of all flights, by interference and method."""
    lines = []
    names = "flight", "method", "allowed_m_per_s"
    for key in dict.fromkeys(tuple(r[name] for name in names) for r in rows):
        mine = [r for r in rows if tuple(r[name] for name in names) == key]
        flight, method, allowed = key
        frames, correct, wrong = (
            sum(r[name] for r in mine) for name in ("trials", "correct", "wrong_frames")
        )
        total = sum((Integrity.of_row(r) for r in mine), Integrity())
        there = 1.0 - CONFIRMING * len(mine) / total.outputs
        counts = (f"{getattr(total, name)} ({total.bound(name):.3f})" for name in ("wrong_5m", "hazardous"))
        shares = (
            number(correct / frames, 3),
            number(wrong / frames, 3),
            number(sum(r["best_right"] for r in mine) / total.outputs, 3),
            number((total.rate("computed") - total.rate("wrong_5m")) / there, 3),
            number(total.availability / there, 3),
        )
        first = np.median([np.inf if r["first_s"] is None else r["first_s"] for r in mine])
        after = f"{first:.2f}" if np.isfinite(first) else "–"
        lines.append([FLIGHTS[flight].title, method, f"{allowed:g}", *shares, after, total.outputs, *counts])
    header = ["interference", "method", "allowed, m/s", "Pd per frame", "wrong and valid per frame"]
    tracked = ["best pair", "Pd tracked", "available", "first after, s", "outputs"]
    return table([*header, *tracked, "wrong by 5 m (bound)", "hazardous (bound)"], lines)
