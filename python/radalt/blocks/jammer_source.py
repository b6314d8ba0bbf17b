"""Jammer source: the scene's interference, one emitter or several, or a mapping as in a scene."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from gnuradio import gr

from ..core.scene import Scene
from ..core.scene.build import jammer_of
from ..core.scene.reading import interference_from_yaml
from ._frames import gather_frames
from ._guard import WORK_DONE, guarded


class jammer_source(gr.sync_block):
    """The sum of all interferers, each at its overlap and SIR, the sum at the scene's total SIR.

    SIRs are averaged over the sweep, against a return of unit power.

    Category: [RadAlt]/Interference. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Interference, frame length, rate, programme (silent while timing is acquired) and seed.
    interference : mapping, optional
        Interferers in place of the scene's, as in a scene file (docs/scene-reference.md).
    overlap, sir_db : float, optional
        Override the overlap (0..1) and total SIR in dB from the next sweep on; None keeps the scene's. Live.
    frames : int
        Sweeps before the stream ends; 0 for endless.

    Raises
    ------
    ValueError
        One line: the key, value or file that does not fit.
    Example
    -------
    ``jam = radalt.jammer_source(scene, {"nr": {"channel_bandwidth_hz": 10e6, "cell_id": 17}}, sir_db=-20)``
    """

    def __init__(
        self,
        scene: Scene,
        interference: Mapping[str, Any] | None = None,
        overlap: float | None = None,
        sir_db: float | None = None,
        frames: int = 0,
    ) -> None:
        gr.sync_block.__init__(self, "radalt_jammer_source", None, [np.complex64])
        if interference is not None:
            interferers = interference_from_yaml(dict(interference), "interference")
            scene = replace(scene, interference=interferers, total_sir_db=None)
        self.stream = jammer_of(scene)
        self._n = scene.waveform.samples_per_frame
        for interferer in scene.interference:
            # fill the emitters' caches (a second of 5G NR, a recording) before the stream starts
            interferer.emitter.samples(self._n, scene.waveform.rate_hz, np.random.default_rng(0))
        self._limit = int(frames)
        self._scene = scene
        self._overlap, self._sir_db = overlap, sir_db
        self._strongest_db = float("inf")
        self._apply()
        gather_frames(self, self._n)

    def hold_drive(self) -> None:
        """Limit bursts to the power of the scene's, for which a radio's converter is scaled.

        A lower SIR, or a shorter burst at the same SIR, is then replaced by the lowest SIR without clipping.
        """
        self._strongest_db = self._scene.burst_db
        self._apply()

    def set_overlap(self, overlap: float | None) -> None:
        """Active fraction from the next sweep on; None keeps the scene's."""
        self._overlap = overlap
        self._apply()

    def set_sir_db(self, sir_db: float | None) -> None:
        """Total SIR in dB from the next sweep on; None keeps the scene's."""
        self._sir_db = sir_db
        self._apply()

    def _apply(self) -> None:
        scene = self._scene.at(overlap=self._overlap, sir_db=self._sir_db)
        excess_db = scene.burst_db - self._strongest_db
        if excess_db > 0:
            scene = scene.at(sir_db=scene.sir_db + excess_db)
        self.stream.play(scene.interference, scene.total_sir_db)

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
