"""A frame, and what was demodulated of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .acquisition import Grid
from .carrier import whole_subcarriers
from .numerology import Numerology
from .received import Received

__all__ = ["NEGLIGIBLE", "Demodulated", "Straight", "straightened"]

NEGLIGIBLE = 1e-4  # subcarriers of carrier that do no harm: neighbours leak -75 dB


@dataclass(frozen=True)
class Straight:
    """A frame's samples (N,) without the carrier, and the factor (N,) that took it out; None if it was negligible."""

    samples: np.ndarray
    turn: np.ndarray | None

    def of(self, samples: np.ndarray) -> Straight:
        """Other ``samples`` (N,) of the same frame."""
        return replace(self, samples=samples)


def straightened(frame: np.ndarray, carrier: float, numerology: Numerology) -> Straight:
    """The frame without a carrier of so many subcarriers, as it is where that is negligible."""
    if abs(carrier) < NEGLIGIBLE:
        return Straight(frame, None)
    # a product of few long and few short steps
    step = -2j * np.pi * carrier / numerology.useful
    short = int(np.sqrt(frame.size)) + 1
    few = np.arange(short)
    turn = np.exp(step * short * few).astype(np.complex64)[:, None] * np.exp(step * few).astype(np.complex64)
    turn = turn.ravel()[: frame.size]
    return Straight(frame * turn, turn)


@dataclass(frozen=True)
class Demodulated:
    """What was demodulated of a frame.

    Attributes
    ----------
    numerology : Numerology
    carrier : float
        In subcarriers, without the whole ones.
    straight : Straight
        The frame without it.
    grid : Grid
        Its symbols.
    clear : (L, K) bool
        Which of their elements no return can be in.
    received : Received
    shift : float
        Whole subcarriers and thirds that the carrier is off as well, modulo 32.
    """

    numerology: Numerology
    carrier: float
    straight: Straight
    grid: Grid
    clear: np.ndarray
    received: Received
    shift: float

    def retraced(self) -> Demodulated:
        """The same with the whole subcarriers of the carrier as the angles now tell them."""
        turns, received = 2 * np.pi / self.numerology.useful, self.received
        times = self.numerology.times_at(self.grid.starts, self.grid.first_long)
        angles = received.angles + self.shift * turns * times
        shift, angles = whole_subcarriers(angles, received.weight, times, self.numerology)
        if shift == self.shift:
            return self
        return replace(self, shift=shift, received=replace(received, angles=angles))

    @property
    def misread(self) -> float:
        """Mean error of all symbols in cells, each at most 1."""
        return self.received.mean_misread
