"""Radar return: is it visible, where is its tone, and is what is left consistent with one return and white noise?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from ...waveform import C_M_PER_S, Waveform
from .arrays import exp_ramp, median, power
from .settings import OfdmSettings

__all__ = ["ReturnEstimate", "ReturnEstimator"]


@dataclass(frozen=True)
class ReturnEstimate:
    """A return as one tone per half sweep.

    Attributes
    ----------
    samples : (N,) complex64
    ratio : float
        The weaker half's peak over the mean power in the altitude band; noise alone has some ``ln(cells)``.
    """

    samples: np.ndarray
    ratio: float


class ReturnEstimator:
    """Return of a frame, seen dechirped: ``beat = frame conj(reference)`` has one tone per half sweep.

    Parameters
    ----------
    waveform : Waveform
    span_m : float
        Highest altitude, above 0.
    settings : OfdmSettings
    """

    def __init__(self, waveform: Waveform, span_m: float, settings: OfdmSettings) -> None:
        self._s, self._half = settings, waveform.samples_per_half
        self._reference = waveform.reference.astype(np.complex64)
        self._table = self._reference.conj().reshape(2, -1)
        cell_hz = waveform.rate_hz / self._half
        top = int(np.ceil(waveform.slope_hz_per_s * 2 * span_m / C_M_PER_S / cell_hz))
        # beats of the first half are negative with this reference, of the second positive
        cells = np.arange(-3, top + 4)
        self._cells = np.stack([-cells % self._half, cells % self._half + self._half])
        fine = np.arange(2 * cells[0], 2 * cells[-1] + 1)
        self._fine = np.stack([-fine % (2 * self._half), fine % (2 * self._half) + 2 * self._half])
        n = np.arange(self._half)
        self._window = (0.5 - 0.5 * np.cos(2 * np.pi * (n + 0.5) / self._half)).astype(np.float32)

    def _dechirped(self, frame: np.ndarray) -> np.ndarray:
        return frame.reshape(2, -1) * self._table

    def visibility(self, frame: np.ndarray) -> float:
        """The weaker half sweep's beat peak over the mean power of an (N,) frame; 0 if the two are not at one beat.

        White interference alone stays below some ``ln(cells)``, 7 for 300 cells.
        """
        level = power(fft.fft(self._dechirped(frame), axis=1))
        band = level.take(self._cells)
        peak = band.argmax(axis=1)
        if abs(int(peak[0]) - int(peak[1])) > self._s.visible_cells:
            return 0.0
        return float((band.max(axis=1) / np.maximum(level.mean(axis=1), 1e-30)).min())

    def estimate(self, frame: np.ndarray) -> ReturnEstimate:
        """Strongest tone of each half sweep in the altitude band of an (N,) frame, where samples of 0 are missing.

        Frequency by a parabola through three bins of the twice zero-padded amplitude spectrum, amplitude and phase by
        the mean over the samples that are there.
        """
        beat = self._dechirped(frame)
        spectrum = fft.fft(beat, 2 * self._half, axis=1)
        band = spectrum.take(self._fine)
        level = power(band)
        best = np.clip(level.argmax(axis=1), 1, level.shape[1] - 2)
        ratio = np.inf
        steps = np.empty(2)
        for row in range(2):
            ratio = min(ratio, float(level[row, best[row]] / max(median(level[row]) / np.log(2), 1e-30)))
            low, mid, high = np.abs(band[row, best[row] - 1 : best[row] + 2])
            bend = low - 2 * mid + high
            off = float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5)) if bend < 0 else 0.0
            sign = 1 if row else -1
            steps[row] = sign * (best[row] + off - 6) / (2 * self._half)
        tone = exp_ramp(steps, self._half)
        there = np.maximum((beat != 0).sum(axis=1), 1)
        gain = (beat * tone.conj()).sum(axis=1) / there
        out = (gain[:, None].astype(np.complex64) * tone).ravel() * self._reference
        return ReturnEstimate(out, ratio)

    def is_consistent(self, frame: np.ndarray) -> bool:
        """Integrity: whether an (N,) cancelled frame is consistent with one return and white noise.

        Beat spectra of the two half sweeps (Hann window, over their noise) are added for all pairs of beats that one
        return at an allowed speed can have. The best pair has to exceed what noise gives, and every other pair. A return
        has one power in both halves: where they differ, the weaker one has to stand out by itself. An emitter that was
        demodulated wrongly leaves one half, or several beats, and an altitude beside the return's.
        """
        s = self._s
        level = power(fft.fft(self._dechirped(frame) * self._window, 2 * self._half, axis=1)).take(self._fine)
        noise = np.maximum(np.median(level, axis=1) / np.log(2), 1e-30)
        up, down = (level / noise[:, None]).astype(np.float32)
        reach, lobe = s.speed_cells, s.lobe_cells

        def sums(first: np.ndarray, second: np.ndarray) -> np.ndarray:
            return first + ndimage.maximum_filter1d(second, 2 * reach + 1, mode="constant")

        pair = sums(up, down)
        at_up = int(pair.argmax())
        low = max(at_up - reach, 0)
        at_down = low + int(down[low : at_up + reach + 1].argmax())
        weaker = min(up[at_up], down[at_down])
        if pair[at_up] < s.pair_ratio or weaker < s.half_ratio:
            return False
        balance_db = 10 * abs(np.log10(level[0, at_up] / level[1, at_down]))
        if balance_db > s.balance_db and weaker < s.half_alone_ratio:
            return False
        rest_up, rest_down = up.copy(), down.copy()
        rest_up[max(at_up - lobe, 0) : at_up + lobe + 1] = 0
        rest_down[max(at_down - lobe, 0) : at_down + lobe + 1] = 0
        return bool(pair[at_up] > s.pair_margin * sums(rest_up, rest_down).max())
