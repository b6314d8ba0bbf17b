"""Sums over one block of frames: its strongest returns, their places, errors and shapes."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..spectral_line import peak_offset, upper_median
from .integrator import Integrator

# Variance of log(1 + x) for x exponential of mean 1, by numerical integration: what one cell of noise adds per frame.
_VARIANCE = 0.1763
# Resolution cells from a peak to the first null of an unweighted sweep: beyond it are other returns.
_MAIN_LOBE = 1.0
# Least share of both halves' strength, or of their mean power, that each half has to show of a return.
EACH_HALF = 0.25
_PARTS = 4  # the last of so many parts of a block has to agree with the whole: a step of the ground within the block
# Standard deviations by which two noisy values contradict each other: noise alone does so in 6 of 100,000 blocks.
CONTRADICTION_SIGMAS = 4.0
# Least power over noise, linear (13 dB), of the peak by which received frames show the return of the cleaned ones:
# interference seldom has a peak of both halves there.
_CLEAR = 20.0
# Most that noise alone moves a peak from frame to frame, in variances of its place (5.7 is the greatest of 320 blocks).
_NOISE_MOVES = 6.0
_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@dataclass(frozen=True)
class Measurement:
    """A return in one block.

    - ``altitude_m``, ``speed_m_per_s``: at the middle of the block's usable frames
    - ``altitude_variance_m2``, ``speed_variance_m2_per_s2``: by the noise in the spectrum
    """

    altitude_m: float
    speed_m_per_s: float
    altitude_variance_m2: float
    speed_variance_m2_per_s2: float
    strength: float  # sum of both halves over its mean in noise, in standard deviations
    cells: np.ndarray  # (2,) float: position of the peak in the up and the down half, in cells
    power: float  # power over noise, mean of both halves, linear
    row: int  # row of the joint table, for the speed by which frames were moved
    altitude_speed_covariance: float = 0.0  # in m m/s; the halves' errors differ, and each goes into both
    fluctuation_m2: float = 0.0
    """Variance of the altitude beyond that of noise, by how the peak moves from frame to frame: the facets of
    extended ground interfere anew in each."""


@dataclass(frozen=True)
class Entry:
    """A place in the joint table: its strength, altitude (on the grid), cells of both halves, power over noise, row."""

    strength: float
    altitude_m: float
    cells: tuple[int, int]
    power: float
    row: int


def _changing(rows: np.ndarray) -> np.ndarray:
    """Variance over the first axis of what is new in every frame: a step or a trend within the block hardly counts."""
    return 0.5 * np.mean(np.diff(rows, axis=0) ** 2, axis=0)


class Block:
    """One block's sums; what follows from them is computed on request.

    ``ratio`` (m, 2, J) float32: normalised spectra of its usable frames (`Integrator.normalise`); ``at`` (m,) float:
    their places in the block, in frames.
    """

    def __init__(self, tables: Integrator, ratio: np.ndarray, at: np.ndarray) -> None:
        self.tables, self.ratio = tables, ratio
        self.count = len(ratio)
        self._known: dict[int, tuple] = {}
        self._away: dict[bytes, np.ndarray] = {}
        self.middle = float(at.mean())
        self._votes = np.log1p(ratio)
        self.latest_frames = late = -(-self.count // _PARTS)  # frames of its last quarter
        self._shifts = shifts = tables.shifts(at)
        sums = tables.moved_sums(self._votes, shifts)
        background, self._sigma = self._noise(sums[len(sums) // 2])
        self._excess = sums - background
        self.table = tables.joint(self._excess) / self._sigma
        latest = tables.moved_sums(self._votes[-late:], shifts[:, -late:])
        latest -= background * (late / self.count)
        self._late = tables.joint(latest) / np.sqrt(2 * late * _VARIANCE)

    def _noise(self, sums: np.ndarray) -> tuple[np.ndarray, float]:
        """Background, a median over eight resolution cells to either side; deviation of two halves' sum in noise."""
        t = self.tables
        inner = sums[:, t.first : t.last]
        # half by half: SciPy's filter for one dimension takes a fourteenth of the time
        residual = inner - [
            ndimage.median_filter(half, size=t.background_cells, mode="reflect") for half in inner
        ]
        everywhere = np.zeros(sums.shape)
        everywhere[:, t.first : t.last] = inner - residual
        # interference that repeats with the sweep does not average out
        seen = _MAD * upper_median(np.abs(residual - upper_median(residual)[:, None]))
        expected = self.count * _VARIANCE
        return everywhere, float(np.sqrt(np.maximum(seen**2, expected).sum()))

    def strongest(self, allowed: np.ndarray | None = None) -> Entry | None:
        """The strongest pair, of those allowed (a mask like `table`); None where none is allowed."""
        table = self.table if allowed is None else np.where(allowed, self.table, -np.inf)
        row, column = divmod(int(table.argmax()), table.shape[1])
        strength = float(table[row, column])
        if not np.isfinite(strength):
            return None
        t = self.tables
        cells = int(t.up_cell[row, column]), int(t.down_cell[row, column])
        k = int(t.rows[row, 0])
        power, floor, _ = self.sums(k)
        over = [float(power[half, cells[half]] / floor[half]) - 1.0 for half in range(2)]
        weaker = min(float(self._excess[k, half, cells[half]]) for half in range(2)) / self._sigma
        if weaker < EACH_HALF * strength:  # both halves have to show a return
            strength = min(strength, weaker / EACH_HALF)
        return Entry(strength, float(t.altitude_m[row, column]), cells, max(0.0, 0.5 * sum(over)), row)

    def best(self, allowed: np.ndarray | None = None) -> Measurement | None:
        """`strongest`, measured to a fraction of a cell; None where none is allowed or it is no peak."""
        entry = self.strongest(allowed)
        return None if entry is None else self.measure(entry)

    def at_peaks(self, allowed: np.ndarray) -> np.ndarray:
        """Those of the allowed entries whose halves both lie next to a peak; all of them where none does.

        Within a gate the strongest entry may lie on the flank of a lobe beyond it.
        """
        t = self.tables
        covered = np.zeros((t.speeds.size, 2, t.beat_hz.size), dtype=bool)
        for k in np.unique(t.rows[allowed.any(axis=1), 0]).tolist():
            power = self.sums(k)[0]
            peak = (power[:, 1:-1] >= power[:, :-2]) & (power[:, 1:-1] >= power[:, 2:])
            for shift in range(3):
                covered[k, :, shift : shift + peak.shape[1]] |= peak
        k = t.rows[:, :1]
        found = allowed & covered[k, 0, t.up_cell] & covered[k, 1, t.down_cell]
        return found if found.any() else allowed

    def measure(self, entry: Entry) -> Measurement | None:
        """Position and variance of a return; None where there is no peak."""
        t = self.tables
        k = int(t.rows[entry.row, 0])
        power, floor, slope = self.sums(k)
        frames = self.aligned(k)
        fine, variance, over, moves = np.empty((4, 2))
        for half in range(2):
            peak = self._peak(power[half], floor[half], slope[half], entry.cells[half])
            if peak is None:
                return None
            fine[half], variance[half], over[half], curvature = peak
            at = round(fine[half])
            slopes = frames[:, half, at + 1] - frames[:, half, at - 1]
            moves[half] = self.count * float(_changing(slopes)) / curvature**2
        up, down = (float(t.beat_hz[0] + t.cell_hz * f) for f in fine)
        hz2 = float(variance.sum()) * t.cell_hz**2
        w = t.waveform
        per_hz = float(w.beats_to_altitude_m(1.0, 0.0)), float(w.beats_to_vertical_speed_m_per_s(1.0, 0.0))
        apart_hz2 = float(variance[0] - variance[1]) * t.cell_hz**2
        speckle_hz2 = max(0.0, float((moves - _NOISE_MOVES * variance).sum())) * t.cell_hz**2
        return Measurement(
            altitude_m=float(w.beats_to_altitude_m(up, -down)),
            speed_m_per_s=float(w.beats_to_vertical_speed_m_per_s(up, -down)),
            altitude_variance_m2=hz2 * per_hz[0] ** 2,
            speed_variance_m2_per_s2=(hz2 + speckle_hz2) * per_hz[1] ** 2,  # each half has its own
            altitude_speed_covariance=apart_hz2 * per_hz[0] * per_hz[1],
            fluctuation_m2=max(0.0, float((moves - variance).sum())) * (t.cell_hz * per_hz[0]) ** 2,
            strength=entry.strength,
            cells=fine,
            power=float(over.mean()),
            row=entry.row,
        )

    def _peak(
        self, power: np.ndarray, floor: float, slope: float, cell: int
    ) -> tuple[float, float, float, float] | None:
        """Position of the peak next to a cell, its variance, in cells; power over noise; curvature; None without it."""
        cell = self._climb(power, cell)
        left, here, right = power[cell - 1 : cell + 2]
        curvature = 2.0 * here - left - right
        if not curvature > 0:
            return None
        over = max(0.0, float(here / floor) - 1.0)
        # noise of the slope over the curvature; next to a return the noise is greater by its power over noise
        variance = slope * (1.0 + over) / curvature**2
        return (
            cell + float(peak_offset(power[cell - 1 : cell + 2], self.tables.peak_curve)),
            float(variance),
            over,
            float(curvature),
        )

    def moved_since(self, found: Measurement) -> tuple[float, float]:
        """Altitude of a return in the block's last quarter, less that in the whole block, and its standard deviation.

        In metres; zero and infinite where the last quarter shows no peak.
        """
        t = self.tables
        k = int(t.rows[found.row, 0])
        share = self.latest_frames / self.count
        _, floor, slope = self.sums(k)
        power = t.moved_sums(
            self.ratio[-self.latest_frames :], self._shifts[k : k + 1, -self.latest_frames :]
        )[0]
        reach = round(_MAIN_LOBE * t.resolution_cells)
        steps, cells = np.arange(-reach, reach + 1), np.arange(power.shape[1])
        over = [np.interp(found.cells[half] + steps, cells, power[half]) / floor[half] for half in range(2)]
        step = int(steps[np.argmax(over[0] + over[1])])  # both halves alike: each alone may climb a lobe
        peaks = [
            self._peak(power[half], share * floor[half], share * slope[half], round(found.cells[half]) + step)
            for half in range(2)
        ]
        if None in peaks:
            return 0.0, np.inf
        moved = 0.5 * sum(peak[0] - at for peak, at in zip(peaks, found.cells, strict=True))
        return moved * t.cell_m, 0.5 * float(np.sqrt(peaks[0][1] + peaks[1][1])) * t.cell_m

    def sums(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(2, J) power moved by speed ``k``; (2,) its level in noise; (2,) variance of its slope in noise."""
        if k not in self._known:
            t = self.tables
            power = t.moved_sums(self.ratio, self._shifts[k : k + 1])[0]
            inner = power[:, t.first : t.last]
            floor = np.maximum(upper_median(inner), 1e-12)
            slopes = np.abs(inner[:, 2:] - inner[:, :-2])
            self._known[k] = power, floor, (0.5 * _MAD * upper_median(slopes)) ** 2
        return self._known[k]

    def _climb(self, power: np.ndarray, cell: int) -> int:
        """Climb to the greatest power next to a cell, since compression flattens the top of a strong return."""
        t = self.tables
        cell = min(max(cell, t.first), t.last - 1)
        while True:
            near = slice(max(t.first, cell - 1), min(t.last, cell + 2))
            top = near.start + int(power[near].argmax())
            if power[top] <= power[cell]:
                return cell
            cell = top

    def away_from(self, found: Measurement) -> np.ndarray:
        """Mask like `table`: entries of which at least one half lies beyond the main lobe of a return."""
        t, key = self.tables, found.cells.tobytes()
        if key not in self._away:  # needed several times
            lobe = _MAIN_LOBE * t.resolution_cells
            up = np.abs(t.up_cell[0] - found.cells[0]) > lobe
            self._away[key] = up | (np.abs(t.down_cell - found.cells[1]) > lobe)
        return self._away[key]

    def power_at(self, found: Measurement) -> float:
        """Power over noise, mean of both halves, where another block shows a return."""
        power, floor, _ = self.sums(int(self.tables.rows[found.row, 0]))
        cells = np.arange(power.shape[1])
        over = [np.interp(found.cells[h], cells, power[h]) / floor[h] - 1.0 for h in range(2)]
        return max(0.0, 0.5 * float(sum(over)))

    def beyond_span(self) -> float:
        """Power over noise, mean of both halves, of the strongest cells beyond the span; 0 below 13 dB in either."""
        power, floor, _ = self.sums(len(self.tables.speeds) // 2)
        over = power[:, self.tables.last :].max(axis=1, initial=0.0) / floor - 1.0
        return float(over.mean()) if over.min() >= _CLEAR else 0.0

    def shows(self, found: Measurement, least: float) -> bool:
        """Whether the block shows another block's return next to its cells: ``least`` strength, 13 dB over noise.

        Power alone may be interference that fills a part of the sweep in every frame.
        """
        t, at = self.tables, np.round(found.cells)
        here = self.best((np.abs(t.up_cell - at[0]) <= 1) & (np.abs(t.down_cell - at[1]) <= 1))
        return here is not None and here.strength >= least and here.power >= _CLEAR

    def contradicted(self, found: Measurement) -> bool:
        """Whether the latest frames contradict the return by four standard deviations: a step of the ground."""
        away = self.away_from(found)
        here = np.where(away, -np.inf, self._late).max()
        other = np.where(away, self._late, -np.inf).max()
        return bool(other - here > CONTRADICTION_SIGMAS * np.sqrt(2.0))

    def aligned(self, k: int) -> np.ndarray:
        """(m, 2, J) normalised spectra, each moved to the block's middle by speed ``k`` under test."""
        shifts = self._shifts[k]
        return self.tables.moved(self.ratio, shifts) if shifts.any() else self.ratio

    def shape_deviation(self, found: Measurement) -> float:
        """How far a return's peak deviates from a point's: share of its energy within a resolution cell, 0..1.

        What the frames' own noise may add is taken off, twice its mean. A second return within the main lobe deviates
        by its share of the power, and pulls the altitude by up to its share of the amplitude, times its distance.
        """
        t = self.tables
        frames = self.aligned(int(t.rows[found.row, 0]))
        level = self.sums(int(t.rows[found.row, 0]))[1] / self.count
        reach = round(t.resolution_cells)
        shares = np.empty(2)
        for half, at in enumerate(found.cells):
            cells = np.clip(round(at) + np.arange(-reach, reach + 1), 0, frames.shape[2] - 1)
            over = frames[:, half, cells] - level[half]
            point = np.interp(cells - at, *t.point_shape)
            rest = over - np.outer(over @ point / (point @ point), point)
            power, deviates, spread = over.mean(axis=0), rest.mean(axis=0), float(_changing(rest).sum())
            energy = max(float(power @ power), 1e-12)
            share = float(deviates @ deviates) / energy
            shares[half] = max(0.0, share - 2.0 * spread / energy / max(1, self.count - 1))
        return min(1.0, float(shares.mean()))

    def differences(self, found: Measurement, reach: int) -> tuple[np.ndarray, np.ndarray]:
        """Power over noise of the peak less that of cells ``-reach..reach`` from it.

        Mean and its variance, (2, 2 reach + 1) each; NaN beyond the beat band. The variance is the frames' own, so it
        holds whatever the interference is.
        """
        t = self.tables
        power = self.aligned(int(t.rows[found.row, 0]))
        mean, variance = np.full((2, 2, 2 * reach + 1), np.nan)
        for half in range(2):
            whole = int(np.floor(found.cells[half]))
            rest = np.float32(found.cells[half] - whole)
            low, high = max(0, whole - reach), min(power.shape[-1] - 1, whole + reach + 1)
            profile = power[:, half, low:high] * (1 - rest) + power[:, half, low + 1 : high + 1] * rest
            apart = profile[:, whole - low, None] - profile
            at = slice(low - whole + reach, high - whole + reach)
            mean[half, at] = apart.mean(axis=0)
            variance[half, at] = apart.var(axis=0) / max(1, self.count - 1)
        return mean, variance
