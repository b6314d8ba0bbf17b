"""Gate: which returns of a block may continue a track."""

import numpy as np
from scipy.special import ndtri

from .integrator import Integrator
from .scan import Scan
from .summed_block import Measurement
from .track import Track

# Standard deviations by which a measured speed may exceed the greatest speed allowed. More would accept the apparent
# speed of a grating lobe of one half sweep.
SPARE_SIGMAS = 2.0
GATE_SIGMAS = 4.0  # half width in standard deviations: a right measurement misses it in 6 of 100,000 blocks
# Largest half width, resolution cells: main lobe and first grating lobes of one return lie within.
_WIDEST_CELLS = 2.0
# Largest distance, cells, from a return to the nearest entry of the table: half a cell, and the grid's rounding.
_GRID_CELLS = 0.51


def noise_threshold(pfa: float, trials: float) -> float:
    """Standard deviations that noise exceeds with probability ``pfa`` in one of ``trials`` cells."""
    return float(-ndtri(min(0.5, pfa / max(1.0, trials))))


class Gate:
    """Validation gate in altitude and vertical speed.

    A return may continue a track if it lies within four standard deviations of the prediction, in altitude and speed,
    and is stronger than noise alone gives in one block of a hundred (`TrackerSettings.gate_pfa`).

    ``tables``: of the blocks that tracks are measured in; ``pfa``: probability that noise alone gives a detection
    within the gate, per block.
    """

    def __init__(self, tables: Integrator, pfa: float) -> None:
        self.tables, self.pfa = tables, pfa
        # where cells are narrow, a return crosses several within an output
        output_s = tables.frames * tables.waveform.sweep_s
        self._widest_m = max(_WIDEST_CELLS * tables.waveform.range_resolution_m, tables.max_speed * output_s)
        # largest distance of a speed from its row's: rows are a cell apart (and rounding), or a speed under test
        self._row_m_per_s = (
            1.01 * tables.speed_per_cell if tables.doppler else np.diff(tables.speeds).max(initial=0.0)
        )

    def mask(self, track: Track, scan: Scan) -> np.ndarray:
        """Mask of the table's entries that may continue a track."""
        t, f = self.tables, track.filter
        row = np.array([1.0, -scan.lead_s])
        measured_m2 = track.latest.altitude_variance_m2 + track.latest.fluctuation_m2
        sigma = np.sqrt(row @ f.covariance @ row + measured_m2)
        expected = row @ f.mean + scan.residual_m
        width = min(GATE_SIGMAS * sigma, self._widest_m) + _GRID_CELLS * t.cell_m
        near = np.abs(t.altitude_m - expected) <= width
        return near & (self.speeds(track) & self._same_pair(track))[:, None]

    def threshold(self, mask: np.ndarray) -> float:
        """Strength that noise alone exceeds within a mask with the gate's probability of false alarm."""
        return noise_threshold(self.pfa, mask.sum() / self.tables.resolution_cells**2)

    def speeds(self, track: Track) -> np.ndarray:
        """(rows,) bool: rows of the table whose speed a track may have."""
        f = track.filter
        spread = GATE_SIGMAS * np.sqrt(f.covariance[1, 1]) + self._row_m_per_s
        return np.abs(self.tables.row_speed - f.mean[1]) <= spread

    def _same_pair(self, track: Track) -> np.ndarray:
        """(rows,) bool: rows near the track's latest Doppler. Peak and lobes move alike: a pair keeps its own."""
        t, last = self.tables, track.latest
        spread = GATE_SIGMAS * np.sqrt(last.speed_variance_m2_per_s2) + self._row_m_per_s
        return np.abs(t.row_speed - last.speed_m_per_s) <= (spread if t.doppler else np.inf)

    def near(self, track: Track, found: Measurement, lead_s: float) -> bool:
        """Whether a measurement's altitude lies within a track's gate."""
        innovation, variance = track.filter.innovation(found, lead_s)
        return bool(abs(innovation) <= min(GATE_SIGMAS * np.sqrt(variance), self._widest_m))

    def near_speed(self, track: Track, found: Measurement) -> bool:
        """Whether a measurement's Doppler lies within a track's gate: no aircraft changes its speed between blocks."""
        innovation, variance = track.filter.speed_innovation(found)
        return not self.tables.doppler or bool(abs(innovation) <= GATE_SIGMAS * np.sqrt(variance))

    def allowed_speed(self, found: Measurement) -> bool:
        """Whether a measurement's speed is one that is allowed, as far as it is known."""
        t = self.tables
        spare = SPARE_SIGMAS * np.sqrt(found.speed_variance_m2_per_s2)
        return not t.doppler or abs(found.speed_m_per_s) <= t.max_speed + spare
