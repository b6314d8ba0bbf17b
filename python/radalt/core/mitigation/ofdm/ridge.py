"""Elements that hold the return as well: where they are, and which part of them is the return."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...waveform import Waveform, altitude_to_delay_s
from .demodulator import Received
from .lattice import BLOCK, DENSE, FAINT, SCALE, SPARSE_POINTS, box, middle, power, rounded_each
from .numerology import Numerology

__all__ = [
    "FOLD",
    "NearPoints",
    "Ridge",
    "expected_return",
    "few_beside",
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
_STEPS_DB = np.array([0.0, -1.0, 1.0])  # to the finer grid, and from frame to frame
_CHANGED_DB = np.array([-12.0, -8.0, -4.0, 4.0, 8.0])  # the same of a return that has changed
_SPREAD = 0.2  # of the return's modulus: noise and Fresnel's ripple
_PRIOR_IN = 0.75  # share of the ridge that the return fills, which has one delay of many
_LEVEL_DB = 8.5  # a return stands in one subcarrier of seven
_SPARSE_PRIOR = np.array([0.2] + [0.15] * 4 + [0.05] * 4, dtype=np.float32)[:, None]
_AXES = np.array([1, 1j, -1, -1j], dtype=np.complex64)[:, None]
_AXES_PRIOR = np.full((4, 1), 0.25, dtype=np.float32)
# of each of `DENSE`
_HALF_CELL = np.array([SCALE[m] for m in DENSE])
_OUTERMOST = np.array([1.001 * (np.sqrt(m) - 1) * SCALE[m] for m in DENSE], dtype=np.float32)
_POINTS = np.array(DENSE, dtype=np.float32)
_SAMPLE = 4  # one element in four tells the SIR
_CHANGE_SAMPLE = 8  # the same where it is asked only whether it has changed
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


def _density(square: np.ndarray, modulus: np.ndarray, noise: float) -> np.ndarray:
    """Density of a return of each ``modulus`` (n,) and noise at squared distances (points, elements), float32: on a
    ring, or (beside the ridge's own line) a disc; (n, points, elements)."""
    modulus = modulus.astype(np.float32)[:, None, None]
    spread = (_SPREAD * modulus) ** 2 + 0.5 * noise
    distance = np.sqrt(square)
    ring = distance - modulus
    ring *= ring
    ring *= -0.5 / spread
    np.exp(ring, out=ring)
    ring /= np.maximum(distance, 0.1 * modulus)
    ring *= _PRIOR_IN / (2 * np.pi * np.sqrt(2 * np.pi * spread))
    size = (0.5 * modulus) ** 2 + noise
    disc = square * (-1 / size)
    np.exp(disc, out=disc)
    disc *= (1 - _PRIOR_IN) / (np.pi * size)
    ring += disc
    return ring


def few_beside(few: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """(L, K) float32, 0..1: the share of elements of few points among the ``clear`` ones (L, K, float32 weights) around
    each, in its symbol (control) and in its block of all symbols (a user)."""

    def around(values: np.ndarray) -> np.ndarray:
        return _ALONG * box(values, _ALONG) + BLOCK * box(values.sum(axis=0), BLOCK)

    return (around(few * clear) + np.float32(0.5)) / (around(clear) + 1)


def _likeliest(evidence: Callable[[np.ndarray], np.ndarray], near_db: float | None) -> float | None:
    """The SIR in dB of most ``evidence``; None for the least. One near that of the frame before is not sought among
    all, unless the return has changed."""
    if near_db is not None:
        tried = near_db + np.r_[_STEPS_DB, _CHANGED_DB]
        best = int(evidence(tried).argmax())
        if best < _STEPS_DB.size:
            return float(tried[best]) if tried[best] > _SIR_DB[0] else None
    best = int(evidence(_SIR_DB).argmax())
    if not best:
        return None
    tried = _SIR_DB[best] + _STEPS_DB
    return float(tried[evidence(tried).argmax()])


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
    most_db = _SIR_DB[-1] if near_db is None else near_db + _CHANGED_DB.max()
    near = NearPoints(received, ridge, clear, most_db)
    sir_db = _likeliest(near.evidence(few_beside(received.few, clear)[ridge]), near_db)
    return None if sir_db is None else (near.expected(sir_db), sir_db)


class NearPoints:
    """Points near what was received in the elements of ``ridge`` (L, K), for SIR up to ``most_db``.

    They are those of each one's lattice, `SPARSE_POINTS`, and those on the axes if any symbol has some: the
    synchronisation signals.
    """

    def __init__(self, received: Received, ridge: np.ndarray, clear: np.ndarray, most_db: float) -> None:
        self._noise, self._shape, self._at = received.noise, ridge.shape, np.flatnonzero(ridge)
        self._level = float(np.sqrt(np.vdot(power(received.symbols), clear) / clear.sum()))
        at, channel = self._at, received.channel
        channel = channel[at % channel.size] if channel.ndim == 1 else channel.ravel()[at]
        families = [(SPARSE_POINTS[:, None], _SPARSE_PRIOR)]
        if _some_on_axes(received.points):
            families.append((_AXES, _AXES_PRIOR))
        scale = 1
        if received.amplitudes is not None:
            dense, few = (each.ravel()[at] for each in received.amplitudes)
            channel, scale = channel * dense, few / dense
        self._channel, values = channel, received.symbols.ravel()[at] / channel
        size = power(channel)
        kinds = received.kinds.ravel()[at]
        root = _HALF_CELL[kinds]
        # points up to two from the nearest, or one where no other is at the return's distance
        reach = 1 if _FAR * self._modulus(most_db) < 3 * root.min() * np.sqrt(middle(size)) else 2
        steps = np.arange(-2 * reach, 2 * reach + 1, 2, dtype=np.float32)
        near = rounded_each(values[None], kinds[None], np.zeros(1, dtype=int))[0]
        dense = near + root * (steps[:, None] + 1j * steps).astype(np.complex64).reshape(-1, 1)
        top = _OUTERMOST[kinds]
        self._rests = np.concatenate([values - dense, *(values - points * scale for points, _ in families)])
        self._square = power(self._rests)
        self._square *= size
        self._prior = np.empty_like(self._square)
        self._first = np.cumsum([0, len(dense), *(len(prior) for _, prior in families[:-1])])
        inside = (np.abs(dense.real) <= top) & (np.abs(dense.imag) <= top)
        np.divide(inside, _POINTS[kinds], out=self._prior[: len(dense)])
        self._prior[len(dense) :] = np.concatenate([prior for _, prior in families])

    def _modulus(self, sir_db: float | np.ndarray) -> float | np.ndarray:
        return self._level * 10 ** ((sir_db + _LEVEL_DB) / 20)

    def evidence(self, share: np.ndarray, every: int = _SAMPLE) -> Callable[[np.ndarray], np.ndarray]:
        """How likely one element in ``every`` few is at SIRs in dB (n,): (n,); ``share`` (elements,) is that of few
        points, by the elements beside."""
        square, prior, share = (
            np.ascontiguousarray(part[..., ::every]) for part in (self._square, self._prior, share)
        )
        anything = np.float32(_ASTRAY / (np.pi * self._level**2))

        def evidence(sir_db: np.ndarray) -> np.ndarray:
            each = self._of_families(_density(square, self._modulus(sir_db), self._noise) * prior)
            many, few = each[:, 0], each[:, 1:].sum(axis=1)
            return np.log(many + share * (few - many) + anything).mean(axis=1)

        return evidence

    def goes_on(self, sir_db: float, share: np.ndarray) -> bool:
        """Whether the return is as large as at that SIR in dB, and not smaller or larger by far; as `evidence`."""
        return not self.evidence(share, _CHANGE_SAMPLE)(sir_db + np.r_[0.0, _CHANGED_DB]).argmax()

    def expected(self, sir_db: float) -> np.ndarray:
        """(elements,) complex64 mean of the return."""
        weight = _density(self._square, np.array([self._modulus(sir_db)]), self._noise)[0]
        weight *= self._prior
        likely = self._of_families(weight) + FAINT
        means = self._of_families(self._rests * weight) / likely
        mean, most = means[0], np.float32(0)
        for of_few, how_likely in zip(means[1:], likely[1:], strict=True):
            # a block is of one alphabet
            plane = np.zeros(self._shape, dtype=np.float32)
            np.put(plane, self._at, np.log(how_likely / likely[0]))
            more = box(plane, BLOCK).ravel()[self._at]
            mean, most = np.where(more > most, of_few, mean), np.maximum(more, most)
        return (mean * self._channel).astype(np.complex64)

    def _of_families(self, values: np.ndarray) -> np.ndarray:
        """Sums of (..., points, elements) over each family of points: (..., families, elements)."""
        return np.add.reduceat(values, self._first, axis=-2)


def _some_on_axes(points: np.ndarray) -> bool:
    """Whether some (L, K) points stand on the axes, at least a block of them."""
    sent = power(points)
    return np.count_nonzero((np.abs(points.real * points.imag) < 1e-3 * sent) & (sent > 0.1)) >= BLOCK
