"""Linear prediction: what a frame's past predicts of its next sample is removed as interference.

A tone or a narrow band is predictable from a few samples; noise is not, and neither is the sweep, whose frequency has
moved on. Two ways: an adaptive one-step predictor, and the best predictor of the whole frame as a filter of zero phase.
"""

import numpy as np
from scipy import fft, linalg

from ..fir import tukey_window
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle, peak_scale, unit_peak

_BLOCK = 8  # samples with the same weights: 20 and more are unstable on a tone at a step of 0.1
# tapered share of the frame: more would weight the return, which sweeps through the band in time
_TAPER = 0.1
_ROUNDING = 1e-12  # share of a frame's power added to lag 0: rounding leaves a tone's lags indefinite


class NlmsPredictor(Mitigation):
    """Prediction error of a one-step NLMS predictor, ``e_n = x_n - w^T (x_{n-1} ... x_{n-L})``.

    Card: *adaptive line enhancer's error output.* Every sample is predicted from the ``L`` before it; weights follow
    ``w += mu conj(x) e / |x|^2``. Good against tones; modulation as wide as the sweep leaves nothing to predict. The
    filter has minimum phase, not zero phase: where it takes a band out of the sweep it delays the rest. Under shaped
    QPSK at -30 dB the delay is 26 m, and the altimeter declares that altitude. So this method is for comparison, not
    for flight.

    B. Widrow et al., "Adaptive noise cancelling: principles and applications", Proc. IEEE 63(12), 1975, sec. VIII.
    Weights start at zero with every frame and are kept for 8 samples at a time.

    ``length``: weights ``L``, 1..256; ``step``: ``mu``, above 0 and at most 0.2.
    """

    name = "nlms_predictor"
    style = PlotStyle("#666666", "p", "--")
    batch = 64  # frames share the calls per block

    def __init__(self, waveform: Waveform, *, length: int = 32, step: float = 0.1) -> None:
        if not (isinstance(length, int) and 1 <= length <= 256):
            raise MitigationError(f"nlms_predictor.length is {length!r}; a whole number within 1..256")
        if not (np.isfinite(step) and 0 < step <= 0.2):
            raise MitigationError(f"nlms_predictor.step is {step!r}; it has to be within 0..0.2")
        self.length, self.step = length, float(step)
        super().__init__(waveform)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        scale = peak_scale(batch)
        n, samples = batch.shape
        padded = np.zeros((n, self.length + samples), dtype=np.complex64)
        np.divide(batch, scale, out=padded[:, self.length :])
        # row m holds the samples before sample m, oldest first
        past = np.lib.stride_tricks.sliding_window_view(padded, self.length, axis=1)[:, :samples]
        power = padded.real**2 + padded.imag**2
        energy = np.cumsum(power, axis=1, dtype=np.float64)
        energy = np.concatenate([np.zeros((n, 1)), energy], axis=1)
        window = (energy[:, self.length : -1] - energy[:, : -self.length - 1]).astype(np.float32)
        floor = 1e-6 * self.length * power.mean(axis=1, keepdims=True) + np.finfo(np.float32).tiny
        gain = self.step / np.maximum(window, floor)
        out = np.empty_like(batch)
        weights = np.zeros((n, self.length, 1), dtype=np.complex64)
        for first in range(0, samples, _BLOCK):
            span = slice(first, min(first + _BLOCK, samples))
            rows = past[:, span]
            error = padded[:, self.length + span.start : self.length + span.stop, None] - rows @ weights
            out[:, span] = error[..., 0]
            weights = weights + rows.conj().transpose(0, 2, 1) @ (error * gain[:, span, None])
        return out * scale


class LinearPrediction(Mitigation):
    """``X |A|`` with ``A`` the prediction-error filter of the frame: zero phase, one Toeplitz solve per frame.

    Card: *autoregressive whitening.* The spectrum of the interference is modelled by ``order`` poles, ``S = g /
    |A|^2``; what is left of it is white. Narrow lines take a pole each, which no smoothed periodogram resolves so
    well; interference as wide as the sweep is white to it.

    The matched filter in that noise would be ``|A|^2``. It leaves coloured noise, and most of the return in the quiet
    parts of the sweep. The altimeter then takes the return's lobes for noise: it declared 0.4 of the frames under 5
    MHz NR at -5 dB, where `none` measures all.

    Yule-Walker equations on the circular autocorrelation of the tapered frame (J. Makhoul, "Linear prediction: a
    tutorial review", Proc. IEEE 63(4), 1975). The return is in the model as well. It is white over the band, except
    at frequencies that the taper removes: with a Hann taper over the frame, extended ground without noise was read 17
    m short.

    ``order``: Poles, 1..256.
    """

    name = "linear_prediction"
    style = PlotStyle("#117733", "h", "-.")

    def __init__(self, waveform: Waveform, *, order: int = 32) -> None:
        if not (isinstance(order, int) and 1 <= order <= min(256, waveform.samples_per_frame // 4)):
            raise MitigationError(
                f"linear_prediction.order is {order!r}; a whole number within "
                f"1..{min(256, waveform.samples_per_frame // 4)}"
            )
        self.order = order
        self._taper = tukey_window(waveform.samples_per_frame, _TAPER).astype(np.float32)
        super().__init__(waveform)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        scaled = unit_peak(batch)
        tapered = fft.fft(scaled * self._taper, axis=1)
        power = tapered.real.astype(np.float64) ** 2 + tapered.imag.astype(np.float64) ** 2
        lags = fft.ifft(power, axis=1)[:, : self.order + 1]
        spectrum = fft.fft(scaled, axis=1)
        for row, lag in zip(spectrum, lags, strict=True):
            level = lag[0].real
            if not level > 0:  # a frame of nothing
                continue
            lag = lag / level
            lag[0] = 1.0 + _ROUNDING
            taps = np.zeros(row.size, dtype=np.complex64)
            taps[0] = 1.0
            taps[1 : self.order + 1] = -linalg.solve_toeplitz(lag[:-1], lag[1:])
            response = fft.fft(taps)
            row *= np.abs(response)
        out = fft.ifft(spectrum, axis=1, overwrite_x=True)
        # the frame's end is not its beginning: within the filter's reach of the seam interference comes through
        out[:, : self.order] = 0
        out[:, -self.order :] = 0
        return out
