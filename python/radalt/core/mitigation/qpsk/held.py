"""QPSK that is switched on the sample grid and not filtered: every sample is one of four points."""

from __future__ import annotations

import numpy as np

from ..ofdm.lattice import middle
from .equaliser import decide, turning
from .runs import MOSTLY, Blocks, longest_run

__all__ = ["Held", "astray", "find_held"]

_SPREAD = 0.25  # of the modulus, over its mean; the return alone makes 0.2 at an SIR of -11 dB
_LOUD = 0.5  # of the modulus while it sends
_ALL = 0.98  # of the samples: where so many are loud, the others are faint by chance
_ERROR = 0.08  # of the points' power; samples at random have 0.3
_WORSE = 2.0  # error over that of the first frame
_CHANGES = (0.01, 0.5)  # of samples that are another point than the one before
_EVERY = 4  # one step from a sample to the next in so many is looked at
_COHERENCE = 0.3  # of those steps' fourth powers; a sweep and OFDM have less than 0.1, what can be decided 0.5 and more
_FAR = 5.0  # times the median distance of a fourth power from their mean
_BLOCKS = Blocks(size=150, fine=30, fewest=600)  # of samples


def astray(frame: np.ndarray) -> float:
    """Share of an (n,) complex64 frame's steps from sample to sample that no such QPSK makes; 1 where none can be told.

    From one sample to the next the phase steps by quarter turns and the carrier, so fourth powers of the products of
    neighbours are alike. A filter leaves steps of other sizes where symbols change.
    """
    steps = frame[1::_EVERY] * frame[:-1:_EVERY].conj()
    size = np.abs(steps)
    high = int(0.9 * size.size)
    loud = size > np.float32(_LOUD**2) * np.partition(size, high)[high]
    fourth = steps[loud] / size[loud]
    fourth *= fourth
    fourth *= fourth
    mean = complex(fourth.mean()) if fourth.size else 0.0
    coherence = abs(mean)
    if not coherence > _COHERENCE:
        return 1.0
    away = np.abs(fourth - np.complex64(mean / coherence))
    return np.count_nonzero(away > _FAR * middle(away)) / away.size


def find_held(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, Held] | None:
    """What is left of an (n,) complex64 frame without such QPSK, what was sent, in which share of the frame, and what
    follows the emitter; None without.

    Each sample is decided alone, so neither clock nor pulse has to be found. No receiver with a filter hears this.
    """
    size = np.abs(frame)
    high = int(0.9 * size.size)
    loud = size > np.float32(_LOUD) * np.partition(size, high)[high]
    if np.count_nonzero(loud) > _ALL * size.size:
        loud[:] = True
    sent = size[loud]
    if not sent.std() < _SPREAD * sent.mean():
        return None
    points, turn = decide(frame, loud)
    straight = frame * turn.conj()
    amplitude = np.vdot(points, straight).real / sent.size
    wrong = (straight - points * np.float32(amplitude))[loud]
    error = float(np.vdot(wrong, wrong).real) / (float(amplitude) ** 2 * sent.size)
    if not error < _ERROR:
        return None
    made = _made(frame, points, turn)
    if made is None:
        return None
    model, carrier = made
    return frame - model, model, sent.size / size.size, Held(carrier, frame.size, error)


class Held:
    """Such an emitter, which sends all the time, from the frame in which it was found on.

    Parameters
    ----------
    carrier : float
        Cycles per sample.
    count : int
        Samples of a frame.
    error : float
        Mean squared distance of samples from their points, of their power.
    """

    def __init__(self, carrier: float, count: int, error: float) -> None:
        self._carrier, self._count = carrier, count
        self._limit = min(_ERROR, _WORSE * error)

    def follow(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, slice | np.ndarray] | None:
        """What is left of an (n,) complex64 frame, what was sent, and the samples in which that is known, a slice or
        (n,) bool; None if the emitter is not as it was.
        """
        count, turn = self._count, turning(self._carrier, self._count)
        run = longest_run(frame, turn, _BLOCKS, self._limit)
        made = None if run is None else _made(frame[run.begin : run.end], run.points, run.turn)
        if made is None:
            return None
        model, self._carrier = made
        if run.points.size == count:
            return frame - model, model, slice(0, count)
        whole, known = np.zeros_like(frame), np.zeros(count, dtype=bool)
        whole[run.begin : run.end], known[run.begin : run.end] = model, True
        for begin, end in ((0, run.begin), (run.end, count)):  # there it begins or ends
            if end - begin < _BLOCKS.fewest:
                continue
            other = longest_run(frame[begin:end], turn[begin:end], _BLOCKS, self._limit, meets=True)
            span = None if other is None else slice(begin + other.begin, begin + other.end)
            made = None if other is None else _made(frame[span], other.points, other.turn)
            if made is not None:
                whole[span], known[span] = made[0], True
        return (frame - whole, whole, known) if known.mean() > MOSTLY else None


def _made(frame: np.ndarray, points: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(n,) samples of what was sent: the decided ``points`` (n,), 0 where nothing was, with the carrier's ``turn`` (n,)
    and an amplitude that changes evenly over the frame; and the carrier in cycles per sample. None if it is no data.
    """
    source = points * turn
    there = points.real * points.real
    there *= 2
    level = there.sum()
    changes = np.count_nonzero(points[1:] != points[:-1])
    if not _CHANGES[0] * level < changes < _CHANGES[1] * level:
        return None
    ramp = np.linspace(-1, 1, frame.size, dtype=np.float32)
    tilt = there @ ramp
    gram = np.array([[level, tilt], [tilt, (there * ramp) @ ramp]])
    compared = source.conj() * frame
    steady, drift = np.linalg.solve(gram, [compared.sum(), compared @ ramp])
    model = source * (np.complex64(steady) + np.complex64(drift) * ramp)
    step = float(np.angle(np.vdot(turn[:-1], turn[1:]))) / (2 * np.pi)
    return model, step + float((drift / steady).imag) / (np.pi * frame.size)
