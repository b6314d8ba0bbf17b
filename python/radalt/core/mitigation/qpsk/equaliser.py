"""From a frame to decided QPSK symbols: a blind equaliser between samples and symbols."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft, linalg

from ...waveform import exp_cycles
from ..ofdm.lattice import box, power, unit
from .clock import Clock

__all__ = ["TAPS", "Equaliser", "Symbols", "decide", "likeness", "nearest", "turning"]

TAPS = 32
_UP = 4  # points per sample, between which is interpolated
_LOADING = 1e-5  # of the mean power: tones make the equations nearly singular, to 1e-6 in float32
_ASKED = 800  # symbols that are enough for 32 weights
_ROUNDS = 24  # of the constant-modulus start
_STILL = 1e-3  # change of the weights' outputs, of their power, at which the start ends
_BURST = 8  # symbols over which power is averaged
_QUIET = 0.2  # of the power while it sends
_COURSE = 61  # symbols over which the carrier's phase is averaged


@dataclass(frozen=True)
class Symbols:
    """Decided symbols of a frame.

    Attributes
    ----------
    times : (K,) float
        In samples of the frame.
    values : (K,) complex64
        Unit points with the carrier's turn, 0 where nothing was sent.
    points : (K,) complex64
        The same without the turn: one of four.
    error : float
        Mean squared distance from the points, of their power, where something was sent.
    alike : float
        Largest correlation of a point with one of the three before it. It is near 0 for data and 1 for a tone.
    busy : float
        Share of the frame's symbols in which something was sent.
    weights : (TAPS,) complex64
        Of the equaliser.
    """

    times: np.ndarray
    values: np.ndarray
    points: np.ndarray
    error: float
    alike: float
    busy: float
    weights: np.ndarray


class Equaliser:
    """Least squares between the samples around each symbol and what the symbols should be.

    Parameters
    ----------
    frame : (n,) complex64
    clock : Clock
    """

    def __init__(self, frame: np.ndarray, clock: Clock) -> None:
        self._step = clock.tap_step
        self._half = max(1, round(0.5 / (clock.rate * self._step)))
        self.times, self._rows = self._taken(frame, clock)
        rails = np.ascontiguousarray(self._rows[:, ::4]).view(np.float32)
        level = np.einsum("kt,kt->k", rails, rails)
        level = box(level, _BURST)
        loud = int(0.9 * level.size)
        self._active = level > _QUIET * np.partition(level, loud)[loud]
        asked = np.flatnonzero(self._active)
        self._asked = asked[:: max(1, asked.size // _ASKED)]
        some = self._rows[self._asked]
        self._turned = some.conj().T
        gram = self._turned @ some
        gram.flat[:: TAPS + 1] += np.float32(_LOADING * np.trace(gram).real / TAPS)
        self._solved = linalg.lapack.cpotrf(gram)[0]
        self._some = some

    def _taken(self, frame: np.ndarray, clock: Clock) -> tuple[np.ndarray, np.ndarray]:
        """(K,) times in samples, (K, TAPS) samples around them, linear between points of 4 per sample."""
        count = frame.size
        side = self._step * TAPS // 2 + 1
        first = clock.instant - np.floor((clock.instant - side) * clock.rate) / clock.rate
        times = np.arange(first, count - side - 1, 1 / clock.rate)
        # each of the points between samples is the frame, a part of a sample early
        fine = fft.ifft(fft.fft(frame) * _early(count), overwrite_x=True)
        place = times * _UP
        whole = place.astype(np.intp)
        part = (place - whole).astype(np.float32)
        sample = whole // _UP
        first_tap = sample - TAPS // 2 * self._step
        column = first_tap // self._step
        row = (first_tap - column * self._step) * _UP + whole - sample * _UP
        pairs = _pairs(fine, self._step)[row, column]
        weights = np.stack([1 - part, part], axis=1)
        rows = np.einsum("kpt,kp->kt", pairs.view(np.float32), weights).view(np.complex64)
        return times, rows

    def _fitted(self, targets: np.ndarray) -> np.ndarray:
        return linalg.lapack.cpotrs(self._solved, self._turned @ targets)[0]

    def blind(self, late: int) -> np.ndarray:
        """(TAPS,) weights that give the outputs one modulus, from the single tap ``late`` half symbols off the middle.

        Each output's own phase is its target, again and again (B. G. Agee, "The least-squares CMA", ICASSP 1986), so
        neither carrier nor pulse has to be known.
        """
        # a copy: how NumPy rounds the modulus of a strided column depends on where its result lies in memory
        outputs = self._some[:, TAPS // 2 + late * self._half].copy()
        for _ in range(_ROUNDS):
            weights = self._fitted(outputs / np.maximum(np.abs(outputs), np.float32(1e-30)))
            before, outputs = outputs, self._some @ weights
            if np.sum(np.abs(outputs - before) ** 2) < _STILL * np.sum(np.abs(outputs) ** 2):
                break
        return weights

    def symbols(self, weights: np.ndarray) -> Symbols | None:
        """Symbols decided with (TAPS,) ``weights``, which the decided points then improve; None if too few are sent."""
        active = self._active
        if active.sum() < 2 * TAPS:
            return None
        for _ in range(2):
            points, turn = decide(self._rows @ weights, active)
            weights = self._fitted((points * turn)[self._asked])
        outputs = (self._rows @ weights) * turn.conj()
        points = nearest(outputs) * active
        sent = np.count_nonzero(active)
        wrong = (outputs - points)[active]
        error = float(np.vdot(wrong, wrong).real / sent)
        busy = sent / active.size
        return Symbols(self.times, points * turn, points, error, likeness(points) / busy, busy, weights)


@lru_cache(maxsize=4)
def _early(count: int) -> np.ndarray:
    """(_UP, count) complex64, read-only: what a transform is multiplied by for 0, 1 ... points of _UP earlier."""
    turns = fft.fftfreq(count) * np.arange(_UP)[:, None] / _UP
    early = exp_cycles(turns)
    early.setflags(write=False)
    return early


def _pairs(fine: np.ndarray, step: int) -> np.ndarray:
    """(step * _UP, places, 2, TAPS): from each point and from the next one on, samples that are ``step`` apart.

    Of points that are one tap apart, the taps of a symbol are neighbours. The last points,
    if they are few, are left out.
    """
    places = fine.shape[1] // step
    points = np.empty((step * _UP + 1, places), dtype=np.complex64)
    points[:-1].reshape(step, _UP, places)[:] = (
        fine[:, : places * step].reshape(_UP, places, step).transpose(2, 0, 1)
    )
    points[-1, :-1] = points[0, 1:]
    points[-1, -1] = 0
    return np.lib.stride_tricks.sliding_window_view(points, (2, TAPS))


def likeness(points: np.ndarray) -> float:
    """Largest correlation of one of (K,) unit points with one of the three before it."""
    return float(max(abs(np.vdot(points[:-lag], points[lag:])) / (points.size - lag) for lag in (1, 2, 3)))


def nearest(outputs: np.ndarray) -> np.ndarray:
    """Nearest points of unit QPSK."""
    rails = np.ascontiguousarray(outputs).view(np.float32)
    return np.copysign(np.float32(np.sqrt(0.5)), rails).view(np.complex64)


def turning(cycles: float, count: int) -> np.ndarray:
    """(count,) complex64 of ``cycles`` per symbol: products of few long and few short steps."""
    short = int(np.sqrt(count)) + 1
    steps = np.arange(short)
    long = short * cycles % 1.0 * steps
    angles = np.concatenate([long - np.rint(long), cycles * steps % 1.0])
    turns = unit((2 * np.pi * angles).astype(np.float32))
    return (turns[:short, None] * turns[short:]).ravel()[:count]


def decide(outputs: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of (K,) outputs and the carrier's turn of each: (K,) complex64 twice.

    The fourth power removes the data; the strongest line of its spectrum is four times the carrier. A quarter turn more
    per symbol gives other points of the same alphabet, which are as good. A straight line through what is left of the
    phase makes it exact.
    """
    fourth = outputs / np.maximum(np.abs(outputs), np.float32(1e-30))
    fourth *= fourth
    fourth *= -fourth  # the points stand on the diagonals
    fourth *= active
    size = 4 * fft.next_fast_len(fourth.size)
    spectrum = fft.fft(fourth, size)
    line = int(np.abs(spectrum).argmax())
    line -= size * (2 * line > size)
    index = np.arange(outputs.size)
    turn = turning(line / size / 4, outputs.size)
    carrier = turn * turn
    carrier *= carrier
    rest = box(fourth * carrier.conj(), _COURSE)
    mean = np.angle(rest.sum())
    # what is left is less than an eighth of a turn either way
    course = np.angle(rest * np.exp(-1j * mean))
    weight = power(rest) * active
    centre = (weight @ index) / weight.sum()
    distance = index - centre
    slope = (weight @ (distance * course)) / (weight @ (distance * distance))
    offset = (weight @ course) / weight.sum()
    turn *= unit((0.25 * (mean + offset + slope * distance)).astype(np.float32))
    return nearest(outputs * turn.conj()) * active, turn
