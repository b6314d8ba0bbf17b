"""The sweep of a deramping altimeter behind its mixer, and the filter between mixer and converter.

    y(t) = IF filter of rx(t) conj(LO(t)),  |LO| = 1

The sweep crosses an emitter's spectrum far faster than the IF is wide, so the IF holds a small part of what an antenna
receives. Emitters are therefore computed at a *simulation rate* of a few IF bandwidths, and only where their beat is
near the IF (`emitters.py`); returns and noise are computed at the IF rate itself.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import fft

from ..fir import kaiser_lowpass
from ..waveform import Waveform, read_only

# Simulation rate over IF rate: a wave that crosses the IF fades in and out over two IF rates outside it, so that the
# edge of that gate is not in the IF (`emitters._crossing`; error vector -31 dB, tests/test_deramp.py).
SIMULATION_FACTOR = 5


@dataclass(frozen=True)
class IfWaveform(Waveform):
    """A sweep whose frames are dechirped by the receiver: ``rate_hz`` is the IF's, and ``reference`` is all ones.

    `Altimeter`, `AltitudeTracker` and methods of mitigation take it like any other waveform. Phases and frequencies
    are those of the sweep on the air.

    Examples
    --------
    >>> w = IfWaveform(bandwidth_hz=150e6, sweep_s=7e-3, rate_hz=1.536e6, pass_hz=0.5e6)
    >>> w.samples_per_frame, bool((w.reference == 1).all())
    (10752, True)
    """

    pass_hz: float = 0.5e6
    """Flat part of the IF filter, to either side of zero; > 0 and below ``rate_hz / 2``, from where on it is 80 dB
    down."""

    deramped: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.centered:
            raise ValueError("waveform.centered is false; a deramping altimeter's sweep has to be centred")
        if not 0 < self.pass_hz < 0.49 * self.rate_hz:
            raise ValueError(
                f"waveform.pass_hz is {self.pass_hz:g}; it has to be above 0 and below 0.49 of the IF's rate "
                f"{self.rate_hz:g}: raise rate_hz"
            )

    @cached_property
    def reference(self) -> np.ndarray:
        """(N,) complex64 ones, read-only: frames are dechirped already."""
        return read_only(np.ones(self.samples_per_frame, dtype=np.complex64))

    @property
    def simulation_hz(self) -> float:
        """Rate at which emitters are computed."""
        return SIMULATION_FACTOR * self.rate_hz

    @property
    def stop_hz(self) -> float:
        """From here on the IF filter is 80 dB down."""
        return 0.5 * self.rate_hz

    @cached_property
    def lead(self) -> int:
        """Samples at the simulation rate that the IF filter needs on either side of a frame; whole IF samples."""
        return SIMULATION_FACTOR * -(-(self._taps.size // 2) // SIMULATION_FACTOR)

    @cached_property
    def _taps(self) -> np.ndarray:
        return kaiser_lowpass(self.pass_hz, self.stop_hz, self.simulation_hz)

    @cached_property
    def simulation_times_s(self) -> np.ndarray:
        """(M,) float64 times of a frame at the simulation rate, with `lead` before and after; 0 is its start."""
        count = SIMULATION_FACTOR * self.samples_per_frame
        return np.arange(-self.lead, count + self.lead) / self.simulation_hz

    @cached_property
    def _filter(self) -> tuple[int, np.ndarray]:
        """FFT size and response of the IF filter, its delay removed."""
        count = self.simulation_times_s.size
        size = SIMULATION_FACTOR * fft.next_fast_len(-(-count // SIMULATION_FACTOR))
        taps = np.zeros(size)
        taps[: self._taps.size] = self._taps
        return size, fft.fft(np.roll(taps, -(self._taps.size // 2))).astype(np.complex64)

    def filtered(self, mixed: np.ndarray) -> np.ndarray:
        """(N,) complex64 IF samples of (M,) complex samples behind the mixer on `simulation_times_s`."""
        size, response = self._filter
        spectrum = fft.fft(mixed.astype(np.complex64, copy=False), size) * response
        folded = spectrum.reshape(SIMULATION_FACTOR, -1).sum(axis=0) / SIMULATION_FACTOR  # decimated
        first = self.lead // SIMULATION_FACTOR
        return fft.ifft(folded)[first : first + self.samples_per_frame]


def white_noise(
    waveform: Waveform, count: int, density_mw_per_hz: float, rng: np.random.Generator
) -> np.ndarray:
    """(count, N) complex64 white noise of a density at the antenna port, in square-root milliwatts.

    A sweep of unit modulus leaves white noise white; the IF filter's slopes beyond ``pass_hz`` are left out.
    """
    rails = rng.standard_normal((count, waveform.samples_per_frame, 2), dtype=np.float32)
    rails *= np.float32(np.sqrt(0.5 * density_mw_per_hz * waveform.rate_hz))
    return rails.view(np.complex64)[..., 0]
