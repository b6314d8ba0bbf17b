"""Amplifier, mixer and converter of a deramping altimeter: compression, second and third order, clipping.

A memoryless nonlinearity acts on the envelope, and so commutes with the mixing by a sweep of constant modulus. A weak
signal is then scaled by a gain that follows the strong one's envelope alone; no simulation at radio
frequency is needed. Amplitudes are square-root milliwatts at the receiver's input; the small-signal gain is 1.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

_SHARPNESS = 3  # s of the saturation law: third order stays within 0.07 dB of the cubic up to P1dB - 15 dB
_NODES = 64  # Gauss-Laguerre nodes over an exponential power: gains within 1e-6


@dataclass(frozen=True)
class EnvelopeGain:
    """Gains of an amplifier under a strong signal."""

    own: float  # gain of the strong signal's amplitude (of the part that correlates with it)
    weak: float  # mean gain of a weak signal's amplitude
    modulation: float
    """Variance of that gain over its square: the power of a weak line that the strong envelope turns into a noise
    skirt as wide as the strong signal's band."""
    # power of the output that is no multiple of the strong signal, over its power at the input
    distortion: float = 0.0


@dataclass(frozen=True)
class Amplifier:
    """Amplifier and mixer, whose 1 dB compression point and third-order intercept are set apart.

        G(A) = A / (1 + 2 s (A / A3)^2 + (A / b)^(2 s))^(1 / 2 s),  s = 3

    ``A3`` is the amplitude at IIP3, and ``b`` follows from P1dB exactly. Rapp's law alone (no ``A3``) ties IIP3 to
    P1dB; the cubic alone grows without bound.
    """

    p1db_dbm: float  # input power at which the gain has fallen by 1 dB
    iip3_dbm: float
    """Input third-order intercept point, more than 7.8 dB above ``p1db_dbm``: below, the cubic term alone compresses
    sooner."""

    def __post_init__(self) -> None:
        if not self._rest > 0:
            raise ValueError(
                f"iip3_dbm {self.iip3_dbm:g} is {self.iip3_dbm - self.p1db_dbm:g} dB above p1db_dbm; it has to be more "
                "than 7.8 dB above: raise it or lower p1db_dbm"
            )

    @property
    def _rest(self) -> float:
        """``(A / b)^2s`` at P1dB: the part of 1 dB that the cubic term leaves to saturation."""
        return 10 ** (_SHARPNESS / 10) - 1 - 2 * _SHARPNESS * 10 ** ((self.p1db_dbm - self.iip3_dbm) / 10)

    @cached_property
    def _scales(self) -> tuple[float, float]:
        """``A3^2`` and ``b^2``, in milliwatts."""
        p1db_mw = 10 ** (self.p1db_dbm / 10)
        return 10 ** (self.iip3_dbm / 10), p1db_mw / self._rest ** (1 / _SHARPNESS)

    def envelope(self, amplitude: np.ndarray) -> np.ndarray:
        """Output amplitude of an input amplitude, any shape, >= 0."""
        square = np.square(amplitude)
        third, limit = self._scales
        s = _SHARPNESS
        return amplitude / (1 + 2 * s * square / third + (square / limit) ** s) ** (1 / (2 * s))

    def gain(self, amplitude: np.ndarray) -> np.ndarray:
        """``G(A) / A``."""
        square = np.square(amplitude)
        third, limit = self._scales
        s = _SHARPNESS
        return (1 + 2 * s * square / third + (square / limit) ** s) ** (-1 / (2 * s))

    def weak_gain(self, amplitude: np.ndarray) -> np.ndarray:
        """Gain of a weak signal elsewhere: half of the radial and the tangential one, ``(G' + G / A) / 2``."""
        square = np.square(amplitude)
        third, limit = self._scales
        s = _SHARPNESS
        gain = self.gain(amplitude)
        # A G'(A) / G(A) = 1 - (2 s A^2 / A3^2 + s (A / b)^2s) / (s D)
        slope = 1 - (2 * square / third + (square / limit) ** s) * gain ** (2 * s)
        return 0.5 * gain * (1 + slope)

    def with_strong(self, power_dbm: float, *, constant_envelope: bool) -> EnvelopeGain:
        """Gains under a strong signal of a mean power.

        ``power_dbm``: at the input; ``constant_envelope``: a carrier or sweep; else complex Gaussian, as OFDM and
        noise are, whose power is exponential.
        """
        power = 10 ** (power_dbm / 10)
        if constant_envelope:
            amplitude = np.array(np.sqrt(power))
            return EnvelopeGain(float(self.gain(amplitude)), float(self.weak_gain(amplitude)), 0.0)
        share, weight = np.polynomial.laguerre.laggauss(_NODES)
        amplitude = np.sqrt(power * share)
        weak = self.weak_gain(amplitude)
        mean = float(weight @ weak)
        own = float(weight @ (share * self.gain(amplitude)))  # E[G(A) A] / E[A^2]
        whole = float(weight @ self.envelope(amplitude) ** 2) / power
        return EnvelopeGain(own, mean, float(weight @ weak**2) / mean**2 - 1, whole - own**2)


def rectified(power_mw: np.ndarray, iip2_dbm: float) -> np.ndarray:
    """Complex samples at the IF of an envelope that the mixer's second order rectifies, both rails alike.

    Referred to the input: two carriers of power P give a line that a wanted signal of power ``P^2 / IIP2`` would give
    on each rail. ``power_mw`` is the envelope's power over time, any shape.
    """
    return (0.5 + 0.5j) * 10 ** (-iip2_dbm / 20) * power_mw


def rectified_mw_per_hz(power_mw: float, iip2_dbm: float, bandwidth_hz: float) -> float:
    """Density near 0 Hz of `rectified` for complex Gaussian noise, flat over a bandwidth: ``P^2 / (2 IIP2 B)``.

    The variance of the power is ``P^2``, and its spectrum a triangle from -B to B.
    """
    return 0.5 * power_mw**2 / (10 ** (iip2_dbm / 10) * bandwidth_hz)


@dataclass(frozen=True)
class Bursts:
    """Time-division duplex: a transmitter that is on for a share of every period. ``duty``: 0..1."""

    period_s: float
    duty: float

    def on(self, time_s: np.ndarray) -> np.ndarray:
        """(...) bool: whether it transmits."""
        return np.mod(time_s, self.period_s) < self.duty * self.period_s

    def gain(self, time_s: np.ndarray, during: float, recovery_s: float) -> np.ndarray:
        """(...) gain of a weak signal: ``during`` a burst, from its end on back to 1 with a time constant."""
        after = np.mod(time_s, self.period_s) - self.duty * self.period_s
        decay = np.exp(-np.maximum(after, 0.0) / recovery_s) if recovery_s > 0 else after < 0
        return 1.0 - (1.0 - during) * decay


@dataclass(frozen=True)
class Converter:
    """Gain control and analogue-to-digital converter of the IF."""

    bits: int  # per rail, 4..24
    headroom_db: float  # full scale over the rms of a rail, which the gain control sets anew for every output

    def __call__(self, frames: np.ndarray, rms: np.ndarray | float) -> np.ndarray:
        """Clipped and rounded samples (n, N) of frames, ``rms`` that of their rails, a scalar or (n, 1)."""
        full_scale = np.asarray(rms * 10 ** (self.headroom_db / 20), dtype=np.float32)
        step = full_scale / np.float32(2 ** (self.bits - 1))
        rails = frames.view(np.float32) / step
        np.rint(rails, out=rails)
        limit = np.float32(2 ** (self.bits - 1))
        np.clip(rails, -limit, limit - 1, out=rails)
        rails *= step
        return rails.view(np.complex64)
