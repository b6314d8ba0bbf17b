"""Carrier recovery by the fourth power, and decisions on QPSK symbols."""

import cmath

import numpy as np
from scipy import fft

from ...waveform import unit

_PADDING = 4  # times the length of the transform in which the carrier's line is found: 0.2 dB of scalloping


def largest_correlation(decisions: np.ndarray) -> float:
    """Largest correlation of one of (K,) unit points with one of the three before it."""
    return float(
        max(abs(np.vdot(decisions[:-lag], decisions[lag:])) / (decisions.size - lag) for lag in (1, 2, 3))
    )


def nearest(outputs: np.ndarray) -> np.ndarray:
    """Nearest points of unit QPSK."""
    rails = np.ascontiguousarray(outputs).view(np.float32)
    return np.copysign(np.float32(np.sqrt(0.5)), rails).view(np.complex64)


def phasors(cycles: float, count: int) -> np.ndarray:
    """(count,) complex64 of ``cycles`` per step: products of few coarse and few fine steps."""
    short = int(np.sqrt(count)) + 1
    steps = np.arange(short)
    coarse = short * cycles % 1.0 * steps
    angles = np.concatenate([coarse - np.rint(coarse), cycles * steps % 1.0])
    both = unit((2 * np.pi * angles).astype(np.float32))
    return (both[:short, None] * both[short:]).ravel()[:count]


def decide(
    outputs: np.ndarray, active: np.ndarray, block: int, cycles: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Decisions on (K,) outputs where ``active`` (K,) bool, and the carrier's phasor of each: (K,) complex64 twice.

    The fourth power removes the data (A. J. Viterbi and A. M. Viterbi, IEEE Trans. Inf. Theory 29(4), 1983); the
    strongest line of its spectrum is four times the carrier. A straight line through the phase that is left, averaged
    over blocks of ``block`` symbols, makes it exact. A quarter turn more per symbol gives other points of the same
    constellation, which are as good. ``cycles`` per symbol is the carrier where that is known.
    """
    size = np.abs(outputs) if cycles is None else np.sqrt(np.vdot(outputs, outputs).real / outputs.size)
    fourth = outputs / np.maximum(size, np.float32(1e-30))
    fourth *= fourth
    fourth *= -fourth  # the points stand on the diagonals
    fourth *= active
    if cycles is None:
        size = _PADDING * fft.next_fast_len(fourth.size)
        line = int(np.abs(fft.fft(fourth, size)).argmax())
        cycles = (line - size * (2 * line > size)) / size / 4
    carrier = phasors(cycles, outputs.size)
    to_fourth = carrier * carrier
    to_fourth *= to_fourth
    blocks = max(1, outputs.size // block)
    sums = np.einsum(
        "bk,bk->b",
        fourth[: blocks * block].reshape(blocks, -1),
        to_fourth[: blocks * block].conj().reshape(blocks, -1),
    )
    mean = complex(sums.sum())
    # what is left is less than an eighth of a turn either way
    phase = np.angle(sums * mean.conjugate())
    weight = np.square(np.abs(sums))
    total = max(float(weight.sum()), 1e-30)
    place = (np.arange(blocks) + 0.5) * block - 0.5
    centre = float(weight @ place) / total
    distance = place - centre
    slope = float(weight @ (distance * phase)) / max(float(weight @ (distance * distance)), 1e-30)
    offset = cmath.phase(mean) + float(weight @ phase) / total - slope * centre
    carrier *= phasors(slope / (8 * np.pi), outputs.size) * np.complex64(cmath.exp(0.25j * offset))
    return nearest(outputs * carrier.conj()) * active, carrier
