"""The altimeter: CFAR on beat spectra (`beat_spectra.py`), pairing of the sweeps, altitude (docs/design.md).

Of all pairs of cells that the allowed speeds permit, the one of greatest power over noise is the forced decision. It is
declared by the sum over both half sweeps of ``-log P``, with ``P`` the probability that noise alone shows a cell's
power (`Cfar`, `PairSearch`), and if most of the likelihood of all pairs lies within 5 m of it.
"""

from functools import cached_property, lru_cache

import numpy as np
from scipy import fft

from ..spectral_line import peak_curve, peak_offset, sum_level
from ..usual_errors import usual_errors
from ..waveform import Waveform, checked, delay_to_altitude_m
from .altimeter_settings import RESULT_DTYPE, SPEED_M_PER_S, AltimeterSettings, Reason
from .beat_spectra import SHAPE_POINTS, BeatSpectra, Spectra
from .cfar import Cfar, Significance
from .extended_peak import centroid_of, edge_of
from .pair_threshold import pair_threshold, upcrossings
from .sweep_pairing import FLOOR, Found, PairSearch

__all__ = ["Altimeter", "AltimeterSettings", "Reason", "RESULT_DTYPE", "Spectra", "shared_altimeter"]

_CLEAR_DB = 999.0  # greatest ambiguity that is given
# First zero of a window's main lobe, in resolution cells: as many as it has cosine terms.
_FIRST_ZERO = {"boxcar": 1.0, "hann": 2.0, "hamming": 2.0, "blackman": 3.0}
# Error of a right altitude, in m; where a resolution cell is longer than 20 m, a quarter of it
_NEAR_M = 5.0


class Altimeter(BeatSpectra):
    """Frames in, one result each; all tables are made once.

    Examples
    --------
    >>> import numpy as np
    >>> from radalt.core.waveform import Waveform
    >>> from radalt.core.returns.point import point_return
    >>> w = Waveform()
    >>> result = Altimeter(w).process(point_return(w, np.array([200.0])))
    >>> bool(abs(result["altitude_m"][0] - 200.0) < 0.1)
    True
    """

    def __init__(self, waveform: Waveform, settings: AltimeterSettings = AltimeterSettings()) -> None:  # noqa: B008
        settings = settings.resolved(checked(waveform))
        limit_m = waveform.max_unambiguous_altitude_m
        if settings.max_altitude_m > limit_m:
            raise ValueError(
                f"altimeter.max_altitude_m {settings.max_altitude_m:g} exceeds {limit_m:.6g} m, where the delay is "
                "half a half sweep; lengthen sweep_s or lower max_altitude_m"
            )
        super().__init__(waveform, settings)
        self._plan_detection()
        self._searches: dict[tuple[int, int], PairSearch] = {}
        cell_m = float(waveform.beats_to_altitude_m(self.cell_hz, -self.cell_hz))
        self._near = max(_NEAR_M, 0.25 * waveform.range_resolution_m) / cell_m
        named = self.settings.max_vertical_speed_m_per_s
        # allowed where a call names none
        self.frame_speed_m_per_s = SPEED_M_PER_S if named is None else named
        self._search = self._search_within((-self.frame_speed_m_per_s, self.frame_speed_m_per_s))
        self.pair_threshold = self._search.pair_threshold  # on the sum of both half sweeps' significance

    @property
    def false_alarms_per_frame(self) -> float:
        """Bound of the probability that white noise alone gives an altitude."""
        return self.settings.pfa_per_frame

    @property
    def doppler_cells(self) -> int:
        """Cells by which the beats of the two half sweeps of one target may differ, at the greatest speed."""
        return round(2.0 * self.doppler_limit_hz / self.cell_hz)

    def _search_within(self, speeds_m_per_s: tuple[float, float]) -> PairSearch:
        """The search over pairs that an interval of vertical speeds allows."""
        limit = self.speed_limit_m_per_s
        low, high = speeds_m_per_s
        if not -limit <= low <= high <= limit:
            raise ValueError(
                f"vertical_speed_m_per_s is {low:g}..{high:g}; it has to rise and to lie within +/-{limit:g} m/s, "
                "altimeter.max_vertical_speed_m_per_s"
            )
        # up and down cell of one return differ by twice its Doppler, two ramps of one slope not at all
        apart = 2.0 if self.waveform.separates_doppler else 0.0
        doppler = apart * self.waveform.vertical_speed_to_doppler_hz(np.array([low, high])) / self.cell_hz
        least, most = (round(float(cells)) for cells in doppler)
        if (least, most) not in self._searches:
            if len(self._searches) >= 256:
                self._searches.clear()
            partners = (most - least) / self._per_resolution
            s = self.settings
            # number of cells whose altitude `_inside` accepts
            cells = 1.0 + (s.max_altitude_m - s.min_altitude_m) / self.waveform.range_resolution_m
            level, lower = (
                pair_threshold(s.pfa_per_frame, cells, partners, share * self._crossings, FLOOR)
                for share in (1.0, 0.25)  # noise over the whole half sweep, and over a quarter of it
            )
            self._searches[least, most] = PairSearch(
                cfar=self.cfar,
                first=self._first,
                last=self._last,
                apart=(least, most),
                per_resolution=round(self._per_resolution),
                cell_threshold=-float(
                    np.log(s.pfa_per_frame * 0.5 * self._per_resolution / (self._last - self._first))
                ),
                pair_threshold=level,
                spare=(level - lower) / float(np.log(4.0)),
                flank=self._flank,
                side_lobes=self._side_lobes,
                outshining=self.settings.strategy == "strongest",
                near=self._near if self.settings.strategy == "strongest" else None,
            )
        return self._searches[least, most]

    # -- construction ---------------------------------------------------------------------------------------------

    def _plan_detection(self) -> None:
        """Noise law, cells searched, and the shape of a peak."""
        s, shape, step = self.settings, self._shape, self._step
        self._crossings = upcrossings(shape)
        group = max(1, round(self._per_resolution))
        each = (
            self._per_resolution / group
        )  # cells per group, of a resolution cell: 1 unless the size divides unevenly
        turns = np.exp(2j * np.pi * step * np.arange(shape.size))  # by one cell
        self.cfar = Cfar(
            train=max(2, round(s.train_cells * each)),
            guard=max(0, round((s.guard_cells - 0.5) * each)),
            group=group,
            per_resolution=self._per_resolution,
            energy=self._per_resolution * shape.size * float(np.sum(shape**2) / np.sum(shape) ** 2),
            change=1.0 - float(abs(turns @ shape**2 / np.sum(shape**2)) ** 2),
            whole=float(np.sum(shape**2) ** 2 / (shape.size * np.sum(shape**4))),
        )
        margin = self.cfar.margin
        inner = self.beat_hz[margin : self.beat_hz.size - margin]
        allowed = np.nonzero((inner >= self.search_hz[0]) & (inner <= self.search_hz[1]))[0]
        self._first, self._last = int(allowed[0]), int(allowed[-1]) + 1
        self._searched = np.arange(self._first, self._last)
        self.peak_curve = peak_curve(shape, step)
        self._flank, self._side_lobes = self._lobe_limits(shape, step)

    def _lobe_limits(self, window: np.ndarray, step: float) -> tuple[float, np.ndarray]:
        """Power half a resolution cell away that no peak shows; greatest side lobe by distance in cells, 6 dB to spare.

        Both come from the window's own transform. The flank ratio is that of a peak 0.35 resolution cells away. The
        side lobes are a falling envelope, begun a quarter of a resolution cell farther in, since a peak may lie
        between cells. The flank ratio covers the main lobe.
        """
        size = self.beat_hz.size
        fine, per = 8, round(self._per_resolution)  # points a cell, cells a resolution cell
        length = fft.next_fast_len(int(np.ceil(fine / step)))
        lobes = np.abs(fft.fft(window, length)[: fine * size + 1]) ** 2
        lobes = lobes / lobes[0]
        envelope = np.maximum.accumulate(lobes[::-1])[::-1]
        distance = np.arange(size)
        side_lobes = 4.0 * envelope[np.maximum(fine * distance - fine * per // 4, 0)]
        side_lobes[:per] = 0.0
        away = fine * max(1, per // 2)
        at = round(0.7 * away)
        return float(lobes[away - at] / lobes[at]), np.minimum(side_lobes, 1.0 - 1e-6)

    def significance(self, spectra: Spectra) -> Significance:
        """Every cell but the margins held against noise: see `Cfar`."""
        return self.cfar.significance(spectra.power, spectra.support)

    # -- detection ------------------------------------------------------------------------------------------------

    @usual_errors()
    def process(
        self,
        frames: np.ndarray,
        *,
        timing_offset_s: np.ndarray | float = 0.0,
        frame_index: np.ndarray | int | None = None,
        vertical_speed_m_per_s: tuple[float, float] | None = None,
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
        vertical_speed_m_per_s : (float, float), optional
            Least and greatest range rate that these frames can have, known from a track; default
            ``-frame_speed_m_per_s..frame_speed_m_per_s``, at most ``speed_limit_m_per_s`` either way. A narrower
            interval lowers the threshold at equal false alarms and leaves fewer grating lobes that pass for a speed.

        Returns
        -------
        (n,) structured array of RESULT_DTYPE
            Where ``valid`` is false ``reason`` says why and ``altitude_m`` is NaN. Of a sawtooth
            ``vertical_speed_m_per_s`` is NaN, and ``altitude_m`` is that of `Waveform.doppler_lead_s` later.
            ``ambiguity_db`` is the likelihood of the pair of cells over that of the best rival, which has a cell
            beyond the main lobe in at least one half sweep. In white noise the rival is ``10^(ambiguity_db/10)``
            times less likely. ``peak_to_sidelobe_db`` is the power of the forced decision's main lobe over the
            strongest cell next to it, in the range profile: power by altitude, both half sweeps added.

        Raises
        ------
        ValueError
            For frames of another length, or a speed interval whose lower limit exceeds its upper.
        """
        return self.detect(
            self.spectra(frames),
            timing_offset_s=timing_offset_s,
            frame_index=frame_index,
            vertical_speed_m_per_s=vertical_speed_m_per_s,
        )

    def detect(
        self,
        spectra: Spectra,
        *,
        timing_offset_s: np.ndarray | float = 0.0,
        frame_index: np.ndarray | int | None = None,
        vertical_speed_m_per_s: tuple[float, float] | None = None,
    ) -> np.ndarray:
        """As `process`, from given spectra."""
        search = (
            self._search if vertical_speed_m_per_s is None else self._search_within(vertical_speed_m_per_s)
        )
        n = spectra.power.shape[0]
        out = np.zeros(n, dtype=RESULT_DTYPE)
        out["frame_index"] = np.arange(n) if frame_index is None else frame_index
        usable = (spectra.scale > 0) & np.isfinite(spectra.scale)
        cells = self.significance(spectra)
        found = search(spectra.power, cells)
        up, down = self._refine(spectra, found)
        ok = usable & (found.reason == Reason.OK)
        altitude = self._altitude(up, down, timing_offset_s)
        inside = self._inside(altitude)
        if (
            self.settings.strategy == "strongest"
        ):  # of spread ground the edge may lie within, and the peak beyond
            declared = np.nonzero(ok & inside)[0]
            inside[declared] = self.beyond(spectra, declared, least=1.0) < 1.0
        reason = np.where(ok & ~inside, Reason.OUT_OF_RANGE, found.reason)
        ok &= inside
        out["altitude_m"] = out["forced_altitude_m"] = altitude
        first, second = self.waveform.half_slopes
        out["beat_up_hz"], out["beat_down_hz"] = first * up, second * down
        out["vertical_speed_m_per_s"] = (
            self.waveform.beats_to_vertical_speed_m_per_s(up, -down) if first != second else np.nan
        )
        ratio = found.around[..., 1] / found.noise
        with np.errstate(divide="ignore", invalid="ignore"):
            out["snr_db"] = 10.0 * np.log10(0.5 * (ratio[:, 0] + ratio[:, 1]), dtype=float)
            out["peak_to_sidelobe_db"] = self._peak_to_sidelobe_db(spectra.power, found.pair)
        out["ambiguity_db"] = np.minimum(10.0 / np.log(10.0) * found.lead, _CLEAR_DB)
        if not ok.all():
            reason = np.where(np.isfinite(spectra.scale), reason, Reason.NOT_FINITE)
            reason = np.where(spectra.scale == 0, Reason.NO_SIGNAL, reason)
            for name in ("altitude_m", "vertical_speed_m_per_s", "beat_up_hz", "beat_down_hz", "snr_db"):
                out[name][~ok] = np.nan
            for name in ("forced_altitude_m", "ambiguity_db", "peak_to_sidelobe_db"):
                out[name][~usable] = np.nan
        out["valid"], out["reason"] = ok, reason
        return out

    def confirms(self, received: np.ndarray, cleaned: np.ndarray, pfa: float = 1.0) -> np.ndarray:
        """(n,) bool: what is found in cleaned frames stands out in the received frames too, or nothing is found.

        In both half sweeps the received spectrum has to exceed twice its own noise there, and to be within 9 dB of
        its own strongest cell. That is more than a first side lobe and less than the loss by interference. A peak
        beyond the span of altitudes is not confirmed, and neither is one that is no return (`Reason`): an altimeter
        with another span or other cells would find something else.

        With a ``pfa`` below 1 the probability that noise alone shows both received cells as strong must not exceed
        it, and whatever an altimeter of any allowed speed could declare counts as found. The altimeter's own
        threshold relies on independent half sweeps; a filter that keeps its weights from one to the other gives both
        the same delay.
        """
        spectra = self.spectra(cleaned)
        after = self.significance(spectra)
        limit = self.speed_limit_m_per_s  # calls that name a speed allow as much
        found = self._search_within((-limit, limit))(spectra.power, after)
        declared = np.isin(found.reason, (Reason.OK, Reason.AMBIGUOUS))
        nothing = found.reason == Reason.NO_DETECTION
        if pfa < 1.0:
            still = self._search_within((0.0, 0.0))
            there = nothing & (_joint(after, found.pair) >= still.threshold(after))
            declared, nothing = declared | there, nothing & ~there
        at = np.flatnonzero(declared)
        if not at.size:
            return nothing
        pair = found.pair[at]
        raw = self.spectra(received[at])
        before = self.significance(raw)
        power = np.take_along_axis(raw.power, (pair + self.cfar.margin)[..., None], axis=-1)[..., 0]
        noise = np.take_along_axis(before.noise, pair[..., None], axis=-1)[..., 0]
        strong = ((power > 2.0 * noise) & (power > raw.power.max(axis=-1) / 8.0)).all(axis=-1)
        strong &= _joint(before, pair) + before.uncounted >= sum_level(pfa, 2)
        beats = self.beat_hz[pair + self.cfar.margin]
        nothing[at] = strong & self._inside(self._altitude(beats[:, 0], beats[:, 1], 0.0))
        return nothing

    def _inside(self, altitude_m: np.ndarray) -> np.ndarray:
        """Whether altitudes lie within the span, half a resolution cell over either end included."""
        half_cell = 0.5 * self.waveform.range_resolution_m
        return (altitude_m >= self.settings.min_altitude_m - half_cell) & (
            altitude_m <= self.settings.max_altitude_m + half_cell
        )

    def _altitude(self, up_hz: np.ndarray, down_hz: np.ndarray, offset_s: np.ndarray | float) -> np.ndarray:
        return self.waveform.beats_to_altitude_m(up_hz, -down_hz) - delay_to_altitude_m(offset_s)

    def _peak_to_sidelobe_db(self, power: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """(n,) main lobe, to its first zeros, over the strongest cell next to it, in the range profile."""
        margin = self.cfar.margin
        power = power[..., margin + self._first : margin + self._last]
        profile = power[:, 0] + power[:, 1]
        apart = np.abs(self._searched - 0.5 * (pair[:, :1] + pair[:, 1:]))
        inside = apart <= _FIRST_ZERO[self.settings.window] * self._per_resolution
        main = np.where(inside, profile, 0.0).max(axis=1)
        others = np.where(inside, 0.0, profile).max(axis=1)
        ratio_db = 10.0 * np.log10(main / others, dtype=float)
        return np.minimum(np.maximum(ratio_db, -_CLEAR_DB), _CLEAR_DB)

    def _refine(self, spectra: Spectra, found: Found) -> tuple[np.ndarray, np.ndarray]:
        """Sub-cell beats (up, down) in hertz by the strategy."""
        if self.settings.strategy == "strongest":
            beats = self._interpolate(found)
        elif self.settings.strategy == "centroid":
            beats = self._centroid(spectra, self._tops(spectra, found.pair))
        else:
            beats = self._leading_edge(spectra, self._tops(spectra, found.pair))
        return beats[:, 0], beats[:, 1]

    def _interpolate(self, found: Found) -> np.ndarray:
        """(n, 2) beats of greatest likelihood: each half sweep's own peak, or both moved together.

        Where one of them is broad its peak says little, and the mean of the likelihood is taken (`Found.mean`). They
        are moved together where one alone is no peak, weighted by their signal over noise. Two peaks are each
        measured where they are, even if they lie farther apart than the allowed speeds permit. Their mean is the
        altitude at any speed; a weighted sum would follow the clearer one and be wrong by the unexpected speed.
        """
        pair, around = found.pair, found.around
        own = peak_offset(around, self.peak_curve)
        peaks = (np.abs(own) < self.peak_curve[1][-1]).all(axis=1)
        if not peaks.all():
            both = (around / found.noise[..., None]).sum(axis=1)
            own = np.where(peaks[:, None], own, peak_offset(both, self.peak_curve)[:, None])
        cells = np.where(np.isnan(found.mean), pair + own, found.mean)
        return self.beat_hz[self.cfar.margin] + self.cell_hz * cells

    def _tops(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) the strongest cells within a resolution cell of a pair: an extended return is no tone."""
        reach = round(self._per_resolution)
        rows, halves = np.arange(len(pair))[:, None, None], np.arange(2)[:, None]
        steps = np.arange(-reach, reach + 1)
        near = np.clip(pair[..., None] + steps, self._first, self._last - 1)
        top = spectra.power[rows, halves, near + self.cfar.margin].argmax(axis=-1)
        return np.take_along_axis(near, top[..., None], axis=-1)[..., 0]

    def _centroid(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) power centroids over the cells around the peak that stay above a tenth of it."""
        cells = pair + self.cfar.margin
        centres = [centroid_of(spectra.power[at], int(cell)) for at, cell in np.ndenumerate(cells)]
        return self.beat_hz[0] + self.cell_hz * np.reshape(centres, cells.shape)

    def _leading_edge(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) beats of the nearest target on the rise of the cluster that holds the peak."""
        lobes, distance = self._main_lobes
        cells = pair + self.cfar.margin
        rows, halves = np.arange(len(pair))[:, None, None], np.arange(2)[:, None]
        around = spectra.power[rows, halves, cells[..., None] + np.arange(-1, 2)]
        # at most half a cell from the nearer one
        straddle = np.minimum(np.abs(peak_offset(around, self.peak_curve)), 0.5)
        most = self._blind_samples(self.beat_hz[-1])
        blind = self._blind_samples(self.beat_hz[cells]) / most if most > 0 else np.zeros(cells.shape)
        edges = np.empty(cells.shape)
        for at, cell in np.ndenumerate(cells):
            power = lobes[0] + blind[at] * (lobes[1] - lobes[0])
            loss = np.interp(straddle[at], distance[::-1], power[::-1])  # straddling loss
            row = spectra.power[at]
            edges[at] = edge_of(row, int(cell), float(row[cell] / loss), (power, distance))
        return self.beat_hz[0] + self.cell_hz * edges

    @cached_property
    def _main_lobes(self) -> tuple[np.ndarray, np.ndarray]:
        """Main lobe of a point target down to a tenth of its power, without a blind part and with the longest one."""
        half = min(self.waveform.samples_per_half, SHAPE_POINTS)
        blind = float(self._blind_samples(self.beat_hz[-1])) / self.waveform.samples_per_half
        windows = np.stack([self._window(half)] * 2, axis=-1)
        windows[: int(np.ceil(blind * half)), 1] = 0.0
        distance = np.linspace(0, 12, 1201)
        step = self.cell_hz * self.waveform.half_sweep_s / half
        lobes = np.abs(np.exp(-2j * np.pi * step * np.outer(distance, np.arange(half))) @ windows).T ** 2
        lobes /= lobes[:, :1]
        keep = slice(0, int(np.argmax((lobes < 0.1).any(axis=0))))
        return lobes[:, keep][:, ::-1], distance[keep][::-1]


def _joint(cells: Significance, pair: np.ndarray) -> np.ndarray:
    """(n,) joint significance of pairs (n, 2), each half by the strongest of a cell and its neighbours."""
    near = np.clip(pair[..., None] + np.arange(-1, 2), 0, cells.value.shape[-1] - 1)
    return np.take_along_axis(cells.value, near, axis=-1).max(axis=-1).sum(axis=-1)


@lru_cache(maxsize=64)
def shared_altimeter(waveform: Waveform, settings: AltimeterSettings) -> Altimeter:
    """One altimeter for all callers with the same sweep and settings: it has tables, but no state."""
    return Altimeter(waveform, settings)
