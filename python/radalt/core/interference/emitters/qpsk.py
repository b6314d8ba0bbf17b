"""QPSK with rectangular or root-raised-cosine pulses."""

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import ClassVar

import numpy as np

from ...parsing import setting
from ...waveform import exp_cycles, read_only
from ..evm import check_evm, error_vectors, evm_fraction, evm_title
from ..transmission import Signal, in_drawn_blocks
from . import NamedEmitter, register


@lru_cache(maxsize=32)
def rrc_taps(rolloff: float, up: int, span_symbols: int = 12) -> np.ndarray:
    """Root-raised-cosine taps at ``up`` samples per symbol, unit energy, length ``span*up + 1``, read-only.

    Closed form with its two removable singularities (J. G. Proakis, Digital Communications, 4th ed., 9.2-1).
    """
    t = np.arange(-span_symbols * up // 2, span_symbols * up // 2 + 1) / up
    b = rolloff
    if b == 0:
        taps = np.sinc(t)
    else:
        den = np.pi * t * (1 - (4 * b * t) ** 2)
        num = np.sin(np.pi * t * (1 - b)) + 4 * b * t * np.cos(np.pi * t * (1 + b))
        sine, cosine = np.sin(np.pi / 4 / b), np.cos(np.pi / 4 / b)
        edge = b / np.sqrt(2) * ((1 + 2 / np.pi) * sine + (1 - 2 / np.pi) * cosine)
        singular = np.isclose(den, 0.0)
        taps = np.where(singular, edge, num / np.where(singular, 1.0, den))
        taps[np.isclose(t, 0.0)] = 1 - b + 4 * b / np.pi
    return read_only(taps / np.sqrt(np.sum(taps**2)))


@register
@dataclass(frozen=True)
class QpskEmitter(NamedEmitter):
    """QPSK with rectangular or root-raised-cosine pulses, random symbols, phase and symbol timing.

    Rectangular pulses are the paper's: symbols change on the sample grid, unfiltered. `QpskReceivedEmitter` adds the
    receiver's filter and a separate symbol clock.
    """

    scene_name: ClassVar[str] = "qpsk"

    bandwidth_hz: float = setting(0.267 * 7.5e6, 1e3, 1e9)
    """Rectangular pulses: the symbol rate (noise-equivalent bandwidth; nulls at +/- this, side lobes fill the band).
    Root-raised-cosine: the occupied bandwidth, symbol rate ``bandwidth_hz / (1 + rolloff)``. Default 26.7 % of 7.5
    MHz, the paper's over-the-air interferer."""
    carrier_hz: float = 0.0
    """Carrier relative to the radar's centre."""
    pulse: str = setting("rectangular", among=("rectangular", "rrc"))
    """Pulse shape; the paper's is rectangular."""
    rolloff: float = setting(0.25, 0.0, 1.0)
    """Root-raised-cosine roll-off."""
    evm: float | str = 0.0
    """Error vector magnitude: RMS of a complex normal error of every symbol over the symbols' RMS, 0..1;
    ``"typical"`` is 0.0875, half of what TS 38.104 allows base stations."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_evm("qpsk", self.evm)

    @property
    def label(self) -> str:
        """See `NamedEmitter.label`: with the pulse shape."""
        return f"{self.scene_name}_{self.pulse}"

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        pulse = "root-raised-cosine" if self.pulse == "rrc" else self.pulse
        return f"QPSK, {pulse} pulses, {100 * self.bandwidth_hz / band_hz:.3g} % of the band, {evm_title(self.evm)}"

    @property
    def symbol_rate_hz(self) -> float:
        """Symbols per second."""
        return self.bandwidth_hz if self.pulse == "rectangular" else self.bandwidth_hz / (1 + self.rolloff)

    @property
    def evm_fraction(self) -> float:
        """The error vector magnitude as a number."""
        return evm_fraction(self.evm, "qpsk")

    def check_rate(self, rate_hz: float) -> None:
        """Raise ValueError unless symbols and carrier fit a sample rate."""
        if self.symbol_rate_hz > rate_hz or abs(self.carrier_hz) > rate_hz / 2:
            raise ValueError(
                f"qpsk of {self.bandwidth_hz:g} Hz at {self.carrier_hz:g} Hz does not fit the rate of {rate_hz:g} S/s; "
                "lower bandwidth_hz or |carrier_hz|"
            )

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`."""
        sent = self._sent(rate_hz, rng, lambda first, number: qpsk_symbols(number, rng, self.evm_fraction))
        return sent(0, count)

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw a transmission: symbols, phase and symbol timing."""
        symbols = in_drawn_blocks(
            lambda drawn: qpsk_symbols(_DRAWN, drawn, self.evm_fraction), _DRAWN, rng, keep=4
        )
        return self._sent(rate_hz, rng, symbols)

    def _sent(self, rate_hz: float, rng: np.random.Generator, symbols: Signal) -> Signal:
        """The transmission of ``symbols``; timing and phase are drawn."""
        self.check_rate(rate_hz)
        rate = self.symbol_rate_hz / rate_hz
        offset, phase = rng.random(2)
        rotation = np.exp(2j * np.pi * phase)
        step = self.carrier_hz / rate_hz

        def signal(first: int, count: int) -> np.ndarray:
            if self.pulse == "rectangular":
                start, index = _held_index(first, count, rate, offset)
                sent = symbols(start, int(index[-1]) + 1)
                # the carrier phase is applied to symbols, which are fewer than samples
                if not self.carrier_hz:
                    return np.take(sent * rotation, index)
                baseband = sent[index]
            else:
                baseband = self._shaped(first, count, rate, offset, symbols)
            if self.carrier_hz:
                turned = np.mod(first * step, 1.0) + phase
                return baseband * exp_cycles(_ramp(count, step) + turned, np.complex128)
            return baseband * rotation

        return signal

    def _shaped(self, first: int, count: int, rate: float, offset: float, symbols: Signal) -> np.ndarray:
        """Polyphase root-raised-cosine at the rational ``down/up`` samples per symbol nearest to ``1/rate``."""
        ratio = Fraction(1 / rate).limit_denominator(64)
        up, down = ratio.numerator, ratio.denominator
        # a pulse decays over 1 / rolloff symbols: truncated at 1.2 / rolloff, its spectrum ripples by a few percent
        side = int(np.ceil(min(32.0, max(6.0, 1.2 / max(self.rolloff, 1e-3)))))
        taps = rrc_taps(self.rolloff, up, 2 * side)
        oldest, lead = divmod(first * down + int(offset * up), up)  # symbol timing, in steps of 1/up symbol
        number = -(-(count * down + lead) // up) + 2 * side
        start = 2 * side * up + lead  # where the oldest pulse has begun
        pad = -start % down  # zeros before the taps, so that decimation by ``down`` keeps the right samples
        taps = np.concatenate([np.zeros(pad), taps * np.sqrt(up)])
        from scipy import signal  # see core/fir.py

        shaped = signal.upfirdn(taps, symbols(oldest, number), up, down)
        start = (start + pad) // down
        return shaped[start : start + count]


_DRAWN = 4096  # symbols drawn at once
_CONSTELLATION = np.exp(0.25j * np.pi * (1 + 2 * np.arange(4)))


def qpsk_symbols(count: int, rng: np.random.Generator, evm: float = 0.0) -> np.ndarray:
    """(count,) random unit QPSK symbols with error vectors of RMS ``evm``."""
    symbols = _CONSTELLATION[rng.integers(0, 4, count)]
    return symbols + error_vectors(count, evm, rng) if evm else symbols


def _held_index(first: int, count: int, rate: float, offset: float) -> tuple[int, np.ndarray]:
    """Number of the symbol of sample ``first``, and the (count,) symbols from it on, ``rate`` per sample."""
    start, within = divmod(first * rate + offset, 1.0)
    # conversion of non-negative times is the floor; fused with the sum it takes half the time, and 32 bits are
    # vectorised
    number = np.empty(count, dtype=np.int32)
    return int(start), np.add(_ramp(count, rate), within, out=number, casting="unsafe")


@lru_cache(maxsize=16)
def _ramp(count: int, step: float) -> np.ndarray:
    """(count,) float64 multiples of ``step`` from 0 on, read-only and cached: every frame of an emitter needs them."""
    return read_only(np.arange(count) * step)
