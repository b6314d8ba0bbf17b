"""Is there interference in this frame? A frame that shows none can skip the network.

Dechirped, a return is one tone in each half sweep; noise and every interferer that does not sweep along are spread over
all cells. The statistic is the power outside the tone over the power in it,
``r = (E_total - E_tone) / E_tone`` over both half sweeps. ``E_tone`` is the power of each one's peak cell and 24 cells
on either side. Without interference ``r = 1 / SNR``; interference at window SIR ``s`` adds ``1 / s``. A dechirped frame
has some 36 dB of compression, so interference below the threshold cannot affect the altitude. A frame above the
threshold goes to the network.

The residual may be white noise alone, which no method can remove. Its powers in short pieces of time and frequency are
exponentially distributed, and the mean of their squares is twice the square of their mean.
Interference leaves some of these cells empty, and the ratio is higher.
"""

import numpy as np
from scipy import fft

from ..waveform import Waveform
from .base import unit_peak

_THRESHOLD_DB = -8.0  # residual over return, dB, from which a frame counts as interfered (see the class)
_REACH = 24  # cells on either side of the peak: 99 % of a tone that straddles two cells
# Noise gives 1.92 to 2.06 (up to 2.2 in frames of 400 samples), NR wider than the sweep 2.0 to 3, everything else 2.7
# or more, QPSK of 2 MHz in a sweep of 3 MHz among it.
_WHITE = 2.3


class InterferenceDetector:
    """Residual-to-return detector.

    A frame counts as interfered from a residual of -8 dB over the return on, so every frame with an SNR below 8 dB
    does. At an SNR of 10 dB, less than one in 10^3 frames with interference at a window SIR of 10 dB or below is
    missed, and less than one clean frame in 10^3 counts as interfered: measured for QPSK, tones, NR and radar pulses
    down to an overlap of 0.05 (``tests/test_detector.py``).

    An interferer that sweeps along with the radar is a ghost target, a tone itself, and not found here. A ground
    return that spreads over many cells counts as interference: the network then runs, which is the safe side.

    Examples
    --------
    >>> w = Waveform()
    >>> detector = InterferenceDetector(w)
    >>> bool(detector.present(w.reference[None])[0])
    False
    """

    def __init__(self, waveform: Waveform) -> None:
        self.waveform = waveform
        self._half = waveform.samples_per_half
        self._table = np.conj(waveform.reference).astype(np.complex64).reshape(1, 2, self._half)

    def residual_db(self, frames: np.ndarray, every: int = 1) -> np.ndarray:
        """(n,) residual over return in dB of (n, N) complex64 frames; +inf for zeros, NaN where not finite.

        One sample in ``every`` few is nearly as good: beats beyond their Nyquist frequency alias, they are not lost.
        """
        frames = np.asarray(frames, dtype=np.complex64)
        n = self.waveform.samples_per_frame
        if frames.ndim != 2 or frames.shape[1] != n:
            raise ValueError(f"frames have shape {frames.shape}; expected (n, {n})")
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            _, power, cells = self._spectra(frames, every)
            tone = np.take_along_axis(power, cells, axis=-1).sum(axis=-1, dtype=np.float64)
            rest = power.sum(axis=-1, dtype=np.float64) - tone
            tone, rest = tone.sum(axis=-1), rest.sum(axis=-1)
            # a frame of zeros is infinite, and infinite or undefined samples stay undefined
            ratio = np.where(
                tone > 0, np.maximum(rest, 1e-12 * tone) / tone, np.where(tone == 0, np.inf, np.nan)
            )
            return 10.0 * np.log10(ratio)

    def _spectra(self, frames: np.ndarray, every: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 2, N/2) dechirped spectra, their powers, and (n, 2, k) the cells of each half's tone."""
        beats = frames.reshape(-1, 2, self._half)[..., ::every] * self._table[..., ::every]
        spectrum = fft.fft(beats, self._half if every == 1 else fft.next_fast_len(beats.shape[-1]), axis=-1)
        power = spectrum.real**2 + spectrum.imag**2
        peak = np.argmax(power, axis=-1)
        return spectrum, power, (peak[..., None] + np.arange(-_REACH, _REACH + 1)) % power.shape[-1]

    def white(self, frames: np.ndarray) -> np.ndarray:
        """(n,) bool: whether (n, N) complex64 finite frames hold a point return and white noise only.

        A return that is strong, or spreads over many cells, may count as interference.
        """
        frames = np.asarray(frames, dtype=np.complex64)
        length = fft.next_fast_len(max(8, round(self._half**0.5)))  # a prime takes four times as long
        blocks = self._half // length
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            spectrum, _, cells = self._spectra(unit_peak(frames))
            np.put_along_axis(spectrum, cells, 0, axis=-1)
            rest = fft.ifft(spectrum, axis=-1)[..., : blocks * length]
            short = fft.fft(rest.reshape(len(rest), -1, length), axis=-1)
            cells = (short.real**2 + short.imag**2).reshape(len(rest), -1)
            ratio = (cells**2).mean(axis=1) / cells.mean(axis=1) ** 2
            return ratio * (1.0 - (2 * _REACH + 1) / self._half) < _WHITE  # the tone's cells are empty

    def present(self, frames: np.ndarray) -> np.ndarray:
        """(n,) bool: whether frames show interference, or might (low SNR, no signal, values that are not finite)."""
        return ~(self.residual_db(frames) < _THRESHOLD_DB)
