"""A frame whose channel moves, without what its change within symbols spreads over the subcarriers beside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .acquisition import transforms
from .carrier import course
from .channel_fit import audible, fit, loudest, sums
from .demodulated import Demodulated
from .demodulator import AGAIN, READ, again, once_more, times_of, trusted
from .drift import change_of_all, matters, moves
from .echoes import grown
from .emission import READABLE
from .lattice import Decisions, middle, misread, power
from .modulator import Modulator
from .received import Received
from .upright import true_up

__all__ = ["still"]

_MOST = 4  # rounds in which the change within symbols is told and taken away
_DOUBTFUL = 0.1  # mean error of a symbol in cells, each at most 1
_WORSE = 1.2  # times the mean error of a frame's symbols: such a round has lost some of those that were read
_STILLER = 0.8  # of the error is left, for one more
_READABLE = 0.2  # mean error of the elements, each at most 1, up to which all symbols tell of one course
_ROUNDS = 4
_ORDER = 2  # of the channel's course in time


def still(frame: Demodulated, modulator: Modulator) -> Demodulated:
    """The frame's samples and symbols without that spread, or as they are where it is negligible."""
    without = _without_change(frame, modulator)
    return _evened(frame, without.received, modulator) or without


def _without_change(frame: Demodulated, modulator: Modulator) -> Demodulated:
    """As `still`; the change is that of the channel as it was received."""
    grid, clear, numerology, received = frame.grid, frame.clear, frame.numerology, frame.received
    without, taken = frame.straight.samples, np.zeros_like(received.points)
    for number in range(_MOST):
        drift = change_of_all(received, grid)
        if drift is None:
            break
        change = drift * received.points * received.phase.conj() * grid.used
        if number and not matters(change - taken, received, grid):
            break
        taken = change
        less = _less(frame, change, _whole(frame, received), modulator)
        symbols = transforms(less, grid.starts, numerology) * received.phase
        before = received.noise
        # a channel that moved may stand still now, so its error says nothing
        likely = replace(received.as_before(clear & grid.used), steady=0.0)
        finer = once_more(grid, clear, replace(received, symbols=symbols), numerology, AGAIN, before=likely)
        error = received.mean_misread
        if error < _DOUBTFUL and finer.mean_misread > max(READ, _WORSE * error):
            break
        if finer.noise > before and (number or not moves(received, grid)):
            break
        without, received = less, finer
        # what that change hid can be read now
        if received.mean_misread > READ:
            received = grown(grid, clear, received, numerology)
        if received.noise > _STILLER * before:
            break
    return replace(frame, straight=frame.straight.of(without), received=received)


def _evened(frame: Demodulated, received: Received, modulator: Modulator) -> Demodulated | None:
    """As `still`, from what was ``received``, with one quadratic course of the channel for all symbols.

    None where that reads no better.

    Each symbol was set upright by the sum of its echoes. Where that sum fades its angle turns fast, and the channel
    of upright symbols has an edge there, which no quadratic follows. A carrier turns symbols evenly: with that
    course alone taken out, a channel that moves is smooth.
    """
    if received.channel.ndim == 1 or received.amplitudes is not None:
        return None
    grid, numerology = frame.grid, frame.numerology
    heard = frame.clear & grid.used
    error = received.capped[heard].mean()
    if error > _READABLE:
        return None
    passed = numerology.halves(grid.starts, grid.first_long)
    away = received.angles - course(received.weight * np.exp(4j * received.angles), passed) / 4
    # points look the same after a quarter turn; a symbol whose points are on the axes was turned by an eighth
    away -= np.pi / 4 * np.rint(away / (np.pi / 4))
    phase = received.phase * np.exp(1j * away)[:, None].astype(np.complex64)
    found = Decisions(
        received.points.copy(), received.error.copy(), received.capped.copy(), received.few, received.kinds
    )  # fmt: skip
    told, most = heard.astype(np.float32), loudest(received.symbols, heard)
    whole = _whole(frame, received)
    sending = heard & whole[:, None]
    times, every = times_of(len(phase)), np.ones_like(heard)
    without, symbols = (
        frame.straight.samples,
        transforms(frame.straight.samples, grid.starts, numerology) * phase,
    )
    for _ in range(_ROUNDS):
        sure = trusted(found, told, sending)
        agreement = symbols * found.points.conj() * sure
        factors = fit(*sums(agreement, power(found.points) * sure, times, _ORDER), _ORDER, 1)
        channel = audible(sum(times[:, None] ** n * one for n, one in enumerate(factors)), most)
        turn, angle, _ = true_up(agreement * channel.conj(), numerology, evenly=False)
        phase, away = phase * turn, away - angle
        change = np.gradient(channel, axis=0) * found.points * phase.conj() * grid.used
        without = _less(frame, change, whole, modulator)
        symbols = transforms(without, grid.starts, numerology) * phase
        again(found, symbols, channel, every, received.kinds)
    kept = sure > 0
    left = (power(symbols - channel * found.points) * kept).sum(axis=0)
    count = np.count_nonzero(kept, axis=0)
    known = count > _ORDER + 1
    if not known.any():
        return None
    noise = middle(left[known] / (count[known] - _ORDER - 1))
    if found.capped[heard].mean() > error or noise > received.noise:
        return None
    received = replace(
        received, symbols=symbols, phase=phase, channel=channel, points=found.points, error=found.error,
        capped=found.capped, misread=misread(found.capped, heard, channel), noise=noise,
        angles=received.angles - away,
    )  # fmt: skip
    return replace(frame, straight=frame.straight.of(without), received=received)


def _whole(frame: Demodulated, received: Received) -> np.ndarray:
    """(L,) bool: symbols that neither the frame nor a burst cuts. One that was read in part is among them: what it
    spreads over its weak elements is what hides them."""
    return (received.misread <= READABLE) & frame.clear.any(axis=1)


def _less(frame: Demodulated, change: np.ndarray, whole: np.ndarray, modulator: Modulator) -> np.ndarray:
    """(N,) complex64 samples less what elements spread over others that ``change`` (L, K) so from symbol to symbol.

    ``whole`` (L,) bool tells which symbols the frame or a burst does not cut.
    """
    starts, numerology = frame.grid.starts, frame.numerology
    spread = modulator.samples(change, whole, starts, numerology)
    return frame.straight.samples - spread * modulator.offsets(starts, numerology)
