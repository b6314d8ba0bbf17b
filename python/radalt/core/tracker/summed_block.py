"""Returns in the sums over one block of frames: the strongest, others next to it, their errors."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from ..spectral_line import peak_offset, upper_median
from .integrator import Integrator

# Variance of log(1 + x) for x exponential of mean 1, by numerical integration: what one cell of noise adds per frame.
_VARIANCE = 0.1763
# Resolution cells from a peak to the first null of an unweighted sweep: beyond it are other returns.
_MAIN_LOBE = 1.0
# Resolution cells from a return, beyond which another return counts: by power alone from the middle of the first side
# lobe on, or nearer by, where both main lobes overlap, if it is also a peak or no extended ground explains it.
_BESIDE, _NEAR_BY = 1.5, 0.9
# Cells that a return may move within a block before its frames are aligned one by one: 3 m with the default sweep's
# four cells per resolution cell, well within its main lobe.
_UNMOVED = 0.6
# Power ratio (6 dB) by which a side lobe may exceed 1 / (pi distance)^2: a method weights the sweep.
_SIDE_LOBE_SPARE = 4.0
# Least share of both halves' strength, or of their mean power, that each half has to show of a return.
_EACH_HALF = 0.25
_PARTS = 4  # the last of so many parts of a block has to agree with the whole: a step of the ground within the block
# Standard deviations by which two noisy values contradict each other: noise alone does so in 6 of 100,000 blocks.
_CONTRADICTION_SIGMAS = 4.0
# Standard deviations by which a second return has to exceed its mirror image: one of the 60 cells examined does so by
# noise in one of 60,000 blocks.
_SECOND_SIGMAS = 5.0
# Resolution cells around a return that are its own peak: the power there says nothing of another return.
OWN_CELLS = 0.35
# One-sided power, as a share of the return's, that is another return's: -25 dB. A point's lobes are equal to -30 dB
# after interpolation between cells.
_ONE_SIDED_SHARE = 0.003
# Least power over noise, linear (13 dB), and largest distance in resolution cells (3 m), of the peak by which received
# frames show the return of the cleaned ones: interference seldom has a peak of both halves there.
_CLEAR, _SAME_PLACE_CELLS = 20.0, 0.15
# Fluctuation of one-sided power from frame to frame that is another return's: standard deviations of what noise gives,
# and share of the return's power. A point at 20 m/s has .0007 at most (SNR 30 dB). A share of .01 or more would let a
# return 20 dB weaker pass both tests: what fluctuates by less than the share still hides its mean.
_FLUCTUATION_SIGMAS, _FLUCTUATION_SHARE = 3.0, 0.005
# Ground whose power falls off linearly or faster, with powers that add, pulls by up to 0.86 resolution cells times the
# fourth root of its deviation (two equal returns: 0.62). The protection level takes three cells times the square root
# of `Block.shape_deviation`, so this is (0.86 / 3)^2.
_POWERS_ADD = 0.082
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


def _at(rows: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """(n, k) values of rows (n, J) at fractional cells (k,), by the cubic through the four nearest."""
    whole = np.clip(np.floor(cells).astype(int), 1, rows.shape[-1] - 3)
    x = np.clip(cells - whole, 0.0, 1.0)
    weights = (
        -x * (x - 1) * (x - 2) / 6,
        (x + 1) * (x - 1) * (x - 2) / 2,
        -(x + 1) * x * (x - 2) / 2,
        (x + 1) * x * (x - 1) / 6,
    )
    return sum(weight * rows[:, whole + k - 1] for k, weight in enumerate(weights))


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
        """Background around each cell, and the standard deviation of the sum of two halves in noise.

        The background is a median over eight resolution cells to either side. The deviation is the greater of what
        independent frames have and of what the cells show: interference that repeats with the sweep does not average
        out.
        """
        t = self.tables
        inner = sums[:, t.first : t.last]
        # half by half: SciPy's filter for one dimension takes a fourteenth of the time
        residual = inner - [
            ndimage.median_filter(half, size=t.background_cells, mode="reflect") for half in inner
        ]
        everywhere = np.zeros(sums.shape)
        everywhere[:, t.first : t.last] = inner - residual
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
        power, floor, _ = self._sums(k)
        over = [float(power[half, cells[half]] / floor[half]) - 1.0 for half in range(2)]
        weaker = min(float(self._excess[k, half, cells[half]]) for half in range(2)) / self._sigma
        if weaker < _EACH_HALF * strength:  # both halves have to show a return
            strength = min(strength, weaker / _EACH_HALF)
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
            power = self._sums(k)[0]
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
        power, floor, slope = self._sums(k)
        frames = self._aligned(k)
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
        return Measurement(
            altitude_m=float(w.beats_to_altitude_m(up, -down)),
            speed_m_per_s=float(w.beats_to_vertical_speed_m_per_s(up, -down)),
            altitude_variance_m2=hz2 * per_hz[0] ** 2,
            speed_variance_m2_per_s2=hz2 * per_hz[1] ** 2,
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
        _, floor, slope = self._sums(k)
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

    def _sums(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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

    # -- rivals ---------------------------------------------------------------------------------------------------

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
        power, floor, _ = self._sums(int(self.tables.rows[found.row, 0]))
        cells = np.arange(power.shape[1])
        over = [np.interp(found.cells[h], cells, power[h]) / floor[h] - 1.0 for h in range(2)]
        return max(0.0, 0.5 * float(sum(over)))

    def is_side_lobe(self, found: Measurement, *, mixed: bool = False) -> bool:
        """Whether a stronger return explains this one: side lobes of an unweighted sweep, with 6 dB to spare.

        With ``mixed`` also a pair of one half sweep of the stronger return with another cell of the other half, if
        the stronger has more power too: a grating lobe may win by strength alone.
        """
        other = self.strongest(self.away_from(found))
        if other is None or other.strength <= found.strength:
            return False
        near, far = np.sort(np.abs(np.array(other.cells) - found.cells)) / self.tables.resolution_cells
        if near < 1.0 <= far:  # one half of the stronger return with the other half's side lobe
            return mixed and other.power > found.power
        return bool(near >= 1.0 and found.power < other.power * _SIDE_LOBE_SPARE / (np.pi * near) ** 2)

    def shows(self, found: Measurement, least: float) -> bool:
        """Whether the block shows another block's return clearly: ``least`` strength, 13 dB over noise, the same place.

        Power alone may be interference that fills a part of the sweep in every frame.
        """
        t, at = self.tables, np.round(found.cells)
        here = self.best((np.abs(t.up_cell - at[0]) <= 1) & (np.abs(t.down_cell - at[1]) <= 1))
        if here is None or here.strength < least or here.power < _CLEAR:
            return False
        return bool(np.abs(here.cells - found.cells).max() <= _SAME_PLACE_CELLS * t.resolution_cells)

    def lobe_from_beyond(self, found: Measurement) -> bool:
        """Whether a return is no more than a side lobe of a line beyond the span, in either half sweep, 6 dB to spare.

        Such a line may be a radar of the same sweep that moves in, or ground too far away; with the default sweep the
        beat band shows it up to 390 m beyond the span. Its speed is its own: frames stay unmoved.
        """
        t = self.tables
        moved, _, _ = self._sums(int(t.rows[found.row, 0]))
        line, cells = self.ratio.sum(axis=0), np.arange(moved.shape[1])
        line[:, t.first : t.last] = 0.0
        for half, at in enumerate(found.cells):
            apart = np.maximum(np.abs(cells - at) / t.resolution_cells, 1.0)
            if np.max(line[half] * _SIDE_LOBE_SPARE / (np.pi * apart) ** 2) >= np.interp(
                at, cells, moved[half]
            ):
                return True
        return False

    def contradicted(self, found: Measurement) -> bool:
        """Whether the latest frames contradict the return by four standard deviations: a step of the ground."""
        away = self.away_from(found)
        here = np.where(away, -np.inf, self._late).max()
        other = np.where(away, self._late, -np.inf).max()
        return bool(other - here > _CONTRADICTION_SIGMAS * np.sqrt(2.0))

    def second_return(
        self, found: Measurement, reach: int, above: float, below: float, asymmetry: float
    ) -> bool:
        """Whether another return, not a side lobe, stands within ``reach`` cells of one.

        A method weights the sweep by real factors, so its lobes lie on both sides alike; a return stands on one side
        only. It counts from 1.5 resolution cells on, if it exceeds a share of the return's power (``above`` it in
        altitude, ``below`` it) and twice its mirror image by five standard deviations. Nearer by, from 0.9 cells on,
        it also has to be a peak of its own, or more than ground beyond the nearest gives: a share ``asymmetry`` of
        the return's power above it, nothing below it.
        """
        t = self.tables
        power, floor, _ = self._sums(int(t.rows[found.row, 0]))
        steps = np.arange(-reach, reach + 1)
        cells = np.arange(power.shape[1])
        here = [np.interp(found.cells[h] + steps, cells, power[h]) / floor[h] - 1.0 for h in range(2)]
        over = 0.5 * (here[0] + here[1])
        share = np.where(steps > 0, above, below)
        noise = np.sqrt(((1.0 + over) ** 2 + 4.0 * (1.0 + over[::-1]) ** 2) / (2.0 * self.count))
        apart = np.abs(steps) >= _BESIDE * t.resolution_cells
        peak = np.r_[False, (over[1:-1] > over[:-2]) & (over[1:-1] >= over[2:]), False]
        unlike_ground = (steps < 0) | (over > asymmetry * found.power)
        apart |= (peak | unlike_ground) & (np.abs(steps) >= _NEAR_BY * t.resolution_cells)
        both = np.minimum(*here) > _EACH_HALF * over  # the two halves show it
        stands = (over >= share * found.power) & (over - 2.0 * over[::-1] > _SECOND_SIGMAS * noise)
        if not np.any(apart & both & stands):
            return False
        # what a network leaves falls off beyond the span it was trained for: that is no return
        around = [ndimage.median_filter(power[h], size=t.background_cells, mode="nearest") for h in range(2)]
        level = [np.interp(found.cells[h] + steps, cells, around[h]) / floor[h] - 1.0 for h in range(2)]
        over = over - np.maximum(0.5 * (level[0] + level[1]), 0.0)
        stands &= (over >= share * found.power) & (over - 2.0 * over[::-1] > _SECOND_SIGMAS * noise)
        return bool(np.any(apart & both & stands))

    def stands_beside(self, found: Measurement, apart: float, window: float) -> bool:
        """Whether something stands ``apart`` cells from a return, ``window`` to either side, beyond its own lobes.

        A point has the same power on both sides, and so have its lobes behind a method, which weights the sweep by
        real factors. Another return shows by power on one side. Nearer by, it shows by how that power fluctuates from
        frame to frame: the phases of two returns rotate against each other. What changes in proportion to time is
        left out, since a point that moves does so. Interference that fluctuates as much counts as a return: nothing
        is known then.
        """
        t = self.tables
        k = int(t.rows[found.row, 0])
        steps = np.arange(apart - window, apart + window + 0.5)
        steps = steps[(np.abs(steps) >= OWN_CELLS * t.resolution_cells) & (np.sign(steps) == np.sign(apart))]
        if not steps.size:
            return False
        frames = self._aligned(k)
        here = 0.5 * sum(_at(frames[:, h], found.cells[h] + steps) for h in range(2))
        mirrored = 0.5 * sum(_at(frames[:, h], found.cells[h] - steps) for h in range(2))
        excess = here - mirrored
        level = 0.5 * float(self._sums(k)[1].sum()) / self.count
        peak = found.power * level
        fluctuation = signal.detrend(excess, axis=0).std(axis=0, ddof=2)
        over = np.maximum(here, mirrored).mean(axis=0)
        # standard deviation of one frame's excess for a constant line in noise
        noise = np.sqrt(np.maximum(over, 0.0) * level + 0.5 * level**2)  # interpolation may fall below zero
        fluctuates = fluctuation > np.maximum(_FLUCTUATION_SIGMAS * noise, _FLUCTUATION_SHARE * peak)
        one_sided = excess.mean(
            axis=0
        ) > _ONE_SIDED_SHARE * peak + _CONTRADICTION_SIGMAS * fluctuation / np.sqrt(self.count)
        return bool(np.any(fluctuates | one_sided))

    def _aligned(self, k: int) -> np.ndarray:
        """(m, 2, J) normalised spectra, each moved to the block's middle by speed ``k`` if that makes a difference."""
        shifts = self._shifts[k]
        return self.ratio if np.ptp(shifts) <= _UNMOVED else self.tables.moved(self.ratio, shifts)

    def shape_deviation(self, found: Measurement) -> float:
        """How far a return's peak deviates from a point's: share of its energy within a resolution cell, 0..1.

        What the frames' own noise may add is taken off, twice its mean. A second return within the main lobe deviates
        by its share of the power, and pulls the altitude by up to its share of the amplitude, times its distance.
        Where frames deviate more from each other than their mean does from a point, phases turn within the block and
        powers add, as over extended ground: a deviation counts as the smaller one that pulls as far then.
        """
        t = self.tables
        frames = self._aligned(int(t.rows[found.row, 0]))
        level = self._sums(int(t.rows[found.row, 0]))[1] / self.count
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
            noise = float(np.sum(level[half] * (2.0 * power + level[half])))
            if spread - noise > share * energy:
                shares[half] = min(shares[half], _POWERS_ADD * np.sqrt(shares[half]))
        return min(1.0, float(shares.mean()))

    def differences(self, found: Measurement, reach: int) -> tuple[np.ndarray, np.ndarray]:
        """Power over noise of the peak less that of cells ``-reach..reach`` from it.

        Mean and its variance, (2, 2 reach + 1) each; NaN beyond the beat band. The variance is the frames' own, so it
        holds whatever the interference is.
        """
        t = self.tables
        power = self._aligned(int(t.rows[found.row, 0]))
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
