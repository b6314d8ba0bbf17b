"""Spectral whitening: divide the frame's spectrum by a smoothed estimate of itself."""

import numpy as np
from scipy import fft, ndimage

from ..altimeter.frame_quality import levels
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle, unit_peak

_SEAM_S = 5e-6  # decay time of the filter's response, s; a return loses 0.05 dB


class Whitening(Mitigation):
    """``X / S^exponent`` with ``S`` the running mean of ``|X|^2`` over ``smoothing_hz``.

    The sweep itself fills the band evenly, so it passes; what is narrower than the sweep and stronger is levelled.
    Interference that is white over the band (10 MHz NR) is out of reach by construction.

    - ``smoothing_hz``: width of the running mean. Narrower resolves tones better, wider disturbs the return's own
      spectrum less.
    - ``exponent``: 0.5 whitens; 1 is the matched filter in coloured noise of spectrum ``S``. That filter narrows the
      sweep to its least disturbed part: more sensitive where little is disturbed, ambiguous where much is (5 MHz NR
      at -35 dB: 0.60 of the altitudes right, against 0.90 with 0.6).
    """

    name = "whitening"
    style = PlotStyle("#009E73", "s", (0, (7, 1.5, 1, 1.5)))
    batch = 16  # 0.88 of the time of four at once, and eight take 0.91

    def __init__(self, waveform: Waveform, *, smoothing_hz: float = 25e3, exponent: float = 0.6) -> None:
        if not 100 <= smoothing_hz <= waveform.rate_hz:
            raise MitigationError(
                f"whitening.smoothing_hz is {smoothing_hz!r}; within 100..{waveform.rate_hz:g}"
            )
        if not 0 < exponent <= 1:
            raise MitigationError(f"whitening.exponent is {exponent!r}; it has to be within 0..1")
        self.smoothing_hz, self.exponent = smoothing_hz, exponent
        self._cells = max(1, round(smoothing_hz * waveform.samples_per_frame / waveform.rate_hz))
        self._seam = min(round(_SEAM_S * waveform.rate_hz), waveform.samples_per_frame // 50) or 1
        # an array: with a number `maximum` is not vectorised and takes twice the time
        self._floor = np.full(waveform.samples_per_frame, 1e-6, dtype=np.float32)
        super().__init__(waveform)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = np.empty_like(batch)
        self._clean_into(batch, out, levels(batch))
        return out

    def _clean_into(self, frames: np.ndarray, out: np.ndarray, quality: np.ndarray) -> None:
        spectrum = fft.fft(unit_peak(frames, out, quality["peak"][:, None]), axis=1, overwrite_x=True)
        np.multiply(spectrum, self._gains(spectrum), out=out)
        cleaned = fft.ifft(out, axis=1, overwrite_x=True)
        if not np.may_share_memory(cleaned, out):  # SciPy promises no transform in place
            out[:] = cleaned
        # the frame's end is not its beginning: at the seam interference comes through, 40 dB above the rest
        out[:, : self._seam] = 0
        out[:, -self._seam :] = 0

    def _gains(self, spectrum: np.ndarray) -> np.ndarray:
        """(n, N) float32 factors of spectra (n, N), made in two arrays."""
        power = np.square(spectrum.real)
        smooth = np.square(spectrum.imag)
        power += smooth
        ndimage.uniform_filter1d(power, self._cells, axis=1, mode="wrap", output=smooth)
        total = np.add.reduce(smooth, axis=1, keepdims=True)  # half the time of `mean`
        cells = np.float32(smooth.shape[1])
        smooth *= cells / np.where(total > 0, total, cells)
        # floor 60 dB below the mean: weaker cells are not raised to it
        np.maximum(smooth, self._floor, out=smooth)
        # exp and log of float32 are vectorised, a power is not and costs as much as a transform
        np.log(smooth, out=smooth)
        smooth *= np.float32(-self.exponent)
        return np.exp(smooth, out=smooth)
