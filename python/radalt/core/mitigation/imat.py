"""IMAT: samples of the dechirped sweep that stand out are dropped and refilled from a sparse spectrum."""

import numpy as np
from scipy import fft

from ..altimeter.altimeter_settings import AltimeterSettings
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle, peak_scale, unit_peak
from .if_band import IfBand

_DECAY = (
    0.35  # of the threshold per iteration, in nepers: ten iterations span 30 dB, what dechirping compresses
)
_NOISE = 9.5  # dB of the last threshold above the spectrum's median: one cell in 500 of white noise


class Imat(Mitigation):
    """Iterative method with adaptive thresholding on dechirped half sweeps.

    Card: *time-domain excision, refilled.* IF samples above ``threshold_db`` over the sweep's lower quartile are
    dropped; ``z <- received where kept, else IDFT(DFT(z) where above T_k)`` with ``T_k = T_0 exp(-0.35 k)`` fills the
    gap with what is sparse in frequency, the return.

    F. Marvasti et al., "Sparse signal processing using iterative method with adaptive thresholding (IMAT)", ICT 2012;
    for FMCW radar J. Bechter et al., "Automotive radar interference mitigation using a sparse sampling approach",
    EuRAD 2017. Interference that lasts for the whole sweep stands out nowhere.

    ``threshold_db``: above 0; over the level of noise alone; ``iterations``: 1..100; ``span_m``: highest altitude;
    None takes the altimeter's.
    """

    name = "imat"
    style = PlotStyle("#44CC66", "v", (0, (4, 2)))

    def __init__(
        self,
        waveform: Waveform,
        *,
        threshold_db: float = 9.0,
        iterations: int = 10,
        span_m: float | None = None,
    ) -> None:
        if not (np.isfinite(threshold_db) and threshold_db > 0):
            raise MitigationError(f"imat.threshold_db is {threshold_db!r}; it has to be above 0")
        if not 1 <= iterations <= 100:
            raise MitigationError(f"imat.iterations is {iterations!r}; a whole number within 1..100")
        self.threshold_db, self.iterations = threshold_db, iterations
        self._band = IfBand(waveform, span_m or AltimeterSettings().resolved(waveform).max_altitude_m)
        super().__init__(waveform)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        scaled = unit_peak(batch)
        band = self._band.take(scaled)
        power = band.real**2 + band.imag**2
        # an exponential population's mean over its lower quartile is 1 / ln(4/3)
        level = np.quantile(power, 0.25, axis=-1, keepdims=True) / np.log(4 / 3)
        kept = power <= level * 10.0 ** (self.threshold_db / 10)
        filled = np.where(kept, band, 0)
        spectrum = np.abs(fft.fft(filled, axis=-1))
        top = spectrum.max(axis=-1, keepdims=True)
        floor = np.median(spectrum, axis=-1, keepdims=True) * 10.0 ** (_NOISE / 20)
        for k in range(self.iterations):
            spectrum = fft.fft(filled, axis=-1)
            sparse = np.where(np.abs(spectrum) > np.maximum(top * np.exp(-_DECAY * k), floor), spectrum, 0)
            filled = np.where(kept, band, fft.ifft(sparse, axis=-1))
        return self._band.put(scaled, (filled - band).astype(np.complex64)) * peak_scale(batch)
