"""Interference as a stream of frames, for the jammer source blocks."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..programme import Programme
from ..waveform import Waveform
from .effects import ImpairedEmitter, Path
from .placement import Interferer, interference_frames
from .transmission import Transmission


class JammerStream:
    """Endless interference in frames of N samples, silent in frames that are not trials of a ``programme``.

    Each burst lies within one sweep. With ``free_running`` the burst grid is offset against the sweep's by a random
    part of a frame, as for an emitter that is not synchronised to the radar. SIR and overlap then hold in the grid's
    windows. Transmitters go on from frame to frame: in bursts, symbols, carrier and timing run on through the gaps;
    with full overlap the gain is constant, and the total SIR holds in the mean; with ``fading`` in the mean over the
    fading. Those with ``always_in_window`` are drawn anew in every frame, and plug-ins without ``begin`` every 40
    frames. Channels and oscillators of ``fading``, ``oscillator`` and ``phase_noise`` are continuous in both cases.
    Without ``total_sir_db`` each interferer keeps its SIR.
    """

    def __init__(
        self,
        waveform: Waveform,
        interferers: Sequence[Interferer],
        *,
        programme: Programme | None = None,
        seed: int = 0,
        free_running: bool = False,
        total_sir_db: float | None = None,
    ) -> None:
        self.waveform, self.programme = waveform, programme
        self._free_running = free_running
        self._running: dict[int, Transmission | Path] = {}  # by place
        self.play(interferers, total_sir_db)
        self._rng = np.random.default_rng([seed, 0x3A3])
        n = waveform.samples_per_frame
        self._shift = int(self._rng.integers(0, n)) if free_running else 0
        self._carry = np.zeros(self._shift, dtype=np.complex64)
        self.frame_index = 0
        # read once per frame, which is ten times as fast from bytes as from an array
        frames = 0 if programme is None else programme.total_frames
        self._trial = b"" if programme is None else programme.is_trial(np.arange(frames)).tobytes()

    def play(self, interferers: Sequence[Interferer], total_sir_db: float | None = None) -> None:
        """Change the interferers and their SIR from the next frame on; transmissions are not begun again."""
        self.interferers, self.total_sir_db = tuple(interferers), total_sir_db
        self._playing = tuple(self._going_on(k, one) for k, one in enumerate(interferers))
        self._scaled_to_db = total_sir_db
        emitters = [i.emitter for i in self._playing]
        if total_sir_db is not None and all(isinstance(e, Transmission) and e.steady for e in emitters):
            # a scale per frame would make the sum step between frames
            excess_db = total_sir_db + 10.0 * np.log10(sum(10.0 ** (-i.sir_db / 10.0) for i in interferers))
            self._playing = tuple(replace(i, sir_db=i.sir_db + excess_db) for i in self._playing)
            self._scaled_to_db = None

    def _going_on(self, place: int, interferer: Interferer) -> Interferer:
        """The interferer as it goes on from frame to frame; as it is, where every frame is drawn anew."""
        emitter, running = interferer.emitter, self._running.get(place)
        goes_on = self._free_running and not getattr(emitter, "always_in_window", False)
        if not goes_on and not isinstance(emitter, ImpairedEmitter):
            return interferer
        if running is None or running.emitter is not emitter:
            kind = Transmission if goes_on else Path
            running = self._running[place] = kind(emitter, self.waveform.samples_per_frame)
        if isinstance(running, Transmission):
            running.steady = interferer.overlap == 1  # else every burst is scaled to the SIR
        return replace(interferer, emitter=running)

    def next_frame(self, out: np.ndarray | None = None) -> np.ndarray:
        """(N,) complex64: interference of the next frame, in ``out`` if that is given."""
        index = self.frame_index
        self.frame_index += 1
        n = self.waveform.samples_per_frame
        frame = np.empty(n, dtype=np.complex64) if out is None else out
        silent = self._is_silent(index)
        # the next frame begins in this window
        if silent and not (self._shift and not self._is_silent(index + 1)):
            frame[:] = 0
        else:
            for running in self._running.values():
                running.frame_index = index
            rate_hz, scaled = self.waveform.rate_hz, {"total_sir_db": self._scaled_to_db}
            interference_frames(self._playing, 1, n, rate_hz, self._rng, **scaled, out=frame[None])
        if self._shift:
            joined = np.concatenate([self._carry, frame])
            self._carry = joined[n:]
            frame[:] = 0 if silent else joined[:n]
        return frame

    def _is_silent(self, index: int) -> bool:
        if self.programme is None:
            return False
        return not (self._trial[index] if index < len(self._trial) else self.programme.is_trial(index))
