"""Cancellation of QPSK: decide its symbols, subtract what they sound like, keep the return."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .ofdm.lattice import middle, power
from .ofdm.tones import without_tones
from .qpsk.clock import Clock, find_clocks
from .qpsk.equaliser import Equaliser, Symbols
from .qpsk.follower import Follower, can_follow
from .qpsk.held import Held, astray, find_held
from .qpsk.pulse import heard

__all__ = ["QpskCancel"]

_CONTRAST = 28.0  # of the clock's line; one frame of OFDM in ten has more than 18, hardly one more than 28
_ERROR = 0.08  # of the points' power; symbols at random have 0.3
_ALIKE = 0.3  # correlation of neighbouring points: more is no data
_TONE = 0.8  # a tone, which an equaliser gives one modulus from any start
_STARTS = (0, 1, -1)  # half symbols; echoes can close the eye at one
_SAME = 1e-3  # of the symbol rate, between frames of one emitter
_WORTH = 4.0  # of power where it sends: a method that takes away less may take from the return
_SENDS = 0.1  # of the mean power of what was sent
_LIMIT = 6.0  # times the median power: what is left where a burst begins
_JUMP = 100.0  # of power, which no emitter that goes on makes in a frame
_CLEAR = 0.99  # of a frame: where so much is left unblanked, every sample is a point
_ASTRAY = 0.03  # of the samples' steps, from which a filter made them
_FEW = 25  # one sample in 25 tells the median
_SHORTEST = 1024  # samples in a frame


@dataclass(frozen=True)
class _Lock:
    """An emitter that is followed: what frames are divided by, and whether they had tones on top."""

    follower: Follower | Held
    scale: np.float32
    tones: bool


@dataclass(frozen=True)
class _Found:
    """What is left of a frame, blanked where it stands out; its mean power before that; what follows the emitter."""

    out: np.ndarray
    left: float
    follower: Follower | Held | None
    depth_db: float
    busy: float


class QpskCancel(Mitigation):
    """Blind demodulation and subtraction of QPSK of any pulse.

    Card: *decision-directed cancellation.* The products of neighbouring samples give the symbol clock. An
    equaliser that makes all symbols one modulus needs neither carrier nor pulse. Its outputs are decided. The
    pulse is fitted to the frame by least squares, with channel, filters and their drift over the frame, and
    subtracted. Tones on top are subtracted before. QPSK that is switched on the sample grid, which no filter leaves, is
    decided sample by sample. An emitter that fills the frame is followed into the next ones: clock, carrier, equaliser
    and pulse are known there and only corrected, and one that begins anew within a frame is read on both sides. Frames
    without QPSK pass bit for bit.
    So do frames in which the return is too strong for safe decisions (an SIR above some -10 dB), which the
    altimeter reads without help. What is not QPSK stays: noise of the emitter, other interference.

    Attributes
    ----------
    cancelled, followed : int
        Frames in which QPSK was cancelled, and how many of them were read by what the frame before had told.
    depth_db : float
        By how much the last such frame became weaker where QPSK was sent.
    busy : float
        Share of that frame in which it was sent.

    Notes
    -----
    What is used of the emitter: that its symbols come at a steady rate, 0.02 to 0.47 per sample, and are four points of
    one modulus (QPSK, turned by any angle per symbol; BPSK). Its pulse may last 14 symbols, echoes included. Up to 100
    samples at either end of a frame are blanked, where symbols are cut.

    Raises
    ------
    MitigationError
        If the frame is too short.
    """

    name = "qpsk_cancel"
    style = PlotStyle("#997700", "h", (0, (2, 1)))

    def __init__(self, waveform: Waveform) -> None:
        if waveform.samples_per_frame < _SHORTEST:
            raise MitigationError(
                f"qpsk_cancel: a frame has {waveform.samples_per_frame} samples; it takes {_SHORTEST} or more"
            )
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.cancelled = self.followed = 0
        self.depth_db = self.busy = 0.0
        self._known: tuple[float, np.ndarray] | None = None  # rate and weights of the frame before
        self._lock: _Lock | None = None

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that were cancelled, and those followed."""
        return super().status() | {"cancelled": self.cancelled, "followed": self.followed}

    def cancel(self, frame: np.ndarray, *, toneless: bool = False) -> np.ndarray | None:
        """An (N,) complex64 frame without its QPSK; None where none could be read.

        ``toneless`` says that its tones were taken away before.
        """
        out = self.follow(frame, toneless=toneless)
        if out is not None:
            return out
        rest = None if toneless else without_tones(frame)
        tones = rest is not None
        frame = rest if tones else frame
        scale = np.float32(np.sqrt(np.vdot(frame, frame).real / frame.size))
        if not 0 < scale < np.inf:
            return None
        frame = frame * (1 / scale)  # a complex division costs four times that
        found = self._found(frame)
        if found is None:
            return None
        self.depth_db, self.busy = found.depth_db, found.busy
        self.cancelled += 1
        if found.follower is not None:
            self._lock = _Lock(found.follower, scale, tones)
        return found.out * scale

    def _found(self, frame: np.ndarray) -> _Found | None:
        """QPSK of a frame of unit power. What makes steps of all sizes is no QPSK on the sample grid, and what makes a
        few is hardly any: it is asked for a pulse first.
        """
        strays = astray(frame)
        held = self._held(frame) if strays < _ASTRAY else None
        if held is not None and np.count_nonzero(held.out) >= _CLEAR * frame.size:
            return held
        filtered = self._impulses(frame)
        if filtered is None and _ASTRAY <= strays < 1:
            held = self._held(frame)
        tried = [one for one in (held, filtered) if one is not None]
        return min(tried, key=lambda one: one.left, default=None)

    def _held(self, frame: np.ndarray) -> _Found | None:
        """QPSK of a frame of unit power, every sample of which is a point."""
        found = find_held(frame)
        if found is None:
            return None
        left, model, busy, follower = found
        out = self._worth(left, model, slice(0, frame.size), busy)
        return None if out is None else self._result(out, left, follower)

    def _impulses(self, frame: np.ndarray) -> _Found | None:
        """QPSK of any pulse in a frame of unit power."""
        clocks = find_clocks(frame, _CONTRAST)
        if self._known is not None:  # the same emitter first
            clocks.sort(key=lambda clock: abs(clock.rate / self._known[0] - 1) > _SAME)
        for clock in clocks:
            for symbols in self._symbols(Equaliser(frame, clock), clock):
                model, train, pulses = heard(frame, symbols)
                left = frame - model
                out = self._worth(left, model, train.known, symbols.busy)
                if out is None:
                    continue
                self._known = clock.rate, symbols.weights
                follows = symbols.busy == 1 and can_follow(symbols, pulses)
                follower = Follower(clock, symbols, pulses, train, left) if follows else None
                return self._result(out, left[train.known], follower)
        return None

    def _result(self, out: np.ndarray, left: np.ndarray, follower: Follower | Held | None) -> _Found:
        size = float(np.vdot(left, left).real) / max(left.size, 1)
        return _Found(out, size, follower if self.busy == 1 else None, self.depth_db, self.busy)

    def follow(self, frame: np.ndarray, *, toneless: bool = False) -> np.ndarray | None:
        """The same if the emitter of the frame before goes on; None if it does not, or there was none."""
        lock, self._lock = self._lock, None
        if lock is None:
            return None
        rest = without_tones(frame) if lock.tones and not toneless else None
        frame = frame if rest is None else rest
        level = float(np.vdot(frame, frame).real) / frame.size / float(lock.scale) ** 2
        if not 1 / _JUMP < level < _JUMP:
            return None
        found = lock.follower.follow(frame * (1 / lock.scale))
        out = None if found is None else self._worth(*found)
        if out is None:
            return None
        self._lock = lock
        self.cancelled += 1
        self.followed += 1
        return out * lock.scale

    def _symbols(self, equaliser: Equaliser, clock: Clock) -> Iterator[Symbols]:
        """Symbols that look safely decided, from one start of the equaliser after another."""
        for start in (None, *_STARTS):
            if start is not None:
                weights = equaliser.blind(start)
            elif self._known is not None and abs(clock.rate / self._known[0] - 1) < _SAME:
                weights = self._known[1]
            else:
                continue
            symbols = equaliser.symbols(weights)
            if symbols is None or symbols.alike > _TONE:
                return
            if symbols.error < _ERROR and symbols.alike < _ALIKE:
                yield symbols

    def _worth(
        self, left: np.ndarray, model: np.ndarray, known: slice | np.ndarray, busy: float = 1.0
    ) -> np.ndarray | None:
        """What is left of a frame, blanked where symbols are cut; None if little was taken away."""
        made, rest = model[known], left[known]
        level = power(rest)
        if busy < 1:
            sent = power(made)
            mean = sent.mean()
            there = (sent > _SENDS * mean).astype(np.float32)
            gain = float(mean * sent.size / max(level @ there, 1e-30))
        else:
            gain = float(np.vdot(made, made).real / max(np.vdot(rest, rest).real, 1e-30))
        if not gain >= _WORTH:
            return None
        out = np.zeros_like(left)
        out[known] = rest * (level <= np.float32(_LIMIT) * middle(level[::_FEW]))
        self.depth_db, self.busy = 10 * float(np.log10(1 + gain)), busy
        return out

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = batch.copy()
        for row, frame in zip(out, batch, strict=True):
            cancelled = self.cancel(frame)
            if cancelled is not None:
                row[:] = cancelled
        return out
