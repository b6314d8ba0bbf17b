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
from ..waveform import Waveform, exp_cycles
from .if_waveform import SIMULATION_FACTOR, IfWaveform

_PULSE_OVERSAMPLING = 16  # rate at which pulses are computed, over the simulation rate
_ROLL_OFF = 0.25  # of QPSK's root-raised-cosine pulse
_SPAN = 12  # symbols to either side at which that pulse is cut: its tail is 50 dB down


class Emitter(Protocol):
    """A signal that a sweep is mixed with."""

    constant_envelope: bool  # else complex Gaussian, as seen by an amplifier

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """(M,) complex samples behind the mixer on ``start_s + simulation_times_s``, right within the IF."""
        ...


def interference_if(waveform: IfWaveform, emitter: Emitter, count: int, first: int = 0) -> np.ndarray:
    """(count, N) complex64 frames ``first ...`` of an emitter at the IF; its power at the port is 1."""
    out = np.empty((count, waveform.samples_per_frame), dtype=np.complex64)
    for i in range(count):
        out[i] = waveform.filtered(emitter.mixed(waveform, (first + i) * waveform.sweep_s))
    return out


def _crossing(
    waveform: IfWaveform,
    time_s: np.ndarray,
    frequency_hz: np.ndarray | float,
    cycles: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """A wave of slowly varying frequency, computed only where its beat lies within reach of the simulated band.

    Beats beyond the simulation rate less the IF's stop band alias outside the IF; the gate falls to zero before.
    """
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
    constant_envelope = True

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
    constant_envelope = True

    def cycles(self, time_s: np.ndarray) -> np.ndarray:
        """Phase at any times, modulo one cycle."""
        return self.sweep.phase_cycles(time_s - self.delay_s) + np.mod(self.offset_hz * time_s, 1.0)

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        t = start_s + waveform.simulation_times_s
        frequency = self.sweep.frequency_hz(t - self.delay_s) + self.offset_hz
        return _crossing(waveform, t, frequency, self.cycles)


@dataclass(frozen=True)
class Ofdm:
    """CP-OFDM with QPSK on every subcarrier, DC included: the numerology of NR without its control signals.

    Per symbol only the subcarriers near the sweep are computed, by one small inverse FFT.

    Parameters
    ----------
    offset_hz : float
        Frequency of subcarrier 0, the middle one.
    subcarriers : int
        624 of 15 kHz are the 52 resource blocks of a 10 MHz NR carrier.
    spacing_hz : float
    prefix : float
        Cyclic prefix over the useful part; 72/1024 is NR's normal prefix, 4.69 us at 15 kHz.
    seed : int
        The data of symbol ``s`` are drawn from (seed, s).
    """

    offset_hz: float = 0.0
    subcarriers: int = 624
    spacing_hz: float = 15e3
    prefix: float = 72 / 1024
    seed: int = 1
    constant_envelope = False

    @property
    def symbol_s(self) -> float:
        """Duration of a symbol with its prefix."""
        return (1.0 + self.prefix) / self.spacing_hz

    def data(self, symbol: int) -> np.ndarray:
        """(subcarriers,) complex128 QPSK data of a symbol, from the lowest subcarrier on; total power 1."""
        quarters = np.random.default_rng([self.seed, symbol + (1 << 32)]).integers(0, 4, self.subcarriers)
        return exp_cycles(quarters / 4 + 0.125, np.complex128) / np.sqrt(self.subcarriers)

    def check(self, waveform: IfWaveform) -> int:
        """Size of the small FFT; raises ValueError where a sweep is too fast or the rates do not fit."""
        size = waveform.simulation_hz / self.spacing_hz
        if abs(size - round(size)) > 1e-6:
            raise ValueError(
                f"the IF's rate {waveform.rate_hz:g} is no multiple of {self.spacing_hz / SIMULATION_FACTOR:g}, a "
                f"subcarrier's spacing over {SIMULATION_FACTOR}; choose one"
            )
        moved = 0.5 * waveform.slope_hz_per_s * self.symbol_s
        if moved + waveform.stop_hz > 0.5 * waveform.simulation_hz:
            raise ValueError(
                f"the sweep moves by {2e-6 * moved:.3g} MHz in a symbol of {1e6 * self.symbol_s:.3g} us, more than the "
                f"simulated band of {1e-6 * waveform.simulation_hz:.3g} MHz holds; raise the IF's rate"
            )
        return round(size)

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        size = self.check(waveform)
        t = start_s + waveform.simulation_times_s
        out = np.zeros(t.size, dtype=np.complex64)
        half = self.subcarriers // 2
        first, last = (int(np.floor(x / self.symbol_s)) for x in (t[0], t[-1]))
        begins = np.arange(first, last + 2) * self.symbol_s
        edges = np.clip(np.ceil((begins - t[0]) * waveform.simulation_hz - 1e-6).astype(int), 0, t.size)
        beside = waveform.frequency_hz(begins[:-1] + 0.5 * self.symbol_s) - self.offset_hz
        reach = half * self.spacing_hz + 0.5 * waveform.simulation_hz
        for k in np.flatnonzero((np.abs(beside) < reach) & (edges[1:] > edges[:-1])):
            part = slice(edges[k], edges[k + 1])
            out[part] = self._symbol(waveform, first + int(k), t[part], begins[k], beside[k], size)
        return out

    def _symbol(
        self, waveform: IfWaveform, symbol: int, t: np.ndarray, begin_s: float, beside_hz: float, size: int
    ) -> np.ndarray:
        """Samples of one symbol: the subcarriers about the sweep, mixed with it."""
        half = self.subcarriers // 2
        middle = int(np.rint(beside_hz / self.spacing_hz))
        carriers = np.arange(max(middle - size // 2, -half), min(middle + size // 2, self.subcarriers - half))
        spectrum = np.zeros(size, dtype=np.complex128)
        spectrum[(carriers - middle) % size] = self.data(symbol)[carriers + half]
        useful = t - begin_s - self.prefix / self.spacing_hz  # time in the useful part
        first = useful[0] * waveform.simulation_hz
        rest = first - np.rint(first)
        spectrum *= np.exp(2j * np.pi * np.fft.fftfreq(size) * rest)  # the grid's fraction of a sample
        index = (int(np.rint(first)) + np.arange(t.size)) % size
        wave = (fft.ifft(spectrum) * size)[index]
        cycles = np.mod(self.offset_hz * t, 1.0) + middle * self.spacing_hz * useful
        return wave * exp_cycles(cycles - waveform.phase_cycles(np.mod(t, waveform.sweep_s)), np.complex128)


@dataclass(frozen=True)
class Qpsk:
    """QPSK through a root-raised-cosine pulse (roll-off 0.25), narrower than the simulated band.

    Parameters
    ----------
    offset_hz : float
    symbol_hz : float
        Symbol rate, at most half the simulation rate.
    seed : int
        Symbol ``s`` follows from it.
    """

    offset_hz: float = 0.0
    symbol_hz: float = 1e6
    seed: int = 1
    constant_envelope = False

    def symbols(self, first: int, count: int) -> np.ndarray:
        """(count,) complex128 symbols ``first ...``, drawn in blocks of 256 by number."""
        blocks = np.arange(first // 256, (first + count - 1) // 256 + 1)
        drawn = [np.random.default_rng([self.seed, int(b) + (1 << 32)]).integers(0, 4, 256) for b in blocks]
        at = first - 256 * int(blocks[0])
        return exp_cycles(np.concatenate(drawn)[at : at + count] / 4 + 0.125, np.complex128)

    def wave(self, time_s: np.ndarray) -> np.ndarray:
        """(n,) complex128 baseband at rising times, about its own centre; mean power 1."""
        u = np.asarray(time_s) * self.symbol_hz
        first = int(np.floor(u[0])) - _SPAN
        symbols = self.symbols(first, int(np.floor(u[-1])) + _SPAN + 1 - first)
        nearest = np.floor(u).astype(int)
        out = np.zeros(u.size, dtype=np.complex128)
        for step in range(-_SPAN, _SPAN + 1):
            out += symbols[nearest + step - first] * _root_raised_cosine(u - nearest - step)
        return out

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        if self.symbol_hz > 0.5 * waveform.simulation_hz:
            raise ValueError(
                f"qpsk.symbol_hz is {self.symbol_hz:g}; it has to be at most half the simulation rate "
                f"{waveform.simulation_hz:g}; use ofdm for a wider carrier"
            )
        t = start_s + waveform.simulation_times_s
        near = np.abs(self.offset_hz - waveform.frequency_hz(t)) < self.symbol_hz + waveform.stop_hz
        out = np.zeros(t.size, dtype=np.complex64)
        for part in _runs(near):
            cycles = np.mod(self.offset_hz * t[part], 1.0) - waveform.phase_cycles(
                np.mod(t[part], waveform.sweep_s)
            )
            out[part] = self.wave(t[part]) * exp_cycles(cycles, np.complex128)
        return out


def _root_raised_cosine(u: np.ndarray) -> np.ndarray:
    """Pulse of unit energy per symbol at times in symbols (J. G. Proakis, Digital Communications, 9.2)."""
    a = _ROLL_OFF
    u = np.where(np.abs(np.abs(4 * a * u) - 1.0) < 1e-9, u + 1e-7, u)
    u = np.where(np.abs(u) < 1e-9, 1e-7, u)
    top = np.sin(np.pi * u * (1 - a)) + 4 * a * u * np.cos(np.pi * u * (1 + a))
    return top / (np.pi * u * (1 - (4 * a * u) ** 2))


def _runs(mask: np.ndarray) -> list[slice]:
    """Runs of true entries."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@dataclass(frozen=True)
class Pulses:
    """A pulsed radar: peak power 1, raised-cosine edges; computed at a higher rate where a pulse is near the sweep.

    Parameters
    ----------
    offset_hz, repetition_hz, width_s, rise_s, start_s : float
        Carrier, pulses per second, width between half amplitudes, duration of an edge, centre of a pulse.
    """

    offset_hz: float = 0.0
    repetition_hz: float = 2e3
    width_s: float = 2e-6
    rise_s: float = 0.1e-6
    start_s: float = 40e-6
    constant_envelope = True

    def envelope(self, time_s: np.ndarray) -> np.ndarray:
        """Amplitude at any times."""
        period = 1.0 / self.repetition_hz
        apart = np.mod(time_s - self.start_s + 0.5 * period, period) - 0.5 * period
        edge = np.clip((0.5 * self.width_s - np.abs(apart)) / self.rise_s + 0.5, 0.0, 1.0)
        return 0.5 - 0.5 * np.cos(np.pi * edge)

    def mixed(self, waveform: IfWaveform, start_s: float) -> np.ndarray:
        """See `Emitter`."""
        t = start_s + waveform.simulation_times_s
        out = np.zeros(t.size, dtype=np.complex64)
        fine, reach_s = _PULSE_OVERSAMPLING, 0.5 * self.width_s + self.rise_s
        first, last = ((x - self.start_s) * self.repetition_hz for x in (t[0] - reach_s, t[-1] + reach_s))
        for number in range(int(np.ceil(first)), int(np.floor(last)) + 1):
            centre = number / self.repetition_hz + self.start_s
            beat = self.offset_hz - float(waveform.frequency_hz(np.array(centre)))
            if abs(beat) > 0.45 * fine * waveform.simulation_hz:
                continue
            out += self._pulse(waveform, t, centre, reach_s)
        return out

    def _pulse(self, waveform: IfWaveform, t: np.ndarray, centre_s: float, reach_s: float) -> np.ndarray:
        """One pulse on the simulated grid, by a low-pass from the finer one."""
        fine, rate = _PULSE_OVERSAMPLING, waveform.simulation_hz
        out = np.zeros(t.size, dtype=np.complex64)
        # what folds stays beside the IF
        taps = kaiser_lowpass(waveform.stop_hz, rate - waveform.stop_hz, fine * rate)
        side = taps.size // 2
        first = int(np.floor((centre_s - reach_s - t[0]) * rate)) - side // fine - 1
        last = int(np.ceil((centre_s + reach_s - t[0]) * rate)) + side // fine + 2
        first, last = max(first, 0), min(last, t.size)
        if last <= first:
            return out
        u = t[first] + np.arange(-side, (last - first - 1) * fine + side + 1) / (fine * rate)
        cycles = np.mod(self.offset_hz * u, 1.0) - waveform.phase_cycles(np.mod(u, waveform.sweep_s))
        wave = self.envelope(u) * exp_cycles(cycles, np.complex128)
        out[first:last] = np.convolve(wave, taps, mode="valid")[::fine]
        return out
