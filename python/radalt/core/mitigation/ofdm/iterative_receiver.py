"""Iterative receiver: soft decisions, noise, phase and channel in turns, for one frame.

The walk of a frame::

    sync.acquire -> search: for each channel model
                        blind_channel -> loop: equalise -> demap -> noise -> phase -> channel -> ...
    return_aware: -> residual CFO -> reconstruction -> return estimate -> loop once more

All gates compare with the noise that is measured from the decisions.
"""

from dataclasses import dataclass

import numpy as np

from .arrays import block_sums, median, moving_sum, power, segment_sums
from .channel_estimation import ChannelStart, blind_channel, estimate_channel
from .common_phase import correct_phase
from .equaliser import ElementGrid, equalise
from .noise_estimation import first_noise, noise_of
from .numerology import Numerology
from .return_fit import RESIDUE, MaskedPoints
from .settings import OfdmSettings
from .soft_demapper import SoftDemapper, SoftSymbols

# Price of one iteration of the loop in FFTs of 7,500 points, as measured: the same on every machine. Other steps cost
# about as much, or a part.
ITERATION_FFTS = 31.0
_LEAST = np.float32(1e-9)  # of the channel's power, that of a frame being 1: a divisor


@dataclass(frozen=True)
class KnownReturn:
    """What is known of the return before decisions."""

    elements: np.ndarray  # (L, K) complex64: its part of them, before timing is corrected
    uncertainty: np.ndarray  # (L, 1) float32: error of its power over its power, in each symbol
    everywhere: bool  # whether it is known so well that masked elements serve as the others do


@dataclass(frozen=True)
class Reception:
    """A frame as it was demodulated."""

    channel: np.ndarray  # (1, K) or (L, K) complex64
    used: np.ndarray  # (K,) bool
    phase: np.ndarray  # (L, 1) complex64 factors that took out the symbols' phases
    elements: np.ndarray  # (L, K) complex64 received, timing and phase corrected, known return included
    noise: np.ndarray  # (L, K) float32
    soft: SoftSymbols
    model: str  # of the channel
    relative_noise: float  # over the emitter's power
    gain: float  # nats per element over a Gaussian of the same power in each subcarrier: 0 for noise
    return_power: float = 0.0  # of the return in its elements, if it is unknown


@dataclass
class _Elements:
    """Received elements (L, K), the known return's part of them or None, and the phases (L, 1) taken out so far."""

    elements: np.ndarray
    back: np.ndarray | None
    phase: np.ndarray
    uncertainty: np.ndarray | None

    @classmethod
    def of(cls, grid: ElementGrid, phase: np.ndarray, known: KnownReturn | None) -> "_Elements":
        factor = grid.ramp * phase
        if known is None:
            return cls(grid.raw * factor, None, phase, None)
        return cls(grid.raw * factor, known.elements * factor, phase, known.uncertainty)

    def emitter(self) -> np.ndarray:
        """(L, K) elements without the known return."""
        return self.elements if self.back is None else self.elements - self.back

    def doubt(self, return_power: np.float32) -> np.ndarray | np.float32:
        """Power of the return that is left in masked elements: what is uncertain of it, or all if it is unknown."""
        return return_power if self.back is None else (self.uncertainty + RESIDUE) * power(self.back)

    def turn(self, factor: np.ndarray) -> None:
        """Take out phases: multiply by (L, 1) factors, and keep them."""
        self.elements = self.elements * factor
        self.back = None if self.back is None else self.back * factor
        self.phase = self.phase * factor


@dataclass(frozen=True)
class _Decided:
    """Decisions of one iteration."""

    y: np.ndarray  # (L, K) complex64 elements without the known return
    z: np.ndarray  # (L, K) complex64 the same over the channel
    h2: np.ndarray  # (1, K) or (L, K) float32 power of the channel
    soft: SoftSymbols
    mean: np.ndarray  # (L, K) complex64 channel times posterior means
    noise: np.ndarray  # (L, K) float32 that they leave
    relative_noise: float  # over the emitter's power


def channel_power(channel: np.ndarray) -> np.ndarray:
    """Power of a channel, (1, K) or (L, K) float32, that may be divided by."""
    return np.maximum(power(channel), _LEAST)


class IterativeReceiver:
    """Receiver for one numerology.

    ``ffts``: cost of the frame so far in FFTs of 7,500 points, by the steps that were taken.
    """

    def __init__(self, numerology: Numerology, settings: OfdmSettings) -> None:
        self._num, self._s = numerology, settings
        self._demapper = SoftDemapper(numerology, settings)
        self.ffts = 0.0

    def search(
        self, grid: ElementGrid, free: np.ndarray, known: KnownReturn | None, only: str | None = None
    ) -> Reception | None:
        """Best reception of a frame among the channel models (or with ``only`` one), None without emitter."""
        s = self._s
        best = self._receive(grid, free, known, only or "static")
        # another channel model and what comes after it are up to 13 iterations
        affords = not only and self.ffts + 13 * ITERATION_FFTS <= s.most_ffts
        if affords and best.gain >= s.readable and self.channel_error(grid, free, best) > s.channel_error:
            errors = self._model_errors(grid, free, best)
            model = "tile" if errors["tile"] < s.tile_better * errors["moving"] else "moving"
            other = self._receive(grid, free, known, model)
            if other.gain > best.gain + s.better_gain:
                best = other
        return best if best.gain >= s.evidence else None

    def _receive(
        self, grid: ElementGrid, free: np.ndarray, known: KnownReturn | None, model: str
    ) -> Reception:
        """Reception with one channel model, nothing known before."""
        self.ffts += ITERATION_FFTS
        blind = blind_channel(grid, free, model, self._s)
        return self.loop(grid, free, blind, self._schedule(model)[0], known=known, acquiring=True)

    def _schedule(self, model: str) -> tuple[int, int, int]:
        """Iterations of a search: at most, before it may end, and with the channel averaged widely."""
        s = self._s
        if model == "moving":
            return s.iterations_moving, s.iterations_moving - 2, s.iterations_moving - 2
        return (s.iterations, 1, 1) if model == "static" else (s.iterations_tile, 3, 0)

    def channel_error(self, grid: ElementGrid, free: np.ndarray, found: Reception) -> float:
        """How coherent the residual still is with the model: 1 for noise, more where the channel is not as modelled.

        ``mean |sum w r conj(m)|^2 / sum w |m|^2`` over half slots and 12 subcarriers: r is the residual, m the model,
        w the inverse noise.
        """
        t = (free & found.used).astype(np.float32)
        model = found.channel * found.soft.mean
        w = t / found.noise
        block, around = self._num.block, self._num.blocks(12)
        agreement = segment_sums(
            ((found.elements - model) * model.conj() * w).astype(np.complex64), grid.segments
        )
        norm = moving_sum(block_sums(segment_sums(power(model) * w, grid.segments), block), around)
        sums = moving_sum(block_sums(agreement, block), around)
        there = norm > 0
        return float((power(sums[there]) / norm[there]).mean()) if there.any() else 1.0

    def _model_errors(self, grid: ElementGrid, free: np.ndarray, found: Reception) -> dict[str, float]:
        """Squared errors of the other two channel models, from the static one's decisions."""
        self.ffts += ITERATION_FFTS
        w = (free & found.used) / found.noise
        mean = found.soft.mean
        agreement = found.elements * mean.conj() * w
        weight = found.soft.second * w
        errors = {}
        for model in ("moving", "tile"):
            h = estimate_channel(agreement, weight, grid, model)
            doubt = power(h) * np.maximum(found.soft.second - power(mean), 0)
            errors[model] = float((np.minimum((power(found.elements - h * mean) + doubt) * w, 30)).sum())
        return errors

    def loop(
        self,
        grid: ElementGrid,
        free: np.ndarray,
        start: ChannelStart | Reception,
        iterations: int,
        *,
        known: KnownReturn | None = None,
        acquiring: bool = False,
        memory: float = 0.3,
    ) -> Reception:
        """Soft decisions, noise, phases and channel in turns, at most ``iterations`` times.

        - ``free`` (L, K) bool: return-free elements
        - ``start``: channel, phases and noise to begin with, and the channel's model
        - ``iterations``: 0 decides once, and estimates the channel once
        - ``acquiring``: whether the channel is still rough, so that it is averaged widely at first
        - ``memory``: weight of the static channel of the iteration before, in symbols of median noise
        """
        s, model, used = self._s, start.model, start.used
        observed = _Elements.of(grid, start.phase, known)
        everywhere = known is not None and known.everywhere
        t = (np.broadcast_to(used, free.shape) if everywhere else free & used).astype(np.float32)
        masked = ~free & used
        channel, noise, bound = start.channel, start.noise, np.abs(start.channel)
        if noise is None:
            z = equalise(observed.emitter(), channel)
            relative = first_noise(z, t, grid.segments, self._demapper, self._num.block, s)
            noise = np.broadcast_to(relative * channel_power(channel), free.shape)
        return_power, before = np.float32(0), 0.0
        _, fewest, wide = self._schedule(model) if acquiring else (0, 0, 0)
        for iteration in range(iterations + 1):
            doubt = masked * observed.doubt(return_power)
            one = self._decided(observed.emitter(), channel, noise + doubt, t, grid)
            noise = one.noise
            if known is None and masked.any() and iteration == min(1, iterations - 1):
                points = MaskedPoints.of(one.z, noise, one.h2, one.soft, grid, masked)
                return_power, _ = points.return_power(s.return_step_db)
            last = iteration >= iterations or (
                iteration > fewest and one.relative_noise > s.converged * before
            )
            if last and acquiring:
                break
            before = one.relative_noise
            w = t / noise
            observed.turn(correct_phase(one.y * one.mean.conj() * w))
            agreement, weight = observed.emitter() * one.soft.mean.conj() * w, one.soft.second * w
            prior = channel[0], np.float32(memory / median(noise[:, :: self._num.block]))
            channel = estimate_channel(
                agreement, weight, grid, model, wide=iteration < wide, prior=prior, bound=bound
            )
            if last:
                break
        return Reception(
            channel,
            used,
            observed.phase,
            observed.elements,
            noise,
            one.soft,
            model,
            one.relative_noise,
            _gain(one, t),
            float(return_power),
        )

    def _decided(
        self, y: np.ndarray, channel: np.ndarray, noise: np.ndarray, t: np.ndarray, grid: ElementGrid
    ) -> _Decided:
        """Soft decisions on elements (L, K) with so much ``noise`` (L, K), and the noise that they leave."""
        self.ffts += ITERATION_FFTS
        h2, z = channel_power(channel), equalise(y, channel)
        soft = self._demapper.demap(z, noise / h2, t, grid.segments)
        mean = channel * soft.mean
        error = power(y - mean) + h2 * np.maximum(soft.second - power(soft.mean), 0)
        noise = noise_of(error, t, h2, self._num, self._s)
        return _Decided(y, z, h2, soft, mean, noise, float((noise * t).sum() / (h2 * t).sum()))


def _gain(one: _Decided, t: np.ndarray) -> float:
    """Nats per trusted element over a Gaussian of the same power in each subcarrier."""
    total = np.maximum(t.sum(axis=0), 1)
    own, h2 = power(one.y), one.h2
    level = np.maximum((own * t).sum(axis=0) / total, _LEAST)
    mean_h2 = np.maximum((np.broadcast_to(h2, t.shape) * t).sum(axis=0) / total, _LEAST)
    gaussian = -np.log(np.pi * level / mean_h2) - own / h2 * (mean_h2 / level)
    return float((np.clip(one.soft.log_density - gaussian, -4, 8) * t).sum() / max(t.sum(), 1))
