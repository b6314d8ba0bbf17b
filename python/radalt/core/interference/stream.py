"""Interference as a stream of frames, for the jammer source blocks."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..programme import Programme
from ..waveform import Waveform
from .effects import WINDOW_FRAMES, ImpairedEmitter, Running
from .placement import Emitter, Interferer, interference_frames


class Continued:
    """An emitter that is continuous from frame to frame: one window spans many frames, each call takes the next part.

    Symbols, carrier phase and fading are continuous within a window; the next window is drawn anew. Not for emitters
    that draw windows in which they are received (``always_in_window``).

    Parameters
    ----------
    emitter : Emitter
    frame_samples : int
        Samples between the starts of two calls.
    frames : int
        Frames in one window.
    repeats : bool
        Whether the first window is repeated without end, for an emitter whose period divides it.
    steady : bool
        Constant gain over the window, as of a transmitter: the SIR holds over the window. Otherwise each frame is
        scaled to the SIR.
    cycles : float
        Cycles of the emitter's carrier in a repeated window, so that the carrier phase is continuous at its seam.
    """

    def __init__(
        self,
        emitter: Emitter,
        frame_samples: int,
        frames: int = 40,
        *,
        repeats: bool = False,
        steady: bool = False,
        cycles: float = 0.0,
    ) -> None:
        self.emitter, self.frame_samples, self.frames = emitter, frame_samples, frames
        self.repeats, self.steady = repeats, steady
        self._rotation = np.exp(2j * np.pi * (cycles % 1.0)) if cycles % 1.0 else None
        self._next, self._window = 0, np.empty(0, dtype=np.complex128)
        self._energy = 0.0

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`; ``count`` is at most ``frame_samples``."""
        if self._next == 0 and not (self.repeats and self._window.size):
            self._window = self.emitter.samples(self.frames * self.frame_samples, rate_hz, rng)
            self._energy = np.vdot(self._window, self._window).real
        elif self._next == 0 and self._rotation is not None:
            self._window *= self._rotation
        first = self._next * self.frame_samples
        self._next = (self._next + 1) % self.frames
        return self._window[first : first + count]

    def write(self, span: np.ndarray, mean_power: float, rate_hz: float, rng: np.random.Generator) -> bool:
        """See `Emitter`: with the window's gain if ``steady``, else nothing is written."""
        if not self.steady:
            return False
        part = self.samples(span.size, rate_hz, rng)
        energy = self._energy
        if energy > 0:
            gain = np.sqrt(mean_power * self._window.size / energy)
            np.multiply(part, gain, out=span, casting="same_kind")
        else:
            span[:] = 0
        return True


class JammerStream:
    """Endless interference in frames of N samples, silent while the segmenter takes its timing.

    Parameters
    ----------
    waveform : Waveform
        Frame length and rate.
    interferers : sequence of Interferer
        Interferers to sum; may be empty (silence).
    programme : Programme or None
        Silent in frames that are not trials; None transmits from the first frame.
    seed : int
        Seed of everything random.
    free_running : bool
        False: each burst lies within one sweep. True: the burst grid is offset against the sweep's by a random part of
        a frame, as for an emitter that is not synchronised to the radar. SIR and overlap then hold in the grid's
        windows. Interference with full overlap is continuous from frame to frame with constant gain: without end if it
        repeats (5G NR, recordings), else in windows of 40 frames. The total SIR then holds in the mean; with
        ``fading`` in the mean over the fading. Channels and oscillators of ``fading``, ``oscillator`` and
        ``phase_noise`` are continuous in both cases.
    total_sir_db : float or None
        SIR of the sum; None keeps each interferer's SIR.
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
        self._running: dict[int, Continued | Running] = {}  # by place
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
        """Change the interferers and their SIR from the next frame on; continuous emitters are not restarted."""
        self.interferers, self.total_sir_db = tuple(interferers), total_sir_db
        self._playing, self._scaled_to_db = self.interferers, total_sir_db
        if not self._free_running:
            self._playing = tuple(self._moving(k, one, steady=False) for k, one in enumerate(interferers))
            return
        self._playing = tuple(self._continued(k, one) for k, one in enumerate(interferers))
        emitters = [i.emitter for i in self._playing]
        if total_sir_db is not None and all(
            isinstance(e, Continued | Running) and e.steady for e in emitters
        ):
            # a scale per frame would make the sum step between frames
            excess_db = total_sir_db + 10.0 * np.log10(sum(10.0 ** (-i.sir_db / 10.0) for i in interferers))
            self._playing = tuple(replace(i, sir_db=i.sir_db + excess_db) for i in self._playing)
            self._scaled_to_db = None

    def _continued(self, place: int, interferer: Interferer) -> Interferer:
        """The interferer, made continuous from frame to frame if it has full overlap."""
        emitter, running = interferer.emitter, self._running.get(place)
        full_overlap = interferer.overlap == 1 and not getattr(emitter, "always_in_window", False)
        if isinstance(emitter, ImpairedEmitter):
            return self._moving(place, interferer, steady=full_overlap)
        if not full_overlap:
            return interferer
        if running is None or running.emitter is not emitter:
            frames = getattr(emitter, "period_s", 0.0) / self.waveform.sweep_s
            repeats = frames >= 1 and frames == round(frames)
            count = round(frames) if repeats else WINDOW_FRAMES
            n = self.waveform.samples_per_frame
            cycles = getattr(emitter, "carrier_hz", 0.0) * count * self.waveform.sweep_s if repeats else 0.0
            running = Continued(emitter, n, count, repeats=repeats, steady=True, cycles=cycles)
            self._running[place] = running
        return replace(interferer, emitter=running)

    def _moving(self, place: int, interferer: Interferer, *, steady: bool) -> Interferer:
        """The interferer with its channel and oscillators, if any, made continuous from frame to frame."""
        emitter, running = interferer.emitter, self._running.get(place)
        if not isinstance(emitter, ImpairedEmitter):
            return interferer
        if running is None or running.emitter is not emitter:
            running = Running(emitter, self.waveform.samples_per_frame)
            self._running[place] = running
        running.steady = steady  # bursts and full overlap share the channel when the overlap is changed
        return replace(interferer, emitter=running)

    def next_frame(self, out: np.ndarray | None = None) -> np.ndarray:
        """(N,) complex64: interference of the next frame, in ``out`` if that is given."""
        index = self.frame_index
        self.frame_index += 1
        n = self.waveform.samples_per_frame
        frame = np.empty(n, dtype=np.complex64) if out is None else out
        if self._is_silent(index):
            frame[:] = 0
        else:
            interference_frames(
                self._playing,
                1,
                n,
                self.waveform.rate_hz,
                self._rng,
                total_sir_db=self._scaled_to_db,
                out=frame[None],
            )
        if self._shift:
            joined = np.concatenate([self._carry, frame])
            self._carry = joined[n:]
            frame[:] = joined[:n]
        return frame

    def _is_silent(self, index: int) -> bool:
        if self.programme is None:
            return False
        return not (self._trial[index] if index < len(self._trial) else self.programme.is_trial(index))
