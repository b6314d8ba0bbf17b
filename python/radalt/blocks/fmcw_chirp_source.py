"""FMCW chirp source with synthetic beat shift."""

import numpy as np
from gnuradio import gr

from ..core.scene import Scene
from ..core.scene.build import sweeps_of
from ._frames import SENT_KEY, gather_frames, sent_tag
from ._guard import WORK_DONE, guarded


class fmcw_chirp_source(gr.sync_block):
    """Triangular FMCW sweep, unit amplitude, its beat shifted to a synthetic altitude.

    ``s(u) = exp(j 2 pi (phi(u) -+ k tau u))``: up sweeps are shifted by ``-k tau``, down sweeps by ``+k tau``, with
    ``tau = 2 R / c``. The phase is continuous at the seams, and the altitude changes on sweep boundaries only.

    Category: [RadAlt]/Sources. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Waveform and altitude programme.
    altitude_m : float, optional
        Synthetic altitude in metres set by hand, from the end of the programme's preamble on (timing is acquired at
        altitude zero); None uses the scene's programme. Live. The stream tag ``radalt_altitude`` signals a change to
        the segmenter; radios pass no tags, see `frame_segmenter`.
    frames : int
        Sweeps before the stream ends; 0 for endless.

    Raises
    ------
    ValueError
        If the altitude is out of range, or is set by hand in a scene whose altitudes are true delays.
    Example
    -------
    ``src = radalt.fmcw_chirp_source(load_scene("paper_qpsk"), altitude_m=200.0)``
    """

    def __init__(self, scene: Scene, altitude_m: float | None = None, frames: int = 0) -> None:
        gr.sync_block.__init__(self, "radalt_fmcw_chirp_source", None, [np.complex64])
        self.waveform = scene.waveform
        self._sweeps = sweeps_of(scene)
        self._sent = self._sweeps.sent
        self._searched_m = scene.altimeter_settings.max_altitude_m
        self._shifting = self._sweeps.synthetic
        self._n = scene.waveform.samples_per_frame
        self._limit = int(frames)
        self._index = 0  # of the next sweep
        self._tagged_m: float | None = None
        self.set_altitude(altitude_m)
        gather_frames(self, self._n)

    def set_altitude(self, altitude_m: float | None) -> None:
        """Synthetic altitude in metres from the next sweep on; None returns to the programme."""
        if altitude_m is None:
            self._manual_m = None
            return
        top = self.waveform.max_unambiguous_altitude_m
        if not 0.0 <= altitude_m <= top:
            raise ValueError(
                f"altitude_m is {altitude_m!r}; it has to be within 0..{top:.6g} m, or None (programme)"
            )
        if not self._shifting:
            raise ValueError(
                f"altitude_m is {altitude_m:g}, and the scene's altitudes are true delays, which the channel plays; "
                "set altitude.mode synthetic, or altitude_m None (programme)"
            )
        if altitude_m > self._searched_m:
            self.logger.warn(
                f"altitude_m {altitude_m:g} m is above the {self._searched_m:g} m that the altimeter searches and will "
                "not be found; raise altimeter.max_altitude_m in the scene"
            )
        self._manual_m = float(altitude_m)

    @property
    def manual_altitude_m(self) -> float | None:
        """Altitude set by hand; None while the programme is in use."""
        return self._manual_m

    def altitude_m(self, frame_index: np.ndarray) -> np.ndarray:
        """True altitude of sweep ``frame_index``, any shape: the programme's, or one of the last 1000 set by hand."""
        return self._sent.altitude_m(frame_index)

    def sent(self, frame_index: int) -> tuple[float, float]:
        """Altitude in metres and range rate in m/s of sweep ``frame_index``, for `frame_segmenter.follow`."""
        altitude_m, rate = self._sent.at(frame_index)
        return altitude_m, 0.0 if self._shifting else rate

    def _tag_altitude(self, index: int, offset: int) -> None:
        """Record an altitude set by hand since the last sweep, and send it as a tag."""
        manual_m = self._manual_m
        if manual_m != self._tagged_m:
            self._sent.set(index, manual_m)
            self._tagged_m = manual_m
            self.add_item_tag(0, offset, SENT_KEY, sent_tag(index, manual_m))

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Copy sweeps into the output; `gather_frames` guarantees room for at least one."""
        out, first = output_items[0], self.nitems_written(0)
        frames = out.size // self._n
        if self._limit:
            frames = min(frames, self._limit - self._index)
            if not frames:
                return WORK_DONE
        for k, sweep in enumerate(out[: frames * self._n].reshape(frames, self._n)):
            self._tag_altitude(self._index, first + k * self._n)
            sweep[:] = self._sweeps.sweep(self._index)
            self._index += 1
        return frames * self._n
