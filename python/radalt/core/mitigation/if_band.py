"""An altimeter's IF band cut out of frames before the mixer, for methods that were made for dechirped samples."""

import numpy as np
from scipy import fft

from ..waveform import Waveform

_WIDTH = 4.0  # band over the highest beat: room for skirts and for the reach of an interferer into the span


class IfBand:
    """Dechirped half sweeps within a band about zero; positive beats are altitudes in both halves.

    ``max_altitude_m``: highest altitude, > 0; the band is four times its beat, at most the sample rate. ``samples``:
    samples M of a half sweep in the band.
    """

    def __init__(self, waveform: Waveform, max_altitude_m: float) -> None:
        self._half = waveform.samples_per_half
        width_hz = _WIDTH * float(waveform.altitude_to_beat_hz(max_altitude_m))
        self.samples = min(self._half, 2 * round(0.5 * width_hz * waveform.half_sweep_s))
        self._conjugated = [slope > 0 for slope in waveform.half_slopes]
        self._reference = waveform.reference.reshape(2, self._half)
        positive = np.arange((self.samples + 1) // 2)
        negative = np.arange(-(self.samples // 2), 0)
        self._bins = np.concatenate([positive, negative]) % self._half

    def take(self, frames: np.ndarray) -> np.ndarray:
        """(n, 2, M) complex64 samples of (n, N) frames, their power per hertz unchanged."""
        mixed = frames.reshape(-1, 2, self._half) * self._reference.conj()
        for half, conjugate in enumerate(self._conjugated):
            if conjugate:
                np.conj(mixed[:, half], out=mixed[:, half])
        return fft.ifft(fft.fft(mixed, axis=-1)[..., self._bins], axis=-1)

    def put(self, frames: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(n, N) frames with (n, 2, M) added within the band; beyond it they stay as they are."""
        spectrum = np.zeros((len(frames), 2, self._half), dtype=np.complex64)
        spectrum[..., self._bins] = fft.fft(change, axis=-1)
        mixed = fft.ifft(spectrum, axis=-1, overwrite_x=True)
        for half, conjugate in enumerate(self._conjugated):
            if conjugate:
                np.conj(mixed[:, half], out=mixed[:, half])
        mixed *= self._reference
        return frames + mixed.reshape(frames.shape)
