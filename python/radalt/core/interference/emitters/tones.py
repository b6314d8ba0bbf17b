"""Unmodulated carriers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...waveform import exp_cycles, sum_of_waves
from ..transmission import Signal
from . import NamedEmitter, register


@register
@dataclass(frozen=True)
class ToneEmitter(NamedEmitter):
    """Sum of K unmodulated carriers of equal power and random phase."""

    scene_name: ClassVar[str] = "tones"
    unit_power: ClassVar[bool] = True

    count: int = 1
    """Number of tones ``K``, 1..256, drawn uniformly over ``span_hz`` unless ``frequencies_hz`` is given."""
    frequencies_hz: tuple[float, ...] = ()
    """Fixed frequencies relative to the radar's centre, in hertz."""
    span_hz: float = 0.0
    """Width of the band in which frequencies are drawn; 0 stands for the sample rate."""

    def __post_init__(self) -> None:
        number = len(self.frequencies_hz) or self.count
        if not 1 <= number <= 256:
            # they are summed as one matrix product: count x samples of a frame
            raise ValueError(f"tones.count is {number}; it has to be within 1..256")
        if self.span_hz < 0:
            raise ValueError(f"tones.span_hz is {self.span_hz:g}; it has to be 0 (the whole band) or more")

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        count = len(self.frequencies_hz) or self.count
        return "one tone" if count == 1 else f"{count} tones"

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw frequencies and phases."""
        if self.frequencies_hz:
            frequencies = np.asarray(self.frequencies_hz, dtype=float)
            if np.any(np.abs(frequencies) > rate_hz / 2):
                raise ValueError(
                    f"tones.frequencies_hz {self.frequencies_hz} leave +/- {rate_hz / 2:g} Hz, half the rate; "
                    "move them inside"
                )
        else:
            span = self.span_hz or rate_hz
            if span > rate_hz:
                raise ValueError(f"tones.span_hz is {span:g}; it has to be at most the rate, {rate_hz:g}")
            frequencies = rng.uniform(-0.5, 0.5, self.count) * span
        phases = rng.random(frequencies.size)
        weights = exp_cycles(phases, np.complex128) / np.sqrt(frequencies.size)
        steps = frequencies / rate_hz

        def signal(first: int, count: int) -> np.ndarray:
            return sum_of_waves(weights * exp_cycles(first * steps, np.complex128), steps, count)

        return signal
