"""QPSK whose clock, carrier, equaliser and pulse are known from the frame before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from .between import at, samples_flat
from .clock import Clock, clock_line
from .equaliser import TAPS, Symbols, likeness, turning
from .pieces import Pieces
from .pulse import Train
from .runs import MOSTLY, Blocks, longest_run

__all__ = ["Follower", "can_follow"]

_FEWEST = 200  # symbols in a frame
_STEADY = 0.02  # of a pulse's power: what drifts more jumped, or its clock is wrong
_BLOCKS = Blocks(size=50, fine=10, fewest=_FEWEST)  # of symbols
_ERROR = 0.1  # of the points' power; symbols at random have 0.3
_WORSE, _LEAST = 2.0, 0.005  # error over that of the first frame, and what may be in any case
_ALIKE = 0.3
_GAIN = 0.02  # of what is left, beside what noise gives: less waits for the next frame
_SHARE = 0.3  # of such a step that is kept: the mean over frames has less noise
_BESIDE = 12  # samples on either side of an equaliser, for times between samples
_ROUNDS = 5  # of conjugate gradients
_LONGEST_REST = 7  # frames in which a pulse is not compared again; one more after each that needed no step
_MORE = 1.02  # times the power that was left when it was compared: more, and it is compared
_CHANGE = 8.0  # of the least that was left: more is something new
_DRIFT = 0.25  # of what is left, that a pulse's drift may have left: more, and carrier or clock are wrong


@dataclass
class _Known:
    """Decided symbols of a frame, and the size of the equaliser's outputs."""

    times: np.ndarray
    values: np.ndarray
    amplitude: float
    error: float
    whole: bool  # no other part of the frame is missing


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
        taps = np.zeros(length, dtype=np.complex64)
        taps[length // 2 + (TAPS // 2 - np.arange(TAPS)) * clock.tap_step] = symbols.weights
        self._pieces = Pieces(count, length)
        response = self._pieces.filters(taps)
        self._response = response * _flat(response.size)
        self._train = train
        self._pulse, self._filter = pulses[0].astype(np.complex64), None
        self._error, self._amplitude = symbols.error, 1.0
        self._left = float(np.mean(np.square(np.abs(left[train.known]))))
        self._turned, self._turning = 0.0, np.zeros(0, dtype=np.complex64)
        self._heard, self._still, self._rests, self._rested = self._left, 0, 0, 0
        self._correct(self._pulse, pulses, train, 1.0)
        self._goes_on(symbols.times)

    def follow(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, slice | np.ndarray] | None:
        """What is left of an (n,) complex64 frame, the part that the symbols explain, and the samples in which all
        symbols are known, a slice or (n,) bool; None if the emitter is not as it was.
        """
        pieces, train = self._pieces, self._train
        outputs = pieces.filtered(pieces.transforms(frame) * self._response)
        runs = self._runs(frame, outputs)
        if not runs:
            return None
        louder = np.float32(runs[0].amplitude / self._amplitude)
        runs.sort(key=lambda run: run.times[0])
        if len(runs) == 1:
            times, values = runs[0].times, runs[0].values
        else:
            times = np.concatenate([run.times for run in runs])
            values = np.concatenate([run.values for run in runs])
        train.send(times, values)
        source = train.sources()
        if self._filter is None:
            self._filter = train.filters(self._pulse)
        model = train.filtered(source * (self._filter * louder))
        if not (len(runs) == 1 and runs[0].whole):
            return self._in_parts(frame, model, source, runs)
        left, span = frame - model, train.known
        part = left[span]
        size = np.vdot(part, part).real / part.size
        if self._rests and size < _MORE * self._heard:
            self._rests -= 1
            self._goes_on(times)
            return left, model, span
        before = self._pulse * louder
        compared = self._compared(frame, model, left, source, before)
        if compared is None:
            return None
        left, model, pulses, size, steps = compared
        if not size < _CHANGE * self._left:
            return None
        share = 1.0 if steps and not self._still else _SHARE
        late = self._correct(before, pulses, train, share)
        self._still = 0 if steps > 1 else min(self._still + 1 - steps, _LONGEST_REST)
        self._rests = self._rested = self._still
        self._heard, self._left = size, min(self._left, size)
        self._amplitude, self._filter = runs[0].amplitude, None
        self._goes_on(times, late)
        return left, model, span

    def _runs(self, frame: np.ndarray, outputs: np.ndarray) -> list[_Known]:
        """Runs of symbols of an (n,) ``frame``, with its equaliser's ``outputs`` (n,), the longest first: one, unless
        the emitter stops, or begins anew in this frame.
        """
        count = self._count
        known = self._decided(outputs, self._instant, 0, count)
        if known is None:
            known = self._decided(outputs, clock_line(frame, 1 / self._period), 0, count)
        if known is None or known.whole:
            return [] if known is None else [known]
        beside = 2 * self._period
        begin, end = int(known.times[0] - beside), int(known.times[-1] + beside) + 1
        runs = [known]
        for first, last in ((0, begin), (begin, end), (end, count)):
            if (last - first) / self._period > _FEWEST + self._side / self._period:
                instant = first + clock_line(frame[first:last], 1 / self._period)
                again = self._decided(outputs, instant, first, last)
                if again is not None and first == begin:
                    # one that begins near the times predicted has its own
                    runs[0] = min(known, again, key=lambda run: run.error)
                elif again is not None:
                    runs.append(again)
        return runs

    def _in_parts(
        self, frame: np.ndarray, model: np.ndarray, source: np.ndarray, runs: list[_Known]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """As `follow`, of a frame with several runs, or one that does not fill it. Each has its gain and delay."""
        train = self._train
        late = train.filtered(source * train.filters(_later(self._pulse)))
        model, known = model.copy(), np.zeros(self._count, dtype=bool)
        beside = train.length // 2
        for run in runs:
            span = slice(int(run.times[0]) + beside, max(0, int(run.times[-1]) - beside))
            both = np.stack([model[span], late[span]])
            if both.shape[1] > train.length:
                model[span] = np.linalg.lstsq(both.T, frame[span], rcond=None)[0] @ both
                known[span] = True
        left, count = frame - model, np.count_nonzero(known)
        if count < MOSTLY * known.size:
            return None
        if not np.vdot(left[known], left[known]).real < _CHANGE * self._left * count:
            return None
        self._rests = 0
        self._goes_on(runs[-1].times)
        return left, model, known

    def _compared(
        self, frame: np.ndarray, model: np.ndarray, left: np.ndarray, source: np.ndarray, pulse: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, int] | None:
        """What is left of a frame, what was sent, the (2, length) pulses for the next frame, the power of what is
        left, and the steps of conjugate gradients taken from a ``pulse``, its ``model`` and what that ``left``; None if
        they do not end or the pulse drifts.
        """
        train = self._train
        span, places = train.known, train.places()
        pulses = np.zeros((2, train.length), dtype=np.complex64)
        pulses[0] = pulse
        moments = np.stack([np.ones_like(places), places]).astype(np.complex64)
        # of the ramp's square the mean is a third; only symbols in the span are correlated
        scale = np.array([[1], [3]]) * (self._period / (span.stop - span.start))
        own = source.conj()
        direction, last, steps = np.complex64(0), np.inf, 0
        for _ in range(_ROUNDS):
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
            left = frame - model
            steps += 1
        else:
            return None
        pulses += step
        # one pulse serves a whole piece, so the ramp is a stair; and a carrier or a clock is no straight line for long
        ratio = _drift(pulses)
        lost = ratio * (places[1] - places[0]) ** 2 / 12 + ratio**2 / 45
        if not (ratio < _STEADY and lost * np.vdot(model[span], model[span]).real < _DRIFT * power):
            return None
        return left, model, pulses, float(power) / (span.stop - span.start), steps

    def _decided(self, outputs: np.ndarray, instant: float, begin: int, end: int) -> _Known | None:
        """Symbols at the times around ``instant``, between two samples; None if they are not those of this emitter."""
        meets = end - begin < self._count
        begin, end = max(begin, self._side), min(end, self._count - self._side - 1)
        first = instant - np.floor((instant - begin) / self._period) * self._period
        times = np.arange(first, end, self._period)
        if times.size < _FEWEST:
            return None
        if self._turning.size < times.size or self._turned != self._carrier:
            self._turned, self._turning = self._carrier, turning(self._carrier, times.size + 1)
        limit = min(_ERROR, max(_WORSE * self._error, _LEAST))
        run = longest_run(at(outputs, times), self._turning[: times.size], _BLOCKS, limit, meets=meets)
        if run is None or likeness(run.points) > _ALIKE:
            return None
        whole = run.points.size == times.size
        return _Known(times[run.begin : run.end], run.points * run.turn, run.amplitude, run.error, whole)

    def _correct(self, before: np.ndarray, pulses: np.ndarray, train: Train, share: float) -> float:
        """Take over a ``share`` of what changes the pulse known ``before`` to the (2, length) ``pulses`` of a frame.
        Returns by how many samples its symbols are late.

        What delays the pulse is no change of it, but of the symbols' times, and comes of the clock in the frames since
        one was compared. How the pulse drifts over half the frame corrects carrier and clock: a carrier turns it, a
        clock delays it, both in proportion to time. What else drifts is left to the next frame's steps.
        """
        turned = 1j * before
        late = _later(before)
        both, own, its = (np.vdot(*pair).real for pair in ((turned, late), (before, before), (late, late)))
        gram = np.array([[own, both], [both, its]])
        changes = np.stack([pulses[0] - before, pulses[1]])
        along = (changes @ np.stack([turned, late]).conj().T).real
        (_, delay), (angle, stretch) = np.linalg.solve(gram, along.T).T
        self._pulse = (before + share * (changes[0] - delay * late)).astype(np.complex64)
        self._carrier += share * angle * self._period / (2 * np.pi * train.half)
        self._period *= 1 + share * stretch / train.half + _SHARE * delay / ((self._rested + 1) * self._count)
        return float(delay)

    def _goes_on(self, times: np.ndarray, late: float = 0.0) -> None:
        """Time of a symbol of the next frame, from the ``times`` in this one, which were too early by ``late``."""
        centre = float(times[times.size // 2]) + late
        self._instant = centre + round(self._count / self._period) * self._period - self._count


@lru_cache(maxsize=4)
def _flat(size: int) -> np.ndarray:
    """(size,) float32, read-only: `samples_flat` of a piece's transform."""
    factors = samples_flat(fft.fftfreq(size))
    factors.setflags(write=False)
    return factors


def _later(pulse: np.ndarray) -> np.ndarray:
    """(length,) change of a pulse per sample by which it is delayed."""
    return fft.ifft(fft.fft(pulse) * (-2j * np.pi * fft.fftfreq(pulse.size)))


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
