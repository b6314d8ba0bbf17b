"""The altimeter: dechirp, decimate to the beat band, window, FFT, CFAR, pair the sweeps, altitude (DESIGN.md 3).

Two rates, as in the paper: the frame is mixed with the reference at the full rate, then low-passed and decimated to
the beat band of the highest altitude of the scene. The window is folded into the reference table, and so is the shift
that moves the middle of the beat band to zero, so mixing costs one complex multiplication a sample.

Both half sweeps are turned so that an altitude shows as a *positive* beat: cells of the up sweep lie at
``k tau + f_D``, cells of the down sweep at ``k tau - f_D``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import fft, ndimage, signal

from .altimeter_settings import RESULT_DTYPE, AltimeterSettings, Reason
from .cfar import Cfar, cell_correlation
from .clusters import centroid_of, edge_of
from .decimator import Decimator
from .waveform import Waveform, altitude_to_delay_s, delay_to_altitude_m

__all__ = ["Altimeter", "AltimeterSettings", "Reason", "RESULT_DTYPE", "Spectra", "shared_altimeter"]

_FLOOR = 3.0  # power over noise that each half sweep has to show on its own for the two to agree
_SHAPE_POINTS = 1 << 15
_MOST_BLIND = 0.1  # of a half sweep: what is left out for the other slope, at most
_OVERSAMPLING = (
    2.0  # spectral cells a resolution cell: keeps the straddling loss of a Hann window below 0.4 dB
)
_CLIMB = int(_OVERSAMPLING)  # cells from the best ratio to the peak of power beside it


@dataclass(frozen=True)
class Spectra:
    """Beat spectra of a batch of frames.

    Attributes
    ----------
    power : (n, 2, J) float32
        Power by half sweep (0 up, 1 down) and cell, each frame scaled to unit peak amplitude.
    noise : (n, 2, J - 2 * margin) float64
        CFAR noise estimate; element 0 belongs to cell ``margin``.
    beat_hz : (J,) float64
        Cells' beat frequencies.
    scale : (n,) float32
        Amplitude by which each frame was divided; 0 or not finite where the frame is unusable.
    """

    power: np.ndarray
    noise: np.ndarray
    beat_hz: np.ndarray
    scale: np.ndarray


class Altimeter:
    """Frames in, one result each; all tables are made once.

    Examples
    --------
    >>> import numpy as np
    >>> from radalt.core.waveform import Waveform
    >>> from radalt.core.returns import point_return
    >>> w = Waveform()
    >>> result = Altimeter(w).process(point_return(w, np.array([200.0])))
    >>> bool(abs(result["altitude_m"][0] - 200.0) < 0.1)
    True
    """

    def __init__(self, waveform: Waveform, settings: AltimeterSettings = AltimeterSettings()) -> None:  # noqa: B008
        settings = settings.resolved(waveform)
        limit_m = waveform.max_unambiguous_altitude_m
        if settings.max_altitude_m > limit_m:
            raise ValueError(
                f"altimeter.max_altitude_m {settings.max_altitude_m:g} exceeds {limit_m:.6g} m, where the delay is "
                "half a half sweep; lengthen sweep_s or lower max_altitude_m"
            )
        self.waveform = waveform
        self.settings = settings
        self._plan_band()
        self._build_tables()
        self.cfar_scale = self.cfar.scale()
        self.joint_scale = self.cfar.joint_scale(_FLOOR)  # of one pair of cells
        # a cell is tested with every partner that Doppler allows: their union keeps to pfa
        each = max(1e-12, settings.pfa / (2 * self._doppler_reach + 1))
        self.pair_scale = replace(self.cfar, pfa=each).joint_scale(_FLOOR)

    @property
    def false_alarms_per_frame(self) -> float:
        """Bound of the probability that white noise alone gives an altitude: ``pfa`` times the cells searched."""
        return min(1.0, self.settings.pfa * (self._last - self._first))

    @property
    def doppler_cells(self) -> int:
        """Cells by which the beats of the two half sweeps of one target may differ."""
        return self._doppler_reach

    # -- construction ---------------------------------------------------------------------------------------------

    def _plan_band(self) -> None:
        """Beat band, decimation and FFT size from the span of altitudes."""
        w, s = self.waveform, self.settings
        cell_hz = 1.0 / w.half_sweep_s
        self.doppler_limit_hz = float(w.vertical_speed_to_doppler_hz(s.max_vertical_speed_m_per_s))
        low, high = (float(w.altitude_to_beat_hz(a)) for a in (s.min_altitude_m, s.max_altitude_m))
        slack = self.doppler_limit_hz + cell_hz
        self.search_hz = (low - slack, high + slack)
        margin_hz = (s.train_cells + s.guard_cells + 2) * cell_hz
        low, high = self.search_hz[0] - margin_hz, self.search_hz[1] + margin_hz
        width = min(high - low, w.rate_hz)
        self.centre_hz = 0.5 * (low + high)
        self.decimator = Decimator(w.samples_per_half, w.rate_hz, width)
        self.decimation, self.decimated_rate_hz = self.decimator.factor, self.decimator.rate_out_hz
        self.outputs = outputs = self.decimator.outputs
        self.fft_size = fft.next_fast_len(
            max(outputs, int(np.ceil(_OVERSAMPLING * w.samples_per_half / self.decimation)))
        )
        self.cell_hz = self.decimated_rate_hz / self.fft_size
        reach = min(int(width / 2 / self.cell_hz), (self.fft_size - 1) // 2)
        self._bins = np.arange(-reach, reach + 1)
        self.beat_hz = self.centre_hz + self._bins * self.cell_hz

    def _build_tables(self) -> None:
        w, s = self.waveform, self.settings
        half = w.samples_per_half
        window = self._window(half)
        # the window's transform is taken from at most so many points: beyond that only memory changes
        shape = self._window(min(half, _SHAPE_POINTS))
        step = self.cell_hz * w.half_sweep_s / shape.size
        t = w.sample_times_s[:half]
        # up: conj(rx) ref has the beat at +(k tau + f_D); its spectrum is the mirror of rx conj(ref), so both halves
        # mix with conj(ref) and the up half is shifted by +centre (and read backwards), the down half by -centre
        table = np.conj(w.reference.astype(np.complex128)).reshape(2, half)
        turn = np.exp(2j * np.pi * self.centre_hz * t)
        table = table * np.stack([turn, np.conj(turn)]) * (window / window.sum())
        self._table = table.astype(np.complex64)
        response = signal.freqz(self.decimator.taps, worN=2 * np.pi * self._bins * self.cell_hz / w.rate_hz)[
            1
        ]
        self._equaliser = (1.0 / np.abs(response)).astype(np.float32)
        lags = int(np.ceil((2 * s.train_cells + 2 * s.guard_cells + 2) / (self.cell_hz * w.half_sweep_s))) + 1
        correlation = cell_correlation(shape, lags, 1.0 / step)
        per_cell = 1.0 / (self.cell_hz * w.half_sweep_s)
        self.cfar = Cfar(
            pfa=s.pfa,
            train=max(2, round(s.train_cells * per_cell)),
            guard=round(s.guard_cells * per_cell),
            kind=s.cfar,
            correlation=tuple(correlation),
        )
        margin = self.cfar.margin
        inner = self.beat_hz[margin : self.beat_hz.size - margin]
        allowed = np.nonzero((inner >= self.search_hz[0]) & (inner <= self.search_hz[1]))[0]
        self._first, self._last = int(allowed[0]), int(allowed[-1]) + 1
        # one cell more than Doppler needs: noise moves the peaks of the two halves against each other
        self._doppler_reach = 1 + int(np.ceil(2.0 * self.doppler_limit_hz / self.cell_hz))
        self._interpolation = self._interpolation_table(shape, step)
        self._flank, self._side_lobes = self._lobe_limits(shape, step)

    def _window(self, points: int) -> np.ndarray:
        """(points,) window over a half sweep, zero for the delay of the highest altitude at its start.

        For so long a return is still on the other slope, and a beat-shifted sweep lies past the edge of the band, where
        a fraction of a sample of latency turns its phase. Either would pull the beat, by up to half a metre at 1500 m;
        leaving it out costs 2 % of the samples there.
        """
        window = signal.get_window(self.settings.window, points, fftbins=False)
        blind = float(altitude_to_delay_s(self.settings.max_altitude_m)) / self.waveform.half_sweep_s
        window[: int(np.ceil(min(blind, _MOST_BLIND) * points))] = 0.0
        return window

    def _interpolation_table(self, window: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Log-power ratio of the two neighbours of a peak cell against the sub-cell offset, exact for one tone."""
        offsets = np.linspace(-0.75, 0.75, 151)
        n = np.arange(window.size) - 0.5 * (window.size - 1)
        left = np.abs(np.exp(-2j * np.pi * step * np.outer(-1 - offsets, n)) @ window)
        right = np.abs(np.exp(-2j * np.pi * step * np.outer(1 - offsets, n)) @ window)
        return 2.0 * np.log(right / left), offsets

    def _lobe_limits(self, window: np.ndarray, step: float) -> tuple[float, np.ndarray]:
        """Neighbour-to-cell power that no peak shows; greatest side lobe by distance in cells, with 6 dB to spare.

        Both from the window's own transform: the flank ratio at the reach of the interpolation table, the side lobes as
        a falling envelope from half a cell inside (a peak may lie between cells); the main lobe is left to the flank.
        """
        size = self.beat_hz.size
        fine = 8  # points a cell
        length = fft.next_fast_len(int(np.ceil(fine / step)))
        lobes = np.abs(fft.fft(window, length)[: fine * size + 1]) ** 2
        lobes = lobes / lobes[0]
        envelope = np.maximum.accumulate(lobes[::-1])[::-1]
        distance = np.arange(size)
        side_lobes = 4.0 * envelope[np.maximum(fine * distance - fine // 2, 0)]
        side_lobes[:2] = 0.0
        at = round(0.7 * fine)
        return float(lobes[fine - at] / lobes[at]), np.minimum(side_lobes, 1.0 - 1e-6)

    # -- spectra --------------------------------------------------------------------------------------------------

    def spectra(self, frames: np.ndarray) -> Spectra:
        """Dechirp, decimate and transform ``(n, N)`` complex frames."""
        w = self.waveform
        frames = np.asarray(frames, dtype=np.complex64)
        if frames.ndim != 2 or frames.shape[1] != w.samples_per_frame:
            raise ValueError(f"frames have shape {frames.shape}; expected (n, {w.samples_per_frame})")
        with np.errstate(invalid="ignore", over="ignore"):
            cells = self._cells(frames)
            scale = np.max(np.abs(cells), axis=(1, 2))
            scale[scale < np.finfo(np.float32).tiny] = 0.0  # denormal: no digits left to measure with
            safe = np.where((scale > 0) & np.isfinite(scale), scale, np.float32(1.0))
            cells = cells / safe[:, None, None]
            power = cells.real**2 + cells.imag**2
            power *= self._equaliser**2
        return Spectra(power, self.cfar.noise(power), self.beat_hz, scale)

    def _cells(self, frames: np.ndarray) -> np.ndarray:
        """(n, 2, J) complex64 beat cells of (n, N) frames, both halves with positive beats."""
        n, half = frames.shape[0], self.waveform.samples_per_half
        buffer, samples = self.decimator.buffer((n, 2))
        np.multiply(frames.reshape(n, 2, half), self._table, out=samples[..., :half])
        low = self.decimator.apply(buffer)
        spectrum = fft.fft(low, self.fft_size, axis=-1)
        cells = np.empty((n, 2, self._bins.size), dtype=np.complex64)
        cells[:, 0] = spectrum[:, 0, -self._bins]  # the up half, mirrored
        cells[:, 1] = spectrum[:, 1, self._bins]
        return cells

    # -- detection ------------------------------------------------------------------------------------------------

    def process(
        self,
        frames: np.ndarray,
        *,
        timing_offset_s: np.ndarray | float = 0.0,
        frame_index: np.ndarray | int | None = None,
    ) -> np.ndarray:
        """Results of a batch of frames.

        Parameters
        ----------
        frames : (n, N) complex
            Frames aligned with the sweep.
        timing_offset_s : (n,) or scalar
            Delay of the frame's start against the sweep's, in seconds (fraction left by the segmenter plus the
            calibrated hardware delay): subtracted from the measured delay.
        frame_index : (n,) int, optional
            Copied into the results; default 0, 1, ...

        Returns
        -------
        (n,) structured array of `RESULT_DTYPE`; where ``valid`` is false ``reason`` says why and ``altitude_m`` is NaN.
        """
        return self.detect(self.spectra(frames), timing_offset_s=timing_offset_s, frame_index=frame_index)

    def detect(
        self,
        spectra: Spectra,
        *,
        timing_offset_s: np.ndarray | float = 0.0,
        frame_index: np.ndarray | int | None = None,
    ) -> np.ndarray:
        """As `process`, from spectra that are already there."""
        n = spectra.power.shape[0]
        out = np.zeros(n, dtype=RESULT_DTYPE)
        out["frame_index"] = np.arange(n) if frame_index is None else frame_index
        usable = (spectra.scale > 0) & np.isfinite(spectra.scale)
        reason, pair = self._pair(spectra)
        up, down = self._refine(spectra, pair)
        ok = usable & (reason == Reason.OK)
        altitude = self._altitude(up, down, timing_offset_s)
        speed = self.waveform.beats_to_vertical_speed_m_per_s(up, -down)
        half_cell = 0.5 * self.waveform.range_resolution_m
        inside = (altitude >= self.settings.min_altitude_m - half_cell) & (
            altitude <= self.settings.max_altitude_m + half_cell
        )
        reason = np.where(ok & ~inside, Reason.OUT_OF_RANGE, reason)
        reason = np.where(np.isfinite(spectra.scale), reason, Reason.NOT_FINITE)
        reason = np.where(spectra.scale == 0, Reason.NO_SIGNAL, reason)
        ok &= inside
        out["valid"], out["reason"] = ok, reason
        out["altitude_m"] = np.where(ok, altitude, np.nan)
        out["vertical_speed_m_per_s"] = np.where(ok, speed, np.nan)
        out["beat_up_hz"] = np.where(ok, up, np.nan)
        out["beat_down_hz"] = np.where(ok, -down, np.nan)
        out["snr_db"] = np.where(ok, self._snr_db(spectra, pair), np.nan)
        out["forced_altitude_m"] = np.where(usable, altitude, np.nan)
        return out

    def confirms(self, received: np.ndarray, cleaned: np.ndarray) -> np.ndarray:
        """(n,) bool: what is found in cleaned frames stands out in the frames they were made from, or nothing is found.

        In both half sweeps the received spectrum has to exceed twice its own noise there, and to be within 9 dB of its
        own strongest cell: more than a first side lobe, less than the loss by interference.
        """
        raw, clean = self.spectra(received), self.spectra(cleaned)
        reason, pair = self._pair(clean)
        power = np.take_along_axis(raw.power, (pair + self.cfar.margin)[..., None], axis=-1)[..., 0]
        noise = np.take_along_axis(raw.noise, pair[..., None], axis=-1)[..., 0]
        strong = (power > 2.0 * noise) & (power > raw.power.max(axis=-1) / 8.0)
        return strong.all(axis=-1) | (reason != Reason.OK)

    def _altitude(self, up_hz: np.ndarray, down_hz: np.ndarray, offset_s: np.ndarray | float) -> np.ndarray:
        return self.waveform.beats_to_altitude_m(up_hz, -down_hz) - delay_to_altitude_m(offset_s)

    def _pair(self, spectra: Spectra) -> tuple[np.ndarray, np.ndarray]:
        """Reason (n,) and cell pair (n, 2) counted from ``margin``; without detection the best pair all the same.

        Up and down cell are tested together, for every difference that Doppler allows: the sum of their ratios to the
        noise against a two-look threshold, each above a floor of its own, so that both sweeps have to show the target.
        """
        first, last, margin = self._first, self._last, self.cfar.margin
        noise = np.maximum(spectra.noise[..., first:last], np.finfo(np.float32).tiny)
        ratio = spectra.power[..., margin + first : margin + last] / noise
        pair, joint = self._best_pair(np.where(ratio >= _FLOOR, ratio, -np.inf))
        found = joint > self.pair_scale
        if not found.all():
            missed = ~found
            pair[missed] = self._best_pair(ratio[missed])[0]
        single = (ratio > self.cfar_scale).any(axis=-1).all(axis=-1)
        reason = np.where(found, Reason.OK, np.where(single, Reason.SWEEPS_DISAGREE, Reason.NO_DETECTION))
        pair += first
        around = self._climb(spectra.power, pair)
        cut, beyond = self._on_flank(around, pair)
        side_lobe, outshone = self._outshone(spectra.power, pair)
        reason[found & (cut | side_lobe)] = Reason.SWEEPS_DISAGREE
        reason[found & (beyond | outshone)] = Reason.OUT_OF_RANGE
        return reason, pair

    def _best_pair(self, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2) up and down cell with the greatest sum of ratios (n, 2, cells) within Doppler's reach, and the sum."""
        reach, cells = self._doppler_reach, ratio.shape[-1]
        up, down = ratio[:, 0], ratio[:, 1]
        near = ndimage.maximum_filter1d(down, 2 * reach + 1, axis=-1, mode="constant", cval=-np.inf)
        joint = up + near
        cell = np.argmax(joint, axis=-1)
        rows = np.arange(len(cell))
        window = np.clip(cell[:, None] + np.arange(-reach, reach + 1), 0, cells - 1)
        partner = window[rows, np.argmax(down[rows[:, None], window], axis=-1)]
        return np.stack([cell, partner], axis=1), joint[rows, cell]

    def _climb(self, power: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Climb in place to the top of power within a resolution cell, as far as span and Doppler's reach allow.

        Side lobes of a strong return in the training cells tilt the ratio to the noise, whose largest cell then lies
        beside the peak, where interpolation has no say. Only upwards, never across a valley: a return whose band was
        notched has side lobes as high as its peak within that distance. Returns (n, 2, 3) powers around the cells.
        """
        rows, halves = np.arange(len(pair))[:, None, None], np.arange(2)[None, :, None]
        steps = np.arange(-_CLIMB - 1, _CLIMB + 2)
        cells = np.clip(pair[..., None] + (self.cfar.margin + steps), 0, power.shape[-1] - 1)
        wide = power[rows, halves, cells]
        rise = np.diff(wide[..., 1:-1], axis=-1)
        right = np.logical_and.accumulate(rise[..., _CLIMB:] > 0, axis=-1).sum(axis=-1)
        left = np.logical_and.accumulate(rise[..., _CLIMB - 1 :: -1] < 0, axis=-1).sum(axis=-1)
        ends = np.stack([_CLIMB + 1 + right, _CLIMB + 1 - left], axis=-1)
        higher = np.argmax(np.take_along_axis(wide, ends, axis=-1), axis=-1)
        step = np.where(higher == 0, right, -left)
        moved = pair + step
        inside = (moved >= self._first) & (moved < self._last)
        reached = np.abs(moved[:, 0] - moved[:, 1]) <= self._doppler_reach
        step *= (inside.all(axis=1) & reached)[:, None]
        pair += step
        return np.take_along_axis(wide, (step + _CLIMB)[..., None] + np.arange(3), axis=-1)

    def _on_flank(self, around: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) flags: the search ended on the flank of a peak beyond Doppler's reach; beyond the span of altitudes."""
        lower, here, upper = np.moveaxis(around, -1, 0)
        flank = np.maximum(lower, upper) > self._flank * here
        edge = ((pair <= self._first) & (lower > upper)) | ((pair >= self._last - 1) & (upper > lower))
        return (flank & ~edge).any(axis=1), (flank & edge).any(axis=1)

    def _outshone(self, power: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) flags by the strongest cell of each half sweep: a cell is no more than its side lobe; it is the return.

        The latter where it lies beyond the span of altitudes in both half sweeps, 10 dB above the cells found.
        """
        rows, halves = np.arange(len(pair))[:, None], np.arange(2)[None, :]
        cell = pair + self.cfar.margin
        strongest = np.argmax(power, axis=-1)
        here, top = power[rows, halves, cell], power[rows, halves, strongest]
        side_lobe = here <= self._side_lobes[np.abs(strongest - cell)] * top
        outside = (strongest < self.cfar.margin + self._first) | (strongest >= self.cfar.margin + self._last)
        beyond = outside & (top > 10.0 * here)
        return side_lobe.any(axis=1), beyond.all(axis=1) & (self.settings.strategy == "strongest")

    def _snr_db(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """Peak over CFAR noise in the beat spectrum, mean of both halves, in decibels."""
        rows, halves = np.arange(pair.shape[0])[:, None], np.arange(2)[None, :]
        peak = spectra.power[rows, halves, pair + self.cfar.margin]
        noise = spectra.noise[rows, halves, pair]
        with np.errstate(divide="ignore", invalid="ignore"):
            return 10.0 * np.log10(np.mean(peak / np.maximum(noise, 1e-30), axis=1))

    def _refine(self, spectra: Spectra, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sub-cell beats (up, down) in hertz by the strategy."""
        if self.settings.strategy == "strongest":
            beats = self._interpolate(spectra, pair)
        elif self.settings.strategy == "centroid":
            beats = self._centroid(spectra, pair)
        else:
            beats = self._leading_edge(spectra, pair)
        return beats[:, 0], beats[:, 1]

    def _interpolate(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) beats from the ratio of a peak's neighbours."""
        rows, halves = np.arange(pair.shape[0])[:, None], np.arange(2)[None, :]
        cell = pair + self.cfar.margin
        tiny = np.float32(1e-37)
        left = np.maximum(spectra.power[rows, halves, cell - 1], tiny)
        right = np.maximum(spectra.power[rows, halves, cell + 1], tiny)
        ratio, offsets = self._interpolation
        return self.beat_hz[cell] + self.cell_hz * np.interp(np.log(right / left), ratio, offsets)

    def _centroid(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) power centroids over the cells around the peak that stay above a tenth of it."""
        return self._over_clusters(spectra, pair, centroid_of)

    def _leading_edge(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) beats of the nearest target on the rise of the cluster that holds the peak."""
        power, distance = self._main_lobe
        cells = pair + self.cfar.margin
        straddle = np.abs(self._interpolate(spectra, pair) - self.beat_hz[cells]) / self.cell_hz
        # what a peak between two cells loses, at most half a cell from the nearer one
        loss = np.interp(np.minimum(straddle, 0.5), distance[::-1], power[::-1])
        edges = np.empty(cells.shape)
        for at, cell in np.ndenumerate(cells):
            row = spectra.power[at]
            edges[at] = edge_of(row, int(cell), float(row[cell] / loss[at]), self._main_lobe)
        return self.beat_hz[0] + self.cell_hz * edges

    def _over_clusters(self, spectra: Spectra, pair: np.ndarray, rule) -> np.ndarray:  # noqa: ANN001
        """Apply a rule (power of one half, peak cell) -> fractional cell to every half of every frame."""
        cells = pair + self.cfar.margin
        out = np.empty(cells.shape)
        for row, halves in enumerate(cells):
            for half, cell in enumerate(halves):
                out[row, half] = rule(spectra.power[row, half], int(cell))
        return self.beat_hz[0] + self.cell_hz * out

    @cached_property
    def _main_lobe(self) -> tuple[np.ndarray, np.ndarray]:
        """Main lobe of a point target down to a tenth: relative power, rising, and distance from its peak in cells."""
        half = min(self.waveform.samples_per_half, _SHAPE_POINTS)
        window = self._window(half)
        distance = np.linspace(0, 6, 601)
        step = self.cell_hz * self.waveform.half_sweep_s / half
        lobe = np.abs(np.exp(-2j * np.pi * step * np.outer(distance, np.arange(half))) @ window) ** 2
        lobe /= lobe[0]
        keep = slice(0, int(np.argmax(lobe < 0.1)))
        return lobe[keep][::-1], distance[keep][::-1]


@lru_cache(maxsize=16)
def shared_altimeter(waveform: Waveform, settings: AltimeterSettings) -> Altimeter:
    """One altimeter for all who measure the same sweep in the same way: it has tables, but no state."""
    return Altimeter(waveform, settings)
