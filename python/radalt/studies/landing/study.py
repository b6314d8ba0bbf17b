"""The landing study on the sweep engine."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ...evaluation.engine.study import Study
from ...evaluation.overlap.study import check_methods, method_files, with_method_files
from ...evaluation.results.rows import Columns
from .config import LandingConfig, check_config, config_dict
from .points import TABLES, LandingPoint, point_rows, seconds, study_points

__all__ = ["LandingStudy"]

_LANDING = ("trajectory", "terrain", "antenna")  # first words of the names in `files` that are not a method's


@dataclass(frozen=True)
class LandingStudy(Study):
    """Altitudes of all methods over an approach, against SINR, and under other assumptions."""

    config: LandingConfig

    tables: ClassVar[Mapping[str, Columns]] = TABLES
    published: ClassVar[Mapping[str, str]] = {
        "figure_1_approach.png": "figures/landing_approach.png",
        "figure_2_error_against_sinr.png": "figures/landing_error_against_sinr.png",
        "approach.csv": "data/landing_approach.csv",
        "curve.csv": "data/landing_curve.csv",
    }

    @property
    def needs_network(self) -> bool:
        """See `Study`."""
        return "tcae" in self.config.methods

    def check(self) -> None:
        """See `Study`; raises `SceneError`, `MitigationError`, `TerrainError`, `TrajectoryError`, `StudyError`."""
        check_methods(self.config)
        check_config(self.config)

    def head(self) -> dict[str, Any]:
        """The study's settings, and hashes of the files of its landing."""
        paths = [path for name, path in self.files().items() if name.split()[0] in _LANDING]
        return {
            "name": self.config.name,
            "seed": self.config.seed,
            "landing": config_dict(self.config),
            "inputs_sha256": {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in paths},
            "methods": check_methods(self.config),
        }

    def points(self) -> tuple[LandingPoint, ...]:
        """See `points.study_points`."""
        return study_points(self.config)

    def measure(self, point: LandingPoint) -> list[dict[str, Any]]:
        """See `points.point_rows`."""
        return point_rows(self.config, point)

    def seconds(self, point: LandingPoint) -> float:
        """See `points.seconds`."""
        return seconds(self.config, point)

    def files(self) -> dict[str, Path]:
        """Flight, terrain, antenna pattern, models and method files."""
        config, spec = self.config, self.config.spec
        out = {"trajectory": spec.path(config.trajectory.file)}
        out |= {f"terrain {k}": spec.path(name) for k, name in enumerate(config.terrain.files)}
        if config.antenna.pattern:
            out["antenna"] = spec.path(config.antenna.pattern)
        return out | method_files(config)

    def with_files(self, files: Mapping[str, Path]) -> LandingStudy:
        """See `Study`."""
        config, at = self.config, {name: str(Path(path).absolute()) for name, path in files.items()}
        own = {name: Path(path) for name, path in at.items() if name.split()[0] not in _LANDING}
        options = with_method_files(config.method_options, own)
        terrain = tuple(at[f"terrain {k}"] for k in range(len(config.terrain.files)))
        changed = dataclasses.replace(
            config,
            trajectory=dataclasses.replace(config.trajectory, file=at["trajectory"]),
            terrain=dataclasses.replace(config.terrain, files=terrain),
            antenna=dataclasses.replace(config.antenna, pattern=at.get("antenna")),
            method_options=options,
        )
        return LandingStudy(changed)
