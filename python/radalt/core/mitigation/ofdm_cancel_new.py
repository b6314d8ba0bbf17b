"""Cancellation of OFDM: demodulate what a 4G or 5G base station sends, subtract it, keep the return."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..receiver.altimeter_settings import AltimeterSettings
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .ofdm_new.equaliser import ElementGrid
from .ofdm_new.iterative_receiver import IterativeReceiver, KnownReturn, Reception
from .ofdm_new.numerology import Numerology
from .ofdm_new.return_estimation import ReturnEstimator
from .ofdm_new.return_mask import ReturnMask
from .ofdm_new.settings import SETTINGS, OfdmSettings
from .ofdm_new.sync import acquire, find_prefix
from .ofdm.tones import without_tones
from .ofdm_new.tracking import TrackingState, grid_of, next_state, tracked
from .outcome import PASSED, Outcome

_TINY = float(np.finfo(np.float32).tiny)


class OfdmCancel(Mitigation):
    name = "ofdm_cancel"
    style = PlotStyle("#882255", "D", (0, (5, 1, 1, 1)))

    def __init__(self, waveform: Waveform, *, span_m: float | None = None, settings: OfdmSettings = SETTINGS) -> None:
        self.span_m = span_m or AltimeterSettings().resolved(waveform).max_altitude_m
        self.settings = s = settings
        self._returns = ReturnEstimator(waveform, self.span_m, s)
        numerologies = [Numerology(waveform.rate_hz, spacing_hz, s) for spacing_hz in s.spacings_hz]
        self._masks = {n: ReturnMask(waveform, n, self.span_m, s) for n in numerologies}
        self._receivers = {n: IterativeReceiver(n, self._returns, s) for n in numerologies}
        super().__init__(waveform)

    def reset(self) -> None:
        super().reset()
        self.found = self.tracked = 0
        self.outcome = PASSED
        self.outcomes = []
        self._state: TrackingState | None = None

    @property
    def tracking(self) -> bool:
        return self._state is not None

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = batch.copy()
        self.outcomes = []
        for row, frame in zip(out, batch, strict=True):
            cancelled = self.cancel(frame)
            self.outcomes.append(self.outcome)
            if cancelled is not None:
                row[:] = cancelled
        return out

    def cancel(self, frame: np.ndarray, *, search: bool = True) -> np.ndarray | None:
        self.outcome = PASSED
        level = float(np.sqrt(np.vdot(frame, frame).real / frame.size))
        if not _TINY < level < np.inf:
            return None
        ratio = self._returns.visibility(frame)
        if ratio > self.settings.visible_ratio:
            self.outcome = Outcome("visible", ffts=1.5)
            if self._state:
                self._state.skipped(frame.size)
            return None
        for r in self._receivers.values():
            r.ffts = 0.0
        result = None
        if self._state is not None:
            level_used = self._state.level
            result = self._track(frame * np.float32(1 / level_used), ratio)
        if result is None and search:
            level_used = level
            result = self._search(frame * np.float32(1 / level), ratio)
        ffts = sum(r.ffts for r in self._receivers.values()) + 5
        if result is None:
            self.outcome = Outcome("passed", ffts=ffts)
            return None
        out, state, found = result
        self._state.level = level_used
        left = float(np.vdot(out, out).real / out.size)
        self.outcome = Outcome(state, -10 * np.log10(max(left, 1e-12)), float(np.sqrt(found.relative_noise)), ffts)
        self._found = found
        return out * np.float32(level_used)

    def _known(self, x: np.ndarray, ratio: float, grid: ElementGrid) -> KnownReturn | None:
        if ratio < self.settings.raw_ratio:
            return None
        back = self._returns.estimate(x)
        if back.ratio < self.settings.raw_ratio:
            return None
        return KnownReturn(grid.transform(back.samples * grid.carrier), self.settings.return_uncertainty / back.ratio, False)

    def _search(self, x: np.ndarray, ratio: float):
        s = self.settings
        best = None
        for numerology in self._masks:
            prefix = find_prefix(x, numerology)
            if best is None or prefix.contrast > best[0].contrast:
                best = prefix, numerology
            if prefix.contrast > s.certain_contrast:
                break
        prefix, numerology = best
        if prefix.contrast < s.prefix_contrast:
            return None
        receiver, mask = self._receivers[numerology], self._masks[numerology]
        grid, first_long = acquire(x, prefix, numerology, mask, s)
        receiver.ffts += 15
        free = mask.free(grid.starts, prefix.cfo)
        known = self._known(x, ratio, grid)
        found = receiver.search(grid, free, known)
        if found is None:
            return None
        out, found, grid = receiver.finish(grid, free, found, known, tune=True)
        self._state = next_state(found, grid, first_long, x.size, None)
        self.found += 1
        return out, "acquired", found

    def _track(self, x: np.ndarray, ratio: float):
        state = self._state
        receiver, mask = self._receivers[state.numerology], self._masks[state.numerology]
        grid = grid_of(x, state)
        free = mask.free(grid.starts, state.cfo)
        known = self._known(x, ratio, grid)
        found = tracked(grid, free, state, receiver, known, self.settings) if state.model == "static" else None
        if found is None and state.model != "static":
            found = receiver.search(grid, free, known, only=state.model)
        if found is None:
            self._state = None
            return None
        out, found, grid = receiver.finish(grid, free, found, known, tune=state.age % 16 == 0)
        self._state = next_state(found, grid, state.first_long, x.size, state)
        self.tracked += 1
        return out, "tracked", found
