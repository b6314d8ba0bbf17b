"""Detectors as altimeters have them: one altitude per block of sweeps, without a track.

`SummedDetector` adds the beat spectra of a block and takes the strongest line or the leading edge. `CounterDetector` is
a limiter and a frequency counter over the whole IF, as altimeters before digital signal processing have it.
"""

import numpy as np
from scipy import fft, ndimage

from ..spectral_line import noise_level, peak_curve, peak_offset, sum_level
from ..waveform import Waveform, delay_to_altitude_m
from .tracker_settings import Status

_PADDING = 2  # spectral cells per resolution cell
# power of the edge over the peak's: the -6 dB point of the rise, as in `AltimeterSettings.strategy`
_EDGE = 0.25


class SummedDetector:
    """Altitude by the sum of a block's power spectra over sweeps and both halves.

    Noise alone exceeds the threshold over its level in the band with probability ``pfa`` per output. Beats of a
    triangle's halves are added for every Doppler that the allowed speeds permit, and the greatest sum decides.

    - ``waveform``: Deramped (`core.deramp.IfWaveform`): frames are the IF's
    - ``sweeps``: frames per output
    - ``strategy``: ``"strongest"``, or ``"leading_edge"``: the -6 dB point of the rise of the nearest return that
      stands out, in the sum of the block and smoothed over a resolution cell; corrected so that a point is unbiased
    - ``least_power``: power of the strongest line, in the unit of the frames, below which there is no computed data
    """

    def __init__(
        self,
        waveform: Waveform,
        sweeps: int,
        *,
        max_altitude_m: float,
        max_vertical_speed_m_per_s: float = 20.0,
        pfa: float = 1e-4,
        strategy: str = "strongest",
        least_power: float = 0.0,
    ) -> None:
        self.waveform, self.sweeps, self.strategy = waveform, sweeps, strategy
        self._least = 2 * sweeps * least_power * waveform.samples_per_half**2
        self._size = fft.next_fast_len(_PADDING * waveform.samples_per_half)
        self.cell_hz = waveform.rate_hz / self._size
        doppler = waveform.vertical_speed_to_doppler_hz(max_vertical_speed_m_per_s) / self.cell_hz
        self._reach = int(np.ceil(doppler)) if waveform.separates_doppler else 0
        # Doppler moves a beat below that of 0 m, and a peak needs both neighbours
        self._first = -int(np.ceil(doppler)) - _PADDING
        top = int(np.ceil(waveform.altitude_to_beat_hz(max_altitude_m) / self.cell_hz + doppler)) + _PADDING
        self.cells = np.arange(self._first - self._reach, top + self._reach)
        inside = top - self._first
        if 2 * self.cells[-1] >= self._size:
            raise ValueError(
                f"max_altitude_m {max_altitude_m:g} has its beat at {top * self.cell_hz:g} Hz, beyond the IF's "
                f"{0.5 * waveform.rate_hz:g} Hz; raise the IF's rate or lower the altitude"
            )
        self._peak_curve = peak_curve(np.ones(waveform.samples_per_half), 1.0 / self._size)
        trials = inside * (2 * self._reach + 1)
        self.threshold = sum_level(pfa / trials, 2 * sweeps)
        self._bias = 0.0
        if strategy == "leading_edge":
            self._bias = self._edge_bias()

    def spectra(self, frames: np.ndarray) -> np.ndarray:
        """(n, 2, cells) float32 power of IF frames (n, N), both halves with positive beats."""
        w = self.waveform
        halves = np.array(frames, dtype=np.complex64).reshape(-1, 2, w.samples_per_half)
        for half, slope in enumerate(w.half_slopes):
            if slope > 0:
                np.conjugate(halves[:, half], out=halves[:, half])
        spectrum = np.take(
            fft.fft(halves, self._size, axis=-1, overwrite_x=True), self.cells, axis=-1, mode="wrap"
        )
        return spectrum.real**2 + spectrum.imag**2

    def sums(self, frames: np.ndarray) -> np.ndarray:
        """(blocks, 2, cells) sums over whole blocks of frames."""
        power = self.spectra(frames)
        return power.reshape(-1, self.sweeps, *power.shape[1:]).sum(axis=1)

    def __call__(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Status and altitude in metres, (blocks,) each, of ``blocks * sweeps`` frames; the status is `Status`'s."""
        return self.decide(self.sums(frames))

    def decide(self, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As for a call, from the blocks' sums."""
        count, best = sums.shape[-1] - 2 * self._reach, None
        for step in range(-self._reach, self._reach + 1):
            up, down = self._reach + step, self._reach - step
            total = sums[:, 0, up : up + count] + sums[:, 1, down : down + count]
            if best is None:
                best = total.copy()
            else:
                better = total.max(axis=1) > best.max(axis=1)
                best[better] = total[better]
        level = noise_level(best, 2 * self.sweeps)
        found = best.max(axis=1) > np.maximum(self.threshold * level, self._least)
        at = self._edge(best, level) if self.strategy == "leading_edge" else self._peak(best)
        beat = (self._first + at) * self.cell_hz
        altitude = delay_to_altitude_m(beat / self.waveform.slope_hz_per_s) - self._bias
        return np.where(found, Status.NORMAL, Status.NO_COMPUTED_DATA), altitude

    def _peak(self, total: np.ndarray) -> np.ndarray:
        """(blocks,) fractional cell of the greatest power, exact for one line."""
        row, k = np.arange(len(total)), np.clip(total.argmax(axis=1), 1, total.shape[1] - 2)
        around = np.stack([total[row, k + step] for step in (-1, 0, 1)], axis=-1)
        return k + peak_offset(around, self._peak_curve)

    def _edge(self, total: np.ndarray, level: np.ndarray) -> np.ndarray:
        """(blocks,) fractional cell where power first rises over a quarter of the peak, and out of the noise."""
        smooth = ndimage.uniform_filter1d(total, _PADDING, axis=1)
        top = smooth.max(axis=1)
        least = np.minimum(np.maximum(_EDGE * top, self.threshold * level), top)[:, None]
        row, k = np.arange(len(total)), np.maximum((smooth >= least).argmax(axis=1), 1)
        low, high = np.sqrt(smooth[row, k - 1]), np.sqrt(smooth[row, k])
        rise = np.maximum(high - low, np.finfo(np.float32).tiny)
        return k - 1 + np.clip((np.sqrt(least[:, 0]) - low) / rise, 0.0, 1.0)

    def _edge_bias(self) -> float:
        """Metres by which the leading edge of a point lies off it, without noise, mean over a resolution cell."""
        w = self.waveform
        t = np.mod(w.sample_times_s, w.half_sweep_s)
        signs = np.repeat([-s for s in w.half_slopes], w.samples_per_half)
        middle = 0.5 * (self.cells[0] + self.cells[-1])
        beats = (np.floor(middle) + np.linspace(0, _PADDING, 8, endpoint=False)) * self.cell_hz
        points = np.exp(2j * np.pi * signs * beats[:, None] * t)
        _, altitude = self.decide(self.spectra(points))
        return float(np.mean(altitude - delay_to_altitude_m(beats / w.slope_hz_per_s)))


class CounterDetector:
    """A limiter and a counter: the mean frequency of the whole IF over a block, NORMAL whenever there is power.

    The phase advance of the limited IF over the sweep, which is what zero crossings count, without the counter's own
    step of half a cycle per sweep. Whatever is strongest at an instant captures it.

    ``waveform``: Deramped; ``sweeps``: frames per output; ``max_altitude_m``: the first samples of each half, in
    which its return is still on the ramp before, are not counted; ``least_power``: mean power of the IF below which
    there is no computed data.
    """

    def __init__(
        self, waveform: Waveform, sweeps: int, *, max_altitude_m: float, least_power: float = 0.0
    ) -> None:
        self.waveform, self.sweeps, self._least = waveform, sweeps, least_power
        blind_s = waveform.altitude_to_beat_hz(max_altitude_m) / waveform.slope_hz_per_s
        self._blind = int(np.ceil(blind_s * waveform.rate_hz)) + 2

    def __call__(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As for `SummedDetector`."""
        w = self.waveform
        halves = np.asarray(frames).reshape(-1, 2, w.samples_per_half)[..., self._blind :]
        turn = np.angle(halves[..., 1:] * np.conj(halves[..., :-1])).mean(axis=2) / (2 * np.pi)
        beat = (turn @ [-s for s in w.half_slopes]) / 2 * w.rate_hz
        altitude = delay_to_altitude_m(beat.reshape(-1, self.sweeps).mean(axis=1) / w.slope_hz_per_s)
        power = np.mean(halves.real**2 + halves.imag**2, axis=(1, 2)).reshape(-1, self.sweeps).mean(axis=1)
        return np.where(power > self._least, Status.NORMAL, Status.NO_COMPUTED_DATA), altitude
