"""Ground beyond the span of altitudes: nothing within the span is the ground then, and no method may make it so.

A method that depends on the span (a network, a short filter) aliases a return from beyond it into the span: the
filterbank of the shipped network has one column per 30 samples, so 2,600 m appear as 103 m. The received frame shows
where the ground is: dechirped, a return is one line in each half sweep, at any height up to Nyquist. Where the
strongest pair of lines lies beyond the span, the frame passes every method unchanged, and the altimeter declares none.
"""

import numpy as np
from scipy import fft

from ..spectral_line import pair_sums, partner, significance, sum_level
from ..waveform import Waveform
from .altimeter_settings import FASTEST_M_PER_S

# Resolution cells beyond the highest altitude from which the altimeter itself declares no return.
_MARGIN_CELLS = 2
# Probability per frame of noise that its strongest pair is taken for a return: far below the altimeter's false alarms.
_PFA = 1e-5
# Training cells on either side of a line, and guard cells next to it.
_TRAIN, _GUARD = 64, 2
# Least power of a pair of lines beyond the span over that within it (-10 dB): weaker ones are no rival of anything.
# Each half sweep has to show half of that.
WEAKEST = 0.1


class BeyondSpan:
    """Which frames show a return beyond the span, stronger than everything within it.

    Costs two FFTs of a half sweep per frame.

    ``max_altitude_m``: highest altitude that the altimeter searches.

    Examples
    --------
    >>> from radalt.core.returns.point import point_return
    >>> w = Waveform()
    >>> BeyondSpan(w, 1500.0)(point_return(w, np.array([300.0, 2600.0]))).tolist()
    [False, True]
    """

    def __init__(self, waveform: Waveform, max_altitude_m: float) -> None:
        self._half = half = waveform.samples_per_half
        cell_hz = 1.0 / waveform.half_sweep_s
        # up and down cell of one return differ by twice its Doppler
        doppler_hz = float(waveform.vertical_speed_to_doppler_hz(FASTEST_M_PER_S))
        self._reach = reach = min(int(np.ceil(2.0 * doppler_hz / cell_hz)), half // 8)
        self._below = reach + _MARGIN_CELLS  # cells of negative beats: a return at 0 m and its Doppler
        top = float(waveform.altitude_to_beat_hz(max_altitude_m)) / cell_hz
        self._first = self._below + top + _MARGIN_CELLS  # least mean of a pair's cells
        # share of the half sweep, per cell of a beat, that its delay leaves on the other slope
        self._delay_share = cell_hz / (waveform.slope_hz_per_s * waveform.half_sweep_s)
        # cells up to Nyquist, or to the delay that leaves half of each half sweep, and a Doppler
        last = min(half // 2, round(0.5 / self._delay_share))
        self._count = min(self._below + last + reach + 1, half)
        # both halves mixed so that a return has a positive beat, the lowest cell first
        turn = np.exp(2j * np.pi * self._below * np.arange(half) / half)
        self._rising = [slope > 0 for slope in waveform.half_slopes]
        reference = waveform.reference.astype(np.complex128).reshape(2, half)
        rows = [row if up else row.conj() for row, up in zip(reference, self._rising, strict=True)]
        self._table = (np.stack(rows) * turn).astype(np.complex64)
        trials = self._count * (2 * reach + 1.0)
        self._threshold = sum_level(_PFA / trials, 2)

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """(n,) bool of (n, N) complex64 frames; False where a frame is not finite."""
        return self.ratio(frames) >= 1.0

    def ratio(self, frames: np.ndarray) -> np.ndarray:
        """(n,) power of the strongest pair of lines beyond the span over that within; 0 below -10 dB.

        NaN where neither stands out: of a frame of noise, or under interference.
        """
        out, halves = np.zeros(len(frames)), frames.reshape(-1, 2, self._half)
        if self._first >= self._count - self._reach:  # the span reaches up to Nyquist
            return out
        # an up cell from here on has its return beyond the span, whatever its Doppler; two cells lower within it
        reach, first = self._reach, int(self._first) + 1
        shown = np.arange(len(halves))
        powers = []
        for half, rising in enumerate(self._rising):
            beats = halves[shown, half]
            if rising:
                np.conjugate(beats, out=beats)
            with np.errstate(invalid="ignore", over="ignore"):
                beats *= self._table[half]
                spectrum = fft.fft(beats, overwrite_x=True)[:, : self._count]
                cells = spectrum.real**2
                cells += spectrum.imag**2
                power = cells[:, :-1] + cells[:, 1:]  # a line between two cells loses less
            strong = power[:, first:].max(axis=1) >= 0.5 * WEAKEST * power[:, : first - 2].max(axis=1)
            shown, powers = shown[strong], [rows[strong] for rows in (*powers, power)]
        for k, pair, power in zip(shown, pair_sums(*powers, reach), zip(*powers, strict=True), strict=True):
            up = first + int(pair[first:].argmax())
            down = partner(power[1], up, reach, first)
            line = float(power[0][up] + power[1][down]) / (1.0 - self._delay_share * (up - self._below)) ** 2
            ratio = line / max(float(pair[: first - 2].max()), 1e-30)
            if ratio >= WEAKEST:
                each = [self._significance(row, cell) for row, cell in zip(power, (up, down), strict=True)]
                out[k] = ratio if sum(each) > self._threshold else np.nan
        return out

    def _significance(self, power: np.ndarray, cell: int) -> np.ndarray:
        """(1,) `significance` of a cell over the noise around it."""
        before = power[max(cell - _GUARD - _TRAIN, 0) : max(cell - _GUARD, 0)]
        around = np.r_[before, power[cell + _GUARD + 1 :][:_TRAIN]]
        level = np.maximum(around.mean(dtype=float, keepdims=True), np.finfo(np.float32).tiny)
        return significance(power[cell : cell + 1], level, around.size)
