"""The channel of every subcarrier from decided points, constant over the frame or moving with time."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .acquisition import level_in_use
from .lattice import FAINT, box, middle, power

__all__ = ["audible", "best_order", "fit", "loudest", "mended", "smooth_fit", "standing", "sums"]

# of the energy, added to what would make a channel move that one symbol alone tells of
_LOADING = np.float32(1e-4)
_ALONG = 3  # subcarriers on either side over which a channel is quadratic: 5 us of delay are 0.7 radians
_BENDS = np.float64(1e-6)  # of the energy, added to what would make it bend where few subcarriers tell
_GAP = 5  # subcarriers: fewer are noise
_MOST = 0.75  # of the subcarriers have to be right
_BESIDE = 8  # subcarriers on either side that tell how the channel goes on
_ORDERS = 3  # 0, 1, 2: tried in the end, and the unknowns of the last
_HELPS = 0.9  # of the error left, for a higher order to be taken
_HARDLY = 0.95  # of the error left by a rough sum: more, and that order would not help
_LOUDEST = np.float32(1.7)  # times the usual amplitude: more, and silence explains anything
_STEADY = 1.3  # times the error of a frame before, within which a channel that stood still does so


def sums(
    agreement: np.ndarray, weight: np.ndarray, times: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of a polynomial of ``order`` in time: (order + 1, K) complex64, (2 order + 1, K) float32.

    ``agreement`` (L, K) is received times conjugate model, ``weight`` (L, K) the model's power; zero where not to be
    used.
    """
    if order == 0:
        return agreement.sum(axis=0)[None], weight.sum(axis=0)[None]
    basis = np.vander(times, 2 * order + 1, increasing=True).T.astype(times.dtype)
    # in real numbers: a product of complex ones costs four times that
    return (basis[: order + 1] @ agreement.view(np.float32)).view(np.complex64), basis @ weight


def fit(right: np.ndarray, left: np.ndarray, order: int, width: int) -> np.ndarray:
    """(order + 1, K) coefficients of the factor by which the model has to be multiplied, over ``width`` subcarriers
    each.

    1 where too little was received to tell.
    """
    right, left = right[: order + 1], left[: 2 * order + 1]
    if width > 1:
        right = ndimage.uniform_filter1d(right, width, axis=1)
        left = box(left, width)
    energy = left[0]
    if order == 0:
        factor = right / np.maximum(energy, 1e-30)
    elif order == 1:
        square = left[2] + _LOADING * energy
        determinant = np.maximum(energy * square - left[1] * left[1], 1e-30)
        factor = np.stack([square * right[0] - left[1] * right[1], energy * right[1] - left[1] * right[0]])
        factor /= determinant
    else:
        factor = _quadratic(right, left.astype(np.float64))
    unknown = energy <= 1e-3 / energy.size * energy.sum()
    np.putmask(factor[0], unknown, 1)
    for course in factor[1:]:
        np.putmask(course, unknown, 0)
    return factor.astype(np.complex64, copy=False)


def _quadratic(right: np.ndarray, left: np.ndarray) -> np.ndarray:
    """(3, K) complex128 coefficients from `sums` of order 2, (3, K) and (5, K) float64.

    Elimination without pivots, as for any positive definite matrix, of all subcarriers at once: a solver called for
    each costs six times that.
    """
    steady = _LOADING * left[0]
    energy = left[0] + 1e-30
    first, second = left[1] / energy, left[2] / energy
    inner = left[2] + steady - first * left[1] + 1e-30
    mixed = (left[3] - first * left[2]) / inner
    outer = left[4] + steady - second * left[2] - mixed * mixed * inner + 1e-30
    one = right[1] - first * right[0]
    two = (right[2] - second * right[0] - mixed * one) / outer
    one = one / inner - mixed * two
    return np.stack([right[0] / energy - first * one - second * two, one, two])


def smooth_fit(right: np.ndarray, left: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """As `fit` of order 2, for a channel that is quadratic over the subcarriers around each, too (local regression).

    ``right`` and ``left`` are `sums` for points, whose factor is the channel; ``channel`` (L, K), what is known of it,
    tells its mean delay. Seven subcarriers tell of each one, which leaves a third of the noise.
    """
    count = right.shape[1]
    slope = np.angle((channel[:, 1:] * channel[:, :-1].conj()).sum())
    late = np.exp(1j * slope * np.arange(count))
    away = np.arange(-_ALONG, _ALONG + 1) / _ALONG
    # sums over the subcarriers around each, by powers of time and of distance
    received = np.stack([_around(right * late.conj(), away**n) for n in range(3)], axis=1)
    energies = np.stack([_around(left.astype(np.float64), away**n) for n in range(5)], axis=1)
    time, place = np.divmod(np.arange(9), 3)
    matrix = energies[np.add.outer(time, time), np.add.outer(place, place)]
    energy = matrix[0, 0].copy()
    known = energy > 1e-3 * energy.mean()
    at = np.arange(9)
    matrix[at, at] += ((time > 0) * np.float64(_LOADING) + (place > 0) * _BENDS)[:, None] * energy
    matrix[:, :, ~known] = np.eye(9)[:, :, None]
    factor = _solved(matrix, received.reshape(9, count))[place == 0] * late
    factor[0, ~known], factor[1:, ~known] = 1, 0
    return factor.astype(np.complex64)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(n, K) solutions of K positive definite systems (n, n, K), float64; ``matrix`` is overwritten.

    Elimination without pivots, of all subcarriers at once. A solver called for each takes several times as long, and
    with threads of its own, beside other work, a thousand times.
    """
    right, count = right.copy(), len(matrix)
    for k in range(count - 1):
        share = matrix[k + 1 :, k] / matrix[k, k]
        matrix[k + 1 :, k + 1 :] -= share[:, None] * matrix[k, k + 1 :]
        right[k + 1 :] -= share * right[k]
    for k in reversed(range(count)):
        right[k] -= (matrix[k, k + 1 :] * right[k + 1 :]).sum(axis=0)
        right[k] /= matrix[k, k]
    return right


def _around(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(rows, K) weighted sums of the subcarriers around each; none are beside the band."""
    return ndimage.correlate1d(values, weights, axis=1, mode="constant")


def mended(channel: np.ndarray, astray: np.ndarray) -> np.ndarray | None:
    """(K,) channel whose runs of ``astray`` (K,) subcarriers are bridged from both sides; None if it has none.

    The data leave the channel's phase open by a quarter turn. Where noise hid how it goes on, it may have made such a
    turn, and is wrong over the subcarriers of the turn. Runs at the ends have one side only and stay.
    """
    right = np.flatnonzero(~astray)
    gaps = np.flatnonzero(np.diff(right) > _GAP)
    if not gaps.size or right.size < _MOST * channel.size:
        return None
    pairs = ~(astray[1:] | astray[:-1])
    slope = np.angle((channel[1:] * channel[:-1].conj())[pairs].sum())
    back = np.exp(-1j * slope * np.arange(channel.size))
    flat = channel * back
    for gap in gaps:
        first, last = right[gap], right[gap + 1]
        before = flat[right[max(0, gap - _BESIDE + 1) : gap + 1]].mean()
        after = flat[right[gap + 1 : gap + 1 + _BESIDE]].mean()
        turns = np.exp(-0.5j * np.pi * np.round(np.angle(after * before.conj()) / (np.pi / 2)))
        flat[last:] *= turns
        flat[first : last + 1] = np.linspace(before, after * turns, last - first + 1)
    return (flat * back.conj()).astype(np.complex64)


def best_order(
    symbols: np.ndarray,
    agreement: np.ndarray,
    weight: np.ndarray,
    times: np.ndarray,
    sure: np.ndarray,
    steady: float,
    *,
    read: bool = False,
) -> tuple[np.ndarray, float]:
    """Coefficients of the order with the least error, and that error per element.

    Orders rise while that helps the median subcarrier, and the error is larger than where the channel stood still,
    ``steady``. At the receiver's edges echoes are longer than the prefix. Symbols that were ``read`` may tell of a
    course that is even in time, which the first order does not have. Where the second does not help, neither does the
    first.
    """
    energy = (power(symbols) * sure).sum(axis=0)
    elements = sure.sum(axis=0, dtype=np.float32)
    known = elements > _ORDERS

    def left_of(order: int, right: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        factor = fit(right, left, order, 1)
        # |y - c m|^2 summed, where c solves the normal equations with their loading
        rest = energy - np.einsum("nk,nk->k", factor.conj(), right[: order + 1]).real
        if order:
            rest -= _LOADING * left[0] * power(factor[1:]).sum(axis=0)
        return factor, rest

    def usual(rest: np.ndarray, order: int) -> float:
        return middle((rest / np.maximum(elements - order - 1, 1))[known]) if known.any() else 0.0

    def fitted(order: int) -> tuple[np.ndarray, float]:
        factor, rest = left_of(order, *both)
        return factor, usual(rest, order)

    factor, rest = left_of(0, *sums(agreement, weight, times, 0))
    best = factor, usual(rest, 0)
    if best[1] < _STEADY * steady:
        return best
    both = sums(agreement, weight, times, 2)  # all that the first needs as well
    # most frames stand still: their second order need not be solved for
    if read and usual(rest - _explained(*both, factor[0]), 2) > _HARDLY * best[1]:
        return best
    second = fitted(2) if read else None
    if second and second[1] >= _HELPS * best[1]:
        return best
    first = fitted(1)
    if first[1] < _HELPS * best[1]:
        best = first
        if best[1] < _STEADY * steady:
            return best
    elif not read:
        return best
    second = second or fitted(2)
    return second if second[1] < _HELPS * best[1] else best


def _explained(right: np.ndarray, left: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """(K,) how much less a course of order 2 leaves than a ``factor`` (K,) that stands still, about.

    ``right`` and ``left`` are the `sums` of order 2. Either power of time is taken as if it alone was fitted: beside
    each other they explain as much, but for the elements that are left out.
    """
    along = right[1:] - factor * left[1:3]
    spread = left[2::2] - left[1:3] * left[1:3] / np.maximum(left[0], FAINT)
    return (power(along) / np.maximum(spread, FAINT)).sum(axis=0)


def standing(
    symbols: np.ndarray,
    channel: np.ndarray,
    points: np.ndarray,
    times: np.ndarray,
    sure: np.ndarray,
    noise: float,
    clear: np.ndarray,
) -> tuple[np.ndarray, float]:
    """A channel that stands still, (K,), and its error, if that is hardly more than ``noise``; or both as they are.

    One that moves is `audible`: a course that few symbols tell of runs away beside them.
    """
    if channel.ndim < 2:
        return channel, noise
    flat = channel.mean(axis=0)
    model = flat * points
    factor, rest = best_order(
        symbols, symbols * model.conj() * sure, power(model) * sure, times, sure, np.inf
    )
    if rest < _STEADY * noise:
        return flat * factor[0], rest
    return audible(channel, loudest(symbols, clear)), noise


def loudest(symbols: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """(K,) largest amplitude that a channel may have, by the power of the ``clear`` (L, K) elements."""
    return _LOUDEST * np.sqrt(level_in_use(symbols, clear)[0])


def audible(model: np.ndarray, most: np.ndarray) -> np.ndarray:
    """(L, K) channel that is nowhere larger than ``most`` (K,), nor zero."""
    size = np.abs(model)
    return np.where(size > 0, model * np.minimum(1, most / np.maximum(size, np.float32(1e-9))), most)
