"""Subtraction, then decisions once more: with the return that shows once the emitter is gone, or in masked elements."""

from dataclasses import replace

import numpy as np

from .arrays import median, spread
from .cfo import residual_cfo
from .equaliser import ElementGrid, equalise
from .iterative_receiver import ITERATION_FFTS, IterativeReceiver, KnownReturn, Reception, channel_power
from .numerology import Numerology
from .reconstruction import blanked, modulate, sent_elements
from .return_estimation import ReturnEstimator
from .return_fit import MaskedPoints, ReturnFit
from .settings import OfdmSettings

# half the distance of 256QAM's points, squared (TS 38.211 clause 5.1.5); returns louder than that of 64QAM are visible
_DISTANCE_256QAM, _RARE = 1.5 / 255, 0.1  # and its share of the elements, from which it counts


class ReturnAwareReceiver(IterativeReceiver):
    """An `IterativeReceiver` that subtracts what it has received, and decides again with the return known."""

    def __init__(self, numerology: Numerology, returns: ReturnEstimator, settings: OfdmSettings) -> None:
        super().__init__(numerology, settings)
        self._returns = returns

    def finish(
        self, grid: ElementGrid, free: np.ndarray, found: Reception, known: KnownReturn | None, *, tune: bool
    ) -> tuple[np.ndarray, Reception, ElementGrid]:
        """Frame without the emitter, CFO put back; residual CFO and return are seen to where they matter.

        Returns the (N,) frame, the reception that was subtracted, and the elements it belongs to.
        """
        s, num = self._s, self._num
        certain = False
        if known is None:
            known, found = self._fitted_return(grid, free, found, tune)
            if known is not None:
                certain = known.uncertainty.max() < 1
                found = self._again(grid, free, found, known)
        if tune:
            sent = modulate(found.channel * found.soft.mean * found.phase.conj(), grid)
            off = residual_cfo(grid, sent)
            # within a symbol it leaves (pi off)^2 / 3 of the power
            if (np.pi * off) ** 2 / 3 > 0.05 * found.relative_noise:
                back = np.exp(2j * np.pi * off / num.useful * (grid.starts + num.useful / 2)).astype("c8")
                grid = grid.retuned(grid.cfo + off)
                found = self._again(grid, free, replace(found, phase=found.phase * back[:, None]), known)
        out = self._subtracted(grid, free, found)
        if (known is not None or tune) and not certain:
            shown = self.known_return(out * grid.carrier.conj(), grid, s.found_ratio, everywhere=True)
            if shown is not None:
                found = self._again(grid, free, found, shown)
                out = self._subtracted(grid, free, found)
        self.ffts += ITERATION_FFTS
        return blanked(out * grid.carrier.conj(), s), found, grid

    def _subtracted(self, grid: ElementGrid, free: np.ndarray, found: Reception) -> np.ndarray:
        """(N,) complex64 frame without the emitter, its CFO still removed."""
        model, limit = found.channel * found.soft.mean, self._s.outlier_return
        elements = sent_elements(found.elements, model, found.noise, free, found.used, limit)
        return grid.samples - modulate(elements * found.phase.conj(), grid)

    def _again(
        self, grid: ElementGrid, free: np.ndarray, found: Reception, known: KnownReturn | None
    ) -> Reception:
        """The frame, decided once more with what is known of the return."""
        return replace(self.loop(grid, free, found, 0, known=known), return_power=found.return_power)

    def known_return(
        self, frame: np.ndarray, grid: ElementGrid, least: float, *, everywhere: bool = False
    ) -> KnownReturn | None:
        """Return of an (N,) frame whose pair of tones has at least so large a ratio in the mean, or None."""
        found = self._returns.estimate(frame)
        if found.ratios.mean() < least:
            return None
        half = frame.size // 2
        middle = grid.starts + self._num.useful // 2
        uncertainty = np.minimum(self._s.return_uncertainty / found.ratios, 1)[(middle >= half).astype(int)]
        elements = grid.transform(found.samples * grid.carrier)
        return KnownReturn(elements, uncertainty.astype(np.float32)[:, None], everywhere)

    def _fitted_return(
        self, grid: ElementGrid, free: np.ndarray, found: Reception, tune: bool
    ) -> tuple[KnownReturn | None, Reception]:
        """The return with which masked elements are points, where one would be taken for data; else None."""
        h2 = channel_power(found.channel)
        least = self._s.return_loud * _DISTANCE_256QAM * median(h2)
        masked, order = ~free & found.used, found.soft.order[-1][grid.segment]
        if not (tune or found.return_power > least) or not masked.any():
            return None, found
        if ((1 - found.soft.control) * spread(order, self._num.block)).mean() < _RARE:
            return None, found
        z = equalise(found.elements, found.channel)
        points = MaskedPoints.of(z, found.noise, h2, found.soft, grid, masked)
        if tune:
            found = replace(found, return_power=float(points.return_power(self._s.return_step_db)[0]))
        if not found.return_power > least or self.ffts + 6 * ITERATION_FFTS > self._s.most_ffts:
            return None, found
        return self._fitted(points, grid, found), found

    def _fitted(self, points: MaskedPoints, grid: ElementGrid, found: Reception) -> KnownReturn | None:
        """The return that fits the masked elements best; None if it is certain in neither half sweep."""
        self.ffts += 3 * ITERATION_FFTS
        fit = ReturnFit(
            points, grid, equalise(grid.ramp * found.phase, found.channel), self._returns, self._s
        )
        elements, certain = fit.best()
        if not certain.any():
            return None
        uncertainty = np.where(certain, self._s.return_fit_error, 1).astype(np.float32)
        return KnownReturn(elements, uncertainty[fit.half][:, None], everywhere=False)
