"""Elements that hold the return as well: where they are, and which part of them is the return."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from ...waveform import Waveform, altitude_to_delay_s
from .lattice import BLOCK, DENSE, FAINT, SCALE, SPARSE_POINTS, box, middle, nearest, power, rounded_each
from .numerology import Numerology
from .received import Received

__all__ = [
    "CHANGED_DB",
    "FOLD",
    "Density",
    "NearPoints",
    "Ridge",
    "expected_return",
    "few_beside",
    "modulus_of",
    "most_plausible",
    "plausible",
    "read_around",
    "usual_level",
    "whitened",
]

_MARGIN = 3  # subcarriers: a sweep of 15 kHz in a microsecond leaks into its neighbours
FOLD = 0.2  # error in the ridge, in cells, each at most 1, up to which a decision is right; a random one has 0.75
_SOME_FOLD = 0.05  # the same where weak users' cells are smaller than others'
_ALL, _NONE = 0.95, 0.01  # shares of few points in a symbol that has nothing else, and in one that has none
_ONE_KIND = 0.9  # of the elements have the same alphabet, if users have but one
_ASTRAY = 0.01  # share of elements whose alphabet was misjudged, which may be anything
_SIR_DB = np.arange(-40.0, -3.0, 2.0)
_STEPS_DB = np.array([0.0, -1.0, 1.0])  # to the finer grid, and from frame to frame
CHANGED_DB = np.array([-12.0, -8.0, -4.0, 4.0, 8.0])  # the same of a return that has changed
_SPREAD = 0.2  # of the return's modulus: noise and Fresnel's ripple
_PRIOR_IN = 0.75  # share of the ridge that the return fills, which has one delay of many
_LEVEL_DB = 8.5  # a return stands in one subcarrier of seven
_SPARSE_PRIOR = np.array([0.2] + [0.15] * 4 + [0.05] * 4, dtype=np.float32)[:, None]
_AXES = np.array([1, 1j, -1, -1j], dtype=np.complex64)[:, None]
_AXES_PRIOR = np.full((4, 1), 0.25, dtype=np.float32)
# of each of `DENSE`
_HALF_CELL = np.array([SCALE[m] for m in DENSE])
_OUTERMOST = np.array([1.001 * (np.sqrt(m) - 1) * SCALE[m] for m in DENSE], dtype=np.float32)
_EACH = 1 / np.array(DENSE, dtype=np.float32)  # how likely each point is
_SAMPLE = 4  # one element in four tells the SIR
CHANGE_SAMPLE = 8  # the same where it is asked only whether it has changed
_MOSTLY = 0.8  # of the elements have less than the usual power; in a fade cells, and what is left in them, are small
_TOO_MUCH = np.float32(3.0)  # times the usual power: more than return and noise, so the point was another one
_REGION = 20  # subcarriers that are misread together
_SPOILT = 0.5  # mean error of such a region, each at most 1; a random one has 0.75
_DOUBTED = 0.3  # the same of one that is louder than others
_UNEVEN = 4.0  # times the usual power, in the mean of such a region; a return from rough ground has that, too
_PARTS, _WIDTHS = (
    16,
    6,
)  # of the ring's standard deviation: the density's steps, and beyond the modulus its last
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


class Density:
    """Tabulated density of a return and noise over the distance from a point: a ring, or (beside its own line) a disc.

    At SIRs in dB ``sir_db`` (n,), beside symbols of RMS ``level`` and noise of power ``noise``.
    """

    def __init__(self, level: float, sir_db: np.ndarray, noise: float) -> None:
        modulus = modulus_of(level, sir_db)[:, None]
        spread = (_SPREAD * modulus) ** 2 + 0.5 * noise
        step = np.sqrt(spread) / _PARTS
        self._last = int((modulus / step).max() + _WIDTHS * _PARTS)
        distance = step * (0.5 + np.arange(self._last + 1))
        ring = np.exp(-0.5 * (distance - modulus) ** 2 / spread) / np.maximum(distance, 0.1 * modulus)
        ring *= _PRIOR_IN / (2 * np.pi * np.sqrt(2 * np.pi * spread))
        size = (0.5 * modulus) ** 2 + noise
        disc = (1 - _PRIOR_IN) / (np.pi * size) * np.exp(-(distance**2) / size)
        table = (ring + disc).astype(np.float32)
        table[:, -1] = 0  # and beyond: what is far from all points tells nothing of a return
        self._table = table.ravel()
        # of each SIR, in the flat table
        self._begins = np.arange(len(step), dtype=np.float32) * table.shape[1]
        self.count, self._per_distance = len(step), (1 / step[:, 0]).astype(np.float32)

    def __call__(self, distance: np.ndarray) -> np.ndarray:
        """(n, ...) float32 at distances (...), float32."""
        place = np.multiply.outer(self._per_distance, distance)
        np.minimum(place, np.float32(self._last), out=place)
        place += self._begins.reshape(-1, *(1,) * distance.ndim)
        return self._table.take(place.astype(np.intp))

    def first(self, distance: np.ndarray) -> np.ndarray:
        """(...) float32 at the first SIR."""
        place = distance * self._per_distance[0]
        np.minimum(place, np.float32(self._last), out=place)
        return self._table.take(place.astype(np.intp))


def modulus_of(level: float, sir_db: float | np.ndarray) -> float | np.ndarray:
    """Modulus of a return in its elements, beside symbols of RMS ``level``."""
    return level * 10 ** ((sir_db + _LEVEL_DB) / 20)


def few_beside(few: np.ndarray, clear: np.ndarray, *, varying: bool) -> np.ndarray:
    """(L, K) float32, 0..1: the share of elements of few points among the ``clear`` ones (L, K, float32 weights) around
    each, in its symbol (control) and in its block of all symbols (a user).

    It is 1 in a symbol that has nothing else, and 0 in one that has none, unless users are ``varying``.
    """

    def around(values: np.ndarray) -> np.ndarray:
        return _ALONG * box(values, _ALONG) + BLOCK * box(values.sum(axis=0), BLOCK)

    few = few * clear
    share = (around(few) + np.float32(0.5)) / (around(clear) + 1)
    if not varying:
        of_symbol = few.sum(axis=1) / np.maximum(clear.sum(axis=1), 1)
        share[of_symbol > _ALL], share[of_symbol < _NONE] = 1, 0
    return share


def _likeliest(evidence: Callable[[np.ndarray], np.ndarray], near_db: float | None) -> float | None:
    """The SIR in dB of most ``evidence``; None for the least. One near that of the frame before is not sought among
    all, unless the return has changed."""
    if near_db is not None:
        tried = near_db + np.r_[_STEPS_DB, CHANGED_DB]
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
    level = usual_level(received.symbols, clear)
    most_db = _SIR_DB[-1] if near_db is None else near_db + CHANGED_DB.max()
    kinds = np.bincount(received.kinds[ridge], minlength=len(DENSE))
    share = few_beside(received.few, clear, varying=kinds.max() < _ONE_KIND * count)[ridge]
    near = NearPoints(received, np.flatnonzero(ridge), share, modulus_of(level, most_db))
    some = near.some(_SAMPLE)

    def density(sir_db: np.ndarray) -> Density:
        return Density(level, sir_db, received.noise)

    sir_db = _likeliest(lambda sir_db: some.evidence(density(sir_db), level), near_db)
    return None if sir_db is None else (near.expected(density(np.array([sir_db]))), sir_db)


def usual_level(symbols: np.ndarray, clear: np.ndarray) -> float:
    """RMS of ``symbols`` (L, K), weighted by ``clear`` (L, K), float32."""
    return float(np.sqrt(np.vdot(power(symbols), clear) / clear.sum()))


class _FewPoints:
    """What a few points leave of ``values`` (elements,), in units of the channel; its modulus in those of the symbols,
    where the channel's is ``size`` (elements,); and the points' prior (points, 1)."""

    def __init__(self, values: np.ndarray, size: np.ndarray, points: np.ndarray, prior: np.ndarray) -> None:
        self._rests, self._prior = values - points, prior
        self._distance = np.abs(self._rests)
        self._distance *= size

    def some(self, at: np.ndarray) -> _FewPoints:
        """The same of some elements."""
        some = copy(self)
        some._rests, some._distance = self._rests[:, at], self._distance[:, at]
        return some

    def likely(self, density: Density) -> np.ndarray:
        """(n, elements) how likely what was received is at the SIRs of the density."""
        return (density(self._distance) * self._prior).sum(axis=1)

    def mean(self, density: Density) -> tuple[np.ndarray, np.ndarray]:
        """(elements,) mean of the return at the density's first SIR, and how likely what was received is."""
        weight = density.first(self._distance)
        weight *= self._prior
        likely = weight.sum(axis=0) + FAINT
        return (self._rests * weight).sum(axis=0) / likely, likely


class _Lattice:
    """The same for points near ``values`` of the lattices ``kinds`` (elements,), for returns up to a ``modulus``.

    Both rails have the same steps, so what depends on one rail is (rail, steps, elements): its rests, and whether its
    points are inside the lattice. The density needs all pairs of them.
    """

    def __init__(self, values: np.ndarray, size: np.ndarray, kinds: np.ndarray, modulus: float) -> None:
        self._each = _EACH.take(kinds)
        if kinds.min() == kinds.max():
            kinds = kinds[:1]
            near = nearest(values, DENSE[kinds[0]])
        else:
            near = rounded_each(values[None], kinds[None], np.zeros(1, dtype=int))[0][0]
        root = _HALF_CELL[kinds]
        # points up to two from the nearest, or one where no other is at the return's distance
        reach = 1 if _FAR * modulus < 3 * root.min() * size.mean() else 2
        points = np.stack([near.real, near.imag])[:, None]
        points = points + root * np.arange(-2 * reach, 2 * reach + 1, 2, dtype=np.float32)[:, None]
        self._rests = np.stack([values.real, values.imag])[:, None] - points
        self._inside = (np.abs(points) <= _OUTERMOST[kinds]).astype(np.float32)
        square = (self._rests * size) ** 2
        self._distance = np.sqrt(square[0][:, None] + square[1])

    def some(self, at: np.ndarray) -> _Lattice:
        """The same of some elements."""
        some = copy(self)
        some._rests, some._inside = self._rests[..., at], self._inside[..., at]
        some._each, some._distance = self._each[at], self._distance[..., at]
        return some

    def likely(self, density: Density) -> np.ndarray:
        """See `_FewPoints.likely`."""
        weight = density(self._distance)
        weight *= self._inside[0][:, None]
        return self._each * ((weight.sum(axis=1)) * self._inside[1]).sum(axis=1)

    def mean(self, density: Density) -> tuple[np.ndarray, np.ndarray]:
        """See `_FewPoints.mean`."""
        weight = density.first(self._distance)
        of_real = (weight * self._inside[1]).sum(axis=1) * self._inside[0]
        of_imag = (weight * self._inside[0][:, None]).sum(axis=0) * self._inside[1]
        likely = of_real.sum(axis=0) + FAINT
        mean = np.empty(likely.shape, dtype=np.complex64)
        np.divide((of_real * self._rests[0]).sum(axis=0), likely, out=mean.real)
        np.divide((of_imag * self._rests[1]).sum(axis=0), likely, out=mean.imag)
        return mean, self._each * likely


class NearPoints:
    """Points near what was received in the elements ``at``, places in (L, K), for returns up to some ``modulus``.

    They are those of each one's lattice; and by the ``share`` (elements,) of few points beside also, or only,
    `SPARSE_POINTS` and those on the axes if any symbol has some: the synchronisation signals.
    """

    def __init__(self, received: Received, at: np.ndarray, share: np.ndarray, modulus: float) -> None:
        channel = received.channel
        channel = channel[at % channel.size] if channel.ndim == 1 else channel.ravel()[at]
        scale = np.ones(1, dtype=np.float32)
        if received.amplitudes is not None:
            dense, few = (each.ravel()[at] for each in received.amplitudes)
            channel, scale = channel * dense, few / dense
        values, size = received.symbols.ravel()[at] / channel, np.abs(channel)
        self._shape, self._at, self._channel, self._share = received.symbols.shape, at, channel, share
        self._many_at, self._few_at = np.flatnonzero(share < 1), np.flatnonzero(share > 0)
        self._many: _Lattice | None = None
        self._few: list[_FewPoints] = []
        if self._many_at.size:
            mine = self._many_at
            self._many = _Lattice(values[mine], size[mine], received.kinds.ravel()[at[mine]], modulus)
        if self._few_at.size:
            mine = self._few_at
            values, size, scale = values[mine], size[mine], scale if scale.size == 1 else scale[mine]
            families = [(SPARSE_POINTS[:, None], _SPARSE_PRIOR)]
            if _some_on_axes(received.points[received.few]):
                families.append((_AXES, _AXES_PRIOR))
            self._few = [_FewPoints(values, size, points * scale, prior) for points, prior in families]

    def some(self, every: int) -> NearPoints:
        """One element in ``every`` few, for `evidence` alone."""
        some = copy(self)
        many, few = (np.flatnonzero(at % every == 0) for at in (self._many_at, self._few_at))
        some._many_at, some._few_at = self._many_at[many] // every, self._few_at[few] // every
        some._share = self._share[::every]
        some._many = self._many and self._many.some(many)
        some._few = [each.some(few) for each in self._few]
        return some

    def evidence(self, density: Density, level: float) -> np.ndarray:
        """(n,) how likely what was received is at the SIRs of the density; ``level`` is the symbols' RMS."""
        likely = np.zeros((density.count, self._share.size), dtype=np.float32)
        if self._many:
            at = self._many_at
            likely[:, at] = (1 - self._share[at]) * self._many.likely(density)
        for each in self._few:
            likely[:, self._few_at] += self._share[self._few_at] * each.likely(density)
        return np.log(likely + np.float32(_ASTRAY / (np.pi * level**2))).mean(axis=1)

    def expected(self, density: Density) -> np.ndarray:
        """(elements,) complex64 mean of the return at the density's first SIR."""
        mean, likely = (np.zeros(self._at.size, dtype=kind) for kind in (np.complex64, np.float32))
        if self._many:
            mean[self._many_at], likely[self._many_at] = self._many.mean(density)
        most, at = np.float32(0), self._few_at
        for each in self._few:
            of_few, how_likely = each.mean(density)
            alone = likely[at] == 0
            mean[at[alone]], likely[at[alone]] = of_few[alone], how_likely[alone]
            if alone.all():
                continue
            # a block is of one alphabet
            plane = np.zeros(self._shape, dtype=np.float32)
            np.put(plane, self._at[at], np.log(how_likely / likely[at]))
            more = box(plane, BLOCK).ravel()[self._at[at]]
            mean[at], most = np.where(more > most, of_few, mean[at]), np.maximum(more, most)
        return mean * self._channel


def _some_on_axes(points: np.ndarray) -> bool:
    """Whether some points (n,) stand on the axes, at least a block of them."""
    sent = power(points)
    return np.count_nonzero((np.abs(points.real * points.imag) < 1e-3 * sent) & (sent > 0.1)) >= BLOCK
