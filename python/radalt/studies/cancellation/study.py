"""Pd, error, wrong altitudes and cost of the cancellers over SIR, case by case."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import fft

from ...core.mitigation import Mitigation
from ...core.receiver.altimeter import shared_altimeter
from ...evaluation.engine.study import Point, Run, Study
from ...evaluation.results.chain import Chain, seconds_per_frame
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import SCORE_COLUMNS, score_frames
from .cases import CASES, WAVEFORM, received

__all__ = ["METHODS", "SIRS_DB", "CancellationStudy", "CasePoint"]

CANCELLERS = ("ofdm_cancel", "qpsk_cancel")  # each is asked for the cases that it is made for
METHODS = ("none", *CANCELLERS)
SIRS_DB = (-20.0, -25.0, -30.0, -35.0, -40.0, -45.0, -50.0, -60.0)
_BELOW_PD = 0.3  # a case is left after two SIRs at which its canceller has less
_FFTS = 3  # FFTs of 7,500 points timed after each frame, so that caches are as the method left them
_COSTS = ("ffts_median", "ffts_mean", "ffts_most")


@dataclass(frozen=True)
class CasePoint(Point):
    """One of `CASES` at all SIRs."""

    case: str = ""


@dataclass(frozen=True)
class CancellationStudy(Study):
    """The table of docs/cancellation.md.

    Attributes
    ----------
    methods, cases : tuple of str
        By name.
    frames : int
        Per case and SIR.
    seed : int
    sirs_db : tuple of float
        From high to low.
    """

    methods: tuple[str, ...] = METHODS
    cases: tuple[str, ...] = tuple(CASES)
    frames: int = 100
    seed: int = 271_828
    sirs_db: tuple[float, ...] = SIRS_DB

    tables: ClassVar[Mapping[str, Columns]] = {
        "rows": Columns(
            ("case", "sir_db", "method", *SCORE_COLUMNS, "cancelled", "tracked", *_COSTS),
            text=frozenset({"case", "method"}),
            whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"})
            | {"cancelled", "tracked"},
        )
    }
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "cancellation.md",
        "rows.csv": "data/cancellation.csv",
        "pd.png": "figures/cancellation_pd.png",
    }

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return vars(self) | {"chains": {m: Chain(m, m).head(WAVEFORM) for m in self.methods}}

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a method does not fit the default sweep."""
        self.head()

    def points(self) -> Sequence[CasePoint]:
        """A point per case."""
        return [CasePoint(CASES[name].title, self.frames, case=name) for name in self.cases]

    def measure(self, point: CasePoint) -> list[dict[str, Any]]:
        """A row per SIR and method, on the same frames."""
        case, rows, failures = CASES[point.case], [], 0
        for sir_db in self.sirs_db:
            if failures >= 2:
                break
            seed = [self.seed, list(CASES).index(point.case), round(-10 * sir_db)]
            frames, altitude_m = received(case, sir_db, point.frames, np.random.default_rng(seed))
            for method in _asked(self.methods, point.case):
                cleaned, found = _cleaned(_method(method), frames, case.stream)
                altimeter = shared_altimeter(WAVEFORM, Chain(method, method).settings)
                score = score_frames(altimeter.detect(altimeter.spectra(cleaned)), altitude_m)
                failures += method == case.method and score.pd < _BELOW_PD
                rows.append({"case": point.case, "sir_db": sir_db, "method": method} | score.row() | found)
        return rows

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `Study`."""
        from .report import write_report  # figures need matplotlib

        return write_report(folder, self, rows, run)

    def seconds(self, point: Point) -> float:
        """See `Study`."""
        settings = Chain("none", "none").settings
        each = sum(seconds_per_frame(m, WAVEFORM, settings) for m in _asked(self.methods, point.case))
        return len(self.sirs_db) * point.frames * (each + 0.012)

    def rehearsal(self) -> tuple[tuple[Study, Point], ...]:
        """See `Study`."""
        return ((self, dataclasses.replace(self.points()[0], frames=3)),)


def _asked(methods: Sequence[str], case: str) -> list[str]:
    return [m for m in methods if m not in CANCELLERS or m == CASES[case].method]


@lru_cache(maxsize=8)
def _method(name: str) -> Mitigation:
    return Chain(name, name).build(WAVEFORM)


def _cleaned(method: Mitigation, frames: np.ndarray, stream: bool) -> tuple[np.ndarray, dict[str, float]]:
    """(n, N) frames behind a method that knows nothing at first (of each, unless they are a stream), and its costs."""
    method.reset()
    out, spent, unit, cancelled, tracked = np.empty_like(frames), [], [], 0, 0
    for row, frame in zip(out, frames, strict=True):
        if not stream:
            method.reset()
        begin = time.thread_time()
        row[:] = method.process(frame)
        spent.append(time.thread_time() - begin)
        outcome = getattr(method, "outcome", None)
        cancelled += outcome is not None and outcome.cancelled
        tracked += outcome is not None and outcome.state == "tracked"
        for _ in range(_FFTS):
            begin = time.thread_time()
            fft.fft(frame)
            unit.append(time.thread_time() - begin)
    costs = np.array(spent) / np.median(unit)
    values = (np.median(costs), costs.mean(), costs.max())
    found = dict(zip(_COSTS, map(float, values), strict=True))
    return out, found | {"cancelled": cancelled, "tracked": tracked}
