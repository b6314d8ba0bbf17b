"""Cancellation of QPSK: demodulate it blindly, rebuild it with the pulse that was received, subtract it."""

import numpy as np

from ..waveform import Waveform
from .base import MitigationError, PlotStyle
from .ofdm.tone_removal import without_tones
from .outcome import Canceller, Outcome
from .qpsk.cma_equaliser import CmaEqualiser
from .qpsk.pulse_estimation import estimate_pulse
from .qpsk.settings import DEFAULTS, QpskSettings
from .qpsk.symbol_timing import find_symbol_timing
from .qpsk.tracking import Tracker, can_track

_MIN_SAMPLES = 1024  # of a frame: 20 of the slowest symbols
# FFTs of 7,500 points that steps cost, as measured
_TRACKING, _TONES, _DETECTION, _DEMODULATION, _PULSE = 20.0, 35.0, 10.0, 32.0, 50.0


class QpskCancel(Canceller):
    """Blind demodulation and subtraction of QPSK of any pulse.

    Card: *decision-directed cancellation.* The products of neighbouring samples give the symbol timing. A
    constant-modulus equaliser needs neither carrier nor pulse. Its outputs are decided. The pulse is fitted to the
    frame by least squares, with channel, filters and their drift over the frame, and the signal is subtracted. Tones
    on top are removed before. An emitter that fills the frame is tracked: timing, carrier, equaliser and pulse are
    known in the next frame and only corrected. Frames without QPSK pass bit for bit. So do frames in which the return
    is too strong for safe decisions (an SIR above some -10 dB), which the altimeter reads without help. What is not
    QPSK stays: the transmitter's error vectors, other interference, symbols that change on the sample grid.

    What is used of the emitter: that its symbols come at an even rate, 0.02 to 0.49 per sample, and are four points
    of one modulus (QPSK, rotated by any angle per symbol; BPSK). Its pulse may last 14 symbols, echoes included. Up
    to 100 samples at either end of a frame are blanked, where symbols are cut.

    - ``settings``: for studies of their sensitivity
    - ``cancelled``: frames in which QPSK was cancelled
    - ``active_share``: share of the last frame that was cancelled in which QPSK was sent
    - ``burst_weight``: weight, in amplitude, that the samples of a burst have in what is left of that frame; 1
      without a burst

    Raises `MitigationError` if the frame is too short.
    """

    name = "qpsk_cancel"
    style = PlotStyle("#997700", "h", (0, (2, 1)))

    def __init__(self, waveform: Waveform, *, settings: QpskSettings = DEFAULTS) -> None:
        if waveform.samples_per_frame < _MIN_SAMPLES:
            raise MitigationError(
                f"qpsk_cancel: a frame has {waveform.samples_per_frame} samples; it takes {_MIN_SAMPLES} or more"
            )
        self._s = settings
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.cancelled = 0
        self.active_share, self.burst_weight = 0.0, 1.0

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that were cancelled, and those tracked."""
        return super().status() | {"cancelled": self.cancelled, "tracked": self.tracked}

    def cancel(self, frame: np.ndarray, *, search: bool = True) -> np.ndarray | None:
        """See `Canceller.cancel`."""
        self._ffts, state = 0.0, "tracked"
        out = self._next(frame) if self._state else None
        if out is None and search:
            state, out = "acquired", self._acquired(frame)
        if out is None:
            self.outcome = Outcome(ffts=self._ffts)
            return None
        left = np.vdot(out, out).real
        suppression_db = 10 * float(np.log10(np.vdot(frame, frame).real / left)) if left else np.inf
        self.outcome = Outcome(state, suppression_db, float(np.sqrt(self._evm_squared)), self._ffts)
        self.cancelled += 1
        self.tracked += state == "tracked"
        return out

    def _next(self, frame: np.ndarray) -> np.ndarray | None:
        """The frame without the emitter of the frame before; None if it is lost."""
        (tracker, scale, tones), self._state = self._state, None
        self._ffts += _TRACKING
        rest = without_tones(frame) if tones else None
        frame = frame if rest is None else rest
        if not 0 < np.vdot(frame, frame).real < np.inf:
            return None
        found = tracker.track(frame * (1 / scale))
        out = None if found is None else self._subtracted(*found)
        if out is None:
            return None
        self._state, self._evm_squared = (tracker, scale, tones), tracker.evm_squared
        return out * scale

    def _acquired(self, frame: np.ndarray) -> np.ndarray | None:
        """The frame without an emitter that is searched; None if there is none."""
        self._ffts += _DETECTION
        rest = without_tones(frame)
        tones = rest is not None
        self._ffts += _TONES * tones
        frame = rest if tones else frame
        scale = np.float32(np.sqrt(np.vdot(frame, frame).real / frame.size))
        if not 0 < scale < np.inf:
            return None
        frame = frame * (1 / scale)  # a complex division costs four times that
        timing = find_symbol_timing(frame, self._s)
        if timing is None:
            return None
        self._ffts += _DEMODULATION
        symbols = CmaEqualiser(frame, timing, self._s).symbols()
        if symbols is None:
            return None
        self._ffts += _PULSE
        residual, train, pulses = estimate_pulse(frame, symbols, self._s)
        if not np.vdot(residual, residual).real < frame.size:  # numerically no fit: it adds power
            return None
        on = np.interp(np.arange(frame.size), symbols.times, symbols.decisions != 0) > 0.5
        out = self._subtracted(residual, train.known, on)
        if out is None:
            return None
        self._evm_squared = symbols.evm_squared
        if can_track(symbols, pulses, self._s):
            # what frames are divided by, and whether they had tones on top
            self._state = Tracker(timing, symbols, pulses, train, residual, self._s), scale, tones
        return out * scale

    def _subtracted(
        self, residual: np.ndarray, known: slice, on: np.ndarray | None = None
    ) -> np.ndarray | None:
        """(n,) residual where the symbols are ``known``, blanked where some are cut; None if none is sent there.

        A burst, ``on`` (n,) bool, leaves its error vectors: there the residual is weighted with the power next to it
        over its own, as least squares weights samples of unequal noise.
        """
        rest = residual[known]
        level = np.square(np.abs(rest))
        on = np.ones(level.size, dtype=bool) if on is None else on[known]
        if not on.any():
            return None
        most = self._s.training_symbols
        median, outside = _median(level[on], most), np.inf if on.all() else _median(level[~on], most)
        self.burst_weight = min(1.0, outside / max(median, 1e-30))
        weight = np.where(on, np.float32(self.burst_weight), np.float32(1))
        weight[level > self._s.outlier_power * np.where(on, median, outside)] = 0
        out = np.zeros_like(residual)
        out[known] = rest * weight
        self.active_share = float(on.mean())
        return out


def _median(values: np.ndarray, most: int) -> float:
    """Median of some ``most`` of (n,) ``values``, evenly spaced."""
    return float(np.median(values[:: max(1, values.size // most)]))
