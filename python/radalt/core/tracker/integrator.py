"""Non-coherent integration: frames' beat spectra in, one joint spectrum of altitude and vertical speed per block out.

Each half sweep's power is divided by its noise level and compressed to ``log(1 + x)`` before it is summed. In
exponential noise that costs 0.3 dB of sensitivity against the plain sum. In return no single frame decides a block,
however strong its peak: a false return in one frame of forty is outvoted.
"""

import numpy as np

from ..altimeter.altimeter import Altimeter, Spectra
from ..returns.point import point_return
from ..spectral_line import noise_level

# Dynamic range of one half sweep, linear (23 dB): the noise level is not estimated below the fourth side lobe of
# its strongest line, 1 / (4.5 pi)^2, so that the side lobes of a strong return do not count as returns.
_DYNAMIC_RANGE = 200.0
# Most that a return is blurred within a block by a speed between two steps of the table, in resolution cells. It
# costs less than 0.1 dB of the peak's power.
_BLUR_CELLS = 0.2
# Resolution cells to either side whose median is the background of a cell. A return's main lobe and the grating lobes
# that a method leaves of it (within 6 cells) fill less than half of them.
_BACKGROUND_CELLS = 8


class Integrator:
    """Tables for the sum over blocks of ``frames`` frames of one altimeter's spectra.

    Up cell ``i`` and down cell ``j`` are one hypothesis: altitude by their mean, speed by their difference. Frames
    are moved by the speed under test before they are summed. The steps in speed are so small that a block is blurred
    by less than a fifth of a resolution cell.

    ``altimeter``: whose spectra are integrated: its beat band, its cells, its limit of vertical speed; ``frames``:
    frames per block, 8 or more; ``doppler``: whether a range rate sets the beats of both halves apart;
    ``max_speed_m_per_s``: largest range rate under test.
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
        # range rate that sets the up and the down cell of a return one cell apart
        self.speed_per_cell = float(w.beats_to_vertical_speed_m_per_s(self.cell_hz, 0.0))
        limit = altimeter.speed_limit_m_per_s if doppler else np.inf
        self.max_speed = min(max_speed_m_per_s, limit)
        self.resolution_cells = w.range_resolution_m / self.cell_m
        low, high = altimeter.search_hz
        inside = np.nonzero((self.beat_hz >= low) & (self.beat_hz <= high))[0]
        self.first, self.last = max(2, int(inside[0])), min(self.beat_hz.size - 2, int(inside[-1]) + 1)
        self._plan_speeds()
        self._plan_pairs(altimeter)
        self.peak_curve, self.point_shape = altimeter.peak_curve, self._point_response(altimeter)
        self.background_cells = 2 * int(np.ceil(_BACKGROUND_CELLS * self.resolution_cells)) + 1

    def _plan_speeds(self) -> None:
        """Speeds by which frames are moved; a speed in between blurs the block by `_BLUR_CELLS` at most."""
        duration = self.frames * self.waveform.sweep_s
        blur = _BLUR_CELLS * self.waveform.range_resolution_m / duration  # m/s to either side
        sides = int(np.ceil(max(0.0, self.max_speed - blur) / (2.0 * blur)))
        self.speeds = np.arange(-sides, sides + 1) * (2.0 * self.max_speed / (2 * sides + 1))
        self._cells_per_frame = self.speeds * self.waveform.sweep_s / self.cell_m

    def _plan_pairs(self, altimeter: Altimeter) -> None:
        """Rows of the joint table: (speed under test, difference of up and down cell), and what each entry says."""
        reach = 1
        if self.doppler:
            reach = min(altimeter.doppler_cells, int(self.max_speed / self.speed_per_cell + 1.01))
        offsets = np.arange(-reach, reach + 1)
        if self.doppler:
            nearest = np.abs(offsets[:, None] * self.speed_per_cell - self.speeds).argmin(axis=1)
            rows = list(zip(nearest.tolist(), offsets.tolist(), strict=True))
        else:
            rows = [(k, d) for k in range(self.speeds.size) for d in offsets.tolist()]
        self.rows = np.array(rows)
        up = np.arange(self.first, self.last)
        down = up - self.rows[:, 1:]
        self.up_cell = np.broadcast_to(up, down.shape)
        self.valid = (down >= self.first) & (down < self.last)
        self.down_cell = np.clip(down, self.first, self.last - 1)
        beat = 0.5 * (self.beat_hz[self.up_cell] + self.beat_hz[self.down_cell])
        self.altitude_m = self.waveform.beats_to_altitude_m(beat, -beat)
        s = altimeter.settings
        half_cell = 0.5 * self.waveform.range_resolution_m
        self.altitude_span_m = np.array([s.min_altitude_m - half_cell, s.max_altitude_m + half_cell])
        self.valid &= (self.altitude_m >= self.altitude_span_m[0]) & (
            self.altitude_m <= self.altitude_span_m[1]
        )
        self._no_pair = ~self.valid
        by_cells = self.rows[:, 1] * self.speed_per_cell
        self.row_speed = by_cells if self.doppler else self.speeds[self.rows[:, 0]]
        # neighbours are correlated at twice the resolution's sampling: every other entry is a trial of its own
        self.trials = max(1.0, self.valid.sum() / self.resolution_cells**2)

    def _point_response(self, altimeter: Altimeter) -> tuple[np.ndarray, np.ndarray]:
        """How a point return shows in the cells around its peak, measured at the middle of the span."""
        s = altimeter.settings
        middle = int(np.argmin(np.abs(self.altitude_m[0] - 0.5 * (s.min_altitude_m + s.max_altitude_m))))
        cell, reach = int(self.up_cell[0, middle]), round(self.resolution_cells) + 1
        offset = np.linspace(-0.7, 0.7, 57)
        beat = self.beat_hz[cell] + offset * self.cell_hz
        frames = point_return(self.waveform, self.waveform.beats_to_altitude_m(beat, -beat))
        power = altimeter.spectra(frames).power[:, 0, cell - reach : cell + reach + 1].astype(float)
        distance = np.arange(-reach, reach + 1) - offset[:, None]
        power /= power[offset.size // 2, reach]
        order = np.argsort(distance.ravel())
        return distance.ravel()[order], power.ravel()[order]

    # -- one block ------------------------------------------------------------------------------------------------

    def normalise(self, spectra: Spectra) -> np.ndarray:
        """(n, 2, J) float32 power over each half sweep's noise level; at most 200 (23 dB), NaN in unusable frames."""
        inner = spectra.power[..., self.first : self.last]
        with np.errstate(invalid="ignore", divide="ignore"):
            level = np.maximum(noise_level(inner), inner.max(axis=-1) / np.float32(_DYNAMIC_RANGE))
            out = spectra.power / level[..., None]
        out[~((spectra.scale > 0) & np.isfinite(spectra.scale) & (level > 0).all(axis=-1))] = np.nan
        return out

    def shifts(self, at: np.ndarray) -> np.ndarray:
        """(K, m) cells by which frames at these places are moved to the block's middle, for each speed under test."""
        return np.multiply.outer(self._cells_per_frame, at - at.mean())

    def moved_sums(self, values: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """(K, 2, J) sums of spectra (m, 2, J), each moved by a fraction of cells (K, m), linear between cells.

        One matrix product per block: rows are the frames' weights for every whole shift that occurs.
        """
        whole = np.floor(shifts).astype(int)
        rest = shifts - whole
        least, most = int(whole.min()), int(whole.max()) + 1
        weights = np.zeros((len(shifts), most - least + 1, len(values)), dtype=np.float32)
        speed, frames = np.arange(len(shifts))[:, None], np.arange(len(values))
        weights[speed, whole - least, frames] = 1.0 - rest
        weights[speed, whole - least + 1, frames] += rest
        parts = weights.reshape(-1, len(values)) @ values.reshape(len(values), -1)
        parts = parts.reshape(*weights.shape[:2], *values.shape[1:])
        cells = values.shape[-1]
        total = np.zeros((len(shifts), *values.shape[1:]))
        for k, shift in enumerate(range(least, most + 1)):
            here, there = max(0, -shift), max(0, shift)
            total[..., here : cells - there] += parts[:, k, ..., there : cells - here]
        return total

    def joint(self, halves: np.ndarray) -> np.ndarray:
        """(rows, cells) sums of up and down cell of (K, 2, J); minus infinity where there is no such pair."""
        cells, speed, offset = self.last - self.first, self.rows[:, 0], self.rows[:, 1]
        reach = int(np.abs(offset).max())
        down = np.zeros((len(halves), cells + 2 * reach))
        down[:, reach : reach + cells] = halves[:, 1, self.first : self.last]
        # whole rows of windows: picking single cells takes ten times as long
        windows = np.lib.stride_tricks.sliding_window_view(down, cells, axis=1)
        out = halves[speed, 0, self.first : self.last] + windows[speed, reach - offset]
        np.copyto(out, -np.inf, where=self._no_pair)
        return out

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
