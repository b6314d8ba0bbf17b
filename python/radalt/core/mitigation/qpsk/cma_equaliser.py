"""From a frame to decided QPSK symbols: a fractionally spaced equaliser that starts blindly."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft, linalg, ndimage

from ...waveform import exp_cycles, read_only
from .carrier_recovery import decide, largest_correlation, nearest
from .settings import QpskSettings
from .symbol_timing import SymbolTiming

_UPSAMPLING = 4  # points per sample, between which samples are interpolated linearly: 33 dB below the signal


@dataclass(frozen=True)
class Symbols:
    """Decided symbols of a frame."""

    times: np.ndarray  # (K,) float: in samples of the frame
    values: np.ndarray  # (K,) complex64: unit points with the carrier's phase, 0 where nothing was sent
    decisions: np.ndarray  # (K,) complex64: the points without the carrier: one of four
    evm_squared: float  # mean squared distance from the points, of their power, where something was sent
    active_share: float  # share of the frame's symbols in which something was sent
    weights: np.ndarray  # (taps,) complex64: of the equaliser


def tap_spacing(rate: float, s: QpskSettings) -> int:
    """Samples from tap to tap at a symbol ``rate``."""
    return max(1, int(1 / (s.taps_per_symbol * rate)))


class CmaEqualiser:
    """Least squares between the samples around each symbol and what the symbols should be. ``frame`` (n,) complex64."""

    def __init__(self, frame: np.ndarray, timing: SymbolTiming, s: QpskSettings) -> None:
        self._s = s
        self._spacing = tap_spacing(timing.rate, s)
        self.times, self._rows = self._samples_around(frame, timing)
        rails = np.ascontiguousarray(self._rows[:, ::4]).view(np.float32)
        level = ndimage.uniform_filter1d(np.einsum("kt,kt->k", rails, rails), s.burst_symbols, mode="nearest")
        high = int(0.9 * level.size)
        self._active = level > s.burst_power * np.partition(level, high)[high]
        chosen = np.flatnonzero(self._active)
        self._training = chosen[:: max(1, chosen.size // s.training_symbols)]
        self._training_rows = self._rows[self._training]
        self._adjoint = self._training_rows.conj().T
        gram = self._adjoint @ self._training_rows
        gram.flat[:: s.taps + 1] += np.float32(s.tap_loading * np.trace(gram).real / s.taps)
        self._cholesky = linalg.lapack.cpotrf(gram)[0]

    def _samples_around(self, frame: np.ndarray, timing: SymbolTiming) -> tuple[np.ndarray, np.ndarray]:
        """(K,) times in samples, (K, taps) samples around them, interpolated."""
        count, taps, spacing = frame.size, self._s.taps, self._spacing
        side = spacing * taps // 2 + 1
        first = timing.instant - np.floor((timing.instant - side) * timing.rate) / timing.rate
        times = np.arange(first, count - side - 1, 1 / timing.rate)
        # points between samples are the frame, advanced by a part of a sample
        fine = fft.ifft(fft.fft(frame) * _advances(count), overwrite_x=True)
        place = times * _UPSAMPLING
        whole = place.astype(np.intp)
        part = (place - whole).astype(np.float32)
        sample = whole // _UPSAMPLING
        first_tap = sample - taps // 2 * spacing
        column = first_tap // spacing
        row = (first_tap - column * spacing) * _UPSAMPLING + whole - sample * _UPSAMPLING
        pairs = _tap_pairs(fine, spacing, taps)[row, column]
        weights = np.stack([1 - part, part], axis=1)
        return times, np.einsum("kpt,kp->kt", pairs.view(np.float32), weights).view(np.complex64)

    def _fit(self, targets: np.ndarray) -> np.ndarray:
        return linalg.lapack.cpotrs(self._cholesky, self._adjoint @ targets)[0]

    def _constant_modulus(self) -> np.ndarray:
        """(taps,) weights that give the outputs one modulus, from the single tap whose output varies least in modulus.

        The target of each output is its own phase, again and again (B. G. Agee, "The least-squares CMA", ICASSP
        1986), so neither carrier nor pulse has to be known.
        """
        middle, half_symbol = self._s.taps // 2, round(self._s.taps_per_symbol / 2)
        columns = self._training_rows[:, middle - half_symbol : middle + half_symbol + 1].T.copy()
        modulus = np.abs(columns)
        outputs = columns[int((modulus.std(axis=1) / modulus.mean(axis=1)).argmin())]
        for _ in range(self._s.cma_iterations):
            weights = self._fit(outputs / np.maximum(np.abs(outputs), np.float32(1e-30)))
            before, outputs = outputs, self._training_rows @ weights
            change = np.sum(np.abs(outputs - before) ** 2)
            if change < self._s.cma_converged * np.sum(np.abs(outputs) ** 2):
                break
        return weights

    def symbols(self) -> Symbols | None:
        """Decided symbols; None if too few are sent, or their EVM is too large, or they repeat."""
        s, active, sent = self._s, self._active, np.count_nonzero(self._active)
        if sent < 2 * s.taps:
            return None
        decisions, carrier = decide(self._rows @ self._constant_modulus(), active, s.carrier_symbols)
        weights = self._fit((decisions * carrier)[self._training])  # the decisions improve the equaliser
        outputs = (self._rows @ weights) * carrier.conj()
        decisions = nearest(outputs) * active
        error = (outputs - decisions)[active]
        evm_squared, share = float(np.vdot(error, error).real / sent), sent / active.size
        if evm_squared > s.max_evm_squared or largest_correlation(decisions) > s.max_correlation * share:
            return None
        return Symbols(self.times, decisions * carrier, decisions, evm_squared, share, weights)


@lru_cache(maxsize=4)
def _advances(count: int) -> np.ndarray:
    """(_UPSAMPLING, count) complex64, read-only: responses that advance a frame by 0, 1 ... parts of a sample."""
    return read_only(exp_cycles(fft.fftfreq(count) * np.arange(_UPSAMPLING)[:, None] / _UPSAMPLING))


def _tap_pairs(fine: np.ndarray, spacing: int, taps: int) -> np.ndarray:
    """(spacing * _UPSAMPLING, places, 2, taps): from each point and from the next one on, samples ``spacing`` apart."""
    places = fine.shape[1] // spacing
    points = np.empty((spacing * _UPSAMPLING + 1, places), dtype=np.complex64)
    points[:-1].reshape(spacing, _UPSAMPLING, places)[:] = (
        fine[:, : places * spacing].reshape(_UPSAMPLING, places, spacing).transpose(2, 0, 1)
    )
    points[-1, :-1] = points[0, 1:]
    points[-1, -1] = 0
    return np.lib.stride_tricks.sliding_window_view(points, (2, taps))
