"""Base class of studies that compare chains of method and altimeter."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from ...core.mitigation import METHODS
from ...core.waveform import Waveform
from ..results.chain import Chain
from .study import Study


class ChainStudy(Study):
    """A study whose rows depend on its ``chains``, a field or a property of the subclass."""

    chains: tuple[Chain, ...]
    waveform: ClassVar[Waveform] = Waveform()  # sweep that the chains are built for

    def head(self) -> dict[str, Any]:
        """All fields, and of each chain what its rows depend on; raises `MitigationError` if one cannot be built."""
        return vars(self) | {"chains": {chain.label: chain.head(self.waveform) for chain in self.chains}}

    @property
    def needs_network(self) -> bool:
        return any(METHODS[chain.method].runs_network for chain in self.chains)

    def files(self) -> dict[str, Path]:
        """The networks, each under the label of its chain."""
        return {chain.label: chain.model for chain in self.chains if chain.model}

    def with_files(self, files: Mapping[str, Path]) -> Study:
        moved = (c.with_model(files[c.label]) if c.label in files else c for c in self.chains)
        return dataclasses.replace(self, chains=tuple(moved)) if files else self  # type: ignore[type-var]
