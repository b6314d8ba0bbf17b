"""Iterative receiver: soft decisions, noise, phase, timing and channel in turns, for one frame.

The walk of a frame::

    sync.acquire -> search: for each channel model
                        blind_channel -> loop: equalise -> demap -> noise -> phase, timing -> channel -> ...
                    -> residual CFO -> reconstruction -> return estimate -> loop once more, return-aware

All gates compare with the noise that is measured from the decisions.
"""

from dataclasses import dataclass, replace

import numpy as np

from .arrays import block_sums, median, moving_sum, power, segment_sums, spread
from .cfo import residual_cfo
from .channel_estimation import ChannelEstimator, ChannelStart, blind_channel
from .equaliser import ElementGrid, equalise
from .numerology import Numerology
from .phase_timing import correct_phase, retimed, timing_drift
from .reconstruction import blanked, modulate, sent_elements
from .return_estimation import ReturnEstimator
from .return_fit import RESIDUE, MaskedPoints, ReturnFit
from .settings import OfdmSettings
from .soft_demapper import SoftDemapper, SoftSymbols

# Price of one iteration of the loop in FFTs of 7,500 points, as measured; other steps cost about as much, or a part
ITERATION_FFTS = 31.0
_SAMPLED = 7  # decimation of resource blocks in the first noise estimate
# penalty on the spread of the log error between regions, nats per neper: a false lock fits some and fails in others
_UNEVEN_PENALTY = 0.05
_LEAST = np.float32(1e-9)  # of the channel's power, that of a frame being 1: a divisor
# half the distance of 256QAM's points, squared (TS 38.211 clause 5.1.5); returns louder than that of 64QAM are visible
_DISTANCE_256QAM, _RARE = 1.5 / 255, 0.1  # and its share of the elements, from which it counts
_EIGHTH = np.complex64(np.exp(0.25j * np.pi))


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
    gain: float = 0.0  # nats per element over a Gaussian of the same power in each subcarrier: 0 for noise
    score: float = 0.0  # gain less a penalty for uneven noise, by which channel models are compared
    ramp: np.ndarray | None = None  # (L, K) complex64: timing correction that belongs to it
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

    def retime(self, factor: np.ndarray) -> None:
        """Multiply by (L, K) or (L, 1) factors."""
        self.elements = self.elements * factor
        self.back = None if self.back is None else self.back * factor

    def turn(self, factor: np.ndarray) -> None:
        """Take out phases: multiply by (L, 1) factors, and keep them."""
        self.retime(factor)
        self.phase = self.phase * factor


class IterativeReceiver:
    """Receiver for one numerology.

    ``ffts``: cost of the frame so far in FFTs of 7,500 points, by the steps that were taken.
    """

    def __init__(self, numerology: Numerology, returns: ReturnEstimator, settings: OfdmSettings) -> None:
        self._num, self._returns, self._s = numerology, returns, settings
        self._demapper = SoftDemapper(numerology, settings)
        self.ffts = 0.0

    def search(
        self, grid: ElementGrid, free: np.ndarray, known: KnownReturn | None, only: str | None = None
    ) -> Reception | None:
        """Best reception of a frame among the channel models (or with ``only`` one), None without emitter."""
        s = self._s
        ramp = grid.ramp
        best = self._receive(grid, free, known, only or "static")
        # another channel model and what comes after it are up to 13 iterations
        affords = not only and self.ffts + 13 * ITERATION_FFTS <= s.most_ffts
        if affords and best.gain >= s.readable and self.channel_error(grid, free, best) > s.channel_error:
            errors = self._model_errors(grid, free, best)
            model = "tile" if errors["tile"] < s.tile_better * errors["moving"] else "moving"
            grid.ramp = ramp
            other = self._receive(grid, free, known, model)
            if other.score > best.score + s.better_score:
                best = other
        grid.ramp = best.ramp
        return best if best.gain >= s.evidence else None

    def _receive(
        self, grid: ElementGrid, free: np.ndarray, known: KnownReturn | None, model: str
    ) -> Reception:
        """Reception with one channel model, nothing known before."""
        s = self._s
        most = {"static": s.iterations, "moving": s.iterations_moving, "tile": s.iterations_tile}[model]
        blind = blind_channel(grid, free, model, s)
        self.ffts += ITERATION_FFTS
        return self.loop(grid, free, blind, most, known=known, acquiring=True)

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
        """Squared errors of the other two channel models over the static one's, from its decisions."""
        w = (free & found.used) / found.noise
        mean = found.soft.mean
        agreement = found.elements * mean.conj() * w
        weight = found.soft.second * w
        errors = {}
        for model in ("static", "moving", "tile"):
            h = ChannelEstimator(self._s).estimate(agreement, weight, grid, model)
            doubt = power(h) * np.maximum(found.soft.second - power(mean), 0)
            errors[model] = float((np.minimum((power(found.elements - h * mean) + doubt) * w, 30)).sum())
        self.ffts += ITERATION_FFTS
        return {model: errors[model] / max(errors["static"], 1e-9) for model in ("moving", "tile")}

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
        """Soft decisions, noise, phases, timing and channel in turns, at most ``iterations`` times.

        - ``free`` (L, K) bool: return-free elements
        - ``start``: channel, phases and noise to begin with, and the channel's model
        - ``iterations``: 0 decides once, and estimates the channel once
        - ``acquiring``: whether the channel is still rough, so that it is averaged widely at first
        - ``memory``: weight of the static channel of the iteration before, in symbols of median noise
        """
        channel, used, noise, model = start.channel, start.used, start.noise, start.model
        estimator = ChannelEstimator(self._s)
        s = self._s
        observed = _Elements.of(grid, start.phase, known)
        everywhere = known is not None and known.everywhere
        t = (np.broadcast_to(used, free.shape) if everywhere else free & used).astype(np.float32)
        masked = ~free & used
        bound = np.abs(channel)
        h2 = np.maximum(power(channel), _LEAST)
        if noise is None:
            relative, turn = self._first_noise(equalise(observed.emitter(), channel), t, grid.segments)
            noise = np.broadcast_to(relative * h2, free.shape)
            observed.turn(turn)
        return_power, before = np.float32(0), 0.0
        wide = {"static": 1, "moving": s.iterations_moving - 2, "tile": 0}[model] if acquiring else 0
        fewest = {"static": 1, "moving": s.iterations_moving - 2, "tile": 3}[model] if acquiring else 0
        for iteration in range(iterations + 1):
            h2 = np.maximum(power(channel), _LEAST)
            y = observed.emitter()
            z = equalise(y, channel)
            soft = self._demapper.demap(
                z, (noise + masked * observed.doubt(return_power)) / h2, t, grid.segments
            )
            decided = channel * soft.mean
            error = power(y - decided) + h2 * np.maximum(soft.second - power(soft.mean), 0)
            noise = self._noise(error, t, h2)
            self.ffts += ITERATION_FFTS
            if known is None and masked.any() and iteration == min(1, iterations - 1):
                points = MaskedPoints.of(z, noise, h2, soft, grid, masked)
                return_power, _ = points.return_power(s.return_step_db)
            w = t / noise
            now = float((noise * t).sum() / (h2 * t).sum())
            last = iteration >= iterations or (iteration > fewest and now > s.converged * before)
            if last and acquiring:
                break
            before = now
            agreement = y * decided.conj() * w
            turn = correct_phase(agreement)
            observed.turn(turn)
            if model == "static" and acquiring and iteration < 2:
                observed.retime(
                    retimed(timing_drift(agreement * turn, h2 * power(soft.mean) * w, grid), grid)
                )
            prior = None
            if model == "static":
                prior = channel[0], np.float32(memory / median(noise[:, :: self._num.block]))
            channel = estimator.estimate(
                observed.emitter() * soft.mean.conj() * w,
                soft.second * w,
                grid,
                model,
                wide=iteration < wide,
                prior=prior,
                bound=bound,
            )
            if last:
                break
        found = Reception(channel, used, observed.phase, observed.elements, noise, soft, model, now)
        found = replace(found, ramp=grid.ramp, return_power=float(return_power))
        return self._judged(found, y, error, h2, t, acquiring)

    def _judged(
        self,
        found: Reception,
        y: np.ndarray,
        error: np.ndarray,
        h2: np.ndarray,
        t: np.ndarray,
        acquiring: bool,
    ) -> Reception:
        """A reception with its gain over a Gaussian; with its score if channel models are to be compared."""
        total = np.maximum(t.sum(axis=0), 1)
        own = power(y)
        level = np.maximum((own * t).sum(axis=0) / total, _LEAST)
        mean_h2 = np.maximum((np.broadcast_to(h2, t.shape) * t).sum(axis=0) / total, _LEAST)
        gaussian = -np.log(np.pi * level / mean_h2) - own / h2 * (mean_h2 / level)
        gain = float((np.clip(found.soft.log_density - gaussian, -4, 8) * t).sum() / max(t.sum(), 1))
        if not acquiring:
            return replace(found, gain=gain, score=gain)
        block, around = self._num.block, self._num.blocks(20)
        inner = t * (h2 > 0.05 * median(h2))
        regions = moving_sum(block_sums(error * inner, block), around)
        powers = moving_sum(block_sums(h2 * inner, block), around)
        there = powers > 0
        usual = median(regions[there] / powers[there]) if there.any() else 1.0
        even = float((error * inner).sum() / max((h2 * inner).sum() * usual, 1e-30))
        return replace(found, gain=gain, score=gain - _UNEVEN_PENALTY * float(np.log(max(even, 1.0))))

    def _first_noise(
        self, z: np.ndarray, t: np.ndarray, segments: np.ndarray
    ) -> tuple[np.float32, np.ndarray]:
        """Noise over channel power of greatest likelihood, and an eighth of a turn for symbols that need it (L, 1)."""
        block = self._num.block
        some = np.ascontiguousarray(z.reshape(len(z), -1, block)[:, ::_SAMPLED]).reshape(len(z), -1)
        known = np.ascontiguousarray(t.reshape(len(t), -1, block)[:, ::_SAMPLED]).reshape(len(t), -1)

        tried = 10 ** (np.array(self._s.noise_grid_db, dtype=np.float32) / 10)
        unrotated = self._nats(some, known, tried, segments)
        best = int(unrotated.sum(axis=1).argmax())
        turned = self._nats(some * _EIGHTH, known, tried[best : best + 1], segments)[0]
        return tried[best], np.where(turned > unrotated[best] + 5, _EIGHTH, np.complex64(1))[:, None]

    def _nats(self, z: np.ndarray, t: np.ndarray, noises: np.ndarray, segments: np.ndarray) -> np.ndarray:
        """(noises, L) log likelihood of the symbols for each candidate noise variance, in one call."""
        count, length = len(noises), len(z)
        many = (np.arange(count)[:, None] * length + segments).ravel()
        noise = np.repeat(noises, length)[:, None] * np.ones(z.shape[1], np.float32)
        nats = self._demapper.evidence(np.tile(z, (count, 1)), noise, np.tile(t, (count, 1)), many)
        return (nats.reshape(count, length, -1) * t).sum(axis=2)

    def _noise(self, error: np.ndarray, t: np.ndarray, h2: np.ndarray) -> np.ndarray:
        """(L, K) float32 noise: of a subcarrier over time, raised where a region of a symbol has more."""
        block, s = self._num.block, self._s
        known = block_sums(t, block)
        sums = block_sums(error * t, block)
        near = self._num.blocks(9)
        total = moving_sum(known.sum(axis=0), near)
        sub = moving_sum(sums.sum(axis=0), near) / np.maximum(total, np.float32(0.1))
        sub = np.where(total > 0, sub, median(sub[total > 0]) if (total > 0).any() else np.float32(1e-6))
        excess = np.minimum(sums / np.maximum(sub, 1e-20), 50 * known)
        around = self._num.blocks(21)
        many = moving_sum(known, around)
        region = moving_sum(excess, around) / np.maximum(many, np.float32(0.02))
        few = many < 0.15 * around * block  # there the whole symbol counts
        of_symbol = excess.sum(axis=1, keepdims=True) / np.maximum(
            known.sum(axis=1, keepdims=True), np.float32(0.02)
        )
        region = np.where(few, of_symbol, region)
        noise = sub * np.where(region > s.uneven_region, region, 1)
        return np.maximum(spread(noise.astype(np.float32), block), np.float32(1e-7) * median(h2))

    def cancel(self, grid: ElementGrid, free: np.ndarray, found: Reception) -> np.ndarray:
        """(N,) complex64 the frame without the emitter, its CFO still removed."""
        model = found.channel * found.soft.mean
        limit = self._s.outlier_return
        elements = sent_elements(found.elements, model, found.noise, free, found.used, limit)
        return grid.samples - modulate(elements * found.phase.conj(), grid)

    def finish(
        self, grid: ElementGrid, free: np.ndarray, found: Reception, known: KnownReturn | None, *, tune: bool
    ) -> tuple[np.ndarray, Reception, ElementGrid]:
        """Frame without the emitter, CFO put back; residual CFO and return are seen to where they matter.

        Returns the (N,) frame, the reception that was subtracted, and the elements it belongs to.
        """
        s, num = self._s, self._num
        certain = False
        if known is None:
            known, found = self._fitted_return(grid, free, found, tune)
            if known is not None:
                certain = known.uncertainty.max() < 1
                found = self._again(grid, free, found, known)
        if tune:
            sent = modulate(found.channel * found.soft.mean * found.phase.conj(), grid)
            off = residual_cfo(grid, sent)
            # within a symbol it leaves (pi off)^2 / 3 of the power
            if (np.pi * off) ** 2 / 3 > 0.05 * found.relative_noise:
                back = np.exp(2j * np.pi * off / num.useful * (grid.starts + num.useful / 2)).astype("c8")
                grid = grid.retuned(grid.cfo + off)
                found = self._again(grid, free, replace(found, phase=found.phase * back[:, None]), known)
        out = self.cancel(grid, free, found)
        if (known is not None or tune) and not certain:
            shown = self.known_return(out * grid.carrier.conj(), grid, s.found_ratio, everywhere=True)
            if shown is not None:
                found = self._again(grid, free, found, shown)
                out = self.cancel(grid, free, found)
        self.ffts += ITERATION_FFTS
        return blanked(out * grid.carrier.conj(), grid, s), found, grid

    def known_return(
        self, frame: np.ndarray, grid: ElementGrid, least: float, *, everywhere: bool = False
    ) -> KnownReturn | None:
        """Return of an (N,) frame whose pair of tones has at least so large a ratio in the mean, or None."""
        found = self._returns.estimate(frame)
        if found.ratios.mean() < least:
            return None
        half = frame.size // 2
        middle = grid.starts + self._num.useful // 2
        uncertainty = np.minimum(self._s.return_uncertainty / found.ratios, 1)[(middle >= half).astype(int)]
        elements = grid.transform(found.samples * grid.carrier)
        return KnownReturn(elements, uncertainty.astype(np.float32)[:, None], everywhere)

    def _fitted_return(
        self, grid: ElementGrid, free: np.ndarray, found: Reception, tune: bool
    ) -> tuple[KnownReturn | None, Reception]:
        """The return with which masked elements are points, where one would be taken for data; else None."""
        h2 = np.maximum(power(found.channel), _LEAST)
        least = self._s.return_loud * _DISTANCE_256QAM * median(h2)
        masked, order = ~free & found.used, found.soft.order[-1][grid.segment]
        if not (tune or found.return_power > least) or not masked.any():
            return None, found
        if ((1 - found.soft.control) * spread(order, self._num.block)).mean() < _RARE:
            return None, found
        z = equalise(found.elements, found.channel)
        points = MaskedPoints.of(z, found.noise, h2, found.soft, grid, masked)
        if tune:
            found = replace(found, return_power=float(points.return_power(self._s.return_step_db)[0]))
        if not found.return_power > least or self.ffts + 6 * ITERATION_FFTS > self._s.most_ffts:
            return None, found
        self.ffts += 3 * ITERATION_FFTS
        factor = equalise(grid.ramp * found.phase, found.channel)
        fit = ReturnFit(points, grid, factor, self._returns, self._s)
        elements, certain = fit.best()
        if not certain.any():
            return None, found
        uncertainty = np.where(certain, self._s.return_fit_error, 1).astype(np.float32)
        return KnownReturn(elements, uncertainty[fit.half][:, None], everywhere=False), found

    def _again(
        self, grid: ElementGrid, free: np.ndarray, found: Reception, known: KnownReturn | None
    ) -> Reception:
        again = self.loop(grid, free, found, 0, known=known)
        return replace(again, return_power=found.return_power)
