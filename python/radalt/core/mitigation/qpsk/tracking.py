"""Tracking of an emitter that fills the frame: timing, carrier, equaliser and pulse of the last frame are known."""

import numpy as np
from scipy import fft

from .carrier_recovery import decide, largest_correlation
from .cma_equaliser import Symbols, tap_spacing
from .nufft import INTERPOLATION_POINTS, correction, interpolate
from .overlap_save import OverlapSave
from .pulse_estimation import SymbolTrain
from .settings import QpskSettings
from .symbol_timing import SymbolTiming, symbol_instant

_BESIDE = 12  # samples on either side of an equaliser: the interpolation's correction is as long


def can_track(symbols: Symbols, pulses: np.ndarray, s: QpskSettings) -> bool:
    """Whether a frame has symbols from end to end, and its (2, length) pulses drift little."""
    return symbols.active_share == 1 and _drift(pulses) < s.max_drift


class Tracker:
    """One emitter, from the frame in which it was acquired on.

    Per frame: the equaliser at the times predicted, decisions, and the pulse, corrected by conjugate gradients where
    that takes away more than noise explains. The symbols are random, so their Toeplitz matrix is nearly the unit
    matrix. Where the times do not fit, they are taken from the timing line at the known rate.

    ``symbols``: of the frame in which the emitter was acquired; ``pulses`` (2, length): of `estimate_pulse`, as
    ``train``; ``residual`` (n,) complex64: what is left of that frame. ``evm_squared``: of the last frame.
    """

    def __init__(
        self,
        timing: SymbolTiming,
        symbols: Symbols,
        pulses: np.ndarray,
        train: SymbolTrain,
        residual: np.ndarray,
        s: QpskSettings,
    ) -> None:
        self._s, self._train, self._count = s, train, residual.size
        self._period = 1 / timing.rate
        spacing = tap_spacing(timing.rate, s)
        self._side = spacing * s.taps // 2 + 1
        length = s.taps * spacing + 2 * _BESIDE
        taps = np.zeros(length, dtype=np.complex64)
        taps[length // 2 + (s.taps // 2 - np.arange(s.taps)) * spacing] = symbols.weights
        self._filter = OverlapSave(self._count, length)
        flat = correction(fft.fftfreq(self._filter.size), INTERPOLATION_POINTS)
        self._response = self._filter.responses(taps) * flat
        self._carrier = _cycles_per_symbol(symbols.values * symbols.decisions.conj())
        self._pulse = pulses[0].astype(np.complex64)
        self.evm_squared = symbols.evm_squared
        self._least = float(np.mean(np.square(np.abs(residual[train.known]))))
        self._power = self._least
        # frames still to skip before the next correction; since the last change
        self._rest = self._unchanged = 0
        self._predict(symbols.times, self._correct(self._pulse, pulses, 1.0))

    def track(self, frame: np.ndarray) -> tuple[np.ndarray, slice] | None:
        """What is left of an (n,) complex64 frame, and the samples in which all symbols are known; None if the emitter
        is lost.
        """
        s, train = self._s, self._train
        outputs = self._filter.filtered(self._filter.transforms(frame) * self._response)
        found = self._decided(outputs, self._instant)
        if found is None:
            found = self._decided(outputs, symbol_instant(frame, 1 / self._period))
        if found is None:
            return None
        times, values = found
        train.send(times, values)
        source = train.segment_transforms()
        model = train.filtered(source * train.responses(self._pulse))
        span = train.known
        # a gain that all of the pulse has: the converter's, or the emitter's
        gain = np.vdot(model[span], frame[span]).real / np.vdot(model[span], model[span]).real
        if not gain > 0:
            return None
        before, model = self._pulse * np.float32(gain), model * np.float32(gain)
        residual = frame - model
        power = np.vdot(residual[span], residual[span]).real / (span.stop - span.start)
        if self._unchanged < self._rest and power < (1 + s.min_correction) * self._power:
            self._unchanged += 1
            self._predict(times, 0.0)
            return residual, span
        pulses, residual, power, steps = self._corrected(frame, model, residual, source, before)
        if not (_drift(pulses) < s.max_drift and power < s.max_residual * self._least):
            return None
        self._power, self._least = power, min(self._least, power)
        self._predict(times, self._correct(before, pulses, 1.0 if steps and not self._rest else s.smoothing))
        self._rest = 0 if steps > 1 else min(self._rest + 1 - steps, s.max_unchanged)
        self._unchanged = 0
        return residual, span

    def _decided(self, outputs: np.ndarray, instant: float) -> tuple[np.ndarray, np.ndarray] | None:
        """(K,) times and (K,) symbols around ``instant``; None if they are not those of this emitter."""
        s, begin, end = self._s, self._side, self._count - self._side - 1
        times = np.arange(
            instant - np.floor((instant - begin) / self._period) * self._period, end, self._period
        )
        received = interpolate(outputs, times)
        active = np.ones(times.size, dtype=bool)
        decisions, carrier = decide(received, active, s.carrier_symbols, self._carrier)
        straight = received * carrier.conj()
        amplitude = np.vdot(decisions, straight).real / times.size
        if not amplitude > 0:
            return None
        error = straight / np.float32(amplitude) - decisions
        self.evm_squared = float(np.vdot(error, error).real) / times.size
        if not self.evm_squared < s.max_evm_squared or largest_correlation(decisions) > s.max_correlation:
            return None
        self._carrier = _cycles_per_symbol(carrier)
        return times, decisions * carrier

    def _corrected(
        self,
        frame: np.ndarray,
        model: np.ndarray,
        residual: np.ndarray,
        source: np.ndarray,
        pulse: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, float, int]:
        """The (2, length) pulses that fit a frame best, from a ``pulse``, its ``model`` and ``residual``; their
        residual, its mean power where all symbols are known, and the steps taken.
        """
        train, span = self._train, self._train.known
        pulses = np.zeros((2, train.length), dtype=np.complex64)
        pulses[0] = pulse
        moments = np.stack([np.ones(train.segments, np.float32), train.ramp()]).astype(np.complex64)
        # the mean square of the ramp is a third; only symbols in the span are correlated
        scale = np.array([[1], [3]]) * (self._period / (span.stop - span.start))
        threshold = self._s.min_correction + 2 * train.length / self._count
        conjugate, steps = source.conj(), 0
        direction, last = np.complex64(0), np.inf
        while steps < self._s.pulse_iterations:
            power = np.vdot(residual[span], residual[span]).real
            lags = train.correlations(moments @ (conjugate * train.to_correlate(residual, span)))
            step = scale * lags
            gain = np.vdot(step, lags).real
            if gain < threshold * power:
                pulses += step
                break
            direction, last = step + gain / last * direction, gain
            made = train.filtered(source * (moments.T @ train.responses(direction)))
            size = np.float32(gain / np.vdot(made[span], made[span]).real)
            pulses += size * direction
            model = model + size * made
            residual = frame - model
            steps += 1
        power = np.vdot(residual[span], residual[span]).real / (span.stop - span.start)
        return pulses, residual, float(power), steps

    def _correct(self, before: np.ndarray, pulses: np.ndarray, share: float) -> float:
        """Move the tracked pulse from ``before`` by ``share`` of its difference to a frame's (2, length) ``pulses``;
        returns the delay of its symbols in samples.

        A delay is no change of the pulse but of the symbols' times. A pulse whose delay drifts over the frame
        corrects the symbol period; the carrier is estimated anew in each frame.
        """
        # derivative of the delay
        delayed = fft.ifft(fft.fft(before) * (-2j * np.pi * fft.fftfreq(before.size)))
        rotated = 1j * before
        gram = np.array([[np.vdot(a, b).real for b in (rotated, delayed)] for a in (rotated, delayed)])
        changes = np.stack([pulses[0] - before, pulses[1]])
        along = (changes @ np.stack([rotated, delayed]).conj().T).real
        (_, delay), (_, stretch) = np.linalg.solve(gram, along.T).T
        self._pulse = (before + share * (changes[0] - delay * delayed)).astype(np.complex64)
        self._period *= (
            1
            + share * stretch / self._train.half
            + self._s.smoothing * delay / ((self._unchanged + 1) * self._count)
        )
        return float(delay)

    def _predict(self, times: np.ndarray, delay: float) -> None:
        """Time of a symbol of the next frame, from the ``times`` in this one, which were too early by ``delay``."""
        centre = float(times[times.size // 2]) + delay
        self._instant = centre + round(self._count / self._period) * self._period - self._count


def _drift(pulses: np.ndarray) -> float:
    """Power of the second of two pulses over that of the first."""
    constant, ramp = (np.vdot(pulse, pulse).real for pulse in pulses)
    return ramp / constant


def _cycles_per_symbol(carrier: np.ndarray) -> float:
    """Mean frequency of (K,) phasors of a carrier."""
    step = np.angle(np.vdot(carrier[:-1], carrier[1:])) / (2 * np.pi)
    steps = carrier.size - 1
    rest = np.angle(carrier[-1] * np.conj(carrier[0]) * np.exp(-2j * np.pi * step * steps)) / (2 * np.pi)
    return float(step + rest / steps)
