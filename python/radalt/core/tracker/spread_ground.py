"""Spread ground: the nearest point of a return that is wider than a point's, by a fit of its leading edge.

A return of ground is the sum of many scatterers, so its power fluctuates from frame to frame, and differently in every
cell. Where beam and reflectivity fall off as Gaussians of the angle off nadir, its mean power over the range ``u``
beyond the nearest point is

    exp(-u / L) I0(b sqrt(u))

with an extent ``L``, and the Bessel function for a beam that points elsewhere, as in a bank (G. S. Brown, The average
impulse response of a rough surface and its applications, IEEE Trans. Antennas Propag. 25 (1977) 67). The Doppler of
ground ahead and astern blurs it by as much as ``sqrt(u)``, and the sweep's window gives it its resolution. All such
shapes that an altitude, a beam and a speed may give are compared with the mean power of one block, by their likelihood;
the nearest point is the mean over them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import i0e

from ..fir import cosine_window
from ..spectral_line import upper_median
from .integrator import Integrator

# Shapes, in resolution cells: extent L; range of most power beyond the nearest point; blur at one cell beyond it.
_EXTENTS = 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0
_TOPS = 0.0, 0.25, 0.6, 1.2, 2.5, 5.0, 10.0
_BLURS = 0.0, 0.3, 0.7, 1.2, 1.7
# Extents up to which the top may lie: there, as in a beam of 40 degrees banked by as many, the nearest ground is 13 dB
# below it.
_FARTHEST_TOP = 5.0
# Greatest extent and top over the altitude (a beam of 60 degrees; a bank of 40), and ground speed in m/s.
_MOST_EXTENT, _MOST_TOP, _FASTEST_M_PER_S = 1.0 / 7.5, 0.4, 120.0
# Points per resolution cell of a shape, and its resolution cells to either side of the edge.
_FINE, _REACH = 16, 14.0
# Resolution cells from the beginning of the rise at which powers are compared.
_WINDOW = np.arange(-5, 9) / 4.0
_EDGES = np.arange(-20, 29) / 16.0  # nearest points that are tried, likewise
_LEVELS = 0.6, 0.8, 1.0, 1.25  # power of a shape's top over the greatest one measured
# Share of that power added to both: side lobes and noise.
_SOFT = 0.02
# The rise begins at -9 dB from the peak, after a resolution cell below -12 dB.
_RISE, _FOOT = 0.125, 0.063
# Least power of the peak over noise (13 dB).
_CLEAR = 20.0
# Log likelihood by which the best shape may fall short of the powers themselves, and by which it has to exceed a point.
_POOR, _SPREAD = 6.0, 2.0
# Least variance of a frame's powers over the squares of their means, and largest share of it by which all cells change
# alike: two points beat alike in all cells, and one that moves changes by a trend.
_CHANGING, _ALIKE = 0.05, 0.85
# Least number of independent frames in a block: fewer, below some 10 m/s, leave the shape to chance.
_LEAST_LOOKS = 4.0
# Metres that are added to the fit: it lies 2 to 6 m before the nearest point in level flight, and up to 3 m beyond it
# over mountains banked by 40 degrees (tests/test_ground.py, shipped kinds of ground); too low is the safe side.
_BIAS_M = 1.5
# Share of the distance from the nearest point to the top by which the fit errs, one deviation.
_LEAN = 0.05
# Rise after a dip, and fall, as power ratios, at which ground ends: beyond it powers stay as they are.
_DIP, _END = 4.0, 0.03
_BEFORE = 6.0  # resolution cells before the edge in which the shape's side lobes are weighted
# A method's lobes lie alike on both sides of a point, and below the peak: of power one to four resolution cells off, at
# most so many times as much lies beyond it as before it, and there the mean is at most -6 dB.
_ALIKE_SIDES, _LOBES = 1.8, 0.25
# Ground that a method has widened begins between the fitted edge and the peak: resolution cells of that distance that
# the protection level's other parts cover.
_COVERED = 0.5


@dataclass(frozen=True)
class Ground:
    """Weights (2, J) of powers that leave a point at the nearest ground, and that place in metres."""

    weights: np.ndarray
    altitude_m: float
    deviation_m: float
    """Standard deviation of that place; each half sweep has its own speckle, so that of its speed follows."""
    deviation_m_per_s: float
    widened_m: float
    """By how much it may lie farther, besides, since a method's own response widens ground."""


class SpreadGround:
    """Finds spread ground in the blocks of one `Integrator`. ``window``: of the sweep (`AltimeterSettings`)."""

    def __init__(self, tables: Integrator, window: str) -> None:
        self.tables = tables
        self._cell_m = tables.waveform.range_resolution_m
        self._x, self._kinds, self._shapes, self._costs, self._inverse = _shapes(window)
        self._kept: tuple[np.ndarray, ...] = (np.zeros(0, dtype=int),) * 3

    def find(self, ratio: np.ndarray, *, cleaned: bool = False) -> Ground | None:
        """Ground in a block's normalised spectra (m, 2, J); None where the strongest return is a point or not clear.

        ``cleaned``: by a method, which may have widened a point, and ground towards the aircraft.
        """
        t = self.tables
        weights, variance = np.ones(ratio.shape[1:], dtype=np.float32), 0.0
        rises = []
        for half in range(2):
            power = ratio[:, half].mean(axis=0, dtype=float)
            floor = float(upper_median(power[t.first : t.last]))
            peak = int(power.argmax())
            if not t.first <= peak < t.last or power[peak] < _CLEAR * floor:
                return None
            rises.append((power, floor, peak, self._rise(power, peak)))
        if cleaned and self._has_lobes(rises):
            return None
        looks = self._looks(ratio, [rise for *_, rise in rises])
        if looks is None:
            return None
        cells = widened = 0.0
        for half, (power, floor, peak, rise) in enumerate(rises):
            fitted = self._fit(power - floor, peak, rise, looks)
            if fitted is None:
                return None
            edge, deviation, top, kind, level = fitted
            if edge < 0.0:  # before the first cell
                return None
            variance += 0.25 * deviation**2 + 0.5 * (_LEAN * top) ** 2
            cells += 0.5 * edge
            if cleaned:
                widened += 0.5 * max(0.0, peak - edge - _COVERED * t.resolution_cells)
            weights[half] = self._weights(power, edge, kind, level)
        beat_hz = float(t.beat_hz[0] + cells * t.cell_hz)
        altitude_m = float(t.waveform.beats_to_altitude_m(beat_hz, -beat_hz)) + _BIAS_M
        deviation_m = float(np.sqrt(variance)) * self._cell_m
        deviation_m_per_s = 2.0 * deviation_m * t.speed_per_cell / t.cell_m
        return Ground(weights, altitude_m, deviation_m, deviation_m_per_s, widened * t.cell_m)

    def _has_lobes(self, rises: list[tuple[np.ndarray, float, int, int]]) -> bool:
        """Whether the peaks have the lobes that a method gives to a point, on both sides."""
        near, far = (round(cells * self.tables.resolution_cells) for cells in (1, 4))
        beyond = before = 0.0
        for power, floor, peak, _ in rises:
            relative = (power - floor) / power[peak] / len(rises) / (far - near)
            beyond += float(relative[peak + near : peak + far].sum())
            before += float(relative[max(0, peak - far) : max(0, peak - near)].sum())
        return before < _LOBES and beyond < _ALIKE_SIDES * before

    def _rise(self, power: np.ndarray, peak: int) -> int:
        """Cell at which the rise to a peak begins."""
        reach, cell, rise, low = round(self.tables.resolution_cells), peak, peak, 0
        while cell > 1 and low < reach:
            cell -= 1
            low = 0 if power[cell] >= _FOOT * power[peak] else low + 1
            rise = rise if low else cell
        while rise < peak and power[rise] < _RISE * power[peak]:
            rise += 1
        return rise

    def _looks(self, ratio: np.ndarray, rises: list[int]) -> float | None:
        """Independent frames in the block; None where cells do not change, or all alike: mean of both half sweeps."""
        per = self.tables.resolution_cells
        changing = alike = new = 0.0
        for half, rise in enumerate(rises):
            near = ratio[:, half, max(0, rise - round(per)) : rise + round(2.75 * per)].astype(float)
            near /= near.sum(axis=1, keepdims=True)
            mean = near.mean(axis=0)
            values = np.linalg.svd(near - mean, compute_uv=False) ** 2
            total = float(values.sum()) + 1e-30
            changing += 0.5 * total / (len(near) - 1) / float(mean @ mean)
            alike += 0.5 * float(values[0]) / total
            new += 0.25 * float((np.diff(near, axis=0) ** 2).sum()) / total
        if changing < _CHANGING or alike > _ALIKE:
            return None
        looks = len(ratio) * min(1.0, new / (2.0 - min(new, 1.0)))
        return looks if looks >= _LEAST_LOOKS else None

    def _fit(
        self, power: np.ndarray, peak: int, rise: int, looks: float
    ) -> tuple[float, float, float, int, float] | None:
        """Cell of the nearest point; its deviation and the top, resolution cells; likeliest shape there, its level."""
        t = self.tables
        here = np.interp(rise + _WINDOW * t.resolution_cells, np.arange(power.size), np.maximum(power, 0.0))
        top = here.max()
        here = here / top + _SOFT
        altitude_m = float(t.waveform.beats_to_altitude_m(t.beat_hz[peak], -t.beat_hz[peak]))
        kinds, costs, inverse = self._possible(altitude_m)
        log = -(costs + (inverse @ here.astype(np.float32)).reshape(costs.shape))  # kinds, levels, edges
        log *= 0.25 * looks  # four powers per resolution cell
        best = float(log.max())
        if (
            0.25 * looks * float(-(np.log(here) + 1.0).sum()) - best > _POOR
            or best - float(log[0].max()) < _SPREAD
        ):
            return None
        share = np.exp(log - best)
        share /= share.sum()
        top_cells = float(share.sum(axis=(1, 2)) @ self._kinds[kinds, 1])
        share = share.sum(axis=(0, 1))
        edge = float(share @ _EDGES)
        at = int(np.abs(_EDGES - edge).argmin())
        kind, level = divmod(int(log[..., at].argmax()), len(_LEVELS))
        deviation = float(np.sqrt(share @ (_EDGES - edge) ** 2))
        return rise + edge * t.resolution_cells, deviation, top_cells, int(kinds[kind]), _LEVELS[level] * top

    def _possible(self, altitude_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(k,) shapes that an altitude may have, their constants, and factors (a row per shape, level and edge)."""
        extent, top, blur = self._kinds.T
        cells = max(altitude_m, 1.0) / self._cell_m
        doppler_cells = _FASTEST_M_PER_S * float(self.tables.waveform.vertical_speed_to_doppler_hz(1.0))
        doppler_cells *= self.tables.waveform.half_sweep_s
        blurred = blur <= doppler_cells * np.sqrt(2.0 / cells)
        wide = (extent <= max(cells * _MOST_EXTENT, _EXTENTS[0])) & (top <= cells * _MOST_TOP)
        kinds = np.flatnonzero(wide & blurred)
        if not np.array_equal(kinds, self._kept[0]):  # the same from block to block
            self._kept = kinds, self._costs[kinds], self._inverse[kinds].reshape(-1, _WINDOW.size)
        return self._kept

    def _weights(self, power: np.ndarray, edge: float, kind: int, level: float) -> np.ndarray:
        """(J,) a point's response over the ground's, from before the edge to the ground's end; 1 elsewhere."""
        per = self.tables.resolution_cells
        x = (np.arange(power.size) - edge) / per
        ground = np.interp(x, self._x, self._shapes[kind]) * level
        smooth = np.convolve(power, np.ones(round(per)) / round(per), mode="same")
        far = np.nonzero(x > _WINDOW[-1])[0]
        last = power.size
        if far.size:
            ground[far] = smooth[far]
            before = smooth[(x > 0.0) & (x <= _WINDOW[-1])].max()
            most = np.maximum.accumulate(np.r_[before, smooth[far]])[1:]
            least = np.minimum.accumulate(np.r_[before, smooth[far]])[1:]
            ends = far[(smooth[far] < _END * most) | (smooth[far] > _DIP * least)]
            last = ends[0] if ends.size else last
        nearest = x - _BIAS_M / self._cell_m
        point = np.interp(nearest, self._x, self._shapes[0])
        near = np.abs(nearest) <= 0.6
        own = float((ground[near] / point[near]).min())
        weights = (point + 0.5 * _SOFT) / (ground / own + 0.5 * _SOFT)
        weights[(x < -_BEFORE) | (np.arange(power.size) >= last)] = 1.0
        return np.minimum(weights, 1.0)


@lru_cache(maxsize=8)
def _shapes(window: str) -> tuple[np.ndarray, ...]:
    """Distances (X,) from the edge, kinds (K, 3), shapes (K, X); constant (K, V, E) and factor of the likelihood."""
    taps = cosine_window(window, 256)
    x = np.arange(-_REACH * _FINE, _REACH * _FINE + 1) / _FINE
    turns = np.exp(-2j * np.pi * np.outer(x, np.arange(taps.size) / taps.size))
    point = np.abs(turns @ taps / taps.sum()) ** 2
    shapes, kinds = [point], [(0.0, 0.0, 0.0)]
    beyond = (np.arange(24 * _FINE) + 0.5) / _FINE
    for extent in _EXTENTS:
        for top in (top for top in _TOPS if top <= _FARTHEST_TOP * extent):
            for blur in _BLURS:
                shapes.append(np.convolve(_power(beyond, extent, top, blur), point, mode="same"))
                kinds.append((extent, top, blur))
    shapes = np.array([shape / shape[np.abs(x) <= 3.0].max() for shape in shapes])
    at = np.round((_WINDOW - _EDGES[:, None] + _REACH) * _FINE).astype(int)
    model = shapes[:, None, at] * np.array(_LEVELS)[:, None, None]
    model /= model[:, 2:3].max(axis=-1, keepdims=True)
    model += _SOFT
    return x, np.array(kinds), shapes, np.log(model).sum(axis=-1), (1.0 / model).astype(np.float32)


def _power(beyond: np.ndarray, extent: float, top: float, blur: float) -> np.ndarray:
    """Mean power over the range from the nearest point, at the distances of a shape."""
    # b sqrt(u), with the top where its slope cancels that of exp(-u / L)
    z = 2.0 * np.sqrt(top * beyond) / extent
    power = -beyond / extent + z + np.log(i0e(z))
    power = np.exp(power - power.max())
    out = np.zeros(round(2 * _REACH * _FINE) + 1)
    # of all directions on the ground
    for along in np.cos(np.pi * (np.arange(16) + 0.5) / 16) if blur else (0.0,):
        at = np.round((beyond + blur * np.sqrt(beyond) * along + _REACH) * _FINE).astype(int)
        inside = (at >= 0) & (at < out.size)
        out += np.bincount(at[inside], power[inside], out.size)
    return out
