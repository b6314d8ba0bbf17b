"""Emitters as a deramping altimeter receives them: mixed with its sweep and filtered, at the IF rate.

Each has mean power 1 at the antenna port while it transmits, and is a function of time: frame ``i`` begins at
``i * sweep_s``, and an instant has the same sample in every frame that contains it. All phases are float64.

Frequencies ``offset_hz`` are relative to the centre of the sweep.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import fft

from ..fir import kaiser_lowpass
from ..interference.transmission import Signal, begin
from ..waveform import Waveform, exp_cycles
from .if_waveform import IfWaveform


class Emitter(Protocol):
    """A signal that a sweep is mixed with."""

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """(M,) complex samples behind the mixer on ``start_s + simulation_times_s``, right within the IF."""
        ...


def interference_if(waveform: IfWaveform, emitter: Emitter, count: int, first: int = 0) -> np.ndarray:
    """(count, N) complex64 frames ``first ...`` of an emitter at the IF; its power at the port is 1."""
    out = np.empty((count, waveform.samples_per_frame), dtype=np.complex64)
    for i in range(count):
        out[i] = waveform.filtered(emitter.mixed(waveform, (first + i) * waveform.sweep_s))
    return out


def delayed_if(waveform: IfWaveform, frames: np.ndarray, delay_s: float) -> np.ndarray:
    """(n, N) complex64 IF frames of an emitter that is received a delay later: y(t - d) LO(t - d) conj LO(t)."""
    w, t = waveform, waveform.sample_times_s
    cycles = w.phase_cycles(t - delay_s) - w.phase_cycles(t) - w.carrier_hz * delay_s
    shift = exp_cycles(-fft.fftfreq(w.samples_per_frame, 1 / w.rate_hz) * delay_s)
    return fft.ifft(fft.fft(frames, axis=1) * shift, axis=1) * exp_cycles(cycles)


def _crossing(
    waveform: IfWaveform,
    time_s: np.ndarray,
    frequency_hz: np.ndarray | float,
    cycles: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """A wave of slowly varying frequency, computed only where its beat lies within reach of the simulated band."""
    beat = frequency_hz - waveform.frequency_hz(time_s)
    inner = 0.5 * waveform.simulation_hz
    outer = waveform.simulation_hz - waveform.stop_hz
    at = np.flatnonzero(np.abs(beat) < outer)
    out = np.zeros(time_s.size, dtype=np.complex64)
    gate = np.clip((outer - np.abs(beat[at])) / (outer - inner), 0.0, 1.0)
    local = np.mod(time_s[at], waveform.sweep_s)
    out[at] = exp_cycles(cycles(time_s[at]) - waveform.phase_cycles(local)) * gate
    return out


@dataclass(frozen=True)
class Tone:
    """A carrier."""

    offset_hz: float = 0.0
    phase_cycles: float = 0.0

    def cycles(self, time_s: np.ndarray) -> np.ndarray:
        """Phase at any times, modulo one cycle."""
        return np.mod(self.offset_hz * time_s, 1.0) + self.phase_cycles

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        t = start_s + waveform.simulation_times_s
        return _crossing(waveform, t, self.offset_hz, self.cycles)


@dataclass(frozen=True)
class OtherAltimeter:
    """Another FMCW altimeter, of equal or different slope, whose sweep begins ``delay_s`` later.

    An equal sweep that is locked appears as a target at ``c delay_s / 2``; one whose period differs by 10 ppm drifts.
    """

    sweep: Waveform
    delay_s: float = 0.0
    offset_hz: float = 0.0

    def cycles(self, time_s: np.ndarray) -> np.ndarray:
        """Phase at any times, modulo one cycle."""
        return self.sweep.phase_cycles(time_s - self.delay_s) + np.mod(self.offset_hz * time_s, 1.0)

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        t = start_s + waveform.simulation_times_s
        frequency = self.sweep.frequency_hz(t - self.delay_s) + self.offset_hz
        return _crossing(waveform, t, frequency, self.cycles)


@dataclass(frozen=True)
class Carrier:
    """A transmission of any emitter (`core.interference`) at an offset, computed only while the sweep is near."""

    signal: Signal  # its samples about its own centre, mean power 1
    rate_hz: float
    """Rate of the signal: a multiple of the simulation rate, at least ``bandwidth_hz`` and twice the IF's stop
    band."""
    bandwidth_hz: float  # band that it occupies, about its centre
    offset_hz: float = 0.0

    @classmethod
    def begun(
        cls,
        emitter: object,
        waveform: IfWaveform,
        bandwidth_hz: float,
        offset_hz: float,
        rng: np.random.Generator,
    ) -> "Carrier":
        """Draw a transmission of an emitter at the least rate that holds it; ValueError if it has no such rate."""
        steps = int(np.ceil((bandwidth_hz + 2 * waveform.stop_hz) / waveform.simulation_hz))
        rate_hz = steps * waveform.simulation_hz
        return cls(begin(emitter, rate_hz, rng), rate_hz, bandwidth_hz, offset_hz)

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        w, steps = waveform, round(self.rate_hz / waveform.simulation_hz)
        # what folds lies outside the IF
        taps = (
            kaiser_lowpass(w.stop_hz, w.simulation_hz - w.stop_hz, self.rate_hz) if steps > 1 else np.ones(1)
        )
        count = w.simulation_times_s.size
        # a frame late: not negative
        begin_n = round((start_s + w.sweep_s - w.lead / w.simulation_hz) * self.rate_hz)
        reach_hz = 0.5 * self.bandwidth_hz + w.stop_hz
        near = np.abs(self.offset_hz - w.frequency_hz(start_s + w.simulation_times_s)) < reach_hz
        out = np.zeros(steps * count, dtype=np.complex64)
        for part in _runs(near):
            at = np.arange(steps * part.start, steps * part.stop)
            t = start_s - w.lead / w.simulation_hz + at / self.rate_hz
            cycles = np.mod(self.offset_hz * t, 1.0) - w.phase_cycles(np.mod(t, w.sweep_s))
            out[at] = self.signal(begin_n + int(at[0]), at.size) * exp_cycles(cycles, np.complex128)
        return np.convolve(out, taps, mode="same")[::steps] if steps > 1 else out


def _runs(mask: np.ndarray) -> list[slice]:
    """Runs of true entries."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
