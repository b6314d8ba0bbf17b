"""Networks of the comparison: `build(name, waveform)` makes one; each states its `normalisation`."""

from __future__ import annotations

from collections.abc import Callable

from torch import nn

from radalt.core.waveform import Waveform

from .alternatives import Mask, Residual
from .cnn import Convolutional
from .compact import Compact, CompactSettings
from .paper import FullyConnected, Paper

__all__ = ["NETWORKS", "build"]

# the shipped network: five of seven blocks, a third of the spectral gains
_LEAN = {"dilations": (1, 2, 8, 32, 1), "spectrum_step": 15, "spectrum_smooth": 3}

NETWORKS: dict[str, Callable[[Waveform], nn.Module]] = {
    "compact": lambda w: Compact(w, CompactSettings(**_LEAN)),
    "compact_wide": Compact,
    "beat_only": lambda w: Compact(w, CompactSettings(modulus=False, spectrum=False)),
    "beat_spectrum": lambda w: Compact(w, CompactSettings(modulus=False)),
    "mask": Mask,
    "residual": Residual,
    "paper": Paper,
    "paper_dropout_0": lambda w: Paper(w, 0.0),
    "paper_dropout_30": lambda w: Paper(w, 0.3),
    "fc": FullyConnected,
    "cnn": Convolutional,
    "cnn_normalised": lambda w: Convolutional(w, normalised=True),
    "cnn_300": lambda w: Convolutional(w, kernel=300),
    "cnn_300_normalised": lambda w: Convolutional(w, kernel=300, normalised=True),
    "cnn_300_wide": lambda w: Convolutional(w, kernel=300, normalised=True, bottleneck=64),
}


def build(name: str, waveform: Waveform) -> nn.Module:
    """A fresh network by name; raises ValueError for an unknown one."""
    if name not in NETWORKS:
        raise ValueError(f"unknown network {name!r}; known: {', '.join(NETWORKS)}")
    return NETWORKS[name](waveform)
