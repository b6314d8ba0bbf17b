"""The landing study on the sweep engine."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ...evaluation.engine.own import with_option_files
from ...evaluation.engine.study import Study
from ...evaluation.overlap.study import check_methods, method_files
from ...evaluation.results.rows import Columns
from .config import LandingConfig, check_config, config_dict
from .points import TABLES, LandingPoint, point_rows, study_points


@dataclass(frozen=True)
class LandingStudy(Study):
    """Altitudes of all methods over an approach, and under other assumptions."""

    config: LandingConfig

    tables: ClassVar[Mapping[str, Columns]] = TABLES
    published: ClassVar[Mapping[str, str]] = {
        "figure_1_approach.png": "figures/landing_approach.png",
        "approach.csv": "data/landing_approach.csv",
    }

    @property
    def needs_network(self) -> bool:
        """See `Study`."""
        return "tcae" in self.config.methods

    def check(self) -> None:
        """See `Study`; raises `SceneError`, `MitigationError`, `TerrainError`, `TrajectoryError`, `InputError`."""
        check_methods(self.config)
        check_config(self.config)

    def head(self) -> dict[str, Any]:
        """The study's settings, and hashes of the files of its landing."""
        paths = self.config.files().values()
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

    def files(self) -> dict[str, Path]:
        """Flight, terrain, antenna pattern, models and method files."""
        return self.config.files() | method_files(self.config)

    def with_files(self, files: Mapping[str, Path]) -> LandingStudy:
        """See `Study`."""
        config = self.config.with_files(files)
        own = {name: path for name, path in files.items() if name not in self.config.files()}
        options = with_option_files(config.method_options, own)
        return LandingStudy(dataclasses.replace(config, method_options=options))
