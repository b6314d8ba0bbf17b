"""Placement of an emitter's waveform in the frame, at exact overlap and window SIR.

An *emitter* makes a waveform of about unit mean power. *Placement* gates it to a fraction ``rho`` of the frame and
scales it so that the power averaged over the frame meets the SIR exactly. They are separate so that one definition of
SIR and overlap holds for every emitter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Emitter(Protocol):
    """Protocol of an emitter.

    With ``begin(rate_hz, rng)`` it is a function of time (see `transmission`) and goes on from frame to frame in a
    stream; without, a stream draws it anew every 40 frames.
    """

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 samples of about unit mean power, centred on the emitter's carrier."""
        ...


@dataclass(frozen=True)
class Interferer:
    """An emitter and how it is placed in every frame."""

    emitter: Emitter
    """The waveform."""
    sir_db: float = -10.0
    """Signal-to-interference ratio, both powers averaged over the frame; a shorter burst at the same SIR is therefore
    stronger while it lasts."""
    overlap: float = 1.0
    """Active fraction ``rho`` of the frame, 0..1; any value above 0 stands for at least one sample."""
    start: float | None = None
    """Burst start as a fraction of the frame; None draws it uniformly so that the burst lies inside the frame."""
    free_running: bool = False
    """In a live jammer source: a burst grid that is not synchronised to the sweep (`JammerStream`)."""

    def __post_init__(self) -> None:
        if not 0 <= self.overlap <= 1:
            raise ValueError(f"overlap is {self.overlap!r}; it has to be within 0..1")
        if not np.isfinite(self.sir_db):
            raise ValueError(
                f"sir_db is {self.sir_db!r}; it has to be finite (leave the interferer out instead)"
            )
        if self.start is not None and not 0 <= self.start <= 1:
            raise ValueError(f"start is {self.start!r}; it has to be within 0..1, or none for random")


def interference_frame(
    interferer: Interferer, frame_samples: int, rate_hz: float, rng: np.random.Generator
) -> np.ndarray:
    """(N,) complex128: one frame of one interferer at its exact overlap and SIR, against a return of unit power."""
    frame = np.empty(frame_samples, dtype=np.complex128)
    _place(frame, interferer, rate_hz, rng)
    return frame


def _place(frame: np.ndarray, interferer: Interferer, rate_hz: float, rng: np.random.Generator) -> None:
    """Write one burst, and silence around it, into a frame, complex64 or complex128."""
    frame_samples = frame.size
    count = max(1, round(interferer.overlap * frame_samples)) if interferer.overlap else 0
    if count < frame_samples:
        frame.view(frame.real.dtype)[:] = 0  # a quarter of the time of complex zeros
    if count == 0:
        return
    if count == frame_samples:  # the only start is 0; drawing it would take a tenth of a burst's time
        first = 0
    elif interferer.start is None:
        first = int(rng.integers(0, frame_samples - count + 1))
    else:
        first = min(round(interferer.start * frame_samples), frame_samples - count)
    emitter, span = interferer.emitter, frame[first : first + count]
    wanted = 10.0 ** (-interferer.sir_db / 10.0) * frame_samples
    if hasattr(emitter, "seek"):
        emitter.seek(first)
    if getattr(emitter, "steady", False):
        part = emitter.samples(count, rate_hz, rng)
        np.multiply(part, np.sqrt(wanted / count), out=span, casting="same_kind")
        return
    burst = emitter.samples(count, rate_hz, rng)
    energy = np.vdot(burst, burst).real
    if energy > 0:
        np.multiply(burst, np.sqrt(wanted / energy), out=span, casting="same_kind")
    else:  # an emitter that is silent in this window (a pulsed radar between pulses) stays silent
        span[:] = 0


def interference_frames(
    interferers: Sequence[Interferer],
    frames: int,
    frame_samples: int,
    rate_hz: float,
    rng: np.random.Generator,
    *,
    total_sir_db: float | None = None,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """(frames, N) complex128: sum of interferers, each at its own SIR, the sum scaled to ``total_sir_db`` if given.

    ``out``, if given, is written to and returned, in its own dtype.
    """
    if len(interferers) == 1 and total_sir_db is None:  # nothing to sum
        alone = np.empty((frames, frame_samples), np.complex128) if out is None else out
        for row in alone:
            _place(row, interferers[0], rate_hz, rng)
        return alone
    total = np.zeros((frames, frame_samples), dtype=np.complex128)
    for row in total:
        for interferer in interferers:
            row += interference_frame(interferer, frame_samples, rate_hz, rng)
        if total_sir_db is not None:
            have, wanted = np.vdot(row, row).real, 10.0 ** (-total_sir_db / 10.0) * frame_samples
            row *= np.sqrt(wanted / have) if have > 0 else 1.0
    if out is None:
        return total
    out[:] = total
    return out
