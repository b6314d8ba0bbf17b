"""Stability: every method and precision on stiff, extreme and broken frames against float64, judged case by case."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from ...core.waveform import Waveform
from ...evaluation.engine.study import Point, Run, Study
from ...evaluation.results.chain import Chain, chains_with, model_files
from ...evaluation.results.folder import RunFolder
from ...evaluation.results.rows import Columns
from . import checks
from .cases import GROUPS, Case
from .judge import judge_all

__all__ = ["StabilityStudy", "compared_chains"]

_STATED = ("group", "case", "chain", "precision", "frames", "bound_m", "condition")
_FOUND = ("valid", "wrong", "error_m", "output_error", "altitude_float64_m", "finite", "diverged", "silenced")
_WORDS = frozenset({"group", "case", "chain", "precision", "reasons", "verdict", "check", "unit"})
_TABLES = {
    "rows": Columns(
        names=(*_STATED, *_FOUND, "recovered", "reasons", "verdict"),
        text=_WORDS,
        whole=frozenset({"frames", "valid", "wrong", "finite", "recovered", "diverged", "silenced"}),
    ),
    "step_limits": Columns(
        names=("spread", "condition", "theory", "measured", "ratio", "verdict"), text=_WORDS
    ),
    "checks": Columns(names=("check", "value", "bound", "unit", "verdict"), text=_WORDS),
}
# CPU seconds of one machine; `rehearsal` finds those of this one
_CASE_S, _FRAME_S = 0.09, 0.002  # per chain: built twice, and one frame more; float64 references
_CHECK_S = {"long runs": 1.0, "determinism": 2.4, "flowgraph": 0.5, "step_limits": 1.2}


def compared_chains(methods: Sequence[str], models: Sequence[Path] = ()) -> tuple[Chain, ...]:
    """The classical methods, and the network once for every model file."""
    networks = [Chain.of_model(model) for model in models] if "tcae" in methods else []
    return (*(Chain(m, m) for m in methods if m != "tcae"), *networks)


@lru_cache(maxsize=len(GROUPS))
def _cases(group: str) -> dict[str, Case]:
    """Of a group by name; made once per process, since some share what they are made of."""
    return {case.name: case for case in GROUPS[group]()}


@dataclass(frozen=True)
class StabilityPoint(Point):
    """A case, a check of one method (``what`` is its kind), or the step limit at one spectral spread."""

    group: str = ""
    what: str = ""
    method: str = ""
    spread: float = 0.0


@dataclass(frozen=True)
class StabilityStudy(Study):
    """Cases and checks for a number of chains.

    Attributes
    ----------
    chains : tuple of Chain
    groups : tuple of str
        Of `cases.GROUPS`.
    checked : tuple of str
        Methods whose long runs, determinism and flowgraph are checked; empty leaves the checks out.
    """

    chains: tuple[Chain, ...]
    groups: tuple[str, ...] = tuple(GROUPS)
    checked: tuple[str, ...] = ()

    tables: ClassVar[Mapping[str, Columns]] = _TABLES
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "stability.md",
        "rows.csv": "data/stability.csv",
        "groups.csv": "data/stability_groups.csv",
        "checks.csv": "data/stability_checks.csv",
        "figures/stability.png": "figures/stability.png",
    }

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return vars(self) | {"chains": {chain.label: chain.head(Waveform()) for chain in self.chains}}

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a chain does not fit the default sweep."""
        self.head()

    def points(self) -> Sequence[StabilityPoint]:
        """Every case, then the step limits and checks."""
        cases = [
            StabilityPoint(f"{group}: {case.name}", len(case.frames), group=group, what=case.name)
            for group in self.groups
            for case in _cases(group).values()
        ]
        if not self.checked:
            return cases
        spreads = checks.SPREADS if "lms" in self.checked else ()
        return [
            *cases,
            *(StabilityPoint(f"LMS step limit, spread {s:.0e}", 0, "step_limits", spread=s) for s in spreads),
            StabilityPoint("long runs", 0, "checks", what="long runs"),
            *(
                StabilityPoint(f"{what}, {method}", 0, "checks", what=what, method=method)
                for what in ("determinism", "flowgraph")
                for method in self.checked
            ),
        ]

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """See `Study`."""
        if point.table == "step_limits":
            return [checks.step_limit(point.spread)]
        if point.what == "long runs":
            return list(checks.long_run_rows())
        if point.what == "determinism":
            return list(checks.determinism_rows(point.method))
        if point.what == "flowgraph":
            return [checks.flowgraph_row(point.method)]
        return list(judge_all([_cases(point.group)[point.what]], self.chains))

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `report.write_report`."""
        from .report import write_report

        return write_report(folder, rows, run)

    def seconds(self, point: Point) -> float:
        """See `Study`."""
        if point.table != "rows":
            return _CHECK_S.get(point.what, _CHECK_S["step_limits"])
        case = _cases(point.group)[point.what]
        length = case.waveform.samples_per_frame / Waveform().samples_per_frame
        return len(self.chains) * (_CASE_S + _FRAME_S * point.frames * length)

    def rehearsal(self) -> tuple[tuple[Study, Point], ...]:
        """See `Study`."""
        cases = [p for p in self.points() if p.table == "rows"]
        return ((self, cases[len(cases) // 2]),) if cases else ()

    def files(self) -> dict[str, Path]:
        """The networks."""
        return model_files(self.chains)

    def with_files(self, files: Mapping[str, Path]) -> StabilityStudy:
        """See `Study`."""
        return dataclasses.replace(self, chains=chains_with(self.chains, files))

    @property
    def needs_network(self) -> bool:
        """See `Study`."""
        return any(chain.model for chain in self.chains) or "tcae" in self.checked
