"""Another FMCW radio altimeter.

The signal is computed at a multiple of the radar's rate that holds all of its band. It is then filtered and decimated
as in a receiver, so that nothing aliases into the band. Its long-run mean power after the filter is about 1. It crosses
the band for a short time only, so by default a window is drawn that contains a crossing.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...parsing import LARGEST, setting
from ...waveform import exp_cycles
from ..receiver_filter import PASSBAND_FRACTION, decimate_window, oversampling, window_guard
from ..transmission import Signal
from . import NamedEmitter, register


@register
@dataclass(frozen=True, kw_only=True)
class FmcwEmitter(NamedEmitter):
    """Another FMCW radio altimeter: linear sweeps, phase-continuous, band-limited by the radar's receiver.

    Frequency in a period: from carrier - B/2 up to carrier + B/2 in the up part, back in the rest. The phase is the
    integral of the frequency, so a period need not hold a whole number of cycles. A sweep that misses the band, or
    needs over 64 times the radar's rate, raises `ValueError` when samples are made.
    """

    scene_name: ClassVar[str] = "fmcw"
    unit_power: ClassVar[bool] = True

    carrier_hz: float = setting(0.0, -LARGEST, LARGEST)
    """Centre of its sweep relative to the radar's centre."""
    sweep_bandwidth_hz: float = setting(150e6, 1e3, 5e9)
    """Swept bandwidth B; 150 MHz is the first altimeter of ITU-R M.2059 Table 2."""
    sweep_period_s: float = setting(1.0 / 143.0, 1e-9, 1.0)
    """Time of up and down sweep together."""
    up_fraction: float = setting(0.5, 0.0, 1.0)
    """Part of the period spent on the up sweep; 0.5 is a triangle, 1 and 0 are sawtooths."""
    always_in_window: bool = True
    """Draw the timing such that the sweep crosses the band inside the window; False draws it uniformly, and many
    short windows are then empty."""

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        return "FMCW radar"

    def phase_cycles(self, seconds: np.ndarray) -> np.ndarray:
        """Integral of the frequency in cycles at `seconds` (any shape) after the start of an up sweep."""
        up_s = self.up_fraction * self.sweep_period_s
        down_s = self.sweep_period_s - up_s
        periods = np.floor(seconds / self.sweep_period_s)
        u = seconds - periods * self.sweep_period_s
        low_hz = self.carrier_hz - self.sweep_bandwidth_hz / 2
        high_hz = self.carrier_hz + self.sweep_bandwidth_hz / 2
        rising = np.minimum(u, up_s)
        falling = np.maximum(u - up_s, 0.0)
        phase = np.mod(periods * np.mod(self.carrier_hz * self.sweep_period_s, 1.0), 1.0) + low_hz * rising
        if up_s > 0:
            phase = phase + self.sweep_bandwidth_hz / (2 * up_s) * rising**2
        if down_s > 0:
            phase = phase + high_hz * falling - self.sweep_bandwidth_hz / (2 * down_s) * falling**2
        return phase

    def in_band_fraction(self, rate_hz: float) -> float:
        """Part of the time that the sweep spends in our band (to the -6 dB points of the filter), 0..1."""
        low_hz, high_hz = self._crossing(rate_hz)
        return max(0.0, high_hz - low_hz) / self.sweep_bandwidth_hz

    def _crossing(self, rate_hz: float) -> tuple[float, float]:
        edge_hz = (PASSBAND_FRACTION * rate_hz + rate_hz) / 4
        half = self.sweep_bandwidth_hz / 2
        return max(-edge_hz, self.carrier_hz - half), min(edge_hz, self.carrier_hz + half)

    def _start_s(self, count: int, rate_hz: float, rng: np.random.Generator) -> float:
        """Time of the first sample within the other radar's period."""
        position, branch, frequency = rng.random(3)
        if not self.always_in_window:
            return position * self.sweep_period_s
        low_hz, high_hz = self._crossing(rate_hz)
        rise = (low_hz + frequency * (high_hz - low_hz) - self.carrier_hz) / self.sweep_bandwidth_hz + 0.5
        up_s = self.up_fraction * self.sweep_period_s
        if branch < self.up_fraction:
            crossing_s = rise * up_s
        else:
            crossing_s = up_s + (1.0 - rise) * (self.sweep_period_s - up_s)
        return crossing_s - position * count / rate_hz

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """Draw a window with random timing and phase: (count,) complex128, long-run mean power near 1."""
        return self._sent(rate_hz, self._start_s(count, rate_hz, rng), rng)(0, count)

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw a transmission with random timing and phase, whatever `always_in_window`: most frames are empty."""
        return self._sent(rate_hz, rng.random() * self.sweep_period_s, rng)

    def _sent(self, rate_hz: float, start_s: float, rng: np.random.Generator) -> Signal:
        fraction = self.in_band_fraction(rate_hz)
        if fraction == 0.0:
            raise ValueError(
                f"fmcw.carrier_hz {self.carrier_hz:g} with {self.sweep_bandwidth_hz:g} Hz never crosses the "
                f"receiver's +-{rate_hz / 2:g} Hz; move it closer or widen the sweep"
            )
        factor = oversampling(rate_hz, abs(self.carrier_hz) + self.sweep_bandwidth_hz / 2)
        guard = window_guard(rate_hz, factor)
        phase = rng.random()

        def signal(first: int, count: int) -> np.ndarray:
            index = np.arange((first - guard) * factor, (first + count + guard) * factor)
            wide = exp_cycles(self.phase_cycles(start_s + index / (factor * rate_hz)) + phase, np.complex128)
            return decimate_window(wide, rate_hz, factor) / np.sqrt(fraction)

        return signal
