"""Elements that hold the return as well: where they are, and which part of them is the return."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...waveform import Waveform, altitude_to_delay_s
from .demodulator import Received
from .lattice import BLOCK, DENSE, FAINT, SCALE, SPARSE_POINTS, box, middle, nearest, power
from .numerology import Numerology

__all__ = [
    "FOLD",
    "Ridge",
    "expected_return",
    "most_plausible",
    "plausible",
    "read_around",
    "whitened",
]

_MARGIN = 3  # subcarriers: a sweep of 15 kHz in a microsecond leaks into its neighbours
FOLD = 0.2  # error in the ridge, in cells, each at most 1, up to which a decision is right; a random one has 0.75
_SOME_FOLD = 0.05  # the same where weak users' cells are smaller than others'
_ASTRAY = 0.01  # share of elements whose alphabet was misjudged, which may be anything
_SIR_DB = np.arange(-40.0, -3.0, 2.0)
_STEP_DB = np.array([0.0, -1.0, 1.0])  # to the finer grid, and from frame to frame
_SPREAD = 0.2  # of the return's modulus: noise and Fresnel's ripple
_PRIOR_IN = 0.75  # share of the ridge that the return fills, which has one delay of many
_LEVEL_DB = 8.5  # a return stands in one subcarrier of seven
_SPARSE_PRIOR = np.array([0.2] + [0.15] * 4 + [0.05] * 4, dtype=np.float32)
_SAMPLE = 4  # one element in four tells the SIR
_MOSTLY = 0.8  # of the elements have less than the usual power; in a fade cells, and what is left in them, are small
_TOO_MUCH = np.float32(3.0)  # times the usual power: more than return and noise, so the point was another one
_REGION = 20  # subcarriers that are misread together
_SPOILT = 0.5  # mean error of such a region, each at most 1; a random one has 0.75
_DOUBTED = 0.3  # the same of one that is louder than others
_UNEVEN = 4.0  # times the usual power, in the mean of such a region; a return from rough ground has that, too
_UNLIKE = 20.0  # times the usual power, more of which tells no more
_BESIDE = 3  # subcarriers of which noise is alike
_ALONG = 121  # subcarriers of a symbol that tell whether it has few points; the ridge is some 80 wide
_FAR = 1.6  # times the return's modulus: at that distance its density is small


class Ridge:
    """Elements that a return from 0 to ``span_m`` can be in, for any window of a frame."""

    def __init__(self, waveform: Waveform, numerology: Numerology, span_m: float) -> None:
        cycles = np.diff(np.unwrap(np.angle(waveform.reference.astype(np.complex128)))) / (2 * np.pi)
        self._subcarrier = np.append(cycles, cycles[-1]) * numerology.useful
        self._delay = int(np.ceil(altitude_to_delay_s(span_m) * waveform.rate_hz))
        self._numerology = numerology
        self._known: dict[tuple[int, int], np.ndarray] = {}
        self._last: tuple[bytes, int, np.ndarray] | None = None

    def clear(self, starts: np.ndarray, carrier: float) -> np.ndarray:
        """(L, K) bool: elements that no return can be in, of a frame whose ``carrier`` (in subcarriers) was taken
        out."""
        key = starts.tobytes(), round(carrier)
        if self._last is None or self._last[:2] != key:
            self._last = *key, np.stack([self._clear(int(start), key[1]) for start in starts])
        return self._last[2]

    def _clear(self, start: int, carrier: int) -> np.ndarray:
        mask = self._known.get((start, carrier))
        if mask is None:
            useful = self._numerology.useful
            samples = np.arange(start - self._delay, start + useful) % self._subcarrier.size
            at = np.rint(self._subcarrier[samples]).astype(int) - carrier + useful // 2
            mask = np.ones(useful, dtype=bool)
            for margin in (-_MARGIN, 0, _MARGIN):
                mask[(at + margin) % useful] = False
            if len(self._known) > 4096:
                self._known.clear()
            self._known[start, carrier] = mask
        return mask


def plausible(size: np.ndarray, asked: np.ndarray, beside: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Weights 0..1 of what is left in elements that hold the return: (L, K) float32, 0 in all others.

    ``size`` (L, K) is its power, in elements that were ``asked`` (read) or are ``beside`` the band in use (L, K, bool).
    A return has the same modulus in all elements, so one far beyond the usual power was misread. A subcarrier with more
    noise than usual (the receiver's skirts, where the band ends) weighs less, by the factors ``white`` (K,).
    """
    if not asked.any():
        return asked.astype(np.float32)
    held = asked | beside
    held &= size < most_plausible(size, asked)
    return held * white


def read_around(capped: np.ndarray, size: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Bool as ``capped`` (..., K), errors in cells, each at most 1: which of the elements ``asked`` (bool) were read.

    In a region that was misread some elements look like a return by chance; the others tell what they are. A strong
    return makes errors, too. So the limit is lower only where the region has many times the usual ``size`` (power).
    """
    count, error = (_in_region(part) for part in (asked.astype(np.float32), capped * asked))
    read = asked & (error <= np.float32(_SPOILT) * count)
    doubted = read & (error > np.float32(_DOUBTED) * count)
    if doubted.any():
        usual = middle(size[asked])
        total = _in_region(np.minimum(size, np.float32(_UNLIKE * usual)) * asked)
        read &= ~(doubted & (total > np.float32(_UNEVEN * usual) * count))
    return read


def _in_region(values: np.ndarray) -> np.ndarray:
    """Means of (..., K) float32 in the region of each one; beyond the ends there is nothing."""
    return box(values, _REGION, before=_REGION // 2 - 1, beside=0.0)


def most_plausible(size: np.ndarray, asked: np.ndarray) -> np.float32:
    """The most power that is plausible of what is left in the elements ``asked``, bool as ``size``."""
    sizes = size[asked]
    if not sizes.size:
        return np.float32(0)
    at = int(_MOSTLY * sizes.size)
    sizes.partition(at)
    return _TOO_MUCH * sizes[at]


def whitened(noise: np.ndarray) -> np.ndarray:
    """(K,) float32 factors, at most 1, that bring a subcarrier's noise down to the usual noise."""
    noise = box(noise, _BESIDE)
    return np.minimum(np.sqrt(np.float32(middle(noise)) / np.maximum(noise, FAINT)), 1)


def _density(square: np.ndarray, modulus: float, noise: float) -> np.ndarray:
    """Density of a return of that modulus and noise at a squared distance: on a ring, or (beside the ridge's own line)
    a disc."""
    spread = (_SPREAD * modulus) ** 2 + noise / 2
    distance = np.sqrt(square)
    ring = distance - np.float32(modulus)
    ring *= ring
    ring *= np.float32(-0.5 / spread)
    np.exp(ring, out=ring)
    ring /= np.maximum(distance, np.float32(0.1 * modulus), out=distance)
    ring *= np.float32(_PRIOR_IN / (2 * np.pi * np.sqrt(2 * np.pi * spread)))
    size = (0.5 * modulus) ** 2 + noise
    disc = square * np.float32(-1 / size)
    np.exp(disc, out=disc)
    disc *= np.float32((1 - _PRIOR_IN) / (np.pi * size))
    ring += disc
    return ring


def _few_beside(few: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """(L, K) float32, 0..1: the share of elements of few points among the ``clear`` ones (L, K, float32 weights) around
    each, in its symbol (control) and in its block of all symbols (a user)."""

    def around(values: np.ndarray) -> np.ndarray:
        return _ALONG * box(values, _ALONG) + BLOCK * box(values.sum(axis=0), BLOCK)

    return (around(few * clear) + np.float32(0.5)) / (around(clear) + 1)


def _likeliest(evidence: Callable[[float], float], tried: np.ndarray, *, finer: bool) -> float | None:
    """The SIR in dB of most ``evidence`` among those ``tried``, or a step beside if ``finer``; None for the least."""
    best = max(tried, key=evidence)
    if best <= _SIR_DB[0]:
        return None
    return float(max(best + _STEP_DB, key=evidence) if finer else best)


def expected_return(
    received: Received, ridge: np.ndarray, clear: np.ndarray, near_db: float | None = None
) -> tuple[np.ndarray, float] | None:
    """Mean of the return, given what was received, in the elements of ``ridge`` (L, K): (elements,) complex64.

    Where the return is larger than half a cell of the lattice, the nearest point may be any point, and subtracting it
    leaves the return folded into a cell. The return's modulus is the same in all elements, so points at that distance
    from what was received are the likely ones. The mean over them is taken, with the modulus that makes all received
    elements most likely. A lattice of many points has one near anything, at any modulus, so the elements beside tell
    how likely the few points are. The SIR in dB that follows is returned as well; ``near_db``, the SIR of the frame
    before, saves the search. None where the nearest points suffice.
    """
    count, amplitudes = np.count_nonzero(ridge), received.amplitudes
    least = FOLD if amplitudes is None else _SOME_FOLD
    if not count or not clear.any() or (received.capped * ridge).sum() < least * count:
        return None
    level = float(np.sqrt((power(received.symbols) * clear).sum() / np.count_nonzero(clear)))
    at = np.flatnonzero(ridge)
    still = received.channel.ndim == 1
    channel = received.channel[at % received.channel.size] if still else received.channel.ravel()[at]
    scanty_points = SPARSE_POINTS[:, None]
    if amplitudes is not None:
        dense, few = (each.ravel()[at] for each in amplitudes)
        channel, scanty_points = channel * dense, scanty_points * (few / dense)
    values = received.symbols.ravel()[at] / channel
    size = power(channel)
    kinds = received.kinds.ravel()[at]
    root = np.array([SCALE[m] for m in DENSE])[kinds]
    tried = _SIR_DB if near_db is None else near_db + _STEP_DB

    def modulus(sir_db: float) -> float:
        return level * 10 ** ((sir_db + _LEVEL_DB) / 20)

    # points up to two from the nearest, or one where no other is at the return's distance
    reach = 1 if _FAR * modulus(tried.max()) < 3 * root.min() * np.sqrt(middle(size)) else 2
    steps = root * np.arange(-2 * reach, 2 * reach + 1, 2, dtype=np.float32)[:, None]
    near = np.choose(kinds, [nearest(values, m) for m in DENSE])
    top = np.array([1.001 * (np.sqrt(m) - 1) * SCALE[m] for m in DENSE], dtype=np.float32)[kinds]
    rests, inside = [], []
    for value, point in ((values.real, near.real), (values.imag, near.imag)):
        rests.append(value - (point + steps))
        inside.append((np.abs(point + steps) <= top).astype(np.float32))
    square = (rests[0] ** 2)[:, None] + rests[1] ** 2
    square *= size
    prior = inside[0][:, None] * (inside[1] / np.array(DENSE, dtype=np.float32)[kinds])
    few_rests = values - scanty_points
    few_square = power(few_rests) * size
    share = _few_beside(received.few, clear).ravel()[at]
    some = (np.ascontiguousarray(part[..., ::_SAMPLE]) for part in (square, prior, few_square, share))
    some_square, some_prior, some_few, some_share = some
    anything = np.float32(_ASTRAY / (np.pi * level**2))

    def evidence(sir_db: float) -> float:
        many = (_density(some_square, modulus(sir_db), received.noise) * some_prior).sum(axis=(0, 1))
        few = _SPARSE_PRIOR @ _density(some_few, modulus(sir_db), received.noise)
        return float(np.mean(np.log(many + some_share * (few - many) + anything)))

    sir_db = _likeliest(evidence, tried, finer=near_db is None)
    if sir_db is None:
        return None
    weight = _density(square, modulus(sir_db), received.noise)
    weight *= prior
    across = weight.sum(axis=1)
    many = across.sum(axis=0) + FAINT
    few_weight = _density(few_square, modulus(sir_db), received.noise) * _SPARSE_PRIOR[:, None]
    few = few_weight.sum(axis=0) + FAINT
    # a block is of one alphabet
    plane = np.zeros(ridge.shape, dtype=np.float32)
    np.put(plane, at, np.log(few / many))
    scanty = box(plane, BLOCK).ravel()[at] > 0
    mean = ((across * rests[0]).sum(axis=0) + 1j * (weight.sum(axis=0) * rests[1]).sum(axis=0)) / many
    mean = np.where(scanty, (few_weight * few_rests).sum(axis=0) / few, mean)
    return (mean * channel).astype(np.complex64), sir_db
