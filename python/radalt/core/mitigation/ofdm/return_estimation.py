"""Radar return: is it visible, where is its tone, and is what is left consistent with one return and white noise?"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ...spectral_line import noise_level, pair_sums, partner, peak_curve, peak_offset, sum_chance
from ...waveform import C_M_PER_S, Waveform
from .arrays import exp_ramp, power
from .settings import OfdmSettings


@dataclass(frozen=True)
class ReturnEstimate:
    """A return as one tone per half sweep, at beats that one return at an allowed speed can have."""

    samples: np.ndarray  # (N,) complex64
    ratios: np.ndarray  # (2,) float32: each half's tone over the mean power of noise in a cell there
    cells: np.ndarray  # (2,) int: each half's beat in the twice zero-padded spectrum


class ReturnEstimator:
    """Return of a frame, seen dechirped: ``beat = frame conj(reference)`` has one tone per half sweep.

    ``span_m``: highest altitude, above 0.
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
        self._peak_curve = peak_curve(np.ones(self._half), 0.5 / self._half)
        n = np.arange(2 * self._half) % self._half + 0.5
        self._window = (0.5 - 0.5 * np.cos(2 * np.pi * n / self._half)).astype(np.float32)

    def _dechirped(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(2, N/2) half sweeps of an (N,) frame, dechirped, and (2, cells) their twice zero-padded spectra."""
        beat = frame.reshape(2, -1) * self._table
        return beat, fft.fft(beat, 2 * self._half, axis=1).take(self._fine)

    def visibility(self, frame: np.ndarray) -> float:
        """The weaker half sweep's beat peak over the mean power of an (N,) frame; 0 if the two are not at one beat.

        White interference alone stays below some ``ln(cells)``, 7 for 300 cells.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            level = power(fft.fft(frame.reshape(2, -1) * self._table, axis=1))
            band = level.take(self._cells)
            peak = band.argmax(axis=1)
            if abs(int(peak[0]) - int(peak[1])) > self._s.visible_cells:
                return 0.0
            return float((band.max(axis=1) / np.maximum(level.mean(axis=1), 1e-30)).min())

    def estimate(self, frame: np.ndarray) -> ReturnEstimate:
        """Return of an (N,) frame, where samples of 0 are missing.

        Frequency by `peak_offset` in the twice zero-padded spectrum, amplitude and phase by the mean over the samples
        that are there.
        """
        beat, band = self._dechirped(frame)
        cells, ratios = _strongest(*_over_noise(band)[0], self._s.speed_cells)
        return ReturnEstimate(self._tones(beat, band, cells), ratios, cells)

    def candidates(self, frame: np.ndarray, count: int) -> list[ReturnEstimate]:
        """The ``count`` likeliest returns of an (N,) frame at speeds that are flown, the likeliest first."""
        reach, lobe, out = self._s.flown_cells, self._s.lobe_cells // 2, []
        beat, band = self._dechirped(frame)
        up, down = _over_noise(band)[0]
        for _ in range(count):
            cells, ratios = _strongest(up, down, reach)
            out.append(ReturnEstimate(self._tones(beat, band, cells), ratios, cells))
            up[max(cells[0] - lobe, 0) : cells[0] + lobe + 1] = -np.inf
        return out

    def neighbours(self, frame: np.ndarray, one: ReturnEstimate) -> list[ReturnEstimate]:
        """Returns of an (N,) frame, each half's beat at all speeds that are flown with the other half's of ``one``."""
        (beat, band), reach = self._dechirped(frame), self._s.flown_cells
        cells = [np.clip(one.cells[::-1] + off, 1, band.shape[1] - 2) for off in range(-reach, reach + 1)]
        few = np.full(2, self._s.return_uncertainty)  # so nothing is certain of its power
        return [ReturnEstimate(self._tones(beat, band, own, exact=True), few, own) for own in cells]

    def _tones(
        self, beat: np.ndarray, band: np.ndarray, cells: np.ndarray, *, exact: bool = False
    ) -> np.ndarray:
        """(N,) a tone in each half sweep at these cells (2,), or between them unless ``exact``."""
        steps = np.empty(2)
        for row, cell in enumerate(np.clip(cells, 1, band.shape[1] - 2)):
            around = power(band[row, cell - 1 : cell + 2])
            off = 0.0 if exact else float(np.clip(peak_offset(around, self._peak_curve), -0.5, 0.5))
            steps[row] = (1 if row else -1) * (cell + off - 6) / (2 * self._half)
        tone = exp_ramp(steps, self._half)
        there = np.maximum((beat != 0).sum(axis=1), 1)
        gain = (beat * tone.conj()).sum(axis=1) / there
        return (gain[:, None].astype(np.complex64) * tone).ravel() * self._reference

    def is_consistent(self, frame: np.ndarray) -> bool:
        """Integrity: whether an (N,) cancelled frame is consistent with one return and white noise.

        Beat spectra of the two half sweeps (Hann window, over their noise) are added for all pairs of beats that one
        return at an allowed speed can have. Cells of noise are exponential, and the sum of two exceeds x by chance
        with probability ``(1 + x) exp(-x)``; with as many pairs as are as close, the best pair has to be unlikely by
        chance, and larger than every other. A return has one power in both halves: where they differ, the weaker one
        has to be unlikely by chance, too. The pair that an altimeter takes has to be at a speed that is flown.
        Symbols decided wrongly leave one half, or several beats, and an altitude next to the return's.
        """
        s = self._s
        over, noise = _over_noise(self._dechirped(frame * self._window)[1])
        cells, ratios = _strongest(*over, s.speed_cells)
        best, weaker = float(ratios.sum()), float(ratios.min())
        # pairs of cells that are as close to each other
        apart = 2 * abs(int(cells[0]) - int(cells[1])) + 1
        if apart > 2 * s.flown_cells + 1:
            return False
        if self._cells.shape[1] * apart * sum_chance(best, 2) > s.chance:
            return False
        powers = ratios * noise
        unequal = 10 * abs(np.log10(powers[0] / powers[1])) > s.balance_db
        if unequal and apart * sum_chance(weaker, 1) > s.chance:
            return False
        for row, cell in zip(over, cells, strict=True):
            row[max(cell - s.lobe_cells, 0) : cell + s.lobe_cells + 1] = 0
        return bool(best > s.pair_margin * pair_sums(over[:1], over[1:], s.speed_cells).max())


def _over_noise(band: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2, cells) powers of spectra over their noise, and that, (2,)."""
    level = power(band)
    noise = np.maximum(noise_level(level), 1e-30)
    return level / noise[:, None], noise


def _strongest(up: np.ndarray, down: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells and ratios, (2,) each, of the greatest sum of two that differ by ``reach`` cells at most."""
    first = int(pair_sums(up[None], down[None], reach).argmax())
    second = partner(down, first, reach)
    return np.array([first, second]), np.array([up[first], down[second]])
