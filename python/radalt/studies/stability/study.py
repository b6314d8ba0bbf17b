"""Stability: every method and precision on stiff, extreme and broken frames, judged against float64."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from ...evaluation.engine.chain_study import ChainStudy
from ...evaluation.engine.study import Point
from ...evaluation.results.chain import Chain
from ...evaluation.results.rows import Columns
from . import checks
from .cases import GROUPS, Case
from .judge import judge_all

_STATED = ("group", "case", "chain", "precision", "frames", "bound_m", "condition")
_FOUND = ("valid", "wrong", "error_m", "output_error", "altitude_float64_m", "finite", "diverged", "silenced")
_TABLES = {
    "rows": Columns((*_STATED, *_FOUND, "recovered", "reasons", "verdict")),
    "step_limits": Columns(("spread", "condition", "theory", "measured", "ratio", "verdict")),
    "checks": Columns(("check", "value", "bound", "unit", "verdict")),
}


def compared_chains(methods: Sequence[str], models: Sequence[Path] = ()) -> tuple[Chain, ...]:
    """The classical methods, and the network once per model file."""
    networks = [Chain.of_model(model) for model in models] if "tcae" in methods else []
    return (*(Chain(m, m) for m in methods if m != "tcae"), *networks)


@lru_cache(maxsize=len(GROUPS))
def _cases(group: str) -> dict[str, Case]:
    """Cases of a group by name, made once per process."""
    return {case.name: case for case in GROUPS[group]()}


@dataclass(frozen=True)
class StabilityPoint(Point):
    """A case, a check of a method (both named by ``what``), or the step limit at a spectral spread."""

    group: str = ""
    what: str = ""
    method: str = ""
    spread: float = 0.0


@dataclass(frozen=True)
class StabilityStudy(ChainStudy):
    """Cases and checks for a number of chains."""

    chains: tuple[Chain, ...]
    groups: tuple[str, ...] = tuple(GROUPS)  # names in `cases.GROUPS`
    checked: tuple[str, ...] = ()
    """Methods whose determinism and flowgraph are checked, besides long runs; empty leaves all checks out."""

    tables: ClassVar[Mapping[str, Columns]] = _TABLES
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "stability.md",
        "rows.csv": "data/stability.csv",
        "groups.csv": "data/stability_groups.csv",
        "checks.csv": "data/stability_checks.csv",
        "figures/stability.png": "figures/stability.png",
    }

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
        if point.table == "step_limits":
            return [checks.step_limit(point.spread)]
        if point.what == "long runs":
            return list(checks.long_run_rows())
        if point.what == "determinism":
            return list(checks.determinism_rows(point.method))
        if point.what == "flowgraph":
            return [checks.flowgraph_row(point.method)]
        case = _cases(point.group)[point.what]
        return [{"group": point.group} | row for row in judge_all([case], self.chains)]
