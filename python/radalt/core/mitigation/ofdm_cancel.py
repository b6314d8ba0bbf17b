"""Cancellation of OFDM: demodulate what a 4G or 5G base station sends, subtract it, keep the return."""

from dataclasses import replace

import numpy as np

from ..altimeter.altimeter_settings import AltimeterSettings
from ..waveform import Waveform
from .base import MitigationError, PlotStyle
from .ofdm.arrays import power
from .ofdm.burst_detection import loud_burst
from .ofdm.iterative_receiver import ITERATION_FFTS, Reception
from .ofdm.numerology import Numerology
from .ofdm.return_aware import ReturnAwareReceiver
from .ofdm.return_estimation import ReturnEstimator
from .ofdm.return_mask import ReturnMask
from .ofdm.settings import SETTINGS, OfdmSettings
from .ofdm.sync import acquire, find_prefix
from .ofdm.tone_removal import without_tones
from .ofdm.tracking import TrackingState, grid_of, next_state, tracked
from .outcome import PASSED, Canceller, Outcome

_TINY = float(np.finfo(np.float32).tiny)
_TEST_FFTS = 5.0  # cost of a test for a return, or for a prefix


class OfdmCancel(Canceller):
    """Blind demodulation and subtraction of cyclic-prefix OFDM (LTE and NR downlinks of 15 or 30 kHz).

    Card: *decision-directed cancellation.* A frame whose return stands out already passes. The cyclic prefix gives
    subcarrier spacing, symbol timing and CFO; fourth powers of the elements give the long prefix, phases and a first
    channel. Then soft decisions, the noise that they leave, phases, timing and channel are estimated in turns, from
    elements that no return can be in, five of six. A transmitter's error vectors are noise like any other here: gates
    are ratios to the noise that was measured. The rebuilt emitter is subtracted. The return that shows then is taken
    out of the elements, and a second pass decides those that it had hidden. What is left has to be consistent with
    one return and white noise, else the frame passes as it came. Once found, an emitter is tracked from frame to
    frame. Frames without such a signal pass bit for bit. Short loud bursts are blanked; tones on top are fitted and
    subtracted. What cannot be demodulated stays: noise 10 dB below the signal or more, two layers of equal power.

    What is used of the emitter: the frame structure of TS 38.211 clause 5.3.1 and TS 36.211 clause 6.12, and the
    constellations. No cell identity, pilots, payload or allocation. The rate has to be a multiple of 30 kHz, so that
    a symbol is a whole number of samples. Steps are left out that, by an estimate, could exceed 590
    FFTs of 7,500 points; CPU time has reached 900 (docs/cancellation.md). The algorithm is in the modules of ``ofdm/``;
    `ofdm.iterative_receiver` has the walk of a frame.

    What `Hybrid` uses: ``cancel(frame, search=...)``, ``tracking`` and ``outcome``. Nothing else of this class is
    meant for other methods.

    - ``span_m``: highest altitude whose return must not be taken for data, above 0; None is the default altimeter's
    - ``drop_when_slow``: whether frames are dropped where the method is too slow: after some searches in vain fewer
      frames are searched
    - ``settings``: numbers of the receiver, for studies
    - ``found``: frames in which an emitter was acquired by search

    Raises `MitigationError` if the rate does not fit or ``span_m`` is out of range.
    """

    name = "ofdm_cancel"
    style = PlotStyle("#882255", "D", (0, (5, 1, 1, 1)))

    def __init__(
        self,
        waveform: Waveform,
        *,
        span_m: float | None = None,
        drop_when_slow: bool = False,
        settings: OfdmSettings = SETTINGS,
    ) -> None:
        wide = max(settings.spacings_hz)
        if waveform.rate_hz % wide or waveform.rate_hz < 64 * wide:
            raise MitigationError(
                f"ofdm_cancel: rate_hz is {waveform.rate_hz:g}; it has to be a multiple of {wide:g}, "
                f"at least {64 * wide:g}"
            )
        if waveform.sweep_s < 0.3e-3:
            raise MitigationError(
                f"ofdm_cancel: sweep_s is {waveform.sweep_s:g}; a frame shorter than 0.3e-3 holds too few symbols"
            )
        if span_m is not None and not 0 < span_m < np.inf:
            raise MitigationError(
                f"ofdm_cancel.span_m is {span_m!r}; it has to be a finite number of metres above 0"
            )
        self.span_m = span_m or AltimeterSettings().resolved(waveform).max_altitude_m
        self.settings = settings
        self._patience = settings.patience if drop_when_slow else np.inf
        self._returns = ReturnEstimator(waveform, self.span_m, settings)
        kinds = [Numerology(waveform.rate_hz, spacing_hz) for spacing_hz in settings.spacings_hz]
        self._masks = {kind: ReturnMask(waveform, kind, self.span_m, settings) for kind in kinds}
        self._receivers = {kind: ReturnAwareReceiver(kind, self._returns, settings) for kind in kinds}
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.found = 0
        self._ffts = 0.0  # of the frame, outside the receivers

    def forget(self) -> None:
        """See `Canceller.forget`."""
        self._state: TrackingState | None = None
        self._in_vain = 0  # searches since one succeeded

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that held an emitter."""
        return super().status() | {"found": self.found, "tracked": self.tracked}

    def cancel(self, frame: np.ndarray, *, search: bool = True) -> np.ndarray | None:
        """See `Canceller.cancel`."""
        self.outcome = PASSED
        level = float(np.sqrt(np.vdot(frame, frame).real / frame.size))
        if not _TINY < level < np.inf:  # of powers that no float32 holds
            return None
        self._ffts = _TEST_FFTS
        for receiver in self._receivers.values():
            receiver.ffts = 0.0
        visibility = self._returns.visibility(frame)
        if visibility > self.settings.visible_ratio:
            if self._state is not None:
                self._state.skipped(frame.size)
            self.outcome = Outcome("visible", ffts=self._ffts)
            return None
        out = self._track(frame, visibility)
        if out is None and search and self._may_search():
            out = self._search(frame, level, visibility)
        spent = self._ffts + sum(receiver.ffts for receiver in self._receivers.values())
        spent *= frame.size / 7500  # samples of the frame for which steps are priced
        if out is None:
            self.outcome = Outcome("passed", ffts=spent)
        else:
            left = float(np.vdot(out, out).real / out.size)
            suppression_db = 20 * np.log10(level) - 10 * np.log10(max(left, _TINY))
            self.outcome = replace(self.outcome, suppression_db=suppression_db, ffts=spent)
        return out

    def _may_search(self) -> bool:
        """Whether this frame is searched: after some searches in vain one frame in as many, if frames are dropped."""
        most = self._patience
        if self._in_vain > most and self._in_vain % most:
            self._in_vain += 1
            return False
        return True

    def _search(self, frame: np.ndarray, level: float, visibility: float) -> np.ndarray | None:
        """A frame without an emitter that is acquired anew; None if none can be demodulated."""
        s = self.settings
        received = without_tones(frame)
        tones = received is not None
        received = received if tones else frame
        if tones:
            self._ffts += ITERATION_FFTS
            level = float(np.sqrt(np.vdot(received, received).real / frame.size))
        x = received * np.float32(1 / max(level, _TINY))
        sizes = power(x)
        if np.vdot(sizes, sizes) < s.least_kurtosis * x.size:
            return None  # a sweep meets itself a symbol later, too
        prefix, kind = max(
            ((find_prefix(x, kind), kind) for kind in self._masks), key=lambda found: found[0].contrast
        )
        self._ffts += _TEST_FFTS
        if prefix.contrast < s.prefix_contrast:
            self._in_vain = 0  # nothing to be searched
            return None
        burst = loud_burst(x, s)
        if burst is not None:
            self.outcome = Outcome("blanked")
            return np.where(burst, np.complex64(0), frame)
        self._in_vain += 1
        self._ffts += ITERATION_FFTS
        receiver, mask = self._receivers[kind], self._masks[kind]
        grid, first_long = acquire(x, prefix, kind, mask, s)
        free = mask.free(grid.starts, prefix.cfo)
        known = receiver.known_return(x, grid, s.raw_ratio) if visibility > s.raw_ratio else None
        found = receiver.search(grid, free, known)
        if found is None:
            return None
        out, found, grid = receiver.finish(grid, free, found, known, tune=True)
        if not self._returns.is_consistent(out):
            return None
        self._in_vain = 0
        self._state = next_state(found, grid, first_long, x.size, None)
        self._state.level, self._state.tones = level, tones
        self.found += 1
        return self._cancelled(out, "acquired", found)

    def _track(self, frame: np.ndarray, visibility: float) -> np.ndarray | None:
        """A frame without the emitter of the frame before; None if there was none, or it has changed."""
        s, state = self.settings, self._state
        if state is None:
            return None
        received = frame
        if state.tones:
            self._ffts += ITERATION_FFTS
            toneless = without_tones(frame)
            received = frame if toneless is None else toneless
        x = received * np.float32(1 / state.level)
        receiver, mask = self._receivers[state.numerology], self._masks[state.numerology]
        grid = grid_of(x, state)
        free = mask.free(grid.starts, state.cfo)
        known = receiver.known_return(x, grid, s.raw_ratio) if visibility > s.raw_ratio else None
        if state.model == "static":
            found = tracked(grid, free, state, receiver, known, s)
        else:
            found = receiver.search(grid, free, known, only=state.model)
        self._state = None
        if found is None:
            return None
        tune = state.age % s.cfo_interval == 0
        out, found, grid = receiver.finish(grid, free, found, known, tune=tune)
        if not self._returns.is_consistent(out):
            return None
        self._state = next_state(found, grid, state.first_long, x.size, state)
        self.tracked += 1
        return self._cancelled(out, "tracked", found)

    def _cancelled(self, out: np.ndarray, state: str, found: Reception) -> np.ndarray:
        self.outcome = Outcome(state, evm=float(np.sqrt(found.relative_noise)))
        return out * np.float32(self._state.level)
