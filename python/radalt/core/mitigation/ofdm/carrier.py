"""What the turning of symbols tells of the carrier."""

from __future__ import annotations

import numpy as np
from scipy import fft

from .numerology import Numerology

__all__ = ["TURNS", "carrier_step", "course", "whole_subcarriers"]

_COURSES = 512  # carriers tried
_COARSELY = 64  # the same where one of sixteen leaps is sought
_IN_STEP = 0.8  # of the sum without regard to phase
_SURELY = 0.95  # the same, with a turn at each long prefix, where an even course has less
_LEAPS = 2 * np.pi / 16 * np.arange(16)  # such turns that are tried
_NO_SLOPE = 2.5  # times its own scatter, a slope may be none
TURNS = 6e-3  # subcarriers: more than that is no carrier's rest, where no whole number of them was told
# subcarriers, of which those 32 apart turn fourth powers alike; carriers below 3 GHz stand 100 kHz apart, 20/3 of them
_WHOLE = np.r_[0, -48:0, 1:48] / 3
_OFF = 3e-3 * np.arange(-4, 5)  # subcarriers by which a prefix mistakes the rest
_EVEN = 0.97  # of the sum of all symbols' weights, for symbols that turn as one carrier turns them
_EVENER = 0.02  # of that sum, for another carrier than the nearest
_LONG = 10  # symbols from the first to the last that tell of it


def course(agreement: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """(L,) angles of the symbols' fourth powers, summed over the subcarriers (L,), in radians.

    A carrier offset turns them evenly, and this common course is known better than the angle of one symbol. That angle
    has the data's noise, or is an eighth of a turn off where the points stand on the axes (the primary synchronisation
    signal). A carrier that is whole subcarriers off turns them once more at each long prefix, of which ``passed`` (L,)
    came before. Where most symbols are out of step (the turns of TS 38.211 clause 5.4) each keeps its own angle.
    """
    weight = np.abs(agreement)
    leap, spectrum = 0.0, fft.fft(agreement, _COURSES)
    size = np.abs(spectrum)
    if size.max() < _SURELY * weight.sum() and passed[-1] > 0:
        turned = agreement * np.exp(-1j * _LEAPS[:, None] * passed)
        best = int(np.abs(fft.fft(turned, _COARSELY)).max(axis=1).argmax())
        finer = fft.fft(turned[best], _COURSES)
        finer_size = np.abs(finer)
        if finer_size.max() > _SURELY * weight.sum():
            leap, spectrum, size = _LEAPS[best], finer, finer_size
    best = int(size.argmax())
    if size[best] < _IN_STEP * weight.sum():
        return np.angle(agreement)
    index = np.arange(len(agreement), dtype=float)
    step = 2 * np.pi * (best - _COURSES * (best > _COURSES // 2)) / _COURSES
    rough = step * index + leap * passed
    away = np.angle(agreement * np.exp(-1j * (np.angle(spectrum[best]) + rough)))
    weight = weight * (np.abs(away) < np.pi / 2)
    if np.count_nonzero(weight) < 3:
        return np.angle(agreement)
    if leap:
        basis = np.stack([np.ones(len(index)), index, passed], axis=1)
        found = np.linalg.lstsq(basis * weight[:, None], away * weight, rcond=None)[0]
        return np.angle(spectrum[best]) + rough + basis @ found
    weight /= weight.sum()
    index -= weight @ index
    away -= weight @ away
    spread = weight @ index**2
    finer = (weight * index) @ away / spread
    scatter = np.sqrt(weight @ (away - finer * index) ** 2 / spread / len(index))
    slope = step + finer
    if abs(slope) < _NO_SLOPE * scatter:
        slope = 0.0
    return np.angle((agreement * np.exp(-1j * slope * index)).sum()) + slope * index


def carrier_step(angles: np.ndarray, weight: np.ndarray, numerology: Numerology) -> float:
    """Carrier offset, in subcarriers, from the turning of the symbols.

    A straight line through (L,) angles, modulo a quarter turn, weighted by (L,) ``weight``.
    """
    heard = np.flatnonzero(weight > 0)
    if len(heard) < 3:
        return 0.0
    course, weight = angles[heard], weight[heard]
    if np.abs(course[1:] - course[:-1]).max() > np.pi / 4:
        course = np.unwrap(4 * course) / 4
    index = heard - (weight @ heard) / weight.sum()
    per_symbol = float((weight * index) @ course / ((weight * index) @ index))
    return per_symbol / (2 * np.pi) * numerology.useful / numerology.spacing


def whole_subcarriers(
    angles: np.ndarray, weight: np.ndarray, times: np.ndarray, numerology: Numerology
) -> tuple[float, np.ndarray]:
    """Whole subcarriers and thirds that a carrier is off, modulo 32, and the angles (L,) without what that turns
    symbols by.

    ``angles`` (L,), modulo a quarter turn, have the weights ``weight`` (L,), and ``times`` (L,) are those of
    `Numerology`. Such a carrier turns each symbol by the time since the one before, which is longer across a long
    prefix. So do the turns of TS 38.211 clause 5.4, whose frequency is a multiple of 5 kHz. The angles are as they are,
    and the number is 0, where nothing fits all symbols, or a burst has too few.
    """
    heard = np.flatnonzero(weight)
    if not heard.size or heard[-1] - heard[0] < _LONG:
        return 0.0, angles
    fourth = weight * np.exp(4j * angles)
    if np.abs(fourth.sum()) > (1 - _EVENER) * weight.sum():
        return 0.0, angles  # nothing turns
    turns = 2 * np.pi / numerology.useful * times
    off = np.exp(-4j * turns[:, None] * _OFF)
    if _fits(fourth[None], off)[0] > 1 - _EVENER:
        return 0.0, angles
    fits = _fits(np.exp(-4j * _WHOLE[:, None] * turns) * fourth, off)
    best = int(fits.argmax())
    if fits[best] < _EVEN or fits[best] < fits[0] + _EVENER:
        return 0.0, angles
    left = angles - _WHOLE[best] * turns
    return float(_WHOLE[best]), np.unwrap(np.angle(np.exp(4j * left))) / 4


def _fits(fourth: np.ndarray, off: np.ndarray) -> np.ndarray:
    """How well the symbols' turned fourth powers (n, L) agree, each at the best ``off`` (L, m): (n,), at most 1.

    A symbol with its points on the axes is an eighth of a turn off. So those do not count that are against the best sum
    of all.
    """
    sums = fourth @ off
    best, rest = np.unravel_index(np.abs(sums).argmax(), sums.shape)
    counts = (fourth[best] * off[:, rest] * sums[best, rest].conj()).real > 0
    return np.abs(fourth[:, counts] @ off[counts]).max(axis=1) / np.abs(fourth[0, counts]).sum()
