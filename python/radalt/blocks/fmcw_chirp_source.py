"""FMCW chirp source with synthetic beat shift."""

from __future__ import annotations

from collections import deque

import numpy as np
from gnuradio import gr

from ..core.scene import Scene
from ._frames import gather_frames
from ._guard import WORK_DONE, guarded

__all__ = ["fmcw_chirp_source"]


_CHANGES = 1000


class fmcw_chirp_source(gr.sync_block):
    """Triangular FMCW sweep, unit amplitude, its beat shifted to a synthetic altitude.

    ``s(u) = exp(j 2 pi (phi(u) -+ k tau u))``: up sweeps are shifted by ``-k tau``, down sweeps by ``+k tau``, with
    ``tau = 2 R / c``; the phase is continuous at the seams and the altitude changes on sweep boundaries only.

    Category: [RadAlt]/Sources. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Waveform and altitude programme.
    altitude_m : float
        Synthetic altitude in metres set by hand, from the end of the programme's preamble on (timing is taken at
        altitude zero); below 0 the scene's programme is followed, frame by frame.
    frames : int
        Sweeps to send before the stream ends; 0 for endless.

    Example
    -------
    ``src = radalt.fmcw_chirp_source(load_scene("paper_qpsk"), altitude_m=200.0)``
    """

    def __init__(self, scene: Scene, altitude_m: float = -1.0, frames: int = 0) -> None:
        gr.sync_block.__init__(self, "radalt_fmcw_chirp_source", None, [np.complex64])
        self.waveform = scene.waveform
        self._programme = scene.altitude.programme
        self._shifting = scene.altitude.mode == "synthetic"
        self._n = scene.waveform.samples_per_frame
        self._limit = int(frames) * self._n
        self._tables: dict[float, np.ndarray] = {}
        self._position = 0
        self._changes: deque[tuple[int, float]] = deque(maxlen=_CHANGES)
        self.set_altitude(altitude_m)
        self._frame = self._table(0)
        gather_frames(self, self._n)

    def set_altitude(self, altitude_m: float) -> None:
        """Synthetic altitude from the next sweep on; below 0 follows the programme."""
        top = self.waveform.max_unambiguous_altitude_m
        if not (np.isfinite(altitude_m) and altitude_m <= top):
            raise ValueError(
                f"altitude_m is {altitude_m!r}; it has to be at most {top:.6g} m (below 0: programme)"
            )
        self._manual_m = float(altitude_m)

    @property
    def manual_altitude_m(self) -> float | None:
        """Altitude set by hand; None where the programme is followed."""
        return self._manual_m if self._manual_m >= 0 else None

    def altitude_m(self, frame_index: np.ndarray) -> np.ndarray:
        """What was sent as sweep ``frame_index``, any shape: programme and altitudes set by hand, the last thousand."""
        index = np.asarray(frame_index)
        changes = list(
            self._changes
        )  # one step under the interpreter's lock; the block may add to it meanwhile
        out = np.asarray(self._programme.altitude_m(index), dtype=float).copy()
        for first, altitude in changes:
            here = index >= first
            out[here] = self._programme.altitude_m(index[here]) if altitude < 0 else altitude
        out[index < self._programme.preamble_frames] = 0.0
        return out

    def sent(self, frame_index: int) -> tuple[float, float]:
        """Altitude in metres and range rate in m/s of sweep ``frame_index``, for `frame_segmenter.follow`."""
        if not self._shifting:
            return self._programme.at(frame_index)
        if frame_index < self._programme.preamble_frames:
            return 0.0, 0.0
        for first, altitude in reversed(list(self._changes)):
            if first <= frame_index and altitude >= 0:
                return altitude, 0.0
            if first <= frame_index:
                break
        return self._programme.at(frame_index)[0], 0.0

    def _table(self, index: int) -> np.ndarray:
        """(N,) complex64 sweep number ``index``."""
        if not self._changes or self._changes[-1][1] != self._manual_m:
            self._changes.append((index, self._manual_m))
        altitude = self._manual_m if self._manual_m >= 0 else self._programme.at(index)[0]
        if not self._shifting or index < self._programme.preamble_frames:
            altitude = 0.0
        if altitude not in self._tables:
            if len(self._tables) >= 64:
                self._tables.clear()
            self._tables[altitude] = self.waveform.beat_shifted(altitude)
        table = self._tables[altitude]
        if self.waveform.cycles_per_frame:
            table = table * np.complex64(self.waveform.frame_rotation(index))
        return table

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Copy sweeps into the output."""
        out = output_items[0]
        if self._limit:
            left = self._limit - self._position
            if left <= 0:
                return WORK_DONE
            out = out[:left]
        done = 0
        while done < out.size:
            index, at = divmod(self._position, self._n)
            if at == 0:
                self._frame = self._table(index)
            count = min(self._n - at, out.size - done)
            out[done : done + count] = self._frame[at : at + count]
            done += count
            self._position += count
        return done
