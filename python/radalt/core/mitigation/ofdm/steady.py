"""A frame of an emitter that goes on as before: what stays the same is taken from an earlier one, not judged anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .acquisition import Grid
from .channel_fit import fit
from .demodulator import FINER, SURE, again
from .emission import MAJORITY, PARTLY, READABLE, Emission
from .lattice import (
    Decisions,
    at_most_one,
    decide,
    few_points,
    middle,
    power,
    rounded,
    turn_to_axes,
)
from .numerology import Numerology
from .received import Received
from .ridge import (
    CHANGE_SAMPLE,
    CHANGED_DB,
    FOLD,
    Density,
    NearPoints,
    few_beside,
    modulus_of,
    most_plausible,
    read_around,
    usual_level,
    whitened,
)
from .upright import true_up

__all__ = ["Reading", "Steady", "read_on", "steady"]

_DOUBTFUL = 0.1  # mean error of a symbol in cells, each at most 1, from which all is judged anew
_WORSE, _LEAST = 1.5, 0.01  # the same of the median symbol, over that of the frame in which all was judged
_LEAST_VARYING = 0.03  # the same where users change, and with them how dense the points are
_FEW = 0.003  # the same of a symbol that may have blocks of few points, read as others
_BY_MISTAKE = 60  # elements of few points in a symbol
_SENDS = 0.05  # of a symbol's usual weight; beside a synchronisation block little is in use


@dataclass(frozen=True)
class Steady:
    """What one frame tells of the next ones: a channel that stands still, and the alphabet if there is one beside few
    points.

    Attributes
    ----------
    clear : (L, K) bool
        Elements that no return can be in.
    trusted : (L, K) float32
        1 for those of them that are in use.
    level, told : (K,), (L,) float32
        Weights of the subcarriers in the symbols' mean errors, and their sums.
    kind : int or None
        The one of `DENSE` that most elements have; None if users have several, which may be others in each slot.
    at, column : (n,) int
        The other elements: places in (L, K), and subcarriers.
    fine, empty : (n,) bool
        Which of them hold a return that can be told, and which hold nothing that was sent.
    count, noise : (K,) float32
        How many trusted elements each subcarrier has, and its noise.
    white : (n,) float32
        Factors that bring the other elements' noise down to the usual.
    misread : float
        Median error of the symbols.
    weight : (L,) float32
        Of the symbols.
    """

    clear: np.ndarray
    trusted: np.ndarray
    level: np.ndarray
    told: np.ndarray
    kind: int | None
    at: np.ndarray
    column: np.ndarray
    fine: np.ndarray
    empty: np.ndarray
    count: np.ndarray
    noise: np.ndarray
    white: np.ndarray
    misread: float
    weight: np.ndarray
    received: Received
    wide: Wide | None


@dataclass(frozen=True)
class Wide:
    """A return that is larger than a cell.

    Attributes
    ----------
    level, modulus : float
        RMS of the symbols, and modulus of the return.
    density : Density
        Of the return, and of one that has changed.
    varying : bool
        Whether users vary.
    shares : dict
        (n,) float32 shares of few points beside each of the other elements, by the symbols that have some: the few
        patterns there are, with synchronisation signals or without.
    certain : bool
        Whether the frame itself told how large it is, not one before.
    """

    level: float
    modulus: float
    density: Density
    varying: bool
    shares: dict[bytes, np.ndarray]
    certain: bool

    def share(self, few: np.ndarray, known: Steady) -> np.ndarray:
        """The share in a frame with these elements of few points, (L, K) bool."""
        key = b"" if self.varying else (few.sum(axis=1) > _BY_MISTAKE).tobytes()
        if key not in self.shares:
            self.shares[key] = few_beside(few, known.trusted, varying=self.varying).ravel()[known.at]
        return self.shares[key]


@dataclass(frozen=True)
class Reading:
    """A frame that was read so; the attributes are those of `Received`, and the elements those of `Emission`."""

    elements: np.ndarray
    channel: np.ndarray
    angles: np.ndarray
    weight: np.ndarray
    misread: np.ndarray
    late: float


def steady(
    received: Received,
    grid: Grid,
    clear: np.ndarray,
    likely: tuple[int, np.ndarray] | None,
    sent: Emission,
    sir_db: float | None,
) -> Steady | None:
    """What a frame that was ``received`` tells of the next ones; None unless it was read well, with users of one power.

    ``likely`` is as in `Before`. ``sir_db`` is what the last frame with a return larger than a cell told; None without.
    """
    misread = middle(received.misread)
    if (
        received.amplitudes is not None
        or sent.skirts is None
        or received.channel.ndim > 1
        or received.mean_misread > PARTLY
        or not sent.readable.all()
        or sent.busy < 1
    ):
        return None
    trusted = (clear & grid.used).astype(np.float32)
    level = power(received.channel)
    at = np.flatnonzero(~clear)
    column = at % clear.shape[1]
    skirts = sent.skirts
    return Steady(
        clear,
        trusted,
        level,
        trusted @ level,
        likely[0] if likely else None,
        at,
        column,
        skirts.fine[column],
        skirts.empty[column],
        trusted.sum(axis=0),
        skirts.noise,
        whitened(skirts.noise)[column],
        misread,
        received.weight,
        received,
        _wide(received, trusted, at, sir_db, varying=likely is None, certain=sent.sir_db is not None),
    )


def _wide(
    received: Received,
    trusted: np.ndarray,
    at: np.ndarray,
    sir_db: float | None,
    *,
    varying: bool,
    certain: bool,
) -> Wide | None:
    """What a frame that was ``received`` tells of a return at ``sir_db`` larger than a cell; None without one."""
    if sir_db is None:
        return None
    level = usual_level(received.symbols, trusted)
    tried = sir_db + np.r_[0.0, CHANGED_DB]
    shares = {b"": few_beside(received.few, trusted, varying=True).ravel()[at]} if varying else {}
    density = Density(level, tried, received.noise)
    return Wide(level, modulus_of(level, sir_db), density, varying, shares, certain)


def read_on(known: Steady, grid: Grid, numerology: Numerology, *, ask: bool = True) -> Reading | None:
    """The symbols of the ``grid`` read with what is ``known``; None where anything seems to be otherwise.

    Whether a return larger than a cell has changed is looked at only if it is to ``ask``.
    """
    symbols, channel = grid.symbols, grid.channel
    found, misread = _decided(known, grid, symbols * (1 / channel), numerology)
    points, error, capped = found.points, found.error, found.capped
    # the frame may cut one symbol, or hold no other of its half slot: judged anew, it is read no better
    beside, most = np.partition(misread, -2)[-2:]
    least = _LEAST if known.kind is not None else _LEAST_VARYING
    usual = _WORSE * known.misread + least
    if not (beside < _DOUBTFUL and most < READABLE and middle(misread) < usual):
        return None
    sure = (error < SURE) * known.trusted
    model = channel * points
    weight = power(model) * sure
    said = weight.sum(axis=1)
    if (said < _SENDS * known.weight).any():
        return None
    agreement = symbols * model.conj()
    agreement *= sure
    turn, angle, slope = true_up(agreement, numerology)
    symbols, phase = symbols * turn, grid.phase * turn
    agreement *= turn
    factor = fit(agreement.sum(axis=0)[None], weight.sum(axis=0)[None], 0, 1)[0]
    channel = channel * factor
    if np.abs(angle).max() > FINER or np.abs(factor - 1).sum() > FINER * factor.size:
        again(found, symbols, channel, ~known.clear, found.kinds)
    at, column = known.at, known.column
    held = capped.ravel().take(at)
    here = symbols.ravel().take(at)
    rest = here - channel.take(column) * points.ravel().take(at)
    np.copyto(rest, here, where=known.empty)
    size = power(rest)
    fine, told = known.fine, read_around(held, size, known.fine)
    kept = None
    if np.count_nonzero(told) <= MAJORITY * np.count_nonzero(fine):
        told = fine
    if (held * told).sum() >= FOLD * np.count_nonzero(told):
        kept = _wide_return(known, symbols, channel, found, told, ask=ask)
        if kept is None:
            return None
        size[told] = power(kept)
    most = most_plausible(size, told)
    weight = (told | known.empty) & (size < most)
    white = known.white
    if known.kind is None:  # users change, and what is misread with them
        white = whitened(_noise(known, symbols, channel * points))[column]
    rest *= weight * white
    if kept is not None:
        rest[told] = kept
    symbols.ravel()[at] -= rest
    symbols *= phase.conj()
    return Reading(symbols, channel, grid.angles + angle, said, misread, middle(slope))


def _wide_return(
    known: Steady,
    symbols: np.ndarray,
    channel: np.ndarray,
    found: Decisions,
    told: np.ndarray,
    *,
    ask: bool,
) -> np.ndarray | None:
    """(elements,) complex64 mean of a return that is larger than a cell, in those of the other elements that are
    ``told`` (n, bool); None unless it is about as large as it was, which may be what to ``ask``."""
    wide = known.wide
    if wide is None:
        return None
    here = replace(
        known.received,
        symbols=symbols,
        channel=channel,
        points=found.points,
        kinds=found.kinds,
        few=found.few,
    )
    near = NearPoints(here, known.at[told], wide.share(found.few, known)[told], wide.modulus)
    if (ask or not wide.certain) and near.some(CHANGE_SAMPLE).evidence(wide.density, wide.level).argmax():
        return None
    return near.expected(wide.density)


def _noise(known: Steady, symbols: np.ndarray, model: np.ndarray) -> np.ndarray:
    """(K,) float32 mean power of what the ``model`` leaves of the trusted elements; as it was where there are none."""
    left = np.einsum("lk,lk->k", power(symbols - model), known.trusted)
    return np.where(known.count > 0, left / np.maximum(known.count, 1), known.noise)


def _decided(
    known: Steady, grid: Grid, values: np.ndarray, numerology: Numerology
) -> tuple[Decisions, np.ndarray]:
    """Decisions, with kinds (L, K), and the symbols' mean errors (L,)."""
    if known.kind is None:
        halves = numerology.halves(grid.starts, grid.first_long)
        found = decide(values, known.trusted > 0, halves, heard=known.trusted)
        found.kinds = found.kinds[halves]
        return found, (found.capped * known.trusted) @ known.level / known.told
    points, error = rounded(values, known.kind)
    capped = at_most_one(error)
    misread = (capped * known.trusted) @ known.level / known.told
    few = np.zeros(values.shape, dtype=bool)
    odd = np.flatnonzero(misread > _WORSE * known.misread + _FEW)
    if odd.size:  # they have blocks of few points, if no more has changed
        part = values[odd]
        level = power(part)
        chosen, far, some = few_points(part, level)
        found = Decisions(
            np.where(some, chosen, points[odd]), np.where(some, far, error[odd]), None, some, None
        )
        found.capped = at_most_one(found.error)
        turn_to_axes(part, level, found)
        points[odd], error[odd], capped[odd], few[odd] = found.points, found.error, found.capped, some
        misread[odd] = (found.capped * known.trusted[odd]) @ known.level / known.told[odd]
    return Decisions(points, error, capped, few, np.full(values.shape, known.kind, dtype=np.int8)), misread
