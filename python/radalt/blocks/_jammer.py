"""Base class of the jammer sources: a `JammerStream` as a complex output."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from gnuradio import gr

from ..core.interference.placement import Interferer
from ..core.interference.stream import JammerStream
from ..core.scene import Scene
from ._frames import gather_frames
from ._guard import WORK_DONE, guarded


class JammerSource(gr.sync_block):
    """Base of the jammer sources; parameters as in `JammerStream`, the waveform and programme from the scene."""

    def __init__(
        self,
        name: str,
        scene: Scene,
        interferers: Sequence[Interferer],
        *,
        total_sir_db: float | None = None,
        free_running: bool = False,
        frames: int = 0,
    ) -> None:
        gr.sync_block.__init__(self, name, None, [np.complex64])
        self.stream = JammerStream(
            scene.waveform,
            interferers,
            programme=scene.altitude.programme,
            seed=scene.seed,
            free_running=free_running,
            total_sir_db=total_sir_db,
        )
        self._interferers = tuple(interferers)
        self._n = scene.waveform.samples_per_frame
        for interferer in interferers:
            # fill the emitters' caches (a second of 5G NR, a recording) before the stream starts
            interferer.emitter.samples(self._n, scene.waveform.rate_hz, np.random.default_rng(0))
        self._limit = int(frames)
        gather_frames(self, self._n)

    def set_overlap(self, overlap: float) -> None:
        """Active fraction from the next sweep on."""
        self._interferers = tuple(replace(i, overlap=overlap) for i in self._interferers)
        self.stream.play(self._interferers)

    def set_sir_db(self, sir_db: float) -> None:
        """Window SIR from the next sweep on."""
        self._interferers = tuple(replace(i, sir_db=sir_db) for i in self._interferers)
        self.stream.play(self._interferers)

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Write frames into the output; `gather_frames` guarantees room for at least one."""
        out = output_items[0]
        frames = out.size // self._n
        if self._limit:
            frames = min(frames, self._limit - self.stream.frame_index)
            if not frames:
                return WORK_DONE
        for frame in out[: frames * self._n].reshape(frames, self._n):
            self.stream.next_frame(frame)
        return frames * self._n
