"""Interference: emitters, and their placement in the frame at exact overlap and window SIR (DESIGN.md 3).

An *emitter* makes a waveform of about unit mean power; *placement* gates it to a fraction ``rho`` of the frame
and scales it so that the power averaged over the whole window meets the SIR exactly. The two are separate so that
every emitter, new ones too, obeys the same definition of SIR and overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy import signal

from ..waveform import exp_cycles

__all__ = [
    "Emitter",
    "Interferer",
    "QpskEmitter",
    "ToneEmitter",
    "interference_frame",
    "interference_frames",
    "rrc_taps",
]


class Emitter(Protocol):
    """What placement needs of an emitter."""

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 samples of about unit mean power, centred on the emitter's own carrier."""
        ...


@dataclass(frozen=True)
class ToneEmitter:
    """Sum of K unmodulated carriers of equal power and random phase.

    Parameters
    ----------
    count : int
        Number of tones ``K`` >= 1, drawn uniformly over ``span_hz`` unless ``frequencies_hz`` is given.
    frequencies_hz : tuple of float
        Fixed frequencies relative to the radar's centre, in hertz.
    span_hz : float
        Width of the band in which frequencies are drawn; 0 stands for the sample rate.
    """

    count: int = 1
    frequencies_hz: tuple[float, ...] = ()
    span_hz: float = 0.0

    def __post_init__(self) -> None:
        number = len(self.frequencies_hz) or self.count
        if not 1 <= number <= 256:
            # all of them are summed at once: count x samples of a frame
            raise ValueError(f"tones.count is {number}; it has to be within 1..256")
        if self.span_hz < 0:
            raise ValueError(f"tones.span_hz is {self.span_hz:g}; it has to be 0 (the whole band) or more")

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`; new frequencies and phases at every call."""
        if self.frequencies_hz:
            frequencies = np.asarray(self.frequencies_hz, dtype=float)
            if np.any(np.abs(frequencies) > rate_hz / 2):
                raise ValueError(
                    f"tones.frequencies_hz {self.frequencies_hz} leave +/- {rate_hz / 2:g} Hz, half the rate"
                )
        else:
            span = self.span_hz or rate_hz
            frequencies = rng.uniform(-0.5, 0.5, self.count) * span
        phases = rng.random(frequencies.size)
        cycles = frequencies[:, None] / rate_hz * np.arange(count) + phases[:, None]
        return exp_cycles(cycles, np.complex128).sum(0) / np.sqrt(frequencies.size)


@lru_cache(maxsize=32)
def rrc_taps(rolloff: float, up: int, span_symbols: int = 12) -> np.ndarray:
    """Root-raised-cosine taps at ``up`` samples a symbol, unit energy, length ``span*up + 1``, read-only.

    Closed form with its two removable singularities (J. G. Proakis, Digital Communications, 4th ed., 9.2-1).
    """
    t = np.arange(-span_symbols * up // 2, span_symbols * up // 2 + 1) / up
    b = rolloff
    if b == 0:
        taps = np.sinc(t)
    else:
        den = np.pi * t * (1 - (4 * b * t) ** 2)
        num = np.sin(np.pi * t * (1 - b)) + 4 * b * t * np.cos(np.pi * t * (1 + b))
        edge = (
            b
            / np.sqrt(2)
            * ((1 + 2 / np.pi) * np.sin(np.pi / 4 / b) + (1 - 2 / np.pi) * np.cos(np.pi / 4 / b))
        )
        singular = np.isclose(den, 0.0)
        taps = np.where(singular, edge, num / np.where(singular, 1.0, den))
        taps[np.isclose(t, 0.0)] = 1 - b + 4 * b / np.pi
    taps = taps / np.sqrt(np.sum(taps**2))
    taps.setflags(write=False)
    return taps


@dataclass(frozen=True)
class QpskEmitter:
    """QPSK with rectangular or root-raised-cosine pulses, random symbols, phase and symbol timing.

    Parameters
    ----------
    bandwidth_hz : float
        Rectangular pulses: the symbol rate (noise-equivalent bandwidth; nulls at +/- this, side lobes fill the
        band). Root-raised-cosine: the occupied bandwidth, symbol rate ``bandwidth_hz / (1 + rolloff)``.
        Default 26.7 % of 7.5 MHz, the paper's over-the-air interferer.
    carrier_hz : float
        Carrier relative to the radar's centre.
    pulse : str
        ``"rectangular"`` (the paper) or ``"rrc"``.
    rolloff : float
        Root-raised-cosine roll-off, 0..1.
    """

    bandwidth_hz: float = 0.267 * 7.5e6
    carrier_hz: float = 0.0
    pulse: str = "rectangular"
    rolloff: float = 0.25

    def __post_init__(self) -> None:
        if not self.bandwidth_hz >= 1.0:
            raise ValueError(f"qpsk.bandwidth_hz is {self.bandwidth_hz!r}; it has to be at least 1 Hz")
        if self.pulse not in ("rectangular", "rrc"):
            raise ValueError(f"qpsk.pulse is {self.pulse!r}; allowed: rectangular, rrc")
        if not 0 <= self.rolloff <= 1:
            raise ValueError(f"qpsk.rolloff is {self.rolloff!r}; it has to be within 0..1")

    @property
    def symbol_rate_hz(self) -> float:
        """Symbols a second."""
        return self.bandwidth_hz if self.pulse == "rectangular" else self.bandwidth_hz / (1 + self.rolloff)

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`."""
        rate = self.symbol_rate_hz / rate_hz
        if rate > 1 or abs(self.carrier_hz) > rate_hz / 2:
            raise ValueError(
                f"qpsk of {self.bandwidth_hz:g} Hz at {self.carrier_hz:g} Hz does not fit the rate of {rate_hz:g} S/s"
            )
        offset, phase = rng.random(2)
        turn = np.exp(2j * np.pi * phase)
        if self.pulse == "rectangular":
            symbols, index = self._held(count, rate, offset, rng)
            if not self.carrier_hz:  # there are fewer symbols to turn than samples
                return np.take(symbols * turn, index)
            baseband = symbols[index]
        else:
            baseband = self._shaped(count, rate, offset, rng)
        if self.carrier_hz:
            return baseband * exp_cycles(_ramp(count, self.carrier_hz / rate_hz) + phase, np.complex128)
        return baseband * turn

    def write(self, span: np.ndarray, mean_power: float, rate_hz: float, rng: np.random.Generator) -> bool:
        """Samples of that mean power into ``span``, complex64 or complex128, where this takes less than `samples`.

        True if written: rectangular pulses without a carrier have one modulus, so their symbols are scaled before they
        are held. Otherwise nothing is drawn or written.
        """
        rate = self.symbol_rate_hz / rate_hz
        if self.pulse != "rectangular" or self.carrier_hz or rate > 1:
            return False
        offset, phase = rng.random(2)
        symbols, index = self._held(span.size, rate, offset, rng)
        symbols = symbols * np.exp(2j * np.pi * phase) * np.sqrt(mean_power)
        np.take(
            symbols.astype(span.dtype), index, out=span, mode="clip"
        )  # the default mode buffers the output
        return True

    @staticmethod
    def _held(
        count: int, rate: float, offset: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Symbols at ``rate`` a sample, and which of them each of ``count`` samples holds."""
        # times are not negative: the conversion is the floor
        index = (_ramp(count, rate) + offset).astype(np.intp)
        return _qpsk_symbols(int(index[-1]) + 1 if count else 1, rng), index

    def _shaped(self, count: int, rate: float, offset: float, rng: np.random.Generator) -> np.ndarray:
        """Polyphase root-raised-cosine at the rational ``down/up`` samples-per-symbol nearest the wanted one."""
        ratio = Fraction(1 / rate).limit_denominator(64)
        up, down = ratio.numerator, ratio.denominator
        # a pulse rings on for the inverse of its roll-off: cut at 1.2 of that its spectrum ripples by a few percent
        side = int(np.ceil(min(32.0, max(6.0, 1.2 / max(self.rolloff, 1e-3)))))
        taps = rrc_taps(self.rolloff, up, 2 * side)
        lead = int(offset * up)  # symbol timing, in steps of 1/up symbol
        symbols = -(-(count * down + lead) // up) + 2 * side
        shaped = signal.upfirdn(taps * np.sqrt(up), _qpsk_symbols(symbols, rng), up, 1)
        start = side * up + lead
        return shaped[start : start + count * down : down]


_CONSTELLATION = np.exp(0.25j * np.pi * (1 + 2 * np.arange(4)))


def _qpsk_symbols(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count,) random unit QPSK symbols."""
    return _CONSTELLATION[rng.integers(0, 4, count)]


@lru_cache(maxsize=16)
def _ramp(count: int, step: float) -> np.ndarray:
    """(count,) float64 multiples of ``step`` from 0 on, read-only: the same for every frame of an emitter."""
    ramp = np.arange(count) * step
    ramp.setflags(write=False)
    return ramp


@dataclass(frozen=True)
class Interferer:
    """An emitter and how it is placed in every frame.

    Parameters
    ----------
    emitter : Emitter
        The waveform.
    sir_db : float
        Signal-to-interference ratio, both powers averaged over the whole frame; a shorter burst at the same SIR
        is therefore stronger while it lasts.
    overlap : float
        Active fraction ``rho`` of the frame, 0..1; any value above 0 stands for at least one sample.
    start : float or None
        Burst start as a fraction of the frame; None draws it uniformly so that the burst lies inside the frame.
    free_running : bool
        In a live jammer source: a burst grid unrelated to the sweep (`JammerStream`).
    """

    emitter: Emitter
    sir_db: float = -10.0
    overlap: float = 1.0
    start: float | None = None
    free_running: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.overlap <= 1:
            raise ValueError(f"overlap is {self.overlap!r}; it has to be within 0..1")
        if not np.isfinite(self.sir_db):
            raise ValueError(
                f"sir_db is {self.sir_db!r}; it has to be finite (leave the interferer out instead)"
            )
        if self.start is not None and not 0 <= self.start <= 1:
            raise ValueError(f"start is {self.start!r}; it has to be within 0..1, or none for random")

    def burst_samples(self, frame_samples: int) -> int:
        """Active samples in a frame."""
        return 0 if self.overlap == 0 else max(1, round(self.overlap * frame_samples))


def interference_frame(
    interferer: Interferer,
    frame_samples: int,
    rate_hz: float,
    rng: np.random.Generator,
    *,
    return_power: float = 1.0,
) -> np.ndarray:
    """(N,) complex128: one frame of one interferer at its exact window SIR and overlap."""
    frame = np.zeros(frame_samples, dtype=np.complex128)
    _place(frame, interferer, rate_hz, rng, return_power)
    return frame


def _place(
    silence: np.ndarray, interferer: Interferer, rate_hz: float, rng: np.random.Generator, return_power: float
) -> None:
    """Write one burst into a frame of zeros, complex64 or complex128."""
    frame_samples = silence.size
    count = interferer.burst_samples(frame_samples)
    if count == 0:
        return
    if interferer.start is None:
        first = int(rng.integers(0, frame_samples - count + 1))
    else:
        first = min(round(interferer.start * frame_samples), frame_samples - count)
    emitter, span = interferer.emitter, silence[first : first + count]
    wanted = return_power * 10.0 ** (-interferer.sir_db / 10.0) * frame_samples
    if isinstance(emitter, QpskEmitter) and emitter.write(span, wanted / count, rate_hz, rng):
        return
    burst = emitter.samples(count, rate_hz, rng)
    energy = np.vdot(burst, burst).real
    if energy > 0:  # an emitter that is silent in this window (a pulsed radar between pulses) stays silent
        np.multiply(burst, np.sqrt(wanted / energy), out=span, casting="same_kind")


def interference_frames(
    interferers: Sequence[Interferer],
    frames: int,
    frame_samples: int,
    rate_hz: float,
    rng: np.random.Generator,
    *,
    return_power: float = 1.0,
    total_sir_db: float | None = None,
    transform: Callable[[np.ndarray, np.random.Generator], np.ndarray] | None = None,
    dtype: type = np.complex128,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """(frames, N) ``dtype``: sum of interferers, each at its own SIR, the sum scaled to ``total_sir_db`` if given.

    ``transform(frame, rng)`` is applied to each interferer's frame before its power is set anew (multipath). Sums are
    made in complex128 whatever the ``dtype``. ``out``, if given, is written to and returned, in its own dtype.
    """
    if len(interferers) == 1 and transform is None and total_sir_db is None:  # nothing to sum
        alone = np.empty((frames, frame_samples), dtype=dtype) if out is None else out
        alone[:] = 0
        for row in alone:
            _place(row, interferers[0], rate_hz, rng, return_power)
        return alone
    total = np.zeros((frames, frame_samples), dtype=np.complex128)
    for row in total:
        for interferer in interferers:
            part = interference_frame(interferer, frame_samples, rate_hz, rng, return_power=return_power)
            if transform is not None:
                part = _rescale(transform(part, rng), np.vdot(part, part).real)
            row += part
        if total_sir_db is not None:
            row[:] = _rescale(row, return_power * 10.0 ** (-total_sir_db / 10.0) * frame_samples)
    if out is None:
        return total.astype(dtype, copy=False)
    out[:] = total
    return out


def _rescale(frame: np.ndarray, energy: float) -> np.ndarray:
    """The same frame with that energy; silence stays silence."""
    have = np.vdot(frame, frame).real
    return frame * np.sqrt(energy / have) if have > 0 else frame
