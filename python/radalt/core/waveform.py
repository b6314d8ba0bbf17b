"""Linear FMCW sweeps, triangle or sawtooth, and their beat/range algebra (docs/design.md).

All phases are kept in float64 *cycles* and reduced modulo one cycle before the exponential: a float32
phase accumulator is wrong within seconds at 7.5 MS/s.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.constants import speed_of_light

from .parsing import InputError, Settings, setting, shown

C_M_PER_S = speed_of_light
# Slope of the frame's two halves by shape: 1 rises, -1 falls.
SHAPES = {"triangle": (1, -1), "sawtooth_up": (1, 1), "sawtooth_down": (-1, -1)}


def read_only(table: np.ndarray) -> np.ndarray:
    """An array, which all who use it share from here on."""
    table.setflags(write=False)
    return table


def exp_cycles(phase_cycles: np.ndarray, dtype: type = np.complex64) -> np.ndarray:
    """``exp(j 2 pi phase)`` of float64 phases in cycles, any shape, reduced modulo one cycle first."""
    return unit(2.0 * np.pi * (phase_cycles - np.rint(phase_cycles)), dtype)


def unit(angle: np.ndarray, dtype: type = np.complex64) -> np.ndarray:
    """``exp(j angle)`` of angles in radians, in their precision; a complex exponential costs ten times that."""
    out: np.ndarray = np.empty(np.shape(angle), dtype=dtype)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out


def sum_of_waves(weights: np.ndarray, step_cycles: np.ndarray, count: int) -> np.ndarray:
    """sum_w weights_w exp(j 2 pi step_w n), n = 0..count-1: (..., waves) twice gives (..., count).

    With n = a * block + b each exponential is a product of two, so the sum is a small matrix product: some 2
    sqrt(count) exponentials per wave instead of count.
    """
    block = int(np.ceil(np.sqrt(count)))
    blocks = -(-count // block)
    coarse = exp_cycles(step_cycles[..., None, :] * (block * np.arange(blocks)[:, None]), np.complex128)
    fine = exp_cycles(step_cycles[..., :, None] * np.arange(block), np.complex128)
    product = (coarse * weights[..., None, :]) @ fine
    return product.reshape(*product.shape[:-2], -1)[..., :count]


def altitude_to_delay_s(altitude_m: np.ndarray | float) -> np.ndarray | float:
    """Two-way delay ``tau = 2 R / c`` in seconds of an altitude in metres."""
    return 2.0 * np.asarray(altitude_m, dtype=float) / C_M_PER_S


def delay_to_altitude_m(delay_s: np.ndarray | float) -> np.ndarray | float:
    """Altitude ``R = c tau / 2`` in metres of a two-way delay in seconds."""
    return 0.5 * C_M_PER_S * np.asarray(delay_s, dtype=float)


@dataclass(frozen=True)
class Waveform(Settings, where="waveform"):
    """Up/down linear sweep, and the quantities derived from it.

    Raises
    ------
    ValueError
        If a value is out of range; names value, limit and remedy.

    Examples
    --------
    >>> w = Waveform()
    >>> w.samples_per_frame, w.slope_hz_per_s
    (7500, 15000000000.0)
    """

    bandwidth_hz: float = setting(7.5e6, 1e5, 5e9)
    """Swept bandwidth ``B``."""
    sweep_s: float = setting(1e-3, 1e-9, 1e5)
    """Duration ``T_sw`` of a frame: one whole period of a triangle (up plus down), two whole periods of a
    sawtooth. Either way a frame holds two ramps over ``B``, of ``T_h = T_sw / 2`` each ("half sweeps")."""
    rate_hz: float = setting(7.5e6, 1e4, 5e9)
    """Complex sample rate ``F_s`` >= ``B``; ``F_s T_sw`` has to be a whole even number of samples."""
    carrier_hz: float = setting(4.3e9, 1e8, 1e12)
    """Carrier ``f_c``, for Doppler and carrier phase."""
    centered: bool = True
    """True sweeps ``-B/2..+B/2`` (what goes on the air), False ``0..B`` (the paper; aliases at ``F_s = B``; a
    triangle only)."""
    shape: str = setting("triangle", among=SHAPES)
    """A sawtooth has one slope, so range and Doppler are one: it measures the altitude of a time `doppler_lead_s`
    later, and a single frame has no vertical speed. A scene plays a triangle."""

    deramped: ClassVar[bool] = False  # whether frames come after the mixer: `core.deramp.IfWaveform`

    def __post_init__(self) -> None:
        # below them a resolution of kilometres, or megahertz written as hertz
        super().__post_init__()
        if not (self.centered or self.separates_doppler):
            raise ValueError(f"waveform.centered is false; a {self.shape} has to be centred")
        if self.bandwidth_hz > self.rate_hz * (1 + 1e-12) and not self.deramped:
            raise ValueError(
                f"waveform.bandwidth_hz {self.bandwidth_hz:g} exceeds the complex rate {self.rate_hz:g} S/s; "
                "lower the bandwidth or raise rate_hz"
            )
        samples = self.rate_hz * self.sweep_s
        whole = round(samples)
        if abs(samples - whole) > 1e-6 * max(1.0, samples) or whole % 2 or whole < 16:
            raise ValueError(
                f"waveform.rate_hz * sweep_s is {samples:.6g} samples; it has to be a whole even number of at "
                f"least 16: try sweep_s = {2 * max(8, round(samples / 2)) / self.rate_hz:.9g}"
            )

    @property
    def half_sweep_s(self) -> float:
        """Half sweep ``T_h`` in seconds."""
        return 0.5 * self.sweep_s

    @property
    def slope_hz_per_s(self) -> float:
        """Chirp slope ``k = B / T_h``."""
        return self.bandwidth_hz / self.half_sweep_s

    @property
    def half_slopes(self) -> tuple[int, int]:
        """Sign of the slope of the frame's first and second half."""
        return SHAPES[self.shape]

    @property
    def separates_doppler(self) -> bool:
        """Whether the two halves have opposite slopes, so that one frame gives altitude and Doppler."""
        return self.half_slopes[0] != self.half_slopes[1]

    @property
    def doppler_lead_s(self) -> float:
        """Seconds by which the altitude that a sawtooth measures is ahead: ``f_c / k`` rising, negative falling.

        The beat is ``k tau + f_D`` with ``f_D = 2 v f_c / c``, so the altitude read is ``R + v f_c / k``: the bias
        ``c f_D / 2k``. Zero for a triangle, whose mean has no Doppler.
        """
        return 0.0 if self.separates_doppler else self.half_slopes[0] * self.carrier_hz / self.slope_hz_per_s

    @property
    def samples_per_frame(self) -> int:
        """Samples ``N`` of a frame, `sweep_s` long."""
        return round(self.rate_hz * self.sweep_s)

    @property
    def samples_per_half(self) -> int:
        """Samples in one half sweep."""
        return self.samples_per_frame // 2

    @property
    def range_resolution_m(self) -> float:
        """Range resolution ``c / 2B`` (20 m for 7.5 MHz)."""
        return C_M_PER_S / (2.0 * self.bandwidth_hz)

    @property
    def max_unambiguous_altitude_m(self) -> float:
        """Altitude whose delay is half a half-sweep: beyond it the two sweeps no longer share half their time.

        The beat then also passes a quarter of the sweep bandwidth's Nyquist zone; the chain declares such altitudes
        out of range rather than folding them.
        """
        return float(delay_to_altitude_m(0.5 * self.half_sweep_s))

    def altitude_to_beat_hz(self, altitude_m: np.ndarray | float) -> np.ndarray | float:
        """Beat ``k tau`` in hertz of an altitude in metres (no Doppler)."""
        return self.slope_hz_per_s * altitude_to_delay_s(altitude_m)

    def beats_to_altitude_m(self, beat_up_hz: np.ndarray, beat_down_hz: np.ndarray) -> np.ndarray:
        """``R = c (f_up - f_down) / 4k`` of a triangle's beats; Doppler cancels."""
        scale = C_M_PER_S / (4.0 * self.slope_hz_per_s)
        return scale * (np.asarray(beat_up_hz) - np.asarray(beat_down_hz))

    def beats_to_vertical_speed_m_per_s(self, beat_up_hz: np.ndarray, beat_down_hz: np.ndarray) -> np.ndarray:
        """Range rate of a triangle, from ``f_D = (f_up + f_down) / 2 = 2 v f_c / c``; positive when climbing."""
        doppler_hz = 0.5 * (np.asarray(beat_up_hz) + np.asarray(beat_down_hz))
        return doppler_hz * C_M_PER_S / (2.0 * self.carrier_hz)

    def vertical_speed_to_doppler_hz(self, vertical_speed_m_per_s: np.ndarray | float) -> np.ndarray | float:
        """``f_D = 2 v f_c / c`` in hertz, in the sign convention of the dechirped beats."""
        return 2.0 * np.asarray(vertical_speed_m_per_s, dtype=float) * self.carrier_hz / C_M_PER_S

    @cached_property
    def cycles_per_frame(self) -> float:
        """Phase advance over one sweep, modulo 1 cycle: ``B T_h`` for ``0..B``, zero when centred."""
        if self.centered:
            return 0.0
        # exact product: rounded to 1e-13 cycles it would be off by a thousandth after some weeks of sweeps
        return float(Fraction(self.bandwidth_hz) * Fraction(self.half_sweep_s) % 1)

    def phase_cycles(self, time_s: np.ndarray, frame_index: np.ndarray | int = 0) -> np.ndarray:
        """Phase in cycles at ``time_s`` after the start of sweep ``frame_index``; any shape, any sign of time.

        The frequency is integrated from sweep to sweep, so the phase is continuous for every ``B T_h`` (pasting the
        per-sweep formulae is right only where ``B T_h`` is whole).
        """
        time_s = np.asarray(time_s, dtype=float)
        sweep = np.floor(time_s / self.sweep_s)
        u = time_s - sweep * self.sweep_s
        k = self.slope_hz_per_s
        th = self.half_sweep_s
        if not self.separates_doppler:
            v = np.where(u < th, u, u - th)  # time in the ramp; its phase returns to zero
            return self.half_slopes[0] * 0.5 * v * (k * v - self.bandwidth_hz)
        v = np.minimum(u, self.sweep_s - u)  # triangle: distance to the nearest sweep boundary
        if self.centered:
            half = 0.5 * v * (k * v - self.bandwidth_hz)
            phase = np.where(u < th, half, -half)
            # down: B/2 (u-T_h) - k (u-T_h)^2 / 2 = -( k v^2/2 - B v/2 ) with v = T_sw - u
            return phase
        rising = 0.5 * k * v * v
        phase = np.where(u < th, rising, k * th * th - rising)
        return phase + np.mod((sweep + frame_index) * self.cycles_per_frame, 1.0)

    def frequency_hz(self, time_s: np.ndarray) -> np.ndarray:
        """Instantaneous frequency about the carrier, centred, at ``time_s`` after a frame's start; any shape."""
        u = np.mod(time_s, self.sweep_s)
        first, second = self.half_slopes
        in_first = u < self.half_sweep_s
        rise = self.slope_hz_per_s * np.where(in_first, u, u - self.half_sweep_s) - 0.5 * self.bandwidth_hz
        return np.where(in_first, first, second) * rise

    @cached_property
    def sample_times_s(self) -> np.ndarray:
        """(N,) float64 times of one frame's samples."""
        return read_only(np.arange(self.samples_per_frame) / self.rate_hz)

    @cached_property
    def reference(self) -> np.ndarray:
        """(N,) complex64 reference sweep 0, unit amplitude, read-only."""
        return read_only(exp_cycles(self.phase_cycles(self.sample_times_s)))

    def frame_rotation(self, frame_index: np.ndarray | int) -> np.ndarray | complex:
        """Unit phasor that carries sweep 0's table to sweep ``frame_index`` (1 when centred)."""
        return exp_cycles(np.mod(np.asarray(frame_index) * self.cycles_per_frame, 1.0), np.complex128)

    def beat_shifted(self, altitude_m: float) -> np.ndarray:
        """(N,) complex64 sweep whose beat is moved to ``altitude_m`` (synthetic altitude).

        Up sweeps are shifted by ``-k tau``, down sweeps by ``+k tau``; the shift's phase returns to zero at the
        frame's end, so altitudes may change from sweep to sweep without a phase step. The carrier phase ``-2 pi f_c
        tau`` of a true return is included. Raises ValueError for a sawtooth, which has no such return.
        """
        if not self.separates_doppler:
            raise ValueError(f"waveform.shape is {self.shape!r}; a beat shift needs a triangle")
        delay_s = float(altitude_to_delay_s(altitude_m))
        u = self.sample_times_s
        v = np.minimum(u, self.sweep_s - u)
        shift = -self.slope_hz_per_s * delay_s * v
        return exp_cycles(self.phase_cycles(u) + shift - np.mod(self.carrier_hz * delay_s, 1.0))


def checked(waveform: Waveform) -> Waveform:
    """The argument; raises InputError, one line, for anything else than a waveform, such as a scene's name."""
    if not isinstance(waveform, Waveform):
        raise InputError(f"waveform is {shown(waveform)}; give a Waveform, such as a scene's waveform")
    return waveform
