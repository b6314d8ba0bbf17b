"""The altimeter: dechirp, decimate to the beat band, window, FFT, CFAR, pair the sweeps, altitude (DESIGN.md 3).

Two rates, as in the paper: the frame is mixed with the reference at the full rate, then low-passed and decimated to
the beat band of the highest altitude of the scene. The window is folded into the reference table, and so is the shift
that moves the middle of the beat band to zero, so mixing costs one complex multiplication a sample.

Both half sweeps are turned so that an altitude shows as a *positive* beat: cells of the up sweep lie at
``k tau + f_D``, cells of the down sweep at ``k tau - f_D``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft, signal

from .cfar import Cfar, cell_correlation
from .waveform import Waveform, delay_to_altitude_m

__all__ = ["Altimeter", "AltimeterSettings", "Reason", "RESULT_DTYPE", "Spectra"]

STRATEGIES = ("strongest", "leading_edge", "centroid")
_FLOOR = 3.0  # power over noise that each half sweep has to show on its own for the two to agree
_OVERSAMPLING = (
    2.0  # spectral cells a resolution cell: keeps the straddling loss of a Hann window below 0.4 dB
)


class Reason:
    """Why a frame has or has no altitude; the values of the ``reason`` field."""

    OK = 0
    NO_DETECTION = 1
    SWEEPS_DISAGREE = 2
    NOT_FINITE = 3
    NO_SIGNAL = 4
    UNLOCKED = 5
    OUT_OF_RANGE = 6

    NAMES = ("ok", "no_detection", "sweeps_disagree", "not_finite", "no_signal", "unlocked", "out_of_range")


RESULT_DTYPE = np.dtype(
    [
        ("frame_index", np.int64),
        ("valid", np.bool_),
        ("reason", np.int8),
        ("altitude_m", np.float64),
        ("vertical_speed_m_per_s", np.float64),
        ("beat_up_hz", np.float64),
        ("beat_down_hz", np.float64),
        ("snr_db", np.float64),
        ("forced_altitude_m", np.float64),
    ]
)


@dataclass(frozen=True)
class AltimeterSettings:
    """How the altimeter looks for a return.

    Parameters
    ----------
    max_altitude_m, min_altitude_m : float
        Search span; the beat band, the decimation and the FFT size follow from it.
    max_vertical_speed_m_per_s : float
        Largest range rate: how far the two sweeps' beats may differ and still be one target.
    window : str
        ``"boxcar"`` (default), ``"hann"``, ``"hamming"`` or ``"blackman"``, over each half sweep. A taper lowers side
        lobes but weights the middle of the sweep, where an interferer at the radar's centre sits: a Hann window costs
        5.6 dB against one there, and a factor 1.6 in error.
    pfa : float
        False-alarm probability of one cell.
    cfar : str
        ``"ca"`` or ``"os"``.
    train_cells, guard_cells : float
        Training and guard on each side, in resolution cells (2 kHz, 20 m by default).
    strategy : str
        ``"strongest"`` point target; ``"leading_edge"`` nearest edge of an extended return, the -6 dB point of the
        rise, corrected so that a point target is unbiased; ``"centroid"`` power centroid.
    """

    max_altitude_m: float = 1500.0
    min_altitude_m: float = 0.0
    max_vertical_speed_m_per_s: float = 150.0
    window: str = "boxcar"
    pfa: float = 1e-4
    cfar: str = "ca"
    train_cells: float = 16.0
    guard_cells: float = 3.0
    strategy: str = "strongest"

    def __post_init__(self) -> None:
        if not self.max_altitude_m > self.min_altitude_m:
            raise ValueError(
                f"altimeter.max_altitude_m {self.max_altitude_m:g} has to be above min_altitude_m "
                f"{self.min_altitude_m:g}"
            )
        if self.strategy not in STRATEGIES:
            raise ValueError(f"altimeter.strategy is {self.strategy!r}; allowed: {', '.join(STRATEGIES)}")
        if self.window not in ("hann", "hamming", "blackman", "boxcar"):
            raise ValueError(f"altimeter.window is {self.window!r}; allowed: hann, hamming, blackman, boxcar")
        if self.max_vertical_speed_m_per_s < 0:
            raise ValueError(
                f"altimeter.max_vertical_speed_m_per_s is {self.max_vertical_speed_m_per_s:g}; it has to be 0 or more"
            )


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
        self.joint_scale = self.cfar.joint_scale(_FLOOR)

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
        # transition band as wide as the pass band keeps the filter near 4 taps a phase
        self.decimation = max(1, int(w.rate_hz / (2.0 * width)))
        self.decimated_rate_hz = w.rate_hz / self.decimation
        self.taps = self._lowpass(width)
        outputs = -(-(w.samples_per_half + self.taps.size - 1) // self.decimation)
        self.outputs = outputs
        self.fft_size = fft.next_fast_len(
            max(outputs, int(np.ceil(_OVERSAMPLING * w.samples_per_half / self.decimation)))
        )
        self.cell_hz = self.decimated_rate_hz / self.fft_size
        reach = min(int(width / 2 / self.cell_hz), (self.fft_size - 1) // 2)
        self._bins = np.arange(-reach, reach + 1)
        self.beat_hz = self.centre_hz + self._bins * self.cell_hz

    def _lowpass(self, width_hz: float) -> np.ndarray:
        """Decimation filter: flat over the beat band, aliases 80 dB down."""
        if self.decimation == 1:
            return np.ones(1)
        nyquist = self.waveform.rate_hz / 2
        stop = self.decimated_rate_hz - width_hz / 2
        count, beta = signal.kaiserord(80.0, (stop - width_hz / 2) / nyquist)
        return signal.firwin(count | 1, 0.5 * (stop + width_hz / 2) / nyquist, window=("kaiser", beta))

    def _build_tables(self) -> None:
        w, s = self.waveform, self.settings
        half = w.samples_per_half
        window = signal.get_window(s.window, half, fftbins=False)
        t = w.sample_times_s[:half]
        # up: conj(rx) ref has the beat at +(k tau + f_D); its spectrum is the mirror of rx conj(ref), so both halves
        # mix with conj(ref) and the up half is shifted by +centre (and read backwards), the down half by -centre
        table = np.conj(w.reference.astype(np.complex128)).reshape(2, half)
        turn = np.exp(2j * np.pi * self.centre_hz * t)
        table = table * np.stack([turn, np.conj(turn)]) * (window / window.sum())
        phases = -(-self.taps.size // self.decimation)
        self._blocks = self.outputs + phases
        self._table = np.zeros((2, half), dtype=np.complex64)
        self._table[:] = table
        taps = np.zeros(phases * self.decimation)
        taps[: self.taps.size] = self.taps
        # y[m] = sum_s sum_d taps[s D + d] x[(m - s) D - d ...]: one matrix product over blocks of D samples
        self._polyphase = np.ascontiguousarray(self._polyphase_matrix(taps, phases))
        self._interleaved = np.kron(self._polyphase, np.eye(2, dtype=np.float32))
        response = signal.freqz(self.taps, worN=2 * np.pi * self._bins * self.cell_hz / w.rate_hz)[1]
        self._equaliser = (1.0 / np.abs(response)).astype(np.float32)
        lags = int(np.ceil((2 * s.train_cells + 2 * s.guard_cells + 2) / (self.cell_hz * w.half_sweep_s))) + 1
        correlation = cell_correlation(window, lags, w.rate_hz / self.cell_hz)
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
        self._allowed = (inner >= self.search_hz[0]) & (inner <= self.search_hz[1])
        self._inner_hz = inner
        self._doppler_reach = int(np.ceil(2.0 * self.doppler_limit_hz / self.cell_hz))
        self._interpolation = self._interpolation_table(window)

    def _polyphase_matrix(self, taps: np.ndarray, phases: int) -> np.ndarray:
        """(D, phases) so that block row b times column s contributes to output b + s."""
        d = self.decimation
        # output m covers input samples up to (m + 1) D - 1; tap index = (m + 1) D - 1 - n, n = b D + r
        r = np.arange(d)[:, None]
        s = np.arange(phases)[None, :]
        return taps[np.minimum(s * d + d - 1 - r, taps.size - 1)].astype(np.float32)

    def _interpolation_table(self, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log-power ratio of the two neighbours of a peak cell against the sub-cell offset, exact for one tone."""
        offsets = np.linspace(-0.75, 0.75, 151)
        step = self.cell_hz / self.waveform.rate_hz
        n = np.arange(window.size) - 0.5 * (window.size - 1)
        left = np.abs(np.exp(-2j * np.pi * step * np.outer(-1 - offsets, n)) @ window)
        right = np.abs(np.exp(-2j * np.pi * step * np.outer(1 - offsets, n)) @ window)
        return 2.0 * np.log(right / left), offsets

    # -- spectra --------------------------------------------------------------------------------------------------

    def spectra(self, frames: np.ndarray) -> Spectra:
        """Dechirp, decimate and transform ``(n, N)`` complex frames."""
        w = self.waveform
        frames = np.asarray(frames, dtype=np.complex64)
        if frames.ndim != 2 or frames.shape[1] != w.samples_per_frame:
            raise ValueError(f"frames have shape {frames.shape}; expected (n, {w.samples_per_frame})")
        n = frames.shape[0]
        with np.errstate(invalid="ignore", over="ignore"):
            mixed = self._mix(frames)
            cells = self._transform(mixed, n)
            scale = np.max(np.abs(cells), axis=(1, 2))
            safe = np.where((scale > 0) & np.isfinite(scale), scale, 1.0)
            cells = cells / safe[:, None, None]
            power = cells.real**2 + cells.imag**2
            power *= self._equaliser**2
        return Spectra(power, self.cfar.noise(power), self.beat_hz, scale)

    def _mix(self, frames: np.ndarray) -> np.ndarray:
        """Full-rate mixing into zero-padded blocks of D samples: (n, 2, blocks * D)."""
        half = self.waveform.samples_per_half
        buffer = np.zeros((frames.shape[0], 2, self._blocks * self.decimation), dtype=np.complex64)
        np.multiply(frames.reshape(-1, 2, half), self._table, out=buffer[:, :, :half])
        return buffer

    def _transform(self, mixed: np.ndarray, n: int) -> np.ndarray:
        """(n, 2, J) complex beat cells, both halves with positive beats."""
        if self.decimation == 1:
            low = mixed[:, :, : self.outputs]
        else:
            # a complex sample is two float32 columns, so that real taps stay a real matrix product: one a frame, which
            # keeps a frame's result the same in every batch
            blocks = mixed.view(np.float32).reshape(n, 2 * self._blocks, 2 * self.decimation)
            partial = np.matmul(blocks, self._interleaved).reshape(n, 2, self._blocks, -1, 2)
            low = np.zeros((n, 2, self.outputs, 2), dtype=np.float32)
            for s in range(self._polyphase.shape[1]):
                low[:, :, s:] += partial[:, :, : self.outputs - s, s]
            low = low.view(np.complex64)[..., 0]
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

    def _altitude(self, up_hz: np.ndarray, down_hz: np.ndarray, offset_s: np.ndarray | float) -> np.ndarray:
        return self.waveform.beats_to_altitude_m(up_hz, -down_hz) - delay_to_altitude_m(offset_s)

    def _pair(self, spectra: Spectra) -> tuple[np.ndarray, np.ndarray]:
        """Reason (n,) and cell pair (n, 2) counted from ``margin``; without detection the best pair all the same.

        Up and down cell are tested together, for every difference that Doppler allows: the sum of their ratios to the
        noise against a two-look threshold, each above a floor of its own, so that both sweeps have to show the target.
        """
        margin, reach = self.cfar.margin, self._doppler_reach
        tiny = np.finfo(np.float32).tiny
        ratio = spectra.power[..., margin:-margin] / np.maximum(spectra.noise, tiny)
        ratio = np.where(self._allowed, ratio, 0.0)
        n, _, cells = ratio.shape
        down = np.zeros((n, cells + 2 * reach))
        down[:, reach : reach + cells] = ratio[:, 1]
        down = np.lib.stride_tricks.sliding_window_view(down, 2 * reach + 1, axis=1)
        joint = np.add(ratio[:, 0, :, None], down)
        agreed = (ratio[:, 0, :, None] >= _FLOOR) & (down >= _FLOOR)
        flat = np.where(agreed, joint, 0.0).reshape(n, -1)
        best = np.argmax(flat, axis=1)
        rows = np.arange(n)
        found = flat[rows, best] > self.joint_scale
        forced = np.argmax(joint.reshape(n, -1), axis=1)
        up, shift = np.divmod(np.where(found, best, forced), 2 * reach + 1)
        pair = np.stack([up, np.clip(up + shift - reach, 0, cells - 1)], axis=1)
        single = (ratio > self.cfar_scale).any(axis=-1).all(axis=-1)
        reason = np.where(found, Reason.OK, np.where(single, Reason.SWEEPS_DISAGREE, Reason.NO_DETECTION))
        return reason, pair

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
        return self._over_clusters(spectra, pair, _centroid_of)

    def _leading_edge(self, spectra: Spectra, pair: np.ndarray) -> np.ndarray:
        """(n, 2) beats of the -6 dB point on the rise of the cluster that holds the peak."""
        width = self._main_lobe_6db_cells
        return self._over_clusters(spectra, pair, lambda p, c: _edge_of(p, c) + width)

    def _over_clusters(self, spectra: Spectra, pair: np.ndarray, rule) -> np.ndarray:  # noqa: ANN001
        """Apply a rule (power of one half, peak cell) -> fractional cell to every half of every frame."""
        cells = pair + self.cfar.margin
        out = np.empty(cells.shape)
        for row, halves in enumerate(cells):
            for half, cell in enumerate(halves):
                out[row, half] = rule(spectra.power[row, half], int(cell))
        return self.beat_hz[0] + self.cell_hz * out

    @cached_property
    def _main_lobe_6db_cells(self) -> float:
        """Distance in cells from a point target's peak to its -6 dB point."""
        half = self.waveform.samples_per_half
        window = signal.get_window(self.settings.window, half, fftbins=False)
        cells = np.linspace(0, 6, 601)
        step = self.cell_hz / self.waveform.rate_hz
        lobe = np.abs(np.exp(-2j * np.pi * step * np.outer(cells, np.arange(half))) @ window) ** 2
        return float(cells[np.argmax(lobe < 0.25 * lobe[0])])


def _centroid_of(power: np.ndarray, cell: int) -> float:
    """Power centroid of the run of cells around ``cell`` above a tenth of its power."""
    above = power > 0.1 * power[cell]
    low, high = _run(above, cell)
    weights = power[low : high + 1].astype(float)
    return float(np.dot(weights, np.arange(low, high + 1)) / weights.sum())


def _edge_of(power: np.ndarray, cell: int) -> float:
    """Fractional cell where the rise towards ``cell`` crosses a quarter of its power, nearest edge of the run."""
    level = 0.25 * power[cell]
    low, _ = _run(power > level, cell)
    if low == 0:
        return 0.0
    # interpolate in decibels: the flank of a main lobe is close to a parabola there
    below, above, crossing = np.log(np.maximum([power[low - 1], power[low], level], 1e-37))
    if not above > below:  # a forced decision on a cell without power, or one that is not finite
        return float(low)
    return low - 1 + float((crossing - below) / (above - below))


def _run(mask: np.ndarray, cell: int) -> tuple[int, int]:
    """First and last index of the run of true cells around ``cell``."""
    below = np.nonzero(~mask[:cell])[0]
    above = np.nonzero(~mask[cell:])[0]
    low = int(below[-1]) + 1 if below.size else 0
    high = cell + int(above[0]) - 1 if above.size else mask.size - 1
    return low, high
