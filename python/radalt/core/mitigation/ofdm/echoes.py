"""A moving channel as echoes: what is read in one part of a frame is carried on to the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft, linalg, ndimage

from .acquisition import Grid
from .channel_fit import audible, loudest, sums
from .demodulator import AGAIN, demodulate, times_of
from .lattice import amid, decide, power
from .numerology import Numerology
from .received import Received

__all__ = ["Echoes", "grown"]

_EARLY, _LATE = 12, 30  # samples of delay about the mean one; echoes come later
_ORDER = 2  # of each echo's course in time
_LOADING = (1e-5, 1e-4, 1e-3)  # of the energy, by power of time: high ones are less likely
_FAINT = 1e-3  # of the strongest echo's power: what counts as little in the next fit
_SHARES = np.array([[1.0], [0.33], [0.1]])  # of a power of time in an echo's power, mean over the frame
_SEED = 0.3  # mean error of the elements around one that was read before
_FEWEST = 60  # elements of a region that was read before
_MOST = 5  # such regions
_TRUSTED = 0.5  # mean error of the elements around one that is read with the echoes
_WEIGHT = 0.2  # mean error around an element at which its weight is 1/e
_SURE = 1.5  # error in cells, up to half a neighbour's distance
_BRIDGE = np.ones((3, 9))  # symbols and subcarriers over which a region goes on
_ROUNDS, _SPREADS = 12, 0.005  # at most; share of the elements that have to be won in one
_CLEARLY = 0.97  # of the error, with the right quarter turn instead of the second best
_ENOUGH = 20.0  # elements of a symbol that tell its phase
_BETTER = 0.97  # of what the model left before


@dataclass
class _Reading:
    """(L, K) points, their errors in cells, and the mean error around each element."""

    points: np.ndarray
    error: np.ndarray
    near: np.ndarray

    def weight(self, asked: np.ndarray) -> np.ndarray:
        """(L, K) float32: how much an element of ``asked`` (L, K) tells of the channel."""
        return (asked & (self.error < _SURE)) * np.exp(-np.square(self.near / np.float32(_WEIGHT)))


def grown(grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> Received:
    """A frame read with a channel of echoes, or as ``received`` where that explains more.

    An element that was misread tells nothing of its channel, so errors stay where they are. But a few echoes, each with
    a quadratic course in time, make up the channel of all elements. They are fitted to the largest region that was
    read, tell the channel beside it, and are fitted again to the region that is read then. Other regions may be a
    quarter turn off: the turn with which one channel explains both is taken.
    """
    growth = _Growth(grid, clear & grid.used, received, numerology)
    regions = growth.regions()
    if not regions:
        return received
    growth.spread(regions[0])
    for region in regions[1:]:
        growth.join(region)
    again = demodulate(growth.result(), clear, numerology, AGAIN)
    again.late += received.late
    # elements that are taken for 256QAM are near its points whatever they are: less is left, and no more is read
    if again.mean_misread > received.mean_misread:
        return received
    return again if _left(again, growth.clear) < _BETTER * _left(received, growth.clear) else received


def _left(received: Received, clear: np.ndarray) -> float:
    """Energy of the ``clear`` elements that the model does not explain."""
    return float((power(received.symbols - received.channel * received.points) * clear).sum())


class Echoes:
    """A channel of a few echoes, each with a quadratic course in time.

    Parameters
    ----------
    channel, read : (M, K) complex64, (M, K) bool
        The channel of some symbols, and where it is known: it tells the mean delay.
    count : int
        Symbols of the frame.
    numerology : Numerology

    Attributes
    ----------
    likely : (delays,) float
        Power of each delay, of the strongest one's.
    """

    def __init__(self, channel: np.ndarray, read: np.ndarray, count: int, numerology: Numerology) -> None:
        pairs = (channel[:, 1:] * channel[:, :-1].conj())[read[:, 1:] & read[:, :-1]]
        late = -np.angle(pairs.sum()) / (2 * np.pi / numerology.useful) - _EARLY
        self._ahead = np.exp(1j * late * numerology.turn).astype(np.complex64)
        self._times = times_of(count)
        self.likely = np.ones(_EARLY + _LATE)

    def fitted(
        self, symbols: np.ndarray, points: np.ndarray, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(L, K) channel by least squares, and the power of each delay, of the strongest one's, at least `_FAINT`.

        Faint delays are loaded more than strong ones, which leaves few unknowns where little was read.
        """
        delays, orders = self.likely.size, _ORDER + 1
        right, left = sums(symbols * points.conj() * weight, power(points) * weight, self._times, _ORDER)
        # sums over the subcarriers, which are evenly spaced, are transforms
        across = fft.ifft(fft.ifftshift(left, axes=1), axis=1, norm="forward").astype(np.complex128)
        right = fft.ifft(fft.ifftshift(right * self._ahead, axes=1), axis=1, norm="forward")[:, :delays]
        apart = np.subtract.outer(np.arange(delays), np.arange(delays))
        power_of = np.add.outer(np.arange(orders), np.arange(orders))
        matrix = across[power_of[:, None, :, None], apart[None, :, None, :]].reshape(orders * delays, -1)
        loading = np.array(_LOADING)[:, None] / self.likely * left[0].sum()
        matrix[np.diag_indices(len(matrix))] += loading.ravel() + 1e-30
        # positive definite by its loading; beside other work a general solver's threads wait for each other
        echoes = linalg.lapack.zposv(matrix, right.ravel().astype(np.complex128))[1].reshape(orders, delays)
        courses = fft.fftshift(fft.fft(echoes, symbols.shape[1], axis=1), axes=1) * self._ahead.conj()
        channel = (self._times[:, None] ** np.arange(orders)) @ courses
        loud = ndimage.maximum_filter1d((np.square(np.abs(echoes)) * _SHARES).sum(axis=0), 3)
        return channel.astype(np.complex64), np.maximum(loud / max(loud.max(), 1e-30), _FAINT)


class _Growth:
    """Region of a frame whose elements are read with one channel of echoes."""

    def __init__(self, grid: Grid, clear: np.ndarray, received: Received, numerology: Numerology) -> None:
        self.grid, self.clear = grid, clear
        self.symbols, self.phase, self.angles = received.symbols, received.phase, received.angles
        self._received = received
        self._halves = numerology.halves(grid.starts, grid.first_long)
        self._heard = clear.astype(np.float32)
        self._before = _Reading(received.points, received.error, amid(received.capped, self._heard))
        self._channel = np.broadcast_to(received.channel, self.symbols.shape)
        read = (self._before.near < _SEED) & grid.used
        self._echoes = Echoes(self._channel, read, len(self.symbols), numerology)
        self._most = loudest(self.symbols, clear)
        self._labels, found = ndimage.label(read)
        self._sizes = np.bincount(self._labels[clear], minlength=found + 1)
        self.region, self.now, self.model = read, self._before, self._channel

    def regions(self) -> list[np.ndarray]:
        """(L, K) bool each: what was read before, the largest region first."""
        labels = 1 + np.argsort(-self._sizes[1:])[:_MOST]
        return [self._labels == label for label in labels if self._sizes[label] > _FEWEST]

    def spread(self, region: np.ndarray) -> None:
        """Fit the echoes to ``region`` (L, K) bool, read the frame with them, and so on while the region grows."""
        last = 0.0
        for _ in range(_ROUNDS):
            weight = self.now.weight(region & self.clear)
            if not weight.any():
                break
            model, self._echoes.likely = self._echoes.fitted(self.symbols, self.now.points, weight)
            self._turn((self.symbols * (model * self.now.points).conj() * weight).sum(axis=1), weight)
            self.model = audible(model, self._most)
            found = decide(self.symbols / self.model, self.clear, self._halves)
            self.now = _Reading(found.points, found.error, amid(found.capped, self._heard))
            region = self._connected((self.now.near < _TRUSTED) & self.grid.used, region)
            share = region.mean()
            if share < last + _SPREADS:
                break
            last = share
        self.region = region

    def join(self, other: np.ndarray) -> None:
        """`spread` from what is read now and the region ``other`` as it was read before, if they fit together."""
        other = other & ~self.region
        if np.count_nonzero(other & self.clear) < _FEWEST:
            return
        before = self._before
        weight = np.where(other, before.weight(other & self.clear), self.now.weight(self.region & self.clear))
        tried = []
        for turn in np.array([1, 1j, -1, -1j], dtype=np.complex64):
            points = np.where(other, turn * before.points, self.now.points)
            model, _ = self._echoes.fitted(self.symbols, points, weight)
            tried.append((float((power(self.symbols - model * points) * weight).sum()), points))
        tried.sort(key=lambda one: one[0])
        if tried[0][0] < _CLEARLY * tried[1][0]:
            error = np.where(other, before.error, self.now.error)
            self.now = _Reading(tried[0][1], error, np.where(other, before.near, self.now.near))
            self.spread(self.region | other)

    def result(self) -> Grid:
        """The grid with the channel of the echoes, or the one before where a subcarrier is read better with it."""
        turned = self._channel * (self.phase * self._received.phase.conj())
        finer = self.now.near.mean(axis=0) <= self._before.near.mean(axis=0)
        channel = np.where(finer, self.model, turned)
        return replace(self.grid, symbols=self.symbols, phase=self.phase, channel=channel, angles=self.angles)

    def _turn(self, agreement: np.ndarray, weight: np.ndarray) -> None:
        """Set symbols upright by their ``agreement`` (L,) with the model, where enough elements tell it."""
        angle = np.where(weight.sum(axis=1) < _ENOUGH, 0, np.angle(agreement + 1e-30))
        back = np.exp(-1j * angle)[:, None].astype(np.complex64)
        self.symbols, self.phase, self.angles = self.symbols * back, self.phase * back, self.angles + angle

    @staticmethod
    def _connected(read: np.ndarray, region: np.ndarray) -> np.ndarray:
        """(L, K) bool: the part of ``read`` that goes on from ``region``; far ones may be a quarter turn off."""
        labels, count = ndimage.label(ndimage.binary_dilation(read, _BRIDGE))
        shared = np.bincount(labels[region & read], minlength=count + 1)
        return read & (labels == 1 + shared[1:].argmax()) if count else read
