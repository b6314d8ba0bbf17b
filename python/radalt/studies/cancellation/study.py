"""Pd, error and wrong altitudes of each case over SIR, behind several methods; and a look into single frames."""

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
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import SCORE_COLUMNS, score_frames
from .cases import CASES, WAVEFORM, received
from .known_symbols import KNOWN, KNOWN_COLUMNS, KNOWN_SIRS_DB, rmse_correct_m, with_known_symbols
from .mixtures import MIXTURE_COLUMNS, MIXTURE_SIRS_DB, MIXTURES, measure_mixture
from .tracked import FLIGHTS, FRAMES, TRACKED_COLUMNS, fly

__all__ = ["METHODS", "SIRS_DB", "CancellationStudy", "CasePoint"]

METHODS = ("none", "whitening", "tcae", "ofdm_cancel", "qpsk_cancel")
TRACKED_METHODS = ("none", "whitening", "tcae", "ofdm_cancel", "hybrid")
SIRS_DB = (0.0, -10.0, -15.0, -20.0, -22.5, -25.0, -27.5, -30.0, -35.0, -40.0, -45.0, -50.0, -55.0, -60.0)
GIVEN_UP_PD = 0.3  # a method leaves a case after two SIRs with less
GO_ON = ("ofdm_cancel", "qpsk_cancel")  # they may find themselves again
# root mean squares that are not in a `Score`, and of how many altitudes or frames each is
_ERRORS = (("rmse_correct_m", "correct"), ("rmse_cleaned_m", "frames_cleaned"))


def _rms(parts: Sequence[tuple[float | None, int]]) -> float:
    """Root mean square of several, each given with its count; NaN of none."""
    known = np.array([part for part in parts if part[1] and np.isfinite(part[0] or np.nan)]).reshape(-1, 2)
    return float(np.sqrt(np.average(known[:, 0] ** 2, weights=known[:, 1]))) if len(known) else float("nan")


@dataclass(frozen=True)
class CasePoint(Point):
    """One of `CASES` at all SIRs; of other tables one of `FLIGHTS`, `MIXTURES`, `KNOWN`."""

    case: str = ""


@dataclass(frozen=True)
class CancellationStudy(Study):
    """The tables of docs/cancellation.md; those of mixtures and known symbols only where all cases are measured.

    Attributes
    ----------
    methods, cases : tuple of str
    frames : int
        Per case and SIR; three times as many where the limit was asked for.
    flights : int
        Of 1 s per kind of interference, behind the tracker.
    seed : int
    """

    methods: tuple[str, ...] = METHODS
    cases: tuple[str, ...] = tuple(CASES)
    frames: int = 60
    flights: int = 10
    seed: int = 271_828

    tables: ClassVar[Mapping[str, Columns]] = {
        "rows": Columns(
            (
                "case",
                "sir_db",
                "method",
                *SCORE_COLUMNS,
                "rmse_correct_m",
                "frames_cleaned",
                "rmse_cleaned_m",
            ),
            text=frozenset({"case", "method"}),
            whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"})
            | {"frames_cleaned"},
        ),
        "tracked": TRACKED_COLUMNS,
        "mixtures": MIXTURE_COLUMNS,
        "known": KNOWN_COLUMNS,
    }
    sampled: ClassVar[bool] = True
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "cancellation.md",
        "rows.csv": "data/cancellation.csv",
        "tracked.csv": "data/cancellation_tracked.csv",
        "mixtures.csv": "data/cancellation_mixtures.csv",
        "known.csv": "data/cancellation_known.csv",
        "pd.png": "figures/cancellation_pd.png",
        "frame.png": "figures/cancellation_frame.png",
    }

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return vars(self) | {
            "sirs_db": SIRS_DB,
            "chains": {m: Chain(m, m).head(WAVEFORM) for m in self.methods},
        }

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a method does not fit the default sweep."""
        self.head()

    def points(self) -> Sequence[CasePoint]:
        """A point per case, and per kind of flight."""
        cases = [
            CasePoint(CASES[name].title, CASES[name].frames(self.frames), case=name) for name in self.cases
        ]
        if self.cases == tuple(CASES):
            cases += [
                CasePoint(f"mixture: {mixture.title}", self.frames, "mixtures", name)
                for name, mixture in MIXTURES.items()
            ]
            cases += [
                CasePoint(f"symbols known: {case.title}", self.frames, "known", name)
                for name, case in KNOWN.items()
            ]
        if not self.flights:
            return cases
        frames = self.flights * FRAMES
        flown = [
            CasePoint(f"flights: {f.title}", frames, "tracked", case=name) for name, f in FLIGHTS.items()
        ]
        return [*cases, *flown]

    def measure(self, point: CasePoint, batch: int = 0) -> list[dict[str, Any]]:
        """A row per SIR and method; of flights one per flight and method."""
        if point.table == "tracked":
            kind = list(FLIGHTS).index(point.case)
            seeds = [[self.seed, 97, kind, flight, batch] for flight in range(self.flights)]
            count = max(1, point.frames // self.flights)
            flown = (fly(point.case, TRACKED_METHODS, np.random.default_rng(seed), count) for seed in seeds)
            return [row for rows in flown for row in rows]
        if point.table == "mixtures":
            seed = [self.seed, 131, batch]
            return [measure_mixture(point.case, sir_db, point.frames, seed) for sir_db in MIXTURE_SIRS_DB]
        if point.table == "known":
            seed = [self.seed, 137, batch]
            return [
                row
                for sir_db in KNOWN_SIRS_DB
                for row in with_known_symbols(point.case, sir_db, point.frames, seed)
            ]
        rows, failures = [], dict.fromkeys(self.methods, 0)
        for sir_db in SIRS_DB:
            seed = [
                self.seed,
                list(CASES).index(point.case),
                round(-10 * sir_db),
                *([batch] if batch else []),
            ]
            frames, altitude_m = received(
                CASES[point.case], sir_db, point.frames, np.random.default_rng(seed)
            )
            for method in self.methods:
                if failures[method] >= 2 and method not in GO_ON:
                    continue
                results, _, cleaned = Chain(method, method).results_and_changes(frames, WAVEFORM)
                score = score_frames(results, altitude_m)
                failures[method] += score.pd < GIVEN_UP_PD
                error = {
                    "rmse_correct_m": rmse_correct_m(results, altitude_m),
                    "frames_cleaned": np.count_nonzero(cleaned),
                    "rmse_cleaned_m": score_frames(results[cleaned], altitude_m[cleaned]).rmse_detected_m,
                }
                rows.append({"case": point.case, "sir_db": sir_db, "method": method} | score.row() | error)
        return rows

    def pooled(self, batches: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
        """See `Study`; with the errors that only this study has. Flights stand one by one."""
        if "flight" in batches[0][0]:
            return [row for batch in batches for row in batch]
        rows = super().pooled(batches)
        for row, *same in zip(rows, *batches, strict=True):
            errors = {
                name: _rms([(r[name], r[count]) for r in same]) for name, count in _ERRORS if name in row
            }
            row |= errors
            if "frames_cleaned" in row:
                row["frames_cleaned"] = sum(r["frames_cleaned"] for r in same)
        return rows

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `Study`."""
        from .report import write_report  # figures need matplotlib

        return write_report(folder, self, rows, run)

    def seconds(self, point: Point) -> float:
        """See `Study`."""
        settings = Chain("none", "none").settings
        if point.table == "tracked":
            each = sum(seconds_per_frame(m, WAVEFORM, settings) for m in TRACKED_METHODS)
            return point.frames * (each + 0.012)
        if point.table == "mixtures":
            each = seconds_per_frame("hybrid", WAVEFORM, settings)
            return len(MIXTURE_SIRS_DB) * point.frames * (each + 0.012)
        if point.table == "known":
            each = seconds_per_frame("ofdm_cancel", WAVEFORM, settings)
            return len(KNOWN_SIRS_DB) * point.frames * (each + 0.02)
        each = sum(seconds_per_frame(m, WAVEFORM, settings) for m in self.methods)
        return len(SIRS_DB) * point.frames * (each + 0.012)

    def rehearsal(self) -> tuple[tuple[Study, Point], ...]:
        """See `Study`."""
        points = self.points()
        return tuple((self, dataclasses.replace(p, frames=3)) for p in (points[0], points[len(points) // 2]))
