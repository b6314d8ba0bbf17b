"""Side-lobe cancellation by a second receive channel, before every method."""

import numpy as np
import pmt
from gnuradio import gr

from ..core.altimeter.frame_quality import FrameQuality
from ..core.scene import Scene
from ..core.scene.build import canceller_of
from ._frames import FRAME_KEY, frame_ring, read_frame_tags
from ._guard import guarded


class auxiliary_cancel(gr.sync_block):
    """Takes out of frames what the second antenna receives as well, except the return; see `AuxiliaryCancel`.

    The tag ``radalt_frame`` of a changed frame has the quality of what is left.

    Category: [RadAlt]/Mitigation. Ports: ``frames: complex vector of N``, ``auxiliary: complex vector of N`` ``>
    frames: complex vector of N``. Both inputs are the frame segmenter's, with ``auxiliary``.

    Parameters
    ----------
    scene : Scene
        Waveform, and settings in ``auxiliary_cancel``.
    Example
    -------
    ``cancel = radalt.auxiliary_cancel(scene)``
    """

    def __init__(self, scene: Scene) -> None:
        n = scene.waveform.samples_per_frame
        gr.sync_block.__init__(self, "radalt_auxiliary_cancel", [(np.complex64, n)] * 2, [(np.complex64, n)])
        self.canceller = canceller_of(scene)
        self._quality = FrameQuality(scene.waveform, scene.altimeter_settings.max_altitude_m)
        self._off = ""
        self.set_tag_propagation_policy(gr.TPP_DONT)
        frame_ring(self, n)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Clean the waiting frames, and hand on their tags."""
        frames, out = input_items[0], output_items[0]
        out[:] = self.canceller.process(frames, input_items[1])
        tags, changed = read_frame_tags(self, len(out)), (out != frames).any(axis=1)
        for k, quality in zip(np.flatnonzero(changed), self._quality(out[changed]), strict=True):
            tags[k, -len(quality) :] = quality.item()
        for place, values in enumerate(tags, self.nitems_written(0)):
            if not np.isnan(values[0]):
                self.add_item_tag(0, place, FRAME_KEY, pmt.init_f64vector(len(values), values.tolist()))
        off = str(self.status()["off"])
        if off and off != self._off:
            self.logger.warn(f"frames pass: {off}")
        self._off = off
        return len(out)

    def status(self) -> dict[str, object]:
        """Counters, isolation as measured, and why frames pass."""
        return self.canceller.status()
