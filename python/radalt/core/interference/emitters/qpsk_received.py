"""QPSK behind a receiver's filter, with a symbol clock that is independent of the sample clock."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...parsing import setting
from ...waveform import exp_cycles
from ..receiver_filter import decimate_window, window_guard
from ..transmission import Signal
from . import register
from .qpsk import QpskEmitter, rrc_taps

# rate of the pulses over the radar's: rectangular ones have side lobes without end, root-raised-cosine is band-limited
_OVERSAMPLING = {"rectangular": 16, "rrc": 2}
_STEPS = 256  # table of the root-raised-cosine pulse, steps per symbol: linear interpolation errs by -90 dB


@register
@dataclass(frozen=True)
class QpskReceivedEmitter(QpskEmitter):
    """QPSK whose symbols begin between samples, through the receiver's filter: emitter protocol.

    `QpskEmitter` changes its rectangular symbols on the sample grid, as the paper does. Every sample is then one of
    four points, which no receiver observes and a method could exploit. Here pulses are made at 16 times the rate,
    each fine sample being the mean over its duration; then they are filtered and decimated. Root-raised-cosine pulses
    are made at twice the rate, at the exact times.
    """

    scene_name: ClassVar[str] = "qpsk_received"

    carrier_hz: float = 1_200.0
    """Carrier relative to the radar's centre, the carrier frequency offset of the oscillators included."""
    clock_ppm: float = setting(2.0, -1000.0, 1000.0)
    """Symbol clock offset against the radar; positive where the emitter's clock is faster."""

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        return f"{super().title(band_hz)}, as received"

    def _sent(self, rate_hz: float, rng: np.random.Generator, symbols: Signal) -> Signal:
        """See `QpskEmitter`; mean power is 1 in the long run before the filter."""
        self.check_rate(rate_hz)
        factor = _OVERSAMPLING[self.pulse]
        guard = 2 * window_guard(rate_hz, factor)
        symbols_per_sample = self.symbol_rate_hz * (1 + 1e-6 * self.clock_ppm) / (rate_hz * factor)
        cycles_per_sample = self.carrier_hz / (rate_hz * factor)
        timing, phase = rng.random(2)

        def signal(first: int, count: int) -> np.ndarray:
            longer = factor * (count + guard)
            oldest, within = divmod(timing + symbols_per_sample * factor * first, 1.0)
            times = within + symbols_per_sample * np.arange(longer + 1)
            if self.pulse == "rectangular":
                fine = _held(times, int(oldest), symbols)
            else:
                fine = _shaped(times[:-1], int(oldest), self.rolloff, symbols)
            turned = phase + np.mod(cycles_per_sample * factor * first, 1.0)
            turns = exp_cycles(turned + cycles_per_sample * np.arange(longer), np.complex128)
            return decimate_window(fine * turns, rate_hz, factor)

        return signal


def _held(times: np.ndarray, oldest: int, symbols_from: Signal) -> np.ndarray:
    """(n,) means of rectangular pulses between n + 1 ``times`` in symbols."""
    index = times.astype(np.intp)
    symbols = symbols_from(oldest, int(index[-1]) + 1)
    before = np.concatenate([[0.0], np.cumsum(symbols)])
    integral = before[index] + (times - index) * symbols[index]
    return np.diff(integral) / (times[1] - times[0])


def _shaped(times: np.ndarray, oldest: int, rolloff: float, symbols_from: Signal) -> np.ndarray:
    """(n,) samples of root-raised-cosine pulses at ``times`` in symbols."""
    side = int(np.ceil(min(32.0, max(6.0, 1.2 / max(rolloff, 1e-3)))))  # as in `QpskEmitter`
    taps = rrc_taps(rolloff, _STEPS, 2 * side) * np.sqrt(_STEPS)
    place = (times - np.floor(times)) * _STEPS
    low = place.astype(np.intp)
    part = place - low
    index = times.astype(np.intp)
    symbols = symbols_from(oldest, int(index[-1]) + 2 * side)
    out = np.zeros(times.size, dtype=np.complex128)
    for offset in range(2 * side):  # the oldest pulse first
        at = low + (2 * side - 1 - offset) * _STEPS
        out += symbols[index + offset] * (taps[at] * (1 - part) + taps[at + 1] * part)
    return out
