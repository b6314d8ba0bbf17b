"""Non-coherent integration: frames' beat spectra in, one joint spectrum of altitude and vertical speed per block out.

Each half sweep's power is divided by its noise level and compressed to ``log(1 + x)`` before it is summed. In
exponential noise that costs 0.3 dB of sensitivity against the plain sum. In return no single frame decides a block,
however strong its peak: what a method invents in one frame of forty is outvoted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..returns.point import point_return
from .altimeter import Altimeter, Spectra

__all__ = ["Block", "Entry", "Integrator", "Measurement"]

_VARIANCE = 0.1763  # of log(1 + x), x exponential of mean 1
_TOP = 200.0  # greatest power over noise in one frame that counts
_MAIN_LOBE = 1.0  # resolution cells from a peak to what may be another return
_NEARLY = 0.8  # of the greatest strength
_STILL = 0.6  # cells that a return may move in a block without being followed by the evidence
_LATEST = 4  # the last of so many parts of a block has to agree with the whole


def _median(values: np.ndarray) -> np.ndarray:
    """Upper median over the last axis; `numpy.median` takes three times as long for rows this short."""
    middle = values.shape[-1] // 2
    return np.partition(values, middle, axis=-1)[..., middle]


@dataclass(frozen=True)
class Measurement:
    """A return in one block.

    Attributes
    ----------
    altitude_m, speed_m_per_s : float
        At the middle of the block's usable frames.
    altitude_variance_m2, speed_variance_m2_per_s2 : float
        By the noise in the spectrum.
    strength : float
        Sum of both halves over its mean in noise, in standard deviations.
    cells : (2,) float
        Position of the peak in the up and the down half, in cells.
    power : float
        Power over noise, mean of both halves, linear.
    row : int
        Row of the joint table, for the speed by which frames were moved.
    """

    altitude_m: float
    speed_m_per_s: float
    altitude_variance_m2: float
    speed_variance_m2_per_s2: float
    strength: float
    cells: np.ndarray
    power: float
    row: int


@dataclass(frozen=True)
class Entry:
    """A place in the joint table: its strength, altitude (on the grid), cells of both halves, power over noise, row."""

    strength: float
    altitude_m: float
    cells: tuple[int, int]
    power: float
    row: int


class Integrator:
    """Tables for the sum over blocks of ``frames`` frames of one altimeter's spectra.

    Parameters
    ----------
    altimeter : Altimeter
        Whose spectra are integrated: its beat band, its cells, its limit of vertical speed.
    frames : int
        Frames per block, 8 or more.
    doppler : bool
        Whether a range rate sets the beats of both halves apart.
    max_speed_m_per_s : float
        Largest range rate under test.

    Notes
    -----
    Up cell ``i`` and down cell ``j`` are one hypothesis: altitude by their mean, speed by their difference. Frames are
    moved by the speed under test before they are summed. The steps in speed are so small that a block is blurred by
    less than a fifth of a resolution cell.
    """

    def __init__(self, altimeter: Altimeter, frames: int, *, doppler: bool, max_speed_m_per_s: float) -> None:
        if frames < 8:
            raise ValueError(
                f"tracker integrates {frames} frames; it has to be at least 8: raise tracker.output_s"
            )
        w = altimeter.waveform
        self.waveform, self.frames, self.doppler = w, frames, doppler
        self.beat_hz, self.cell_hz = altimeter.beat_hz, altimeter.cell_hz
        self.cell_m = float(w.beats_to_altitude_m(self.cell_hz, -self.cell_hz))
        self.speed_per_cell = float(
            w.beats_to_vertical_speed_m_per_s(self.cell_hz, 0.0)
        )  # of up against down
        limit = altimeter.settings.max_vertical_speed_m_per_s if doppler else np.inf
        self.max_speed = min(max_speed_m_per_s, limit)
        self.resolution_cells = w.range_resolution_m / self.cell_m
        low, high = altimeter.search_hz
        inside = np.nonzero((self.beat_hz >= low) & (self.beat_hz <= high))[0]
        self.first, self.last = max(2, int(inside[0])), min(self.beat_hz.size - 2, int(inside[-1]) + 1)
        self._plan_speeds()
        self._plan_pairs(altimeter)
        self._curve = self._peak_curve(altimeter)
        self._background = 2 * int(np.ceil(8 * self.resolution_cells)) + 1

    def _plan_speeds(self) -> None:
        """Speeds by which frames are moved; a speed in between blurs the block by 0.2 resolution cells at most."""
        duration = self.frames * self.waveform.sweep_s
        blur = 0.2 * self.waveform.range_resolution_m / duration  # m/s to either side
        sides = int(np.ceil(max(0.0, self.max_speed - blur) / (2.0 * blur)))
        self.speeds = np.arange(-sides, sides + 1) * (2.0 * self.max_speed / (2 * sides + 1))
        self._cells_per_frame = self.speeds * self.waveform.sweep_s / self.cell_m

    def _plan_pairs(self, altimeter: Altimeter) -> None:
        """Rows of the joint table: (speed under test, difference of up and down cell), and what each entry says."""
        reach = (
            min(altimeter.doppler_cells, int(self.max_speed / self.speed_per_cell + 1.01))
            if self.doppler
            else 1
        )
        offsets = np.arange(-reach, reach + 1)
        if self.doppler:
            nearest = np.abs(offsets[:, None] * self.speed_per_cell - self.speeds).argmin(axis=1)
            rows = list(zip(nearest.tolist(), offsets.tolist(), strict=True))
        else:
            rows = [(k, d) for k in range(self.speeds.size) for d in offsets.tolist()]
        self.rows = np.array(rows)
        up = np.arange(self.first, self.last)
        down = up - self.rows[:, 1:]
        self._up = np.broadcast_to(up, down.shape)
        self._valid = (down >= self.first) & (down < self.last)
        self._down = np.clip(down, self.first, self.last - 1)
        beat = 0.5 * (self.beat_hz[self._up] + self.beat_hz[self._down])
        self.altitude_m = self.waveform.beats_to_altitude_m(beat, -beat)
        s = altimeter.settings
        half_cell = 0.5 * self.waveform.range_resolution_m
        self.altitude_span_m = np.array([s.min_altitude_m - half_cell, s.max_altitude_m + half_cell])
        self._valid &= (self.altitude_m >= self.altitude_span_m[0]) & (
            self.altitude_m <= self.altitude_span_m[1]
        )
        by_cells = self.rows[:, 1] * self.speed_per_cell
        self.row_speed = by_cells if self.doppler else self.speeds[self.rows[:, 0]]
        # neighbours are correlated at twice the resolution's sampling: every other entry is a trial of its own
        self.trials = max(1.0, self._valid.sum() / self.resolution_cells**2)

    def _peak_curve(self, altimeter: Altimeter) -> tuple[np.ndarray, np.ndarray]:
        """Offset of a tone from its peak cell against (R - L) / (2 C - R - L), which a noise floor leaves alone."""
        s = altimeter.settings
        middle = int(np.argmin(np.abs(self.altitude_m[0] - 0.5 * (s.min_altitude_m + s.max_altitude_m))))
        cell = int(self._up[0, middle])
        offset = np.linspace(-0.7, 0.7, 57)
        beat = self.beat_hz[cell] + offset * self.cell_hz
        frames = point_return(self.waveform, self.waveform.beats_to_altitude_m(beat, -beat))
        left, here, right = altimeter.spectra(frames).power[:, 0, cell - 1 : cell + 2].T.astype(float)
        return (right - left) / (2.0 * here - right - left), offset

    # -- one block ------------------------------------------------------------------------------------------------

    def normalise(self, spectra: Spectra) -> np.ndarray:
        """(n, 2, J) float32 power over the noise level of each half sweep; at most `_TOP`, NaN in unusable frames."""
        inner = spectra.power[..., self.first : self.last]
        with np.errstate(invalid="ignore", divide="ignore"):
            level = _median(inner) * np.float32(1.0 / np.log(2.0))
            level = np.maximum(level, inner.max(axis=-1) / np.float32(_TOP))
            out = spectra.power / level[..., None]
        out[~((spectra.scale > 0) & np.isfinite(spectra.scale) & (level > 0).all(axis=-1))] = np.nan
        return out

    def integrate(self, ratio: np.ndarray, at: np.ndarray) -> Block:
        """A block from normalised spectra (m, 2, J) of usable frames and their places (m,) in the block."""
        return Block(self, ratio, at)

    def shifts(self, at: np.ndarray, speed: int) -> np.ndarray:
        """(m,) cells by which frames at these places are moved to the block's middle, for a speed under test."""
        return (at - at.mean()) * self._cells_per_frame[speed]

    def moved_sum(self, values: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """(2, J) sum of spectra (m, 2, J), each moved by a fraction of cells, linear between cells.

        One matrix product per block: rows are the frames' weights for every whole shift that occurs.
        """
        whole = np.floor(shifts).astype(int)
        rest = shifts - whole
        least, most = int(whole.min()), int(whole.max()) + 1
        weights = np.zeros((most - least + 1, len(values)), dtype=np.float32)
        frames = np.arange(len(values))
        weights[whole - least, frames] = 1.0 - rest
        weights[whole - least + 1, frames] += rest
        parts = (weights @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])
        cells = values.shape[-1]
        total = np.zeros(values.shape[1:])
        for shift, part in zip(range(least, most + 1), parts, strict=True):
            total[..., max(0, -shift) : cells - max(0, shift)] += part[
                ..., max(0, shift) : cells - max(0, -shift)
            ]
        return total

    @staticmethod
    def moved(values: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """(m, 2, J) spectra moved by a fraction of cells each."""
        whole = np.floor(shifts).astype(int)
        rest = (shifts - whole).astype(np.float32)[:, None, None]
        cells = np.clip(np.arange(values.shape[-1]) + whole[:, None], 0, values.shape[-1] - 2)
        rows = np.arange(len(values))[:, None]
        # the advanced indices lead: (m, J, 2)
        here = values[rows, :, cells].transpose(0, 2, 1)
        above = values[rows, :, cells + 1].transpose(0, 2, 1)
        return here + rest * (above - here)


class Block:
    """One block's sums; what follows from them is computed on request."""

    def __init__(self, tables: Integrator, ratio: np.ndarray, at: np.ndarray) -> None:
        self.tables, self._ratio, self._at = tables, ratio, at
        self.count = len(ratio)
        self._known: dict[int, tuple] = {}
        self.middle = float(at.mean())
        self._votes = np.log1p(ratio)
        late = -(-self.count // _LATEST)
        shifts = [tables.shifts(at, k) for k in range(tables.speeds.size)]
        sums = np.stack([tables.moved_sum(self._votes, s) for s in shifts])  # (K, 2, J)
        background, self._sigma = self._noise(sums[len(sums) // 2])
        self._excess = sums - background
        self.table = self._joint(self._excess) / self._sigma
        latest = np.stack([tables.moved_sum(self._votes[-late:], s[-late:]) for s in shifts])
        latest -= background * (late / self.count)
        self._late = self._joint(latest) / np.sqrt(2 * late * _VARIANCE)

    def _noise(self, sums: np.ndarray) -> tuple[np.ndarray, float]:
        """Background around each cell, and the standard deviation of the sum of two halves in noise.

        The background is a median over eight resolution cells to either side. The deviation is the greater of what
        independent frames have and of what the cells show: interference that repeats with the sweep does not average
        out.
        """
        t = self.tables
        inner = sums[:, t.first : t.last]
        # half by half: SciPy's filter for one dimension takes a fourteenth of the time
        residual = inner - [ndimage.median_filter(half, size=t._background, mode="reflect") for half in inner]
        everywhere = np.zeros(sums.shape)
        everywhere[:, t.first : t.last] = inner - residual
        seen = 1.4826 * _median(np.abs(residual - _median(residual)[:, None]))
        expected = self.count * _VARIANCE
        return everywhere, float(np.sqrt(np.maximum(seen**2, expected).sum()))

    def _joint(self, halves: np.ndarray) -> np.ndarray:
        """(rows, cells) sums of up and down cell; minus infinity where there is no such pair."""
        t = self.tables
        k = t.rows[:, :1]
        out = halves[k, 0, t._up] + halves[k, 1, t._down]
        out[~t._valid] = -np.inf
        return out

    def strongest(self, allowed: np.ndarray | None = None) -> Entry | None:
        """The strongest pair, of those allowed (a mask like `table`); None where none is allowed."""
        table = self.table if allowed is None else np.where(allowed, self.table, -np.inf)
        row, column = divmod(int(table.argmax()), table.shape[1])
        strength = float(table[row, column])
        if not np.isfinite(strength):
            return None
        t = self.tables
        cells = int(t._up[row, column]), int(t._down[row, column])
        k = int(t.rows[row, 0])
        weaker = min(float(self._excess[k, half, cells[half]]) for half in range(2)) / self._sigma
        if weaker < 0.25 * strength:  # both halves have to show a return
            strength = min(strength, 4.0 * weaker)
        power, floor, _ = self._sums(k)
        over = sum(power[half, cells[half]] / floor[half] - 1.0 for half in range(2))
        return Entry(strength, float(t.altitude_m[row, column]), cells, max(0.0, 0.5 * float(over)), row)

    def best(self, allowed: np.ndarray | None = None) -> Measurement | None:
        """`strongest`, measured to a fraction of a cell; None where none is allowed or it is no peak."""
        entry = self.strongest(allowed)
        return None if entry is None else self.measure(entry)

    def prominent(self, allowed: np.ndarray) -> np.ndarray:
        """Of the allowed entries that come near the strongest, the one of most power, as a mask like `table`.

        After compression a return and its grating lobes are alike; without compression one frame could decide.
        """
        t = self.tables
        table = np.where(allowed, self.table, -np.inf)
        top = table.max()
        row, column = np.nonzero((table >= min(_NEARLY * top, top)) & (table > -np.inf))
        cells, speed = (t._up[row, column], t._down[row, column]), t.rows[row, 0]
        power = np.empty(row.size)
        for k in np.unique(speed).tolist():
            at = speed == k
            sums, floor, _ = self._sums(k)
            power[at] = sum(sums[half, cells[half][at]] / floor[half] for half in range(2))
        mask = np.zeros(table.shape, dtype=bool)
        if row.size:
            best = power.argmax()
            mask[row[best], column[best]] = True
        return mask

    def at_peaks(self, allowed: np.ndarray) -> np.ndarray:
        """Those of the allowed entries whose halves both lie beside a peak; all of them where none does.

        Within a gate the strongest entry may lie on the flank of a lobe beyond it.
        """
        t = self.tables
        beside = np.zeros((t.speeds.size, 2, t.beat_hz.size), dtype=bool)
        for k in np.unique(t.rows[allowed.any(axis=1), 0]).tolist():
            power = self._sums(k)[0]
            peak = (power[:, 1:-1] >= power[:, :-2]) & (power[:, 1:-1] >= power[:, 2:])
            for shift in range(3):
                beside[k, :, shift : shift + peak.shape[1]] |= peak
        k = t.rows[:, :1]
        found = allowed & beside[k, 0, t._up] & beside[k, 1, t._down]
        return found if found.any() else allowed

    def measure(self, entry: Entry) -> Measurement | None:
        """Position and variance of a return; None where there is no peak."""
        t = self.tables
        k = int(t.rows[entry.row, 0])
        power, floor, slope = self._sums(k)
        fine, variance, over = np.empty(2), np.empty(2), np.empty(2)
        for half in range(2):
            cell = self._climb(power[half], entry.cells[half])
            left, here, right = power[half, cell - 1 : cell + 2]
            curvature = 2.0 * here - left - right
            if not curvature > 0:
                return None
            over[half] = max(0.0, here / floor[half] - 1.0)
            fine[half] = cell + np.interp((right - left) / curvature, *t._curve)
            # noise of the slope over the curvature; beside a return the noise is greater by its power over noise
            variance[half] = slope[half] * (1.0 + over[half]) / curvature**2
        up, down = (float(t.beat_hz[0] + t.cell_hz * f) for f in fine)
        hz2 = float(variance.sum()) * t.cell_hz**2
        w = t.waveform
        return Measurement(
            altitude_m=float(w.beats_to_altitude_m(up, -down)),
            speed_m_per_s=float(w.beats_to_vertical_speed_m_per_s(up, -down)),
            altitude_variance_m2=hz2 * float(w.beats_to_altitude_m(1.0, 0.0)) ** 2,
            speed_variance_m2_per_s2=hz2 * float(w.beats_to_vertical_speed_m_per_s(1.0, 0.0)) ** 2,
            strength=entry.strength,
            cells=fine,
            power=float(over.mean()),
            row=entry.row,
        )

    def _sums(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(2, J) power moved by speed ``k``; (2,) its level in noise; (2,) variance of its slope in noise."""
        if k not in self._known:
            t = self.tables
            power = t.moved_sum(self._ratio, t.shifts(self._at, k))
            inner = power[:, t.first : t.last]
            floor = np.maximum(_median(inner), 1e-12)
            slopes = np.abs(inner[:, 2:] - inner[:, :-2])
            self._known[k] = power, floor, (0.5 * 1.4826 * _median(slopes)) ** 2
        return self._known[k]

    def _climb(self, power: np.ndarray, cell: int) -> int:
        """Climb to the greatest power next to a cell, since compression flattens the top of a strong return."""
        t = self.tables
        while True:
            near = slice(max(t.first, cell - 1), min(t.last, cell + 2))
            top = near.start + int(power[near].argmax())
            if power[top] <= power[cell]:
                return cell
            cell = top

    # -- rivals ---------------------------------------------------------------------------------------------------

    def away_from(self, found: Measurement) -> np.ndarray:
        """Mask like `table`: entries of which at least one half lies beyond the main lobe of a return."""
        t = self.tables
        lobe = _MAIN_LOBE * t.resolution_cells
        return (np.abs(t._up - found.cells[0]) > lobe) | (np.abs(t._down - found.cells[1]) > lobe)

    def power_at(self, found: Measurement) -> float:
        """Power over noise, mean of both halves, where another block shows a return."""
        power, floor, _ = self._sums(int(self.tables.rows[found.row, 0]))
        cells = np.arange(power.shape[1])
        over = [np.interp(found.cells[h], cells, power[h]) / floor[h] - 1.0 for h in range(2)]
        return max(0.0, 0.5 * float(sum(over)))

    def lobe_from_beyond(self, found: Measurement) -> bool:
        """Whether a return is no more than a side lobe of a line beyond the span, in either half sweep, 6 dB to spare.

        Such a line may be a radar of the same sweep, or ground too far away. Its speed is its own: frames stay unmoved.
        """
        t = self.tables
        moved, _, _ = self._sums(int(t.rows[found.row, 0]))
        line, cells = self._ratio.sum(axis=0), np.arange(moved.shape[1])
        line[:, t.first : t.last] = 0.0
        for half, at in enumerate(found.cells):
            apart = np.maximum(np.abs(cells - at) / t.resolution_cells, 1.0)
            if np.max(line[half] * 4.0 / (np.pi * apart) ** 2) >= np.interp(at, cells, moved[half]):
                return True
        return False

    def contradicted(self, found: Measurement) -> bool:
        """Whether the latest frames contradict the return by four standard deviations: a step of the ground."""
        away = self.away_from(found)
        here = np.where(away, -np.inf, self._late).max()
        other = np.where(away, self._late, -np.inf).max()
        return bool(other - here > 4.0 * np.sqrt(2.0))

    def second_return(self, found: Measurement, reach: int, above: float, below: float) -> bool:
        """Whether another return, not a side lobe, stands within ``reach`` cells of one.

        A method weights the sweep by real factors, so its lobes lie on both sides alike; a return stands on one side
        only. It counts from 1.5 resolution cells on, if it exceeds a share of the return's power (``above`` it in
        altitude, ``below`` it) and twice its mirror image by five standard deviations.
        """
        t = self.tables
        power, floor, _ = self._sums(int(t.rows[found.row, 0]))
        steps = np.arange(-reach, reach + 1)
        cells = np.arange(power.shape[1])
        here = [np.interp(found.cells[h] + steps, cells, power[h]) / floor[h] - 1.0 for h in range(2)]
        over = 0.5 * (here[0] + here[1])
        share = np.where(steps > 0, above, below)
        noise = np.sqrt(((1.0 + over) ** 2 + 4.0 * (1.0 + over[::-1]) ** 2) / (2.0 * self.count))
        apart = np.abs(steps) >= 1.5 * t.resolution_cells
        both = np.minimum(*here) > 0.25 * over  # the two halves show it
        stands = (over >= share * found.power) & (over - 2.0 * over[::-1] > 5.0 * noise)
        if not np.any(apart & both & stands):
            return False
        # what a network leaves falls off beyond the span it was trained for: that is no return
        around = [ndimage.median_filter(power[h], size=t._background, mode="nearest") for h in range(2)]
        level = [np.interp(found.cells[h] + steps, cells, around[h]) / floor[h] - 1.0 for h in range(2)]
        over = over - np.maximum(0.5 * (level[0] + level[1]), 0.0)
        stands &= (over >= share * found.power) & (over - 2.0 * over[::-1] > 5.0 * noise)
        return bool(np.any(apart & both & stands))

    def differences(self, found: Measurement, reach: int) -> tuple[np.ndarray, np.ndarray]:
        """Power over noise of the peak less that of cells ``-reach..reach`` from it.

        Mean and its variance, (2, 2 reach + 1) each; NaN beyond the beat band. The variance is the frames' own, so it
        holds whatever the interference is.
        """
        t = self.tables
        shifts = t.shifts(self._at, int(t.rows[found.row, 0]))
        power = self._ratio if np.ptp(shifts) <= _STILL else t.moved(self._ratio, shifts)
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
