"""SigMF source: a recording instead of the receiver."""

from collections.abc import Iterator

import numpy as np
from gnuradio import gr

from ..core.radio.recording import open_capture
from ..core.scene import Scene
from ._frames import RX_TIME_KEY, time_tag
from ._guard import WORK_DONE, guarded


class sigmf_source(gr.sync_block):
    """Plays a SigMF recording at the scene's rate, ``rx_time`` at its start and after every gap.

    Recordings of `iq_recorder` are reproduced bit for bit; others (``ci16``, ``cf32``, other rates) are converted and
    resampled.

    Category: [RadAlt]/Sources. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Scene whose waveform gives the output's rate.
    file : str
        ``.sigmf-meta`` file.
    Example
    -------
    ``src = radalt.sigmf_source(scene, "flight.sigmf-meta")``
    """

    def __init__(self, scene: Scene, file: str = "capture.sigmf-meta") -> None:
        gr.sync_block.__init__(self, "radalt_sigmf_source", None, [np.complex64])
        self._rate = scene.waveform.rate_hz
        self.capture = open_capture(file)
        self._blocks: Iterator[tuple[int, np.ndarray]] = self.capture.blocks(self._rate)
        self._block = np.zeros(0, dtype=np.complex64)
        self._at = 0
        self._expected: int | None = None

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Copy the recording into the output."""
        out = output_items[0]
        done = 0
        while done < out.size:
            if self._at == self._block.size and not self._next(done):
                return done or WORK_DONE
            count = min(self._block.size - self._at, out.size - done)
            out[done : done + count] = self._block[self._at : self._at + count]
            done += count
            self._at += count
        return done

    def _next(self, done: int) -> bool:
        """Fetch a block; False at the end."""
        counter, block = next(self._blocks, (0, None))
        if block is None:
            return False
        if counter != self._expected:
            self.add_item_tag(0, self.nitems_written(0) + done, RX_TIME_KEY, time_tag(counter, self._rate))
        self._expected = counter + block.size
        self._block, self._at = block, 0
        return True
