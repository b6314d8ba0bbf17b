"""Cancellation of OFDM: demodulate what a 4G or 5G base station sends, subtract it, keep the return."""

from __future__ import annotations

import cmath
from dataclasses import dataclass, replace

import numpy as np

from ..receiver.altimeter_settings import AltimeterSettings
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .ofdm.acquisition import Grid, find_prefix, transforms
from .ofdm.at_rest import at_rest
from .ofdm.burst import loud_burst
from .ofdm.carrier import TURNS, carrier_step, course
from .ofdm.demodulated import Demodulated, Straight, straightened
from .ofdm.demodulator import AGAIN, READ, demodulate, once_more
from .ofdm.emission import READABLE, Emission, emission, faint_emission
from .ofdm.first_reading import Opened
from .ofdm.front_end import FrontEnd, front_end
from .ofdm.gain import gain, usual_misfit
from .ofdm.lattice import DENSE, FAINT, middle, power, unit
from .ofdm.long_prefix import well_placed
from .ofdm.modulator import BLANKED, Modulator
from .ofdm.numerology import SPACINGS_HZ, Numerology
from .ofdm.received import Before, Received
from .ofdm.ridge import Ridge
from .ofdm.settled import Returned
from .ofdm.steady import Reading, Steady, read_on, steady
from .ofdm.still import still
from .ofdm.thorough import read_thoroughly
from .ofdm.tones import without_tones
from .outcome import PASSED, Outcome

__all__ = ["OfdmCancel"]

_CONTRAST = 4.5  # of the prefix over its scatter: noise and the bench's other emitters stay below
_SHORT = 0.4  # of a frame: a burst that is blanked where it cannot be read
_SHORTER = 0.36  # of a frame: a burst that is better blanked than read by its few symbols
_CERTAIN = 8.0  # no other spacing has so much
# mean squared power over squared mean power: OFDM has 2 and more, a sweep 4 dB over the noise less
_UNEVEN = 1.5
_COHERENCE = 0.2  # of fourth powers with the channel of the frame before; 64QAM has 0.45, another timing 0.05
_DOUBTFUL = 0.1  # mean error of a symbol in cells from which the channel is not taken over
_UNSURE = 0.15  # error of the best symbol at first, from which QPSK and noise may explain the frame, too
_AS_GOOD = 0.4  # of what nearest points explain, for QPSK and noise to do so with far fewer of them
_HOPELESS = 0.35  # error of the best symbol at first: noise leaves 0.45 and more, a moving channel 0.22
_SEARCH_FFTS, _TRACKING_FFTS, _PREFIX_FFTS = (
    300.0,
    15.0,
    5.0,
)  # FFTs of 7,500 points that a frame costs in the median
_PATIENCE = 8  # looks in vain, one after the other, at a prefix whose symbols cannot be read
_PAUSE = 8  # from then on one frame in eight is looked at
_STRAYED = 0.25  # mean error of what is sent: another emitter, whose symbols fit no alphabet there, has 0.5
_LOST = 0.25  # of a frame's symbols: an emitter that is looked for anew
_ASKED = 7  # one subcarrier in seven tells the gain
_PREDICTED = 0.15  # misfit in cells up to which a frame goes on as predicted; that of other signals is 0.3
_SOME = 3  # one subcarrier in three tells the symbols' phases
_TINY = float(np.finfo(np.float32).tiny)
_STILL = 0.004  # samples of timing that need no new phases
_DRIFTS = 0.3  # of what a frame tells of the clock's drift
_ASKED_AGAIN = 4  # one such frame in four is asked whether a return larger than a cell has changed
_READ_ON = 63  # frames that are read with what one told of them, before all is judged anew


@dataclass
class _Lock:
    """What earlier frames tell of an emitter; times in samples of the next frame."""

    numerology: Numerology
    ridge: Ridge
    first_long: float
    carrier: float
    channel: np.ndarray
    used: np.ndarray
    shift: float
    level: float = 1.0
    tones: bool = False
    before: Before | None = None
    misfit: float = 0.0
    usual: float = 1.0
    sir_db: float | None = None
    steady: Steady | None = None
    read_on: int = 0
    front_end: FrontEnd | None = None
    heard_through: bool = False  # whether the front end was looked for
    ramp: tuple[float, np.ndarray, np.ndarray] | None = None  # the last of `_ramp`, and its ``first_long``
    drift: float = 0.0  # samples that its clock loses in a frame
    left: float | None = None  # samples by which the last frame was late, less what was made up for


class OfdmCancel(Mitigation):
    """Blind demodulation and subtraction of cyclic-prefix OFDM (LTE and NR downlinks of 15 or 30 kHz).

    Card: *decision-directed cancellation.* The prefix gives spacing, timing and carrier. The fourth power of the
    subcarriers gives the place of the long prefix and all phases. Points and channel are estimated in turns from
    elements that no return can be in, about five of six. In the other elements the nearest point is subtracted. Where
    the return is larger than a cell of the constellation, the mean of the return given all near points is kept instead.
    Tones on top are fitted and subtracted before. Once found, an emitter is followed from frame to frame. One that
    could not be read in eight frames is looked for in every eighth. Frames without such a signal pass bit for bit. What
    cannot be demodulated stays: the emitter's own noise, other interference on top of it, several antennas' streams.
    Of QPSK that such noise hides the mean is subtracted, given what was received. Short bursts are blanked.

    Parameters
    ----------
    span_m : float or None
        Highest altitude whose return must not be taken for data, above 0; None is the default altimeter's.

    Attributes
    ----------
    found, followed : int
        Frames in which an emitter was acquired, and frames in which it was followed from the frame before.
    busy : float
        Share of the symbols in which the emitter sent, in the last frame that had one.
    misread : float
        Mean error of that frame's symbols in cells, each at most 1; noise has 0.75.

    Notes
    -----
    What is used of the emitter: the frame structure of TS 38.211 clause 5.3.1 and TS 36.211 clause 6.12, and the
    alphabets. No cell identity, pilots, payload or allocation. The rate has to be a multiple of 30 kHz, so that a
    symbol is a whole number of samples.

    Raises
    ------
    MitigationError
        If the rate does not fit or ``span_m`` is out of range.
    """

    name = "ofdm_cancel"
    style = PlotStyle("#882255", "D", (0, (5, 1, 1, 1)))
    _unequal = True  # whether users may have powers of their own
    _moving = True  # whether the channel may move

    def __init__(self, waveform: Waveform, *, span_m: float | None = None) -> None:
        wide = SPACINGS_HZ[-1]
        if waveform.rate_hz % wide or waveform.rate_hz < 64 * wide:
            raise MitigationError(
                f"ofdm_cancel: rate_hz is {waveform.rate_hz:g}; it has to be a multiple of {wide:g}, "
                f"at least {64 * wide:g}"
            )
        if waveform.sweep_s < 0.3e-3:
            raise MitigationError(
                f"ofdm_cancel: sweep_s is {waveform.sweep_s:g}; a frame shorter than 0.3e-3 holds too few symbols"
            )
        if span_m is not None and not 0 < span_m < np.inf:
            raise MitigationError(
                f"ofdm_cancel.span_m is {span_m!r}; it has to be a finite number of metres above 0"
            )
        self.span_m = span_m or AltimeterSettings().resolved(waveform).max_altitude_m
        kinds = [Numerology(waveform.rate_hz, spacing_hz) for spacing_hz in SPACINGS_HZ]
        self._returned = Returned(waveform, self.span_m)
        self._kinds = [(kind, Ridge(waveform, kind, self.span_m)) for kind in kinds]
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.found = self.followed = 0
        self.busy = self.misread = 0.0
        self._contrast = 0.0  # of the prefix, in the last frame that was searched
        self.outcome = PASSED
        self._vain = 0  # frames since one had no prefix or could be read
        self._lock: _Lock | None = None
        self._modulator = Modulator(self.waveform.samples_per_frame)

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that held an emitter."""
        return super().status() | {"found": self.found, "followed": self.followed}

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = np.empty_like(batch)
        for row, frame in zip(out, batch, strict=True):
            cancelled = self.cancel(frame)
            row[:] = self._unread(frame) if cancelled is None else cancelled
        return out

    def _unread(self, frame: np.ndarray) -> np.ndarray:
        """A frame without the short and loud burst in it that may be OFDM, but could not be read; or as it is."""
        burst = loud_burst(frame, _SHORT) if self._contrast >= _CONTRAST else None
        return frame if burst is None else np.where(burst, 0, frame)

    @property
    def tracking(self) -> bool:
        """Whether an emitter is known from the frame before, so that ``cancel(frame, search=False)`` may cancel it."""
        return self._lock is not None

    def cancel(self, frame: np.ndarray, *, search: bool = True) -> np.ndarray | None:
        """(N,) complex64: a finite frame without its OFDM; None if it has none that can be demodulated.

        ``search=False`` only tracks an emitter of the frame before.
        """
        out = self.follow(frame)
        self.outcome = PASSED if out is None else Outcome("tracked", ffts=_TRACKING_FFTS)
        if out is None and search:
            out = self._searched(frame)
            state = "passed" if out is None else "acquired"
            self.outcome = Outcome(
                state, ffts=_SEARCH_FFTS if self._vain or out is not None else _PREFIX_FFTS
            )
        return out

    def _searched(self, frame: np.ndarray) -> np.ndarray | None:
        """The frame without an emitter that is searched."""
        if not _audible(frame):
            return None
        if self._vain > _PATIENCE and self._vain % _PAUSE:
            self._vain += 1
            return None
        heard = without_tones(frame)
        tones = heard is not None
        heard = heard if tones else frame
        level = float(np.sqrt(np.vdot(heard, heard).real / frame.size))
        out = self._find(heard * np.float32(1 / level))
        if out is None:
            return None
        self.found += 1
        self._vain = 0
        if self._lock:
            self._lock.level, self._lock.tones = level, tones
        return out * np.float32(level)

    def follow(self, frame: np.ndarray) -> np.ndarray | None:
        """The same if the emitter of the frame before goes on; None if it does not, or there was none."""
        lock = self._lock
        if lock is None or not _audible(frame):
            return None
        heard = without_tones(frame) if lock.tones else None
        out = self._follow((frame if heard is None else heard) * np.float32(1 / lock.level))
        if out is None:
            self._lock = None
            return None
        self.followed += 1
        return out * np.float32(lock.level)

    def _find(self, frame: np.ndarray) -> np.ndarray | None:
        """A frame without its OFDM, acquired without earlier frames; None if none can be demodulated."""
        size = power(frame)
        if np.vdot(size, size) < _UNEVEN * size.size:
            return None  # a sweep meets itself a symbol later, too
        prefix = None
        for kind, its_ridge in self._kinds:
            found = find_prefix(frame, kind)
            if prefix is None or found.contrast > prefix.contrast:
                prefix, numerology, ridge = found, kind, its_ridge
            if found.contrast > _CERTAIN:
                break
        self._contrast = prefix.contrast
        if prefix.contrast < _CONTRAST:
            self._vain = 0
            return None
        burst = loud_burst(frame, _SHORTER)
        if burst is not None:
            self.busy = np.count_nonzero(burst) / burst.size
            return np.where(burst, 0, frame)
        self._vain += 1
        opened = Opened(frame, prefix, numerology, ridge)
        if not opened.is_wide():
            return None
        first = opened.read()
        best = float(first.received.misread.min()) if first else 1.0
        if best > _UNSURE:
            out = self._faint(opened, first if best <= _HOPELESS else None)
            if out is not None or best > _HOPELESS:
                return out
        if first.misread <= READ or not self._returned.seen(frame):
            first = self._thoroughly(first)
        read = still(at_rest(first), self._modulator).retraced()
        grid = read.grid
        lock = _Lock(numerology, ridge, grid.first_long, read.carrier, grid.channel, grid.used, read.shift)
        return self._less(read, lock)

    def _faint(self, opened: Opened, first: Demodulated | None) -> np.ndarray | None:
        """A frame less the mean of QPSK under noise; None where that does not help, or what was read explains more."""
        least, frame = 0.0, first or opened
        if first is not None:
            own, beside, received = power(first.grid.symbols), first.clear & first.grid.used, first.received
            rest = received.symbols - received.channel * received.points
            least = _AS_GOOD * float((own * beside).sum() / max((power(rest) * beside).sum(), FAINT))
        sent = faint_emission(frame.grid, frame.clear, frame.numerology, least)
        return (
            None
            if sent is None
            else self._subtracted(frame.straight, sent, frame.grid.starts, frame.numerology)
        )

    def _thoroughly(self, first: Demodulated) -> Demodulated:
        """A frame read thoroughly, with the long prefix where its symbols can be read."""
        grid, clear, numerology = first.grid, first.clear, first.numerology
        received = read_thoroughly(grid, clear, first.received, numerology, unequal=self._unequal)
        placed, received = well_placed(grid, clear, received, numerology)
        if placed is not grid:
            received = read_thoroughly(placed, clear, received, numerology, unequal=self._unequal)
        return replace(first, grid=placed, received=received)

    def _follow(self, frame: np.ndarray) -> np.ndarray | None:
        """A frame without its OFDM, followed from the frame before; None if that signal is gone."""
        lock = self._lock
        numerology = lock.numerology
        if lock.front_end:
            frame = lock.front_end.without(frame)
        starts, ramp = self._ramp(lock)
        straight = straightened(frame, lock.carrier, numerology)
        symbols = transforms(straight.samples, starts, numerology) * ramp
        clear = lock.ridge.clear(starts, lock.carrier)
        angle, channel, phase = np.zeros(len(starts)), lock.channel, ramp
        if lock.read_on and lock.steady.clear is clear:
            grid = Grid(starts, lock.first_long, symbols, phase, channel, lock.used, angle)
            reading = read_on(lock.steady, grid, numerology, ask=lock.read_on % _ASKED_AGAIN == 0)
            if reading is not None:
                lock.read_on -= 1
                self.busy = 1.0
                self._keep(lock, grid, reading, middle(reading.misread))
                every = np.ones(len(starts), dtype=bool)
                return self._modulator.subtract(
                    straight.samples, straight.turn, reading.elements, every, starts, numerology
                )
        trusted = clear & lock.used
        some = slice(None, None, _ASKED)
        asked = trusted[:, some]
        values = symbols[:, some] * (1 / channel[some])
        usual = (DENSE[lock.before.likely[0]],) if lock.before.likely else DENSE
        if usual_misfit(values, asked, usual) > _PREDICTED and usual_misfit(values, asked) > _PREDICTED:
            angle = self._angles(symbols, starts, clear, lock)
            if angle is None:
                return None
            own = np.exp(-1j * angle).astype(np.complex64)[:, None]
            symbols, phase = symbols * own, ramp * own
            factor, lock.misfit = gain(symbols[:, some] * (1 / channel[some]), asked, lock.misfit)
            channel = channel / factor
        grid = Grid(starts, lock.first_long, symbols, phase, channel, lock.used, angle)
        received = demodulate(grid, clear, numerology, AGAIN, lock.before)
        if middle(received.misread) > max(_DOUBTFUL, 2 * lock.usual):
            # as far off as the channel had moved; now it is known
            received = once_more(grid, clear, received, numerology, AGAIN)
        read = Demodulated(numerology, lock.carrier, straight, grid, clear, received, lock.shift)
        read = still(read, self._modulator)
        received = read.received
        misread = received.misread
        usual = middle(misread)
        # a frame of little else than silence is read without errors, whatever else is in it
        told = received.capped[:, some][asked & (received.points[:, some] != 0)]
        if (
            not told.size
            or told.mean() > _STRAYED
            or usual > min(READABLE, max(3 * lock.usual, _DOUBTFUL))
            or np.count_nonzero(misread > max(2 * _DOUBTFUL, 2 * usual)) > _LOST * misread.size
        ):
            return None
        if not lock.heard_through:
            lock.front_end, lock.heard_through = self._front_end(read), True
        return self._less(read, lock)

    def _front_end(self, read: Demodulated) -> FrontEnd | None:
        """What the receiver adds, by the symbols of a frame that were read."""
        received, straight = read.received, read.straight
        elements = received.channel * received.points * received.phase.conj()
        readable = received.misread <= READABLE
        model = self._modulator.samples(elements, readable, read.grid.starts, read.numerology)
        rest = (straight.samples - model) * (model != 0)
        if straight.turn is not None:
            model, rest = model * straight.turn.conj(), rest * straight.turn.conj()
        level = power(rest)
        rest *= level <= np.float32(BLANKED) * middle(level)
        return front_end(model, rest)

    @staticmethod
    def _angles(symbols: np.ndarray, starts: np.ndarray, clear: np.ndarray, lock: _Lock) -> np.ndarray | None:
        """(L,) angles by which symbols are ahead of the prediction, modulo a quarter turn; None if they are others."""
        some = slice(None, None, _SOME)
        fourth = symbols[:, some] * (1 / lock.channel[some])
        size = power(fourth)
        fourth *= fourth
        fourth *= fourth
        fourth *= (clear[:, some] & lock.used[some] & (size > 0.1)) / (size + np.float32(0.05))
        agree = fourth.sum(axis=1)
        if np.abs(agree).sum() <= _COHERENCE * np.abs(fourth).sum():
            return None
        # points of QPSK and QAM stand on the diagonals: their fourth power is negative
        return course(-agree, lock.numerology.halves(starts, lock.first_long)) / 4

    def _ramp(self, lock: _Lock) -> tuple[np.ndarray, np.ndarray]:
        """Windows of the symbols, and the phases by which each is late: (L,) int, (L, K) complex64."""
        if lock.ramp is None or lock.ramp[0] != lock.first_long:
            times = lock.numerology.times(lock.first_long, self.waveform.samples_per_frame)
            held, starts = lock.numerology.windows(times, self.waveform.samples_per_frame)
            moved = np.inf if lock.ramp is None else lock.first_long - lock.ramp[0]
            # a carrier that is whole subcarriers off turns symbols by their times
            shift = 2 * np.pi / lock.numerology.useful * lock.shift
            turn = lock.numerology.turn - np.float32(shift)
            if abs(moved) < 1 and np.array_equal(starts, lock.ramp[1]):
                ramp = lock.ramp[2] * unit(np.float32(moved) * turn)
            else:
                late = (starts - times[held]).astype(np.float32)
                ramp = unit(-late[:, None] * turn - np.float32(shift * starts[:, None]))
            lock.ramp = lock.first_long, starts, ramp
        return lock.ramp[1:]

    def _less(self, read: Demodulated, lock: _Lock) -> np.ndarray | None:
        """The frame less what was demodulated, None if nothing was; ``lock`` is updated for the next frame."""
        grid, clear, received = read.grid, read.clear, read.received
        sent = emission(received, grid, clear, lock.sir_db)
        if sent is None:
            return None
        out = self._subtracted(read.straight, sent, grid.starts, read.numerology)
        if self._moving and received.channel.ndim > 1:
            settled = self._returned.settled(read, sent, out, self._modulator)
            if settled is None:
                return None
            received, sent, out = settled
        if sent.sir_db is not None:
            lock.sir_db = sent.sir_db  # kept while frames need none: at the limit the data decide which do
        lock.before = received.as_before(clear & grid.used)
        # the frame after the first one is judged anew in any case
        if lock.heard_through:
            lock.steady = steady(received, grid, clear, lock.before.likely, sent, lock.sir_db)
            lock.read_on = _READ_ON if lock.steady else 0
        self._keep(lock, grid, received, middle(received.misread))
        return out

    def _subtracted(
        self, straight: Straight, sent: Emission, starts: np.ndarray, numerology: Numerology
    ) -> np.ndarray:
        """(N,) complex64: the frame less what was sent in it, with its carrier again."""
        self.busy, self.misread = sent.busy, sent.misread
        return self._modulator.subtract(
            straight.samples,
            straight.turn,
            sent.elements,
            sent.readable,
            starts,
            numerology,
            alike=sent.kept is not None,
        )

    def _keep(self, lock: _Lock, grid: Grid, received: Received | Reading, usual: float) -> None:
        """Keep what the next frame needs."""
        numerology, samples = lock.numerology, self.waveform.samples_per_frame
        step = carrier_step(received.angles, received.weight, numerology)
        step = step if abs(step) < TURNS else 0.0
        # angle of the carrier at the frame's end, modulo a quarter turn
        left = 2 * np.pi / numerology.useful * (samples - grid.starts - numerology.useful / 2)
        ahead = cmath.phase(received.weight @ np.exp(4j * (received.angles + step * left))) / 4
        ahead += 2 * np.pi * (lock.carrier + lock.shift) * samples / numerology.useful
        lock.carrier += step
        if lock.left is not None:
            lock.drift += _DRIFTS * (received.late - lock.left - lock.drift)
        late = received.late + lock.drift
        late = late if abs(late) > _STILL else 0.0
        lock.left = received.late - late
        lock.first_long = (grid.first_long - late - samples) % numerology.cycle
        if lock is not self._lock or usual < 1.5 * lock.usual + 0.01:
            lock.usual = usual
            channel = received.channel
            lock.channel = channel if channel.ndim == 1 else channel[-1]
        lock.channel = lock.channel * np.complex64(np.exp(1j * ahead))
        self._lock = lock


def _audible(frame: np.ndarray) -> bool:
    """Whether an (N,) complex64 frame has a power that float32 can divide by."""
    return _TINY < float(np.vdot(frame, frame).real) / frame.size < np.inf
