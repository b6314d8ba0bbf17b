"""A second receive channel behind the mixer, its antenna away from the ground: what both receive is taken out.

An emitter reaches the second antenna a delay earlier or later. Behind the mixers that delay is a phase that turns along
the sweep by bandwidth times delay, so weights are fitted per piece of the sweep. The return leaks into the second
antenna; it is left out of the fit by a notch at its beat.
"""

import numpy as np
from scipy import fft, ndimage

from ...core.deramp.front_end import Amplifier
from ...core.deramp.if_waveform import IfWaveform
from ...core.tracker.summed_detector import SummedDetector

DELAY_S = 3e-9  # path difference of 0.9 m between the antennas (assumed)
GAIN_DB, RETURN_DB = (
    6.0,
    -20.0,
)  # the second antenna's gain over the first's, for the emitter and the return (assumed)
_UNLIKE_DB = 0.5  # difference of the two amplifiers' compression points (assumed)
_PIECE_S = 55e-6  # a carrier of 1 MHz stays in the IF for that long at 43 GHz/s
_NOTCH = 65  # samples of the running mean that takes the return out of the fit: 24 kHz at 1.536 MHz
_MOST = 3.0  # weight above which a piece is left: what the first antenna receives 10 dB better is the ground


def delayed(frames: np.ndarray, waveform: IfWaveform, delay_s: float) -> np.ndarray:
    """(n, N) frames as a channel has them that the emitter reaches a delay later: y(t - d) LO(t - d) conj LO(t)."""
    w, t = waveform, waveform.sample_times_s
    turned = np.exp(-2j * np.pi * fft.fftfreq(w.samples_per_frame, 1 / w.rate_hz) * delay_s)
    cycles = w.phase_cycles(t - delay_s) - w.phase_cycles(t) - w.carrier_hz * delay_s
    return (fft.ifft(fft.fft(frames, axis=1) * turned, axis=1) * np.exp(2j * np.pi * cycles)).astype(
        np.complex64
    )


def unlike_share(amplifier: Amplifier, power_dbm: float) -> float:
    """Share of the first amplifier's output of Gaussian noise that is no multiple of the second's: both compress."""
    share, weight = np.polynomial.laguerre.laggauss(64)
    drives_dbm = (power_dbm, power_dbm + GAIN_DB - _UNLIKE_DB)
    first, second = (amplifier.envelope(np.sqrt(10 ** (x / 10) * share)) for x in drives_dbm)
    return float(1 - (weight @ (first * second)) ** 2 / ((weight @ first**2) * (weight @ second**2)))


class Canceller:
    """Takes out of the first channel what the second has in common with it.

    ``sweeps``: frames over which the return's beat is found.
    """

    def __init__(self, waveform: IfWaveform, sweeps: int, max_altitude_m: float) -> None:
        self.waveform = waveform
        self._spectrum = SummedDetector(waveform, sweeps, max_altitude_m=max_altitude_m)
        self._pieces = -(-waveform.samples_per_frame // round(_PIECE_S * waveform.rate_hz))

    def __call__(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """(n, N) complex64 first channel without what it has in common with the second, n whole blocks of sweeps."""
        total = self._total(first)
        if total.max() < self._spectrum.threshold:  # the return does not stand out yet
            total = self._total(self._cancelled(first, second, first, second))
        beat_hz = (self._spectrum.cells[0] + total.argmax()) * self._spectrum.cell_hz
        return self._cancelled(first, second, *(self._notched(x, beat_hz) for x in (first, second)))

    def _total(self, frames: np.ndarray) -> np.ndarray:
        """(cells,) mean power over its median."""
        total = self._spectrum.spectra(frames).mean(axis=(0, 1))
        return total / np.median(total)

    def _notched(self, frames: np.ndarray, beat_hz: float) -> np.ndarray:
        """Frames without a line; both channels are turned alike, so weights stay."""
        w = self.waveform
        signs = -np.repeat(np.sign(w.half_slopes), w.samples_per_half)
        turned = frames * np.exp(-2j * np.pi * signs * beat_hz * w.sample_times_s).astype(np.complex64)
        halves = turned.reshape(len(frames), 2, -1)
        mean = [
            ndimage.uniform_filter1d(part, _NOTCH, axis=-1, mode="nearest")
            for part in (halves.real, halves.imag)
        ]
        return (halves - mean[0] - 1j * mean[1]).reshape(frames.shape).astype(np.complex64)

    def _cancelled(self, first: np.ndarray, second: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """``first`` less weights times ``second``, a line per piece of the sweep, fitted to ``a`` and ``b``."""
        out = np.empty_like(first)
        for part in np.array_split(np.arange(first.shape[1]), self._pieces):
            ramp = np.linspace(-1, 1, part.size, dtype=np.float32)
            rows = np.stack([b[:, part], b[:, part] * ramp], axis=1)  # (n, 2, samples)
            power = rows @ rows.conj().swapaxes(1, 2)
            floor = 1e-6 * np.trace(power, axis1=1, axis2=2).real + 1e-30
            power = power.astype(complex) + floor[:, None, None] * np.eye(2)
            weights = (
                np.linalg.solve(power, rows @ a[:, part, None].conj())[..., 0].conj().astype(np.complex64)
            )
            weights[np.abs(weights[:, 0]) > _MOST] = 0
            out[:, part] = first[:, part] - (weights[:, :1] + weights[:, 1:] * ramp) * second[:, part]
        return out
