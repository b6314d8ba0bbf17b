"""STFT-CFAR: cells of the dechirped sweep's plane that stand out over time are zeroed or extrapolated."""

import numpy as np
from scipy import ndimage

from ..altimeter.altimeter_settings import AltimeterSettings
from ..stft import Stft
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle, peak_scale, unit_peak
from .if_band import IfBand

_WINDOW = (
    32  # samples of the band: 53 us by default, in which a crossing interferer's frequency is nearly constant
)
_RANK = (
    0.25  # quantile of a bin that is taken for its level: an interferer may fill three quarters of the sweep
)
_NEIGHBOURS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)[None, None]
_ORDER = 2  # Burg's model of a bin over time: ground and one interferer's skirt


class StftCfar(Mitigation):
    """Dechirp, STFT, ordered-statistic CFAR along each frequency bin, excision of what it declares, resynthesis.

    Card: *CFAR-based mitigation of automotive radar.* After dechirping a return is a constant tone, so its bin is
    even over time; what crosses the beat band is short in every bin. Declared cells, dilated by one, are set to zero
    or extrapolated by an autoregressive model of the bin (Burg), from both sides of the gap.

    J. Wang, "CFAR-based interference mitigation for FMCW automotive radar systems", IEEE Trans. Intelligent
    Transportation Systems 23(8), 2022, doi 10.1109/TITS.2021.3111514. The extrapolation is that of S. Neemat et al.,
    IEEE Trans. Microwave Theory and Techniques 67(3), 2019. A bin's level is its lower quartile (Rohling 1983): a
    cell-averaging window is filled by a burst of a tenth of the sweep, which then raises its own threshold.

    ``fill``: ``"zero"`` or ``"burg"``; ``pfa``: False alarms per cell of white noise, within 1e-9..0.1; ``span_m``:
    highest altitude; None takes the altimeter's.
    """

    name = "stft_cfar"
    style = PlotStyle("#220088", "^", (0, (2, 1)))

    def __init__(
        self, waveform: Waveform, *, fill: str = "zero", pfa: float = 1e-4, span_m: float | None = None
    ) -> None:
        if fill not in ("zero", "burg"):
            raise MitigationError(f"stft_cfar.fill is {fill!r}; allowed: zero, burg")
        if not 1e-9 <= pfa <= 0.1:
            raise MitigationError(f"stft_cfar.pfa is {pfa!r}; it has to be within 1e-9..0.1")
        self.fill, self.pfa = fill, pfa
        self._band = IfBand(waveform, span_m or AltimeterSettings().resolved(waveform).max_altitude_m)
        self._stft = Stft(self._band.samples, min(_WINDOW, self._band.samples // 4 * 4))
        self._factor = np.log(pfa) / np.log1p(-_RANK)  # exponential cells: threshold over quantile
        super().__init__(waveform)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        scaled = unit_peak(batch)
        band = self._band.take(scaled)
        plane = self._stft.forward(band)
        power = plane.real**2 + plane.imag**2
        declared = power > self._factor * np.quantile(power, _RANK, axis=-2, keepdims=True)
        declared = ndimage.binary_dilation(declared, _NEIGHBOURS)
        if self.fill == "burg":
            bins = np.moveaxis(plane, -2, 0)
            filled = extrapolated(
                bins.reshape(len(bins), -1), ~np.moveaxis(declared, -2, 0).reshape(len(bins), -1)
            )
            plane = np.ascontiguousarray(np.moveaxis(filled.reshape(bins.shape), 0, -2))
        else:
            plane[declared] = 0
        return self._band.put(scaled, self._stft.inverse(plane) - band) * peak_scale(batch)


def extrapolated(plane: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(hops, bins) plane whose cells that are not ``kept`` continue Burg's model of their bin, from both sides."""
    clean = np.where(kept, plane, 0)
    taps = _burg(clean, kept)
    ahead, back = clean.copy(), clean.copy()
    count = len(plane)
    for hop in range(_ORDER, count):
        for series, at, model, step in ((ahead, hop, taps, -1), (back, count - 1 - hop, taps.conj(), 1)):
            gap = ~kept[at]
            series[at, gap] = -sum(model[k, gap] * series[at + step * (k + 1), gap] for k in range(_ORDER))
    hops = np.arange(count)[:, None]
    since = hops - np.maximum.accumulate(np.where(kept, hops, -1), axis=0)
    until = np.minimum.accumulate(np.where(kept, hops, count)[::-1], axis=0)[::-1] - hops
    share = np.where(kept, 0.5, since / np.maximum(since + until, 1))
    return ((1 - share) * ahead + share * back).astype(np.complex64)


def _burg(series: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(order, bins) prediction-error taps of (hops, bins) series by Burg's recursion over kept cells."""
    forward = backward = series
    whole = kept
    taps = np.zeros((0, series.shape[1]), dtype=series.dtype)
    for _ in range(_ORDER):
        f, b, whole = forward[1:], backward[:-1], whole[1:] & kept[: len(whole) - 1]
        power = np.sum((np.abs(f) ** 2 + np.abs(b) ** 2) * whole, axis=0)
        reflection = -2 * np.sum(f * b.conj() * whole, axis=0) / np.where(power > 0, power, 1)
        taps = np.concatenate([taps + reflection * taps[::-1].conj(), reflection[None]])
        forward, backward = f + reflection * b, b + reflection.conj() * f
    return taps
