"""A transmitter's power amplifier: Rapp's model of a solid-state amplifier."""

from dataclasses import dataclass

import numpy as np

from ..parsing import Settings, setting
from .emitters import NamedEmitter
from .placement import Emitter
from .receiver_filter import decimate_window, repeated, window_guard
from .transmission import Signal, begin

# Rate of the amplifier over the radar's: products up to the seventh order alias outside the carrier.
_OVERSAMPLING = 4


@dataclass(frozen=True, kw_only=True)
class Amplifier(Settings, where="amplifier"):
    """Rapp's solid-state amplifier.

    y = x / (1 + |x/A|^(2p))^(1/(2p)), A^2 being the mean power raised by the back-off (C. Rapp, "Effects of
    HPA-nonlinearity on a 4-DPSK/OFDM-signal for a digital sound broadcasting system", 2nd European Conf. on Satellite
    Communications, 1991). There is no conversion of amplitude to phase.
    """

    backoff_db: float = setting(8.0, -10.0, 60.0)
    """Saturation power over the mean input power."""
    smoothness: float = setting(2.0, 0.3, 100.0)
    """Rapp's p: small is soft, large clips; 2 to 3 is usual for solid-state amplifiers."""

    def amplify(self, samples: np.ndarray, mean_power: float = 1.0) -> np.ndarray:
        """(n,) complex samples, of mean power ``mean_power``, through the amplifier, small-signal gain 1."""
        power = (samples.real**2 + samples.imag**2) * (10.0 ** (-self.backoff_db / 10.0) / mean_power)
        # log1p(exp()) keeps a large exponent from overflowing
        with np.errstate(divide="ignore"):
            log_power = self.smoothness * np.log(power)
        return samples * np.exp(np.logaddexp(0.0, log_power) * (-0.5 / self.smoothness))


@dataclass(frozen=True, kw_only=True)
class AmplifiedEmitter(NamedEmitter):
    """An emitter behind its amplifier: simulated at a rate that holds the spectral regrowth, amplified, then received.

    An emitter with a ``period`` (5G NR) is amplified once, at its own rate; others at four times the radar's.
    """

    emitter: Emitter
    amplifier: Amplifier

    @property
    def unit_power(self) -> bool:
        """Whether the mean power is 1 already: that of a period is."""
        return hasattr(self.emitter, "period")

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 at `rate_hz`; see `Emitter`. Mean power is below 1 where the amplifier saturates."""
        if hasattr(self.emitter, "period"):
            return self.begin(rate_hz, rng)(0, count)
        longer = _OVERSAMPLING * (count + 2 * window_guard(rate_hz, _OVERSAMPLING))
        return self._received(self.emitter.samples(longer, _OVERSAMPLING * rate_hz, rng), rate_hz)

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw a transmission of the emitter."""
        if hasattr(self.emitter, "period"):
            period, residual_hz = self.emitter.period(rate_hz, self.amplifier)
            return repeated(period, residual_hz / rate_hz, rng)
        sent = begin(self.emitter, _OVERSAMPLING * rate_hz, rng)
        guard = window_guard(rate_hz, _OVERSAMPLING)

        def signal(first: int, count: int) -> np.ndarray:
            longer = sent(_OVERSAMPLING * (first - guard), _OVERSAMPLING * (count + 2 * guard))
            return self._received(longer, rate_hz)

        return signal

    def _received(self, sent: np.ndarray, rate_hz: float) -> np.ndarray:
        return decimate_window(self.amplifier.amplify(sent), rate_hz, _OVERSAMPLING)
