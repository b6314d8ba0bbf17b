"""QPSK and OFDM of like power in one band, read in turns: each is decided with the other one subtracted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..waveform import Waveform
from .ofdm.acquisition import transforms
from .ofdm.demodulated import Demodulated, straightened
from .ofdm.demodulator import AGAIN, MORE, once_more
from .ofdm.echoes import grown
from .ofdm.gain import misfit
from .ofdm.lattice import DENSE
from .ofdm.received import Received
from .ofdm_cancel import OfdmCancel
from .qpsk.clock import Clock, find_clocks
from .qpsk.equaliser import Equaliser, Symbols, nearest
from .qpsk.sequence import decide_sequence, other_decisions
from .qpsk.trains import Impulses, Pulse, Steps, SymbolTrain

__all__ = ["JointCancel"]

_CONTRAST = 28.0  # of the clock's line under the other signal, as in `QpskCancel`
_CLEARER = 10.0  # the same, where that is subtracted
_ERROR = 0.2  # of the points' power, at first; symbols at random have 0.3
_ALIKE = 0.3  # correlation of neighbouring points: more is no data
_STARTS = (0, 1, -1)  # half symbols off the middle, from which the equaliser begins
_FAINTEST = 0.2  # of the frame's amplitude without QPSK: less, and `QpskCancel` reads that alone
_ROUNDS = 4
_READ = 0.02  # mean error of all OFDM symbols, where nothing is left to be mended
_MENDS = 0.97  # of the error that was left, for one more round
_AMISS = 0.1  # error of an OFDM symbol in which QPSK may be misread
_TRIED = 40  # other decisions in such a symbol, the likeliest ones
_PASSES = 3
_WON = 0.05  # error that another decision has to gain
_BESIDE = 20  # samples on either side of an OFDM symbol, from which a pulse reaches into it
_SKEWED = 0.3  # error of an OFDM symbol whose phase is searched
_TURNS = np.exp(1j * np.pi / 36 * np.arange(-9, 9)).astype(np.complex64)
_TURNED = 0.04  # error that a turn has to gain
_SPOILT = 0.2  # error of an OFDM symbol that is blanked
_ENOUGH = 0.65  # of the OFDM symbols have to be read
_TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class _Ofdm(Demodulated):
    """OFDM of a frame as it was read, and what `OfdmCancel` keeps of it."""

    lock: object


class _OfdmReader(OfdmCancel):
    """Reads a frame and subtracts nothing; each frame for itself."""

    _unequal = False  # what QPSK leaves would pass for users of other powers
    _moving = False  # or for a channel that moves

    def read(self, frame: np.ndarray) -> _Ofdm | None:
        """OFDM of an (N,) frame of unit power, None without."""
        self.reset()
        self._found: _Ofdm | None = None
        self._find(frame)
        return self._found

    def _less(self, read: Demodulated, lock: object) -> None:
        self._found = _Ofdm(**vars(read), lock=lock)

    def less(self, ofdm: _Ofdm) -> np.ndarray | None:
        """(N,) the frame that was read less its OFDM, None if too little was read."""
        return super()._less(ofdm, ofdm.lock)

    def again(self, ofdm: _Ofdm, frame: np.ndarray) -> _Ofdm:
        """The same read once more, from a ``frame`` (N,) of which more is known."""
        samples = straightened(frame, ofdm.carrier, ofdm.numerology).samples
        numerology, before = ofdm.numerology, ofdm.received
        symbols = transforms(samples, ofdm.grid.starts, numerology) * before.phase
        before = _upright(replace(before, symbols=symbols), ofdm.clear & ofdm.grid.used)
        tried = (once_more(ofdm.grid, ofdm.clear, before, numerology, turns) for turns in (AGAIN, MORE))
        received = min(tried, key=lambda one: one.misread.mean())
        if received.misread.mean() > _READ:
            received = grown(ofdm.grid, ofdm.clear, received, numerology)
        return replace(ofdm, straight=ofdm.straight.of(samples), received=received)

    def model(self, ofdm: _Ofdm) -> np.ndarray:
        """(N,) samples of what was decided."""
        received, grid = ofdm.received, ofdm.grid
        elements = received.channel * received.points * received.phase.conj() * grid.used
        all_of = np.ones(len(elements), dtype=bool)
        out = self._modulator.samples(elements, all_of, grid.starts, ofdm.numerology)
        return out if ofdm.straight.turn is None else out * ofdm.straight.turn.conj()

    @staticmethod
    def edges(ofdm: _Ofdm, count: int) -> np.ndarray:
        """(L + 1,) samples at which the symbols begin, in the middle of their prefixes, and the last one ends."""
        numerology, starts = ofdm.numerology, ofdm.grid.starts
        half = numerology.prefix / 2
        edges = np.append(starts - half, starts[-1] + numerology.useful + half)
        return edges.round().astype(int).clip(0, count)

    def fits(self, ofdm: _Ofdm, rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Function that gives the errors (rows,) of those OFDM symbols, in cells, from an (N,) frame."""
        numerology, grid, received = ofdm.numerology, ofdm.grid, ofdm.received
        asked = (ofdm.clear & grid.used)[rows]
        factor = received.phase[rows] / np.broadcast_to(received.channel, received.symbols.shape)[rows]
        alphabets = [(DENSE[int(np.median(received.kinds[row]))],) for row in rows]

        def errors(frame: np.ndarray) -> np.ndarray:
            straight = straightened(frame, ofdm.carrier, numerology).samples
            values = transforms(straight, grid.starts[rows], numerology) * factor
            parts = zip(values[:, None], asked[:, None], alphabets, strict=True)
            return np.array([misfit(*part) for part in parts])

        return errors


def _upright(received: Received, asked: np.ndarray) -> Received:
    """The same with symbols that fit no alphabet turned by the angle with which they fit best."""
    symbols, phase, angles = received.symbols.copy(), received.phase.copy(), received.angles.copy()
    channel = np.broadcast_to(received.channel, symbols.shape)
    for row in np.flatnonzero(received.misread > _SKEWED):
        values, part = symbols[row] / channel[row], asked[row : row + 1]
        left = [misfit((values * turn)[None], part) for turn in _TURNS]
        best = int(np.argmin(left))
        if left[best] < left[_TURNS.size // 2] - _TURNED:
            symbols[row] *= _TURNS[best]
            phase[row] *= _TURNS[best]
            angles[row] -= np.angle(_TURNS[best])
    return replace(received, symbols=symbols, phase=phase, angles=angles)


class JointCancel:
    """Blind demodulation and subtraction of QPSK and OFDM that neither of the two methods can read under the other.

    QPSK is decided as a sequence, since the OFDM hides only a part of its spectrum. Its pulse is fitted and subtracted,
    the OFDM is read, and QPSK is decided again with that subtracted. Where OFDM symbols stay misread, the likeliest
    other decisions of the sequence are tried: right ones bring the elements back to the points of their lattice.
    OFDM symbols that are misread in the end are blanked; if they are many, the frame is given up.

    Parameters
    ----------
    waveform : Waveform
    span_m : float or None
        See `OfdmCancel`.

    Notes
    -----
    A frame that holds both costs some 5,000 transforms of its length, one without QPSK 6. Each is read for itself.
    """

    def __init__(self, waveform: Waveform, *, span_m: float | None = None) -> None:
        self._ofdm = _OfdmReader(waveform, span_m=span_m)

    def cancel(self, frame: np.ndarray) -> np.ndarray | None:
        """(N,) complex64 frame, of which tones are taken away, less QPSK and OFDM; None if it is not both of them."""
        mean = float(np.vdot(frame, frame).real) / frame.size
        if not _TINY < mean < np.inf:
            return None
        level = np.float32(np.sqrt(mean))
        frame = frame * (1 / level)
        found = _first(frame)
        if found is None:
            return None
        ofdm, scale = self._read(frame, *found) or (None, None)
        return None if ofdm is None else self._worth(ofdm, frame.size, scale * level)

    def _read(self, frame: np.ndarray, symbols: Symbols, clock: Clock) -> tuple[_Ofdm, np.float32] | None:
        """The OFDM of a frame less its QPSK, and the level that frame was divided by; None if one cannot be read."""
        train, pulse = _likelier(frame, symbols, clock)
        points, ofdm, other, inside = train.points, None, np.zeros_like(frame), slice(0, frame.size)
        qpsk, best = pulse.heard(points), None
        for number in range(_ROUNDS):
            heard = frame - other
            if number == 1:
                again = self._retimed(heard, heard - qpsk, train, symbols, clock)
                if again is None:
                    return None
                train = again
            if number < 2:
                outputs = train.outputs(frame, frame - qpsk)
                points = decide_sequence(outputs, nearest(outputs))
            if number:
                # where the other signal was read, symbols are decided without it
                edges = self._ofdm.edges(ofdm, frame.size)
                row = np.searchsorted(edges, train.times) - 1
                read = np.append(ofdm.received.misread < _AMISS, False)[row]  # False before the first, too
                points = np.where(read, nearest(train.outputs(heard, heard - qpsk)), points)
            pulse = Pulse(heard, train, points, inside)
            left = frame - pulse.heard(points)
            if ofdm is None:
                level = np.float32(np.sqrt(np.vdot(left, left).real / left.size))
                ofdm = self._ofdm.read(left * (1 / level)) if level > _FAINTEST else None
                if ofdm is None:
                    return None
            else:
                ofdm = self._ofdm.again(ofdm, left * (1 / level))
                if ofdm.received.misread.mean() > _AMISS:
                    anew = self._ofdm.read(left * (1 / level))
                    if anew is not None and anew.received.misread.mean() < ofdm.received.misread.mean():
                        ofdm = anew
            better = self._other(frame, level, ofdm, train, pulse, outputs, points)
            if better is not points:
                points = better
                ofdm = self._ofdm.again(ofdm, (frame - pulse.heard(points)) * (1 / level))
            error, before = ofdm.received.misread.mean(), best.received.misread.mean() if best else np.inf
            best = ofdm if error < before else best
            if number and (error < _READ or error > _MENDS * before):
                break
            qpsk, other = pulse.heard(points), self._ofdm.model(ofdm) * level
            edges = self._ofdm.edges(ofdm, frame.size)
            inside = slice(edges[0], edges[-1])
        return best, level

    @staticmethod
    def _retimed(
        frame: np.ndarray, rest: np.ndarray, train: SymbolTrain, symbols: Symbols, clock: Clock
    ) -> SymbolTrain | None:
        """The train with the times that a ``frame`` (N,) without the other signal tells; None if it has none."""
        if isinstance(train, Steps):
            return Steps(frame, rest, symbols, clock)
        clock = min(
            [*find_clocks(frame, _CLEARER), clock], key=lambda one: (one is clock, abs(one.rate - clock.rate))
        )
        again = Equaliser(frame, clock).symbols(symbols.weights)
        return None if again is None else Impulses(again, clock, frame.size)

    def _other(
        self,
        frame: np.ndarray,
        level: np.float32,
        ofdm: _Ofdm,
        train: SymbolTrain,
        pulse: Pulse,
        outputs: np.ndarray,
        points: np.ndarray,
    ) -> np.ndarray:
        """(K,) points with other decisions where misread OFDM symbols fit better with them; the same where none do.

        The n-th likeliest decisions in all those symbols are tried at once, since none reaches into another.
        """
        rows = np.flatnonzero(ofdm.received.misread > _AMISS)
        if not rows.size:
            return points
        events = other_decisions(outputs, points)
        edges, times = self._ofdm.edges(ofdm, frame.size), train.times[events.begins]
        likely = []
        for row in rows:
            near = np.flatnonzero((times > edges[row] - _BESIDE) & (times < edges[row + 1] + _BESIDE))
            likely.append(near[np.argsort(events.cost[near])[:_TRIED]])
        errors = self._ofdm.fits(ofdm, rows)

        def left(tried: np.ndarray) -> np.ndarray:
            return errors((frame - pulse.heard(tried)) * (1 / level))

        now = left(points)
        for _ in range(_PASSES):
            table = np.full((_TRIED, rows.size), np.inf)
            for rank in range(_TRIED):
                tried, asked = (
                    points.copy(),
                    [number for number, near in enumerate(likely) if rank < near.size],
                )
                for number in asked:
                    events.flip(tried, likely[number][rank])
                table[rank, asked] = left(tried)[asked]
            best = table.argmin(axis=0)
            won = np.flatnonzero(table.min(axis=0) < now - _WON)
            if not won.size:
                break
            points = points.copy()
            for number in won:
                events.flip(points, likely[number][best[number]])
            now = left(points)
        return points

    def _worth(self, ofdm: _Ofdm, count: int, level: np.float32) -> np.ndarray | None:
        """(N,) what is left of a frame, blanked where it was not read; None if that is much of it."""
        read = ofdm.received.misread <= _SPOILT
        if np.count_nonzero(read) < _ENOUGH * read.size:
            return None
        out = self._ofdm.less(ofdm)
        if out is None:
            return None
        edges = self._ofdm.edges(ofdm, count)
        out[: edges[0]] = out[edges[-1] :] = 0
        for row in np.flatnonzero(~read):
            out[edges[row] : edges[row + 1]] = 0
        return out * level


def _first(frame: np.ndarray) -> tuple[Symbols, Clock] | None:
    """QPSK of a frame as the equaliser decides it under the other signal, and its clock; None without."""
    for clock in find_clocks(frame, _CONTRAST):
        equaliser = Equaliser(frame, clock)
        for start in _STARTS:
            symbols = equaliser.symbols(equaliser.blind(start))
            if symbols is None:
                break
            if symbols.alike < _ALIKE and symbols.error < _ERROR and symbols.busy == 1:
                return symbols, clock
    return None


def _likelier(frame: np.ndarray, symbols: Symbols, clock: Clock) -> tuple[SymbolTrain, Pulse]:
    """Impulses or steps, whichever leave less of a frame, and the pulse that goes with them."""
    whole = slice(0, frame.size)
    impulses = Impulses(symbols, clock, frame.size)
    pulse = Pulse(frame, impulses, impulses.points, whole)
    steps = Steps(frame, frame - pulse.heard(impulses.points), symbols, clock)
    held = Pulse(frame, steps, steps.points, whole)
    inner = impulses.known
    rests = [(frame - p.heard(t.points))[inner] for t, p in ((impulses, pulse), (steps, held))]
    return (
        (steps, held)
        if np.vdot(rests[1], rests[1]).real < np.vdot(rests[0], rests[0]).real
        else (impulses, pulse)
    )
