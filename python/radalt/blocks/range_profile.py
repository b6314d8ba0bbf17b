"""Range profile: beat spectrum and CFAR threshold of frames, for a display."""

import numpy as np
from gnuradio import gr

from ..core.scene import Scene
from ..core.scene.live import RangeProfile
from ._guard import guarded


class range_profile(gr.basic_block):
    """Power over altitude, and the power from which the altimeter declares a detection; see `RangeProfile`.

    ``profile = 10 log10((P_up + P_down) / 2)``, ``threshold = profile - 10 log10(r / r_T)``. ``r`` is the power over
    noise at which two equal half sweeps have the joint significance found; ``r_T`` is the least one for a detection.

    Category: [RadAlt]/Displays. Ports: ``frames: complex vector of N > profile: float vector of points``,
    ``threshold: float vector of points`` (both in dB over a return of unit amplitude).

    Parameters
    ----------
    scene : Scene
        Waveform and altimeter settings.
    points : int
        Points from 0 to the scene's ``altimeter.max_altitude_m``.
    every : int
        Shows one of ``every`` frames and skips the others.
    Example
    -------
    ``view = radalt.range_profile(scene, points=512, every=50)``
    """

    def __init__(self, scene: Scene, points: int = 512, every: int = 50) -> None:
        n = scene.waveform.samples_per_frame
        gr.basic_block.__init__(self, "radalt_range_profile", [(np.complex64, n)], [(np.float32, points)] * 2)
        if every < 1:
            raise ValueError(f"range_profile.every is {every}; it has to be at least 1 frame")
        self.profile = RangeProfile(scene.waveform, scene.altimeter_settings, points)
        self._every, self._seen = int(every), 0
        self.set_tag_propagation_policy(gr.TPP_DONT)

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        """One frame."""
        return [1] * ninputs

    @guarded
    def general_work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Output the profile of every ``every``-th frame."""
        frames, room = input_items[0], len(output_items[0])
        turns = np.arange(-self._seen % self._every, len(frames), self._every)
        done = min(room, turns.size)
        if done:
            output_items[0][:done], output_items[1][:done] = self.profile.process(frames[turns[:done]])
        # consume up to the first frame to show for which there is no room
        used = len(frames) if done == turns.size else int(turns[done])
        self._seen += used
        self.consume(0, used)
        return done
