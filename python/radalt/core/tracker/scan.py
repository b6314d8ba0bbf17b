"""One block for the tracker's parts: its sums, its place in time, and the least errors of a measurement."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .spread_ground import Ground
from .summed_block import Block, Measurement

# Least standard deviations of one measurement. Interference that lasts keeps both up from block to block, so a mean
# over blocks is no better: measured behind `tcae` below 5 MHz NR (docs/tracker.md, protection level).
_ALTITUDE_FLOOR_M, _SPEED_FLOOR_M_PER_S = 0.25, 1.5

# Second moment of a point's delays, squared resolution cells: 0.6 m, by the blind part of a half sweep.
_POINT_MOMENT = 0.001


@dataclass
class Scan:
    """One block of frames."""

    block: Block  # sums of its usable frames
    middle: float  # frame index of their middle
    lead_s: float  # seconds from there to the end of the block's last frame, for which the altitude is given
    residual_m: float = 0.0  # altitude that the frames' residual timing offset adds
    ground: Ground | None = None  # spread ground, the strongest return; None of a point
    beyond: float = 0.0
    """Median power of the strongest line beyond the span over that within it, in the frames before mitigation."""
    moments: np.ndarray | None = None
    """(m, 2, 3) complex: `BeatSpectra.moments` of the frames before mitigation."""
    sum_received: Callable[[], Block] | None = None
    """Makes the block of the same frames before mitigation; called at most once, and only if it is needed. None where
    there are no such frames."""

    @cached_property
    def received(self) -> Block:
        """The block of the same frames before mitigation; without such frames the block itself."""
        return self.block if self.sum_received is None else self.sum_received()

    def moment(self, found: Measurement, reach: float) -> complex | None:
        """Mean second moment of a return's delays; None where another line is the strongest, ``reach`` cells away.

        Less what noise adds, twice its deviation, and what a point has.
        """
        if self.moments is None or self.ground is not None:
            return None
        near = (np.abs(self.moments[..., 1].real - found.cells) <= reach).all(axis=1)
        if 2 * near.sum() < len(near):
            return None
        moment, power = self.moments[near, :, 0], self.moments[near, :, 2].real
        share = power / power.sum()
        mean = complex((moment * share).sum())
        noise = float(np.sqrt((np.abs(moment - mean) ** 2 * share).sum() / share.size))
        return mean * max(0.0, 1.0 - (2.0 * noise + _POINT_MOMENT) / max(abs(mean), 1e-12))

    def corrected(self, found: Measurement) -> Measurement:
        """A measurement less the residual delay, its variances raised by what every measurement has at least."""
        g = self.ground
        deviation_m, deviation_m_per_s = (0.0, 0.0) if g is None else (g.deviation_m, g.deviation_m_per_s)
        speed_variance = found.speed_variance_m2_per_s2 + _SPEED_FLOOR_M_PER_S**2 + deviation_m_per_s**2
        return replace(
            found,
            altitude_m=found.altitude_m - self.residual_m,
            altitude_variance_m2=found.altitude_variance_m2 + _ALTITUDE_FLOOR_M**2,
            speed_variance_m2_per_s2=speed_variance,
            fluctuation_m2=found.fluctuation_m2 + deviation_m**2,
        )
