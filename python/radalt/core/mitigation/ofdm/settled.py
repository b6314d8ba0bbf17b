"""A channel that moves, estimated together with the return that was found beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from ...waveform import Waveform
from .acquisition import Grid, transforms
from .channel_fit import smooth_fit, sums
from .demodulated import Demodulated
from .demodulator import again, times_of, trusted
from .emission import Emission, emission
from .lattice import FAINT, Decisions, middle, power
from .modulator import Modulator
from .numerology import Numerology
from .received import Received
from .ridge import FOLD
from .upright import true_up

__all__ = ["Returned"]

_DOPPLER_BINS = 3  # of a half sweep, on the wrong side of no beat: 150 m/s have two
_FINER = 2  # points per bin of a half sweep
_EXPLAINED = 0.5  # of the power that was kept, for a return to be one
_FEWEST = 8  # elements that tell of a return
_TURNS = 2  # of return and channel
_ROUNDS = 2  # of points and channel in each
_DOUBTFUL = 0.1  # mean error of the symbols, each at most 1: from there on altitudes are half a metre off
_ENOUGH = 0.6  # of the elements that may hold the return, kept in the end
_ORDER = 2  # of the channel's course in time
_MOSTLY = 0.6  # of the elements that were kept fit the return best, and tell it
_STEPS = 4  # to find them
_FAR = 9.0  # times the usual power beside the return: one element of noise in 500 has more
_SEEN = 40.0  # times the mean power of a half sweep's beats: that of a return at SIR -19 dB


class Returned:
    """The return of a frame as a tone in each half sweep, and the channel without it.

    Elements that may hold the return have no say in the channel, as long as the return is not known. Where the channel
    moves, its course is then extrapolated to them at the frame's ends, and the error of that is larger than the noise.
    With the return subtracted, as far as it was found, all elements tell of the channel. Return and channel are
    estimated in turns, which leads to least squares for both.
    """

    def __init__(self, waveform: Waveform, span_m: float) -> None:
        self._reference = waveform.reference
        self._half = waveform.samples_per_half
        step_hz = waveform.rate_hz / self._half
        most = int(np.ceil(waveform.altitude_to_beat_hz(span_m) / step_hz)) + _DOPPLER_BINS
        self._bins = np.arange(-_DOPPLER_BINS * _FINER, most * _FINER + 1)  # those of all altitudes
        self._time = (
            np.arange(self._half) - (self._half - 1) / 2
        ) / self._half  # half sweeps from the middle of one

    def seen(self, frame: np.ndarray) -> bool:
        """Whether a return stands far out of an (N,) complex64 frame as it is: what is beside it does little harm."""
        for half, sign in enumerate((-1, 1)):
            part = slice(half * self._half, (half + 1) * self._half)
            beats = power(fft.fft(frame[part] * self._reference[part].conj()))
            if beats[sign * self._bins[::_FINER] // _FINER].max() < _SEEN * beats.mean():
                return False
        return True

    def settled(
        self, frame: Demodulated, sent: Emission, out: np.ndarray, modulator: Modulator
    ) -> tuple[Received, Emission, np.ndarray] | None:
        """What was received of a ``frame``, what was ``sent`` in it, and ``out`` (N,), the frame less that, settled so.

        None if too much of the frame or of the return was misread: what is left may be anything. Where no return stands
        out, or it is larger than a cell of the constellation, all is as it was.
        """
        straight, grid, clear, received = frame.straight, frame.grid, frame.clear, frame.received
        if received.mean_misread > _DOUBTFUL:
            return None
        if sent.kept is None:
            return received, sent, out
        held = grid.used & ~clear & sent.readable[:, None]

        def found() -> np.ndarray | None:
            return _found(self._tones(out, straight.turn), held & sent.kept, received, sent, frame)

        def less() -> np.ndarray:
            return modulator.subtract(
                straight.samples, straight.turn, sent.elements, sent.readable, grid.starts, frame.numerology
            )

        for _ in range(_TURNS):
            back = found()
            if back is None:
                break
            better = _of_all(received, grid, clear, back, frame.numerology)
            again = emission(better, grid, clear, None)
            if again is None or again.kept is None:
                break
            received, sent = better, again
            out = less()
        back = found()
        if back is not None:
            sent = _fitting(sent, received, back, held)
            out = less()
        enough = np.count_nonzero(held & sent.kept) >= _ENOUGH * np.count_nonzero(held)
        fine = held & sent.skirts.fine
        if not enough or received.capped[fine].sum() > FOLD * np.count_nonzero(fine):
            return None
        return received, sent, out

    def _tones(self, out: np.ndarray, turn: np.ndarray | None) -> list[np.ndarray]:
        """(N,) complex64 returns of unit power at the strongest beat of either half sweep, without the carrier."""
        tones, time = [], self._time
        for half, sign in enumerate((-1, 1)):
            part = slice(half * self._half, (half + 1) * self._half)
            bins = _FINER * self._half
            beats = out[part] * self._reference[part].conj()
            level = np.abs(fft.fft(beats, bins))
            asked = sign * self._bins
            best = int(asked[level[asked].argmax()])
            before, at, after = level[[best - 1, best, (best + 1) % bins]]
            bend = before - 2 * at + after
            beat = (best + (0.5 * (before - after) / bend if bend < 0 else 0.0)) / _FINER
            # the phase that is left turns evenly: the slope of its course
            left = beats * np.exp(-2j * np.pi * beat * time)
            beat += 12 / (2 * np.pi) * float((left @ time / (left.sum() + FAINT)).imag)
            tone = np.zeros(out.size, dtype=np.complex64)
            tone[part] = self._reference[part] * np.exp(2j * np.pi * beat * time)
            tones.append(tone if turn is None else tone * turn)
        return tones


def _found(
    tones: list[np.ndarray],
    held: np.ndarray,
    received: Received,
    sent: Emission,
    frame: Demodulated,
) -> np.ndarray | None:
    """(L, K) complex64 elements of the return that is in the elements ``held`` (L, K, bool); None where none stands
    out."""
    kept = (received.symbols - sent.elements * received.phase)[held]
    parts = [transforms(tone, frame.grid.starts, frame.numerology) * received.phase for tone in tones]
    basis = np.stack([part[held] for part in parts], axis=1)
    if len(basis) < _FEWEST:
        return None
    near = slice(None)
    for _ in range(_STEPS):  # least trimmed squares: what was misread in a region has no say
        gains = np.linalg.lstsq(basis[near], kept[near], rcond=None)[0].astype(np.complex64)
        away = power(kept - basis @ gains)
        near = away <= np.quantile(away, _MOSTLY)
    found = (basis @ gains)[near]
    if np.vdot(found, found).real < _EXPLAINED * np.vdot(kept[near], kept[near]).real:
        return None
    return sum(gain * part for gain, part in zip(gains, parts, strict=True))


def _fitting(sent: Emission, received: Received, back: np.ndarray, held: np.ndarray) -> Emission:
    """What was ``sent``, and with it all of those elements that were kept but are far from the return ``back`` (L, K).

    An element that was misread may be as large as a return by chance.
    """
    kept = held & sent.kept
    away = power(received.symbols - sent.elements * received.phase - back)
    far = kept & (away > _FAR * middle(away[kept]))
    elements = np.where(far, received.symbols * received.phase.conj(), sent.elements)
    return replace(sent, elements=elements, kept=sent.kept & ~far)


def _of_all(
    received: Received, grid: Grid, clear: np.ndarray, back: np.ndarray, numerology: Numerology
) -> Received:
    """The symbols with points, phases and channel of all elements, of which ``back`` (L, K), the return, was taken."""
    times, asked = times_of(len(back)), grid.used & (received.weight > 0)[:, None]
    every, used = np.ones_like(clear), np.broadcast_to(grid.used, clear.shape).astype(np.float32)
    found = Decisions(
        received.points.copy(), received.error.copy(), received.capped.copy(), received.few, received.kinds
    )  # fmt: skip
    symbols, channel = received.symbols - back, received.channel
    turns, angles = np.complex64(1), received.angles
    again(found, symbols, channel, every, received.kinds)
    for _ in range(_ROUNDS):
        sure = trusted(found, used, asked)
        agreement = symbols * found.points.conj() * sure
        turn, angle, _ = true_up(agreement * channel.conj(), numerology, evenly=False)
        symbols, agreement, turns, angles = symbols * turn, agreement * turn, turns * turn, angles + angle
        factors = smooth_fit(*sums(agreement, power(found.points) * sure, times, _ORDER), channel)
        channel = sum(times[:, None] ** n * one for n, one in enumerate(factors))
        again(found, symbols, channel, every, received.kinds)
    return replace(
        received, symbols=received.symbols * turns, phase=received.phase * turns, channel=channel,
        points=found.points, error=found.error, capped=found.capped, angles=angles,
    )  # fmt: skip
