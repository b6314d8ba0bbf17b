"""Cancellation of QPSK: demodulate it blindly, rebuild it with the pulse that was received, subtract it."""

from dataclasses import dataclass

import numpy as np

from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .ofdm.tone_removal import without_tones
from .outcome import PASSED, Outcome
from .qpsk.cma_equaliser import CmaEqualiser
from .qpsk.pulse_estimation import estimate_pulse
from .qpsk.settings import DEFAULTS, QpskSettings
from .qpsk.symbol_timing import find_symbol_timing
from .qpsk.tracking import Tracker, can_track

_MIN_SAMPLES = 1024  # of a frame: 20 of the slowest symbols
# FFTs of 7,500 points that steps cost, as measured
_TRACKING, _TONES, _DETECTION, _DEMODULATION, _PULSE = 20.0, 35.0, 10.0, 32.0, 50.0


@dataclass(frozen=True)
class _Track:
    """A tracker, what frames are divided by for it, and whether they had tones on top."""

    tracker: Tracker
    scale: np.float32
    tones: bool


class QpskCancel(Mitigation):
    """Blind demodulation and subtraction of QPSK of any pulse.

    Card: *decision-directed cancellation.* The products of neighbouring samples give the symbol timing. A
    constant-modulus equaliser needs neither carrier nor pulse. Its outputs are decided. The pulse is fitted to the
    frame by least squares, with channel, filters and their drift over the frame, and the signal is subtracted. Tones
    on top are removed before. An emitter that fills the frame is tracked: timing, carrier, equaliser and pulse are
    known in the next frame and only corrected. Frames without QPSK pass bit for bit. So do frames in which the return
    is too strong for safe decisions (an SIR above some -10 dB), which the altimeter reads without help. What is not
    QPSK stays: the transmitter's error vectors, other interference, symbols that change on the sample grid.

    What is used of the emitter: that its symbols come at an even rate, 0.02 to 0.47 per sample, and are four points
    of one modulus (QPSK, rotated by any angle per symbol; BPSK). Its pulse may last 14 symbols, echoes included. Up
    to 100 samples at either end of a frame are blanked, where symbols are cut.

    - ``settings``: for studies of their sensitivity
    - ``cancelled``, ``tracked``: frames in which QPSK was cancelled, and how many of them without a search
    - ``outcome``: of the last frame that `cancel` was given
    - ``outcomes``: one per finite frame of the last call of `process`
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
        self.cancelled = self.tracked = 0
        self.outcome, self.outcomes = PASSED, []
        self.active_share, self.burst_weight = 0.0, 1.0
        self._track: _Track | None = None

    def forget(self) -> None:
        """See `Mitigation.forget`: the emitter that is tracked."""
        self._track = None

    @property
    def tracking(self) -> bool:
        """Whether an emitter is known from the frame before, so that ``cancel(frame, search=False)`` may cancel it."""
        return self._track is not None

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that were cancelled, and those tracked."""
        return super().status() | {"cancelled": self.cancelled, "tracked": self.tracked}

    def cancel(self, frame: np.ndarray, *, search: bool = True) -> np.ndarray | None:
        """(N,) complex64 frame without its QPSK; None where none was demodulated: the frame passes.

        ``search=False`` only tracks an emitter of the frame before.
        """
        self._ffts, state = 0.0, "tracked"
        out = self._next(frame) if self._track else None
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
        track, self._track = self._track, None
        self._ffts += _TRACKING
        rest = without_tones(frame) if track.tones else None
        frame = frame if rest is None else rest
        if not 0 < np.vdot(frame, frame).real < np.inf:
            return None
        found = track.tracker.track(frame * (1 / track.scale))
        out = None if found is None else self._subtracted(*found)
        if out is None:
            return None
        self._track, self._evm_squared = track, track.tracker.evm_squared
        return out * track.scale

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
        model, train, pulses = estimate_pulse(frame, symbols, self._s)
        residual = frame - model
        on = np.interp(np.arange(frame.size), symbols.times, symbols.decisions != 0) > 0.5
        out = self._subtracted(residual, model, train.known, on)
        if out is None:
            return None
        self._evm_squared = symbols.evm_squared
        if can_track(symbols, pulses, self._s):
            self._track = _Track(Tracker(timing, symbols, pulses, train, residual, self._s), scale, tones)
        return out * scale

    def _subtracted(
        self, residual: np.ndarray, model: np.ndarray, known: slice, on: np.ndarray | None = None
    ) -> np.ndarray | None:
        """(n,) residual where the symbols are ``known``, blanked where some are cut; None if little was subtracted.

        A burst, ``on`` (n,) bool, leaves its error vectors: there the residual is weighted with the power next to it
        over its own, as least squares weights samples of unequal noise.
        """
        rest, made = residual[known], model[known]
        level = np.square(np.abs(rest))
        on = np.ones(level.size, dtype=bool) if on is None else on[known]
        left = float(level[on].sum())
        if not (on.any() and np.vdot(made, made).real >= self._s.min_suppression * left):
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

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out, self.outcomes = batch.copy(), []
        for row, frame in zip(out, batch, strict=True):
            cancelled = self.cancel(frame)
            self.outcomes.append(self.outcome)
            if cancelled is not None:
                row[:] = cancelled
        return out


def _median(values: np.ndarray, most: int) -> float:
    """Median of some ``most`` of (n,) ``values``, evenly spaced."""
    return float(np.median(values[:: max(1, values.size // most)]))
