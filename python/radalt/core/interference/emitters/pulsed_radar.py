"""A coherent pulsed radar.

The signal is computed at a multiple of the radar's rate that holds all of its band. It is then filtered and decimated
as in a receiver, so that nothing aliases into the band. Its long-run mean power after the filter is about 1. Its duty
cycle is low, so by default a window is drawn that contains a pulse.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from ...parsing import LARGEST, setting
from ...waveform import exp_cycles
from ..receiver_filter import decimate_window, oversampling, window_guard
from ..transmission import Signal
from . import NamedEmitter, register


@register
@dataclass(frozen=True, kw_only=True)
class PulsedRadarEmitter(NamedEmitter):
    """A coherent pulsed radar: pulses with raised-cosine edges, plain or linear FM, behind the radar's filter."""

    scene_name: ClassVar[str] = "pulsed_radar"
    unit_power: ClassVar[bool] = True

    carrier_hz: float = setting(0.0, -LARGEST, LARGEST)
    """Carrier relative to the radar's centre."""
    prf_hz: float = setting(2e3, 1e-3, 1e9)
    """Pulse repetition frequency."""
    pulse_width_s: float = 2e-6
    """Between the half-amplitude points, > rise_time_s and below 1/prf_hz - rise_time_s."""
    chirp_bandwidth_hz: float = setting(0.0, -LARGEST, LARGEST)
    """Linear FM swept within each pulse, upwards if > 0, downwards if < 0, 0 for none."""
    rise_time_s: float = setting(50e-9, 1e-12, 1.0)
    """Duration of each raised-cosine edge."""
    always_in_window: bool = True
    """Draw the timing such that a pulse lies inside the window; False draws it uniformly, and many short windows are
    then empty."""

    def __post_init__(self) -> None:
        super().__post_init__()
        longest = 1.0 / self.prf_hz - self.rise_time_s
        if not self.rise_time_s < self.pulse_width_s < longest:
            raise ValueError(
                f"pulsed_radar.pulse_width_s is {self.pulse_width_s:g}; it has to lie between rise_time_s "
                f"{self.rise_time_s:g} and {longest:g} (1/prf_hz - rise_time_s)"
            )

    def waveform(self, seconds: np.ndarray) -> np.ndarray:
        """Pulse train of unit peak at `seconds` (any shape), a pulse centred on time 0; complex128."""
        period_s = 1.0 / self.prf_hz
        from_centre = seconds - np.rint(seconds / period_s) * period_s
        # 1 inside, 0 outside, half a cosine of length rise_time_s about the half-amplitude points.
        edge = np.clip((self.pulse_width_s / 2 - np.abs(from_centre)) / self.rise_time_s + 0.5, 0.0, 1.0)
        envelope = 0.5 - 0.5 * np.cos(np.pi * edge)
        slope = self.chirp_bandwidth_hz / self.pulse_width_s
        return envelope * exp_cycles(self.carrier_hz * seconds + slope / 2 * from_centre**2, np.complex128)

    def _received(self, start_s: float, count: int, rate_hz: float) -> np.ndarray:
        # A raised-cosine edge's spectrum is some 60 dB down at three times the inverse rise time.
        highest_hz = abs(self.carrier_hz) + abs(self.chirp_bandwidth_hz) / 2 + 3.0 / self.rise_time_s
        factor = oversampling(rate_hz, highest_hz)
        guard = window_guard(rate_hz, factor)
        index = np.arange(-guard * factor, (count + guard) * factor)
        wide = self.waveform(start_s + index / (factor * rate_hz))
        return decimate_window(wide, rate_hz, factor)

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """Draw a window with random timing and phase: (count,) complex128, long-run mean power near 1."""
        position, within, phase = rng.random(3)
        if self.always_in_window:
            start_s = (within - 0.5) * self.pulse_width_s - position * count / rate_hz
        else:
            start_s = position / self.prf_hz
        return self._sent(rate_hz, start_s, phase)(0, count)

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw a transmission with random timing and phase; many frames are empty, whatever `always_in_window`."""
        position, phase = rng.random(2)
        return self._sent(rate_hz, position / self.prf_hz, phase)

    def _sent(self, rate_hz: float, start_s: float, phase: float) -> Signal:
        gain = np.exp(2j * np.pi * phase) / np.sqrt(_pulse_power(self, rate_hz))
        return lambda first, count: self._received(start_s + first / rate_hz, count, rate_hz) * gain


@lru_cache(maxsize=32)
def _pulse_power(emitter: PulsedRadarEmitter, rate_hz: float) -> float:
    """Long-run mean power after the receiver of a train of unit peak: energy of one pulse times the PRF."""
    period = int(np.ceil(rate_hz / emitter.prf_hz))
    reach = min(int(np.ceil(rate_hz * emitter.pulse_width_s)) + 256, period)
    pulse = emitter._received(-reach / 2 / rate_hz, reach, rate_hz)
    return float(np.sum(np.abs(pulse) ** 2)) / rate_hz * emitter.prf_hz
