"""Blanking: excise what stands out in the time-frequency plane, except where the return can be."""

import numpy as np

from ..returns.point import point_return
from ..stft import Stft
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle, peak_scale, unit_peak

_SAMPLE = 17  # stride of the sample in cells: no divisor of a window, so that all frequencies are sampled


class Blanking(Mitigation):
    """Short-time Fourier transform, per-cell threshold, zeroing, resynthesis.

    A return exceeds the noise in the plane just as interference does. Its cells are known, since frames are aligned
    with the sweep: within this return mask a cell is compared with the mask's own level, elsewhere with the frame's
    quiet cells.

    - ``window``: STFT length in samples (Hann, three quarters overlap). 64 samples at 7.5 MS/s are about the square
      root of the sweep's time-bandwidth product, where the return is narrowest
    - ``threshold_db``: a cell is excised when it exceeds the robust level of its kind (in the return mask or not) by
      this much
    - ``max_altitude_m``: highest altitude whose return must not be excised; widens the return mask
    """

    name = "blanking"
    style = PlotStyle("#D55E00", "P", (0, (4, 1.2, 1, 1.2, 1, 1.2)))

    def __init__(
        self,
        waveform: Waveform,
        *,
        window: int = 64,
        threshold_db: float = 12.0,
        max_altitude_m: float = 1500.0,
    ) -> None:
        n = waveform.samples_per_frame
        if not (8 <= window <= n and window % 4 == 0):
            raise MitigationError(f"blanking.window is {window!r}; a multiple of 4 within 8..{n}")
        if not (np.isfinite(threshold_db) and threshold_db > 0):
            raise MitigationError(f"blanking.threshold_db is {threshold_db!r}; it has to be above 0")
        self.window, self.threshold_db, self.max_altitude_m = window, threshold_db, max_altitude_m
        self._stft = Stft(n, window)
        super().__init__(waveform)
        mask = self._return_mask()
        self._in_mask, self._elsewhere = np.flatnonzero(mask), np.flatnonzero(~mask)
        # the mask's cells by hop; at the ends a hop may have none
        count = mask.sum(axis=1)
        self._mask_hops = np.flatnonzero(count)
        self._mask_firsts = (np.cumsum(count) - count)[self._mask_hops]

    def _return_mask(self) -> np.ndarray:
        """(hops, window) bool: cells that a return between 0 and the highest altitude can occupy."""
        mask = np.zeros((self._stft.hops, self.window), dtype=bool)
        for altitude in np.linspace(0.0, self.max_altitude_m, 8):
            power = np.abs(self._stft.forward(point_return(self.waveform, altitude))) ** 2
            mask |= power > 1e-3 * np.median(power.max(axis=1))
        return mask

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        # frame by frame: the planes of several frames do not fit the cache
        out = np.empty_like(batch)
        for frame, cleaned in zip(unit_peak(batch), out, strict=True):
            cleaned[:] = self._blanked(frame)
        out *= peak_scale(batch)
        return out

    def _blanked(self, frame: np.ndarray) -> np.ndarray:
        """(N,) frame of unit peak without the cells that exceed their level."""
        plane = self._stft.forward(frame)
        power = plane.real**2
        power += plane.imag**2
        factor = np.float32(10.0 ** (self.threshold_db / 10.0))
        # outside the mask: the lower quartile is that of undisturbed cells up to an occupancy of three quarters; the
        # median of an exponential population is 2.41 times its lower quartile
        off = _lower_quartile(power.take(self._elsewhere)) * np.float32(2.41)
        # in the mask: the return is as strong as the strongest masked cell of an undisturbed hop
        masked = power.take(self._in_mask)
        strongest = np.zeros(self._stft.hops, dtype=np.float32)
        strongest[self._mask_hops] = np.maximum.reduceat(masked, self._mask_firsts)
        excised = power > off * factor
        excised.reshape(-1)[self._in_mask] &= masked > _lower_quartile(strongest) * factor
        np.copyto(plane, 0, where=excised)
        return self._stft.inverse(plane)


def _lower_quartile(cells: np.ndarray) -> np.float32:
    """Lower quartile of (m,) cells, which may be reordered."""
    rank = cells.size // 4
    sample = cells[::_SAMPLE].copy()
    middle = sample.size // 4
    aside = round(3.0 * np.sqrt(middle))  # three and a half standard deviations
    if middle > 2 * aside:
        sample.partition((middle - aside, middle + aside))
        low, high = sample[middle - aside], sample[middle + aside]
        within = cells.take(np.flatnonzero((cells >= low) & (cells <= high)))
        below = np.count_nonzero(cells < low)
        if below <= rank < below + within.size:
            cells, rank = within, rank - below
    cells.partition(rank)
    return cells[rank]
