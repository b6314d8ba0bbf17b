"""QPSK whose clock, carrier, equaliser and pulse are known from the frame before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from ...waveform import exp_cycles
from ..ofdm.lattice import unit
from .clock import Clock, clock_line
from .equaliser import TAPS, Symbols, likeness, nearest, turning
from .pieces import Pieces
from .pulse import Train

__all__ = ["Follower", "can_follow"]

_FEWEST = 200  # symbols in a frame
_STEADY = 0.02  # of a pulse's power: what drifts more jumped, or its clock is wrong
_BLOCK = 50  # symbols whose phase and error are averaged
_COHERENT = 0.7  # of the blocks' fourth powers: less is another carrier, or none
_ERROR = 0.08  # of the points' power; symbols at random have 0.3
_WORSE, _LEAST = 2.0, 0.03  # error over that of the first frame, and what may be in any case
_WORST = 0.25  # of a block of symbols: the emitter begins, ends or jumps there
_MOSTLY = 0.6  # of the frame's blocks: with fewer it is looked for anew
_ALIKE = 0.3
_GAIN = 0.02  # of what is left, beside what noise gives: less waits for the next frame
_SHARE = 0.3  # of such a step that is kept: the mean over frames has less noise
_BESIDE = 12  # samples on either side of an equaliser, for times between samples
_STEPS = 512  # of the table between two points
_ROUNDS = 5
_CHANGE = 8.0  # of the least that was left: more is something new
_DRIFT = 0.25  # of what is left, that a pulse's drift may have left: more, and carrier or clock are wrong


@dataclass
class _Known:
    """Decided symbols of a frame, and the size of the equaliser's outputs."""

    times: np.ndarray
    values: np.ndarray
    amplitude: float


def can_follow(symbols: Symbols, pulses: np.ndarray) -> bool:
    """Whether there are enough symbols in a frame, and the (2, length) pulses of `heard` drift little."""
    return symbols.times.size >= _FEWEST and _drift(pulses) < _STEADY


class Follower:
    """One emitter that sends all the time, from the frame in which it was found on.

    Per frame: the old equaliser at the times predicted, decisions, and the old pulse, corrected by conjugate gradients
    where that takes away more than noise explains. The symbols are random, so their Toeplitz matrix is nearly the
    unit matrix, and a step leaves some -15 dB of an error. Where the times do not fit, they are taken from the
    clock's line at the known rate.

    Parameters
    ----------
    clock : Clock
    symbols : Symbols
        Of the frame in which the emitter was found.
    pulses : (2, length)
        Of `heard`, as ``train``.
    train : Train
    left : (n,) complex64
        What is left of that frame, which had unit power.
    """

    def __init__(
        self, clock: Clock, symbols: Symbols, pulses: np.ndarray, train: Train, left: np.ndarray
    ) -> None:
        self._count = count = left.size
        self._period = 1 / clock.rate
        self._side = clock.tap_step * TAPS // 2 + 1
        turn = symbols.values * symbols.points.conj()
        self._carrier = _cycles(turn)
        # between samples the equaliser lasts as long as the sinc that is cut off
        length = TAPS * clock.tap_step + 2 * _BESIDE
        taps = np.zeros(2 * length, dtype=np.complex64)
        taps[length // 2 + (TAPS // 2 - np.arange(TAPS)) * clock.tap_step] = symbols.weights
        later = fft.ifft(fft.fft(taps) * exp_cycles(0.5 * fft.fftfreq(taps.size)))
        self._pieces = Pieces(count, length)
        self._response = self._pieces.filters(np.stack([taps, later])[:, :length])[:, None]
        self._train = train
        self._pulse = pulses[0].astype(np.complex64)
        self._error, self._amplitude = symbols.error, 1.0
        self._left = float(np.mean(np.square(np.abs(left[train.known]))))
        self._instant = 0.0
        self._move(train, symbols.times, pulses[1])

    def follow(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, slice] | None:
        """What is left of an (n,) complex64 frame, the part that the symbols explain, and the samples in which all
        symbols are known; None if the emitter is not as it was.
        """
        pieces = self._pieces
        outputs = pieces.filtered(pieces.transforms(frame) * self._response).T.ravel()  # two per sample
        known = self._decided(outputs, self._instant)
        if known is None:
            known = self._decided(outputs, clock_line(frame, 1 / self._period))
            if known is None:
                return None
        train = self._train
        train.send(known.times, known.values)
        span = train.known
        source, places = train.transforms(train.steady), train.places()
        pulses = np.zeros((2, train.length), dtype=np.complex64)
        pulses[0] = self._pulse * np.float32(known.amplitude / self._amplitude)
        moments = np.stack([np.ones_like(places), places]).astype(np.complex64)
        # of the ramp's square the mean is a third; only symbols in the span are correlated
        scale = np.array([[1], [3]]) * (self._period / (span.stop - span.start))
        own = source.conj()
        made = train.filtered(source * (moments.T @ train.filters(pulses)))
        model, direction, last = made, np.complex64(0), np.inf
        for _ in range(_ROUNDS):  # conjugate gradients
            left = frame - model
            power = np.vdot(left[span], left[span]).real
            lags = train.lags(moments @ (own * train.compared(left, span)))
            step = scale * lags
            gain = np.vdot(step, lags).real
            if gain < (_GAIN + 2 * train.length / self._count) * power:
                break
            direction, last = step + gain / last * direction, gain
            made = train.filtered(source * (moments.T @ train.filters(direction)))
            size = np.float32(gain / np.vdot(made[span], made[span]).real)
            pulses += size * direction
            model = model + size * made
        else:
            return None
        pulses += step * np.array([[_SHARE], [1]])
        # one pulse serves a whole piece, so the ramp is a stair; and a carrier or a clock is no straight line for long
        ratio = _drift(pulses)
        lost = ratio * (places[1] - places[0]) ** 2 / 12 + ratio**2 / 45
        if not (ratio < _STEADY and lost * np.vdot(model[span], model[span]).real < _DRIFT * power):
            return None
        power = float(power) / (span.stop - span.start)
        if not power < _CHANGE * self._left:
            return None
        self._left, self._amplitude = min(self._left, power), known.amplitude
        self._pulse = pulses[0].astype(np.complex64)
        self._move(train, known.times, pulses[1])
        return left, model, span

    def _decided(self, outputs: np.ndarray, instant: float) -> _Known | None:
        """Symbols at the times around ``instant``; None if they are not those of this emitter."""
        count = self._count
        first = instant - np.floor((instant - self._side) / self._period) * self._period
        times = np.arange(first, count - self._side - 1, self._period)
        place = 2 * times
        whole = place.astype(np.intp)
        weights = _between().take(np.rint((place - whole) * _STEPS).astype(np.intp), axis=1)
        whole -= 1
        before = sum(weight * outputs[offset:].take(whole) for offset, weight in enumerate(weights))
        return self._read(times, before)

    def _read(self, times: np.ndarray, before: np.ndarray, *, whole: bool = True) -> _Known | None:
        """Symbols of the equaliser's outputs (K,) ``before`` their carrier is taken out, at (K,) ``times``.

        Of a ``whole`` frame a part may be another emitter's, or none's: the rest is read alone.
        """
        turn = turning(self._carrier, times.size)
        straight = before * turn.conj()
        used = times.size - times.size % _BLOCK
        fourth = straight[:used] * straight[:used]
        fourth *= -fourth  # the points stand on the diagonals
        blocks = fourth.reshape(-1, _BLOCK).sum(axis=1)
        mean = blocks.sum()
        if not abs(mean) > _COHERENT * np.abs(blocks).sum():
            return None
        course = np.angle(blocks * mean.conj())
        index = np.arange(blocks.size) - (blocks.size - 1) / 2
        slope = float(index @ course / (index @ index)) / _BLOCK
        late = np.arange(times.size) - (used - 1) / 2
        correction = unit((0.25 * (np.angle(mean) + slope * late)).astype(np.float32))
        turn *= correction
        straight *= correction.conj()
        points = nearest(straight)
        amplitude = np.vdot(points, straight).real / points.size
        wrong = straight * np.float32(1 / amplitude) - points
        rails = wrong[:used].view(np.float32).reshape(-1, 2 * _BLOCK)
        error = np.einsum("bk,bk->b", rails, rails) / _BLOCK
        limit = min(_ERROR, max(_WORSE * self._error, _LEAST))
        good = error < min(_WORST, 2 * limit)
        if whole and not good.all():
            own = _longest(good)
            if own.stop - own.start < _MOSTLY * error.size:
                return None
            # where the other part meets it, a block may be of both
            first = own.start + (own.start > 0)
            last = own.stop - 1 if own.stop < error.size else None
            own = slice(first * _BLOCK, None if last is None else last * _BLOCK)
            return self._read(times[own], before[own], whole=False)
        if not (error.mean() < limit and error.max() < _WORST) or likeness(points) > _ALIKE:
            return None
        return _Known(times, points * turn, amplitude)

    def _move(self, train: Train, times: np.ndarray, drift: np.ndarray) -> None:
        """Carrier and clock from how the pulse drifts over half the frame; times and angles of the next frame.

        A carrier turns the pulse, a clock delays it, both in proportion to time. What else drifts is left to the next
        frame's steps.
        """
        pulse = self._pulse
        turned = 1j * pulse
        late = fft.ifft(fft.fft(pulse) * (-2j * np.pi * fft.fftfreq(pulse.size)))
        both, own, its = (np.vdot(*pair).real for pair in ((turned, late), (pulse, pulse), (late, late)))
        first, second = np.vdot(turned, drift).real, np.vdot(late, drift).real
        angle = (its * first - both * second) / (own * its - both * both)
        delay = (own * second - both * first) / (own * its - both * both)
        self._carrier += angle * self._period / (2 * np.pi * train.half)
        centre = float(times[times.size // 2])
        self._period *= 1 + delay / train.half
        self._instant = centre + round(self._count / self._period) * self._period - self._count


@lru_cache(maxsize=1)
def _between() -> np.ndarray:
    """(4, _STEPS + 1) float32, read-only: Lagrange's weights of four points for each place between the inner two."""
    place = np.arange(_STEPS + 1) / _STEPS
    points = np.arange(-1, 3)
    weights = np.stack(
        [np.prod([(place - q) / (p - q) for q in points if q != p], axis=0) for p in points]
    ).astype(np.float32)
    weights.setflags(write=False)
    return weights


def _longest(good: np.ndarray) -> slice:
    """The longest run of a (n,) bool array."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]])))
    runs = edges.reshape(-1, 2)
    return slice(*max(runs, key=lambda run: run[1] - run[0])) if runs.size else slice(0, 0)


def _drift(pulses: np.ndarray) -> float:
    """Power of the second of two pulses over that of the first."""
    steady, drift = (np.vdot(pulse, pulse).real for pulse in pulses)
    return drift / steady


def _cycles(turn: np.ndarray) -> float:
    """Cycles per symbol of (K,) numbers that turn evenly."""
    step = np.angle(np.vdot(turn[:-1], turn[1:])) / (2 * np.pi)
    steps = turn.size - 1
    rest = np.angle(turn[-1] * np.conj(turn[0]) * np.exp(-2j * np.pi * step * steps)) / (2 * np.pi)
    return float(step + rest / steps)
