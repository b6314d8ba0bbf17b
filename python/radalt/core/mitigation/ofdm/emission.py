"""Which part of each element the emitter sent; the rest of it is the return, or was misread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .acquisition import Grid
from .lattice import FAINT, amid, middle, power
from .numerology import Numerology
from .received import Received
from .ridge import expected_return, plausible, read_around, whitened
from .under_noise import mean_model

__all__ = ["MAJORITY", "PARTLY", "READABLE", "Emission", "Skirts", "emission", "faint_emission"]

READABLE = 0.5  # mean error of a symbol in cells, each at most 1; a random one has 0.75
PARTLY = 0.05  # mean error of all symbols, where some regions of time and frequency may be misread
_MOSTLY = 0.45  # median error of the symbols that send; two streams on the same elements have 0.6
_BADLY = (
    0.25  # mean error of a longer burst's symbols: what is left then looks like returns at other altitudes
)
_SHORT = 0.4  # of a frame's symbols
_SHORTLY = 0.2  # median error in so short a burst, from which it is better blanked
_FEWEST = 0.3  # of the symbols that send have to be readable
_AMISS = 0.2  # mean error of the elements around one whose channel is wrong
MAJORITY = 0.7  # of the elements that hold the return
_FEWEST_TOLD = 3  # elements of a subcarrier that tell of the receiver, where some regions are misread
_SILENT = np.float32(0.03)  # mean power of a symbol's points below which it sends nothing
_IDLE = 0.1  # power of a symbol, of the loudest one's, below which it sends nothing, if it is not read well
_WELL = 0.1  # mean error of a symbol that is read well
_NOTHING = 0.5  # error over power of a subcarrier from which nothing is sent there
_SKIRT = 0.01, 0.1  # error over power of a subcarrier that is of no use, at least and at most
_BESIDE = np.float32(
    0.05
)  # of a subcarrier's usual power, below which one that cannot be read is beside the band
_STANDS_OUT = 4.0  # times the median


@dataclass(frozen=True)
class Skirts:
    """Subcarriers (K,) that are ``fine``, or ``empty`` (bool), and the power of their ``noise``."""

    fine: np.ndarray
    empty: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True)
class Emission:
    """What an emitter sent in a frame, as it was received.

    Attributes
    ----------
    elements : (L, K) complex64
        What is to be subtracted of each element, with the phases of the frame itself.
    readable : (L,) bool
        Symbols of which anything is.
    busy : float
        Share of the symbols in which the emitter sent.
    sir_db : float or None
        SIR in dB where the return is larger than a cell of the constellation, None elsewhere.
    kept : (L, K) bool or None
        Elements that hold the return, which is not subtracted; None where more than a point was subtracted.
    skirts : Skirts or None
        Of its subcarriers.
    misread : float
        Mean error of its symbols in cells, each at most 1.
    """

    elements: np.ndarray
    readable: np.ndarray
    busy: float
    sir_db: float | None = None
    kept: np.ndarray | None = None
    skirts: Skirts | None = None
    misread: float = 0.0


def emission(
    received: Received,
    grid: Grid,
    clear: np.ndarray,
    near_db: float | None,
) -> Emission | None:
    """What of a demodulated frame may be subtracted; None if too little was read.

    ``clear`` (L, K) bool tells which elements no return can be in, ``near_db`` the SIR of the frame before.
    """
    trusted = (clear & grid.used).astype(np.float32)
    misread = received.misread
    sent = _sent(received, trusted)
    own = power(received.symbols)
    loud = own.sum(axis=1)
    # a symbol may be weak because its channel fades, and is read all the same
    sending = sent & ((loud > _IDLE * loud.max()) | (misread < _WELL))
    readable = sending & (misread <= READABLE)
    short = np.count_nonzero(sending) < _SHORT * sending.size
    if (
        not readable.any()
        or middle(misread[sending]) > (_SHORTLY if short else _MOSTLY)
        or np.count_nonzero(readable) < _FEWEST * np.count_nonzero(sending)
        or (not short and misread[sending].mean() > _BADLY)
    ):
        return None
    rest = received.symbols - received.channel * received.points
    size = power(rest)
    told = (clear & readable[:, None]).astype(np.float32)
    beside = _beside(received.capped, own, told)
    heard = told * grid.used
    partly = misread.sum() > PARTLY * misread.size
    if partly:
        # regions that are misread tell nothing of the receiver
        right = amid(received.capped, heard) < _AMISS
        well = told * right
        told = np.where(well.sum(axis=0) < _FEWEST_TOLD, told, well)
    noise, level = _over_subcarriers(size, told), _over_subcarriers(own, told)
    left = noise / np.maximum(level, FAINT)
    empty = left > _NOTHING
    empty |= ~grid.used | beside
    if empty.any():
        rest[:, empty], size[:, empty], noise[empty] = (
            received.symbols[:, empty],
            own[:, empty],
            level[empty],
        )
    ridge = ~clear
    ridge &= readable[:, None]
    # the receiver's skirts stand out of what noise leaves in all subcarriers
    fine = ~empty & (left < min(max(_STANDS_OUT * middle(left), _SKIRT[0]), _SKIRT[1]))
    both = ridge & fine
    asked = both & right if partly else both
    # where a return is larger than a cell, most regions look misread
    read = read_around(received.capped, size, asked)
    if np.count_nonzero(read) > MAJORITY * np.count_nonzero(asked):
        asked = read
    kept, where = expected_return(received, asked, heard, near_db), asked
    if kept is not None and partly:
        # where the return is larger than a cell, misread elements make little difference
        kept, where = expected_return(received, both, heard, kept[1]), both
    if kept is not None:
        # beside the band the return is as large as it is here, not as what is left of it in a cell
        size[where] = power(kept[0])
    # where no return can be, and where it was misread, all of an element goes
    ridge &= empty
    noise /= np.maximum(told.sum(axis=0), 1)
    weight = plausible(size, where, ridge, whitened(noise))
    rest *= weight
    sir_db, held = None, weight > 0
    if kept is not None:
        (rest[where], sir_db), held = kept, None
    elements = np.subtract(received.symbols, rest, out=rest)
    elements *= received.phase.conj()
    skirts = Skirts(fine, empty, noise)
    busy = np.count_nonzero(sending) / sending.size
    return Emission(elements, readable, busy, sir_db, held, skirts, received.mean_misread)


def _sent(received: Received, trusted: np.ndarray) -> np.ndarray:
    """(L,) bool: symbols that hold more than silence, by the ``trusted`` (L, K, float32) elements.

    Between bursts there is nothing to take away, and a return that is strong would be read as data. Elements count by
    the channel's power: beside the band noise over noise is always near some point.
    """
    weight = trusted * power(received.channel)
    return _over_symbols(power(received.points), weight) > _SILENT * weight.sum(axis=1)


def _beside(capped: np.ndarray, own: np.ndarray, told: np.ndarray) -> np.ndarray:
    """(K,) bool: faint subcarriers that cannot be read, by the power ``own`` (L, K) of the elements ``told`` (L, K).

    Noise fits no alphabet, but a lattice that is scaled to it is near it all the same.
    """
    count, total = told.sum(axis=0), _over_subcarriers(own, told)
    faint = total < _BESIDE * middle(total / np.maximum(count, 1)) * count
    return faint & (_over_subcarriers(capped, told) > READABLE * count)


def faint_emission(grid: Grid, clear: np.ndarray, numerology: Numerology, least: float) -> Emission | None:
    """The mean of QPSK that noise of its own hides; None where taking it away does not help.

    ``clear`` as in `emission`, ``least`` as in `mean_model`.
    """
    found = mean_model(grid, clear, numerology, least)
    if found is None:
        return None
    symbols, phase, model = found
    rest = symbols - model
    size = power(rest)
    noise = (size * clear).sum(axis=0) / np.maximum(np.count_nonzero(clear, axis=0), 1)
    white = whitened(noise.astype(np.float32))
    rest *= plausible(size, ~clear & grid.used, ~clear & ~grid.used, white)
    return Emission((symbols - rest) * phase.conj(), np.ones(len(symbols), dtype=bool), 1.0)


def _over_symbols(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(L,) weighted sums of (L, K) float32, in one pass."""
    return np.einsum("lk,lk->l", values, weight)


def _over_subcarriers(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(K,) weighted sums of (L, K) float32, in one pass."""
    return np.einsum("lk,lk->k", values, weight)
