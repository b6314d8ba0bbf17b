"""Mitigation block for every registered method, and the base of such blocks."""

import time
from collections import deque
from typing import Any

import numpy as np
from gnuradio import gr

from ..core.mitigation import Mitigation, OwnProcess, method_class
from ..core.scene import Scene
from ..core.scene.build import method_of
from ._frames import frame_ring, read_quality
from ._guard import guarded

_TIMES = 20_000  # processing times kept, frames: 20 s of the default sweep


class MitigationBlock(gr.sync_block):
    """Base of the mitigation blocks: frames in, cleaned frames out; tags pass with their frames."""

    def __init__(self, name: str, method: Mitigation, batch: int = 1) -> None:
        n = method.waveform.samples_per_frame
        gr.sync_block.__init__(self, name, [(np.complex64, n)], [(np.complex64, n)])
        if batch < 1:
            raise ValueError(f"batch is {batch}; it has to be at least 1 frame")
        self.method = method
        self._batch = int(batch)
        self.active = True
        self._milliseconds: deque[float] = deque(maxlen=_TIMES)
        frame_ring(self, n)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Process the waiting frames, at most ``batch`` at a time; pass them unchanged while the block is inactive."""
        frames, out = input_items[0], output_items[0]
        if not self.active:
            out[:] = frames
            return len(out)
        quality = read_quality(self, len(out))
        # a process of its own takes all that is there, and divides it itself
        batch = len(out) if isinstance(self.method, OwnProcess) else self._batch
        for first in range(0, len(out), batch):
            span = slice(first, first + batch)
            begin = time.thread_time_ns() + self.method.outside_cpu_ns
            self.method.process_into(frames[span], out[span], None if quality is None else quality[span])
            count = len(out[span])
            spent = time.thread_time_ns() + self.method.outside_cpu_ns - begin
            self._milliseconds.extend([spent * 1e-6 / count] * count)
        return len(out)

    def milliseconds(self) -> np.ndarray:
        """CPU milliseconds per frame, of this block's thread and the method's process; the last 20,000 frames."""
        return np.array(self._milliseconds)

    def status(self) -> dict[str, object]:
        """The method's counters and state."""
        return self.method.status()


class mitigation(MitigationBlock):
    """One method by its name: any of `METHODS`, or ``custom`` for the user's method.

    Category: [RadAlt]/Mitigation. Ports: ``frames: complex vector of N > frames: complex vector of N``.

    Parameters
    ----------
    scene : Scene
        Waveform; ``method_options`` of the scene give the method's parameters.
    method : str
        Name as in `radalt.core.mitigation.create`. Live.
    options : dict, optional
        Parameters that override the scene's.
    drop_when_slow : bool
        As the frame segmenter's: where frames may be dropped, `hybrid` and `ofdm_cancel` search within a budget.
    Example
    -------
    ``clean = radalt.mitigation(scene, "whitening")``
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "whitening",
        options: dict[str, Any] | None = None,
        drop_when_slow: bool = False,
    ) -> None:
        self._scene, self._name, self._options = scene, method, options or {}
        self._drop_when_slow = bool(drop_when_slow)
        super().__init__("radalt_mitigation", self._create(method), method_class(method).batch)

    def _create(self, method: str) -> Mitigation:
        return method_of(self._scene, method, self._options, drop_when_slow=self._drop_when_slow)

    def set_method(self, method: str) -> None:
        """Change the method from the next frames on; the new one starts without state."""
        if method != self._name:
            self.method, self._name = self._create(method), method
            self._batch = method_class(method).batch
