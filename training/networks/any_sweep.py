"""`compact` with the tables of a sweep as inputs: one exported file that serves every sweep."""

from __future__ import annotations

from torch import Tensor, nn

from .compact import Compact
from .layers import Given

__all__ = ["AnySweep"]


class AnySweep(nn.Module):
    """(B, 2, N) and the tables, in the order of ``names``, in; (B, 2, N) out."""

    def __init__(self, network: Compact) -> None:
        super().__init__()
        self.network = network
        self.names = tuple(network.tables.state())

    def forward(self, x: Tensor, *tables: Tensor) -> Tensor:
        """Clean frames."""
        return self.network(x, Given(dict(zip(self.names, tables, strict=True))))
