"""A recorder block in a flowgraph: received samples as SigMF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...core.scene import Scene

__all__ = ["Recorder", "attach_recorder"]


class Recorder:
    """A recorder block in a flowgraph, closed by `finish` once the flowgraph has ended."""

    def __init__(self, top: Any, block: Any) -> None:
        self._top, self._block = top, block

    @property
    def sample_counter(self) -> int:
        """Counter of the next sample, which may lie behind the segmenter's."""
        return self._block.sample_counter

    def finish(self) -> Path | None:
        """Write the metadata; returns their path, or None where nothing was received."""
        from ...blocks._guard import raise_stored

        raise_stored([self._block])
        latency = self._top.frame_segmenter.latency_samples
        self._block.latency_samples = latency if np.isfinite(latency) else 0.0
        return self._block.finish()


def attach_recorder(
    top: Any,
    source: Any,
    scene: Scene,
    path: Path | str,
    *,
    start_s: float = 0.0,
    drop_when_slow: bool = False,
    radio: Mapping[str, float] | None = None,
) -> Recorder:
    """Connect a recorder to a flowgraph that is not yet started.

    Parameters
    ----------
    top : object
        Generated flowgraph.
    source : block
        Block whose output 0 is recorded.
    path : path
        Path of the recording without ending.
    start_s : float
        Device time of the transmitter's first sample.
    drop_when_slow : bool
        For radios; see `iq_recorder`.
    radio : mapping, optional
        For radios; see `write_metadata`.
    """
    from ...blocks.iq_recorder import iq_recorder

    block = iq_recorder(scene, str(path), drop_when_slow)
    block.finish_at_stop = False
    block.set_start_time(start_s)
    block.radio = dict(radio or {})
    top.connect((source, 0), (block, 0))
    return Recorder(top, block)
