"""Base class of the mitigation blocks: a `Mitigation` on frames, with its processing times."""

import time
from collections import deque

import numpy as np
from gnuradio import gr

from ..core.mitigation import Mitigation, OwnProcess
from ._frames import frame_ring, read_quality
from ._guard import guarded

_TIMES = 20_000  # processing times kept, frames: 20 s of the default sweep


class MitigationBlock(gr.sync_block):
    """Frames in, cleaned frames out; tags pass with their frames."""

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
