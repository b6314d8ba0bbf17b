"""Pd, error, wrong altitudes and cost of the cancellers over SIR, case by case."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import fft

from ...core.mitigation import Mitigation
from ...core.receiver.altimeter import shared_altimeter
from ...evaluation.engine.chain_study import ChainStudy
from ...evaluation.engine.study import Point
from ...evaluation.results.chain import Chain, method_of
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import SCORE_COLUMNS, score_frames
from .cases import CASES, WAVEFORM, Case, received

CANCELLERS = ("ofdm_cancel", "qpsk_cancel")  # each runs on the cases of its own emitter only
METHODS = ("none", *CANCELLERS)
SIRS_DB = (-20.0, -25.0, -30.0, -35.0, -40.0, -45.0, -50.0, -60.0)
_BELOW_PD = 0.3  # Pd below which a canceller has failed; a case ends after two such SIRs
_FFTS = 3  # FFTs of 7,500 points timed after each frame, so that caches are as the method left them
_COSTS = ("ffts_median", "ffts_mean", "ffts_most")


@dataclass(frozen=True)
class CasePoint(Point):
    """A case (of `CASES`) at all SIRs."""

    case: str = ""


@dataclass(frozen=True)
class CancellationStudy(ChainStudy):
    """The table of docs/cancellation.md.

    Attributes
    ----------
    methods, cases : tuple of str
    frames : int
        Frames per case and SIR.
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

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The methods, each with the default altimeter."""
        return tuple(Chain(m, m) for m in self.methods)

    def points(self) -> Sequence[CasePoint]:
        """A point per case."""
        return [CasePoint(CASES[name].title, self.frames, case=name) for name in self.cases]

    def _chains_of(self, case: Case) -> list[Chain]:
        """All chains but the cancellers of other emitters."""
        return [c for c in self.chains if c.method not in CANCELLERS or c.method == case.method]

    def measure(self, point: CasePoint) -> list[dict[str, Any]]:
        """A row per SIR and method, on the same frames."""
        case, rows, failures = CASES[point.case], [], 0
        for sir_db in self.sirs_db:
            if failures >= 2:
                break
            seed = [self.seed, list(CASES).index(point.case), round(-10 * sir_db)]
            frames, altitude_m = received(case, sir_db, point.frames, np.random.default_rng(seed))
            for chain in self._chains_of(case):
                cleaned, found = _cleaned(method_of(chain, WAVEFORM), frames, case.stream)
                altimeter = shared_altimeter(WAVEFORM, chain.settings)
                score = score_frames(altimeter.detect(altimeter.spectra(cleaned)), altitude_m)
                failures += chain.method == case.method and score.pd < _BELOW_PD
                where = {"case": point.case, "sir_db": sir_db, "method": chain.method}
                rows.append(where | score.row() | found)
        return rows


def _cleaned(method: Mitigation, frames: np.ndarray, stream: bool) -> tuple[np.ndarray, dict[str, float]]:
    """(n, N) frames behind a method that is reset first (before each frame unless they are a stream), and its costs."""
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
