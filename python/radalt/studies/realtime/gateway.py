"""Cost of GNU Radio and its Python gateway with blocks that only copy."""

import time

import numpy as np
from gnuradio import blocks, gr

from ...blocks._frames import frame_ring
from ...blocks._guard import WORK_DONE, guarded


class _Copy(gr.sync_block):
    """Copies frames."""

    def __init__(self, samples: int) -> None:
        gr.sync_block.__init__(self, "copy", [(np.complex64, samples)], [(np.complex64, samples)])
        frame_ring(self, samples)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        output_items[0][:] = input_items[0]
        return len(output_items[0])


class _Source(gr.sync_block):
    """A given number of frames with the ring's content."""

    def __init__(self, samples: int, frames: int) -> None:
        gr.sync_block.__init__(self, "source", None, [(np.complex64, samples)])
        self._left = frames
        frame_ring(self, samples)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        done = min(self._left, len(output_items[0]))
        self._left -= done
        return done or WORK_DONE


def gateway_seconds(samples: int, *, count: int = 6, frames: int = 2000) -> float:
    """CPU seconds per frame of ``count`` Python blocks that copy, between a source and a null sink."""
    top = gr.top_block()
    chain = [_Source(samples, frames), *(_Copy(samples) for _ in range(count)), blocks.null_sink(8 * samples)]
    top.connect(*chain)
    begin = time.process_time()
    top.run()
    return (time.process_time() - begin) / frames
