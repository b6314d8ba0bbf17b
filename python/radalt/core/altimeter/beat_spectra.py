"""Beat spectra: frames dechirped, decimated to the beat band, windowed and transformed.

Two rates, as in the paper: the frame is mixed with the reference at the full rate, then low-passed and decimated to the
beat band of the highest altitude of the scene. The window is folded into the reference table, and so is the shift that
moves the middle of the beat band to zero, so mixing costs one complex multiplication per sample.

A half sweep begins with the return still on the other slope, for as long as its delay. Every cell leaves that part out,
for exactly the delay that the cell stands for (`BeatSpectra._head_table`).

Both half sweeps are turned so that an altitude shows as a *positive* beat: cells of the up sweep lie at
``k tau + f_D``, cells of the down sweep at ``k tau - f_D``.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ..fir import cosine_window
from ..waveform import Waveform, altitude_to_delay_s
from .altimeter_settings import FASTEST_M_PER_S, AltimeterSettings
from .beyond_span import WEAKEST, BeyondSpan
from .cfar import support_of
from .decimator import Decimator

SHAPE_POINTS = 1 << 15
_CLOSE = 0.01  # cycles that a return may be off its beat's phase at the beginning of a half sweep
# Entries of the table that leaves out each cell's own delay: 8 MB, which costs 30 FFTs a frame.
_LARGEST_HEAD = 1 << 20
_SOFT = 0.05  # singular values below this share of the largest only sharpen the edge of what is left out
# Spectral cells per resolution cell: two lose 0.9 dB to straddling, and next to a grating lobe the decision with it
# (5 MHz NR at -60 dB behind the network: 0.84 of forced altitudes right with two, 1.00 with four).
_OVERSAMPLING = 4.0
# Share of its energy that a frame has left at least where a line beyond the span is found: half a cell off, and by its
# other slope, a line shows less than it has (tests/test_beyond_span.py).
_ROOM = 0.5


@dataclass(frozen=True)
class Spectra:
    """Beat spectra of a batch of frames."""

    power: np.ndarray
    """(n, 2, J) float32: power by half sweep (of a triangle 0 up, 1 down) and cell, of frames divided by
    ``scale``."""
    support: np.ndarray
    """(n, 2) float64: share of each half sweep that its noise lasts for (`support_of`)."""
    beat_hz: np.ndarray
    """(J,) float64: cells' beat frequencies."""
    scale: np.ndarray
    """(n,) float32: largest rail of the decimated beats, by which each frame was divided; 0 or not finite where it is
    unusable."""
    frames: np.ndarray | None = (
        None  # (n, N) complex64: what they are of; None of spectra that are no single frame's
    )
    cells: np.ndarray | None = None  # (n, 2, J) complex64 or None, likewise: roots of power with phase
    quality: np.ndarray | None = None
    """(n,) of `QUALITY_DTYPE` or None: of the received frames, where that is known."""


class BeatSpectra:
    """Tables for one sweep, span of altitudes and limit of speed, made once; ``settings`` are resolved for it."""

    def __init__(self, waveform: Waveform, settings: AltimeterSettings) -> None:
        self.waveform = waveform
        self.settings = settings
        self._plan_band()
        self._build_tables()
        self._beyond_span = BeyondSpan(waveform, settings.max_altitude_m)

    def _plan_band(self) -> None:
        """Beat band, decimation and FFT size from the span of altitudes."""
        w, s = self.waveform, self.settings
        cell_hz = 1.0 / w.half_sweep_s
        named = s.max_vertical_speed_m_per_s
        # the limit for tracks, and for calls that name a speed; a single frame is allowed less
        self.speed_limit_m_per_s = FASTEST_M_PER_S if named is None else named
        self.doppler_limit_hz = float(w.vertical_speed_to_doppler_hz(self.speed_limit_m_per_s))
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
        self._per_resolution = 1.0 / (self.cell_hz * w.half_sweep_s)
        group = max(1, round(self._per_resolution))
        self._bins = np.arange(-reach, reach + 1 - (2 * reach + 1) % group)  # whole groups of the CFAR
        self.beat_hz = self.centre_hz + self._bins * self.cell_hz

    def _build_tables(self) -> None:
        """What frames and spectra are multiplied by."""
        w = self.waveform
        half = w.samples_per_half
        self._head = self._head_table()
        window = self._window(half)
        # the window's transform is taken from at most so many points: beyond that only memory changes
        self._shape = self._window(min(half, SHAPE_POINTS))
        self._step = self.cell_hz * w.half_sweep_s / self._shape.size
        # factor per cell that refers phases to the window's middle; its second and fourth moments, of the spectrum
        middle = (0.5 * half + 0.5 * self.decimator.taps.size) / self.decimation - 1.0
        self._centre = np.exp(2j * np.pi * middle / self.fft_size)
        time = 2.0 * np.pi * ((np.arange(half) + 0.5) / half - 0.5)
        plain = cosine_window(self.settings.window, half)
        self._width = tuple(float(plain @ time**power / plain.sum()) for power in (2, 4))
        t = w.sample_times_s[:half]
        # up: conj(rx) ref has the beat at +(k tau + f_D); its spectrum is the mirror of rx conj(ref), so both halves
        # mix with conj(ref); a rising half is shifted by +centre (and read backwards), a falling one by -centre
        table = np.conj(w.reference.astype(np.complex128)).reshape(2, half)
        turn = np.exp(2j * np.pi * self.centre_hz * t)
        turns = np.stack([turn if slope > 0 else np.conj(turn) for slope in w.half_slopes])
        table = table * turns * (window / window.sum())
        self.mixer = table.astype(np.complex64)
        turns = np.exp(-2j * np.pi * self._bins * self.cell_hz / w.rate_hz)
        response = np.polynomial.polynomial.polyval(turns, self.decimator.taps)
        # equalises power for the filter's response and for the noise that the blind part removes
        energy = np.cumsum(np.concatenate([[0.0], window**2]))
        own = 0.0 if self._head is None else self._blind_samples(self.beat_hz)
        left = 1.0 - np.interp(own, np.arange(half + 1), energy / energy[-1])
        self._equaliser = (1.0 / (left * np.abs(response) ** 2)).astype(np.float32)

    def _window(self, points: int) -> np.ndarray:
        """(points,) window over a half sweep; zero in its blind part where each cell cannot have its own."""
        window = cosine_window(self.settings.window, points)
        if self._head is None:
            blind = self._blind_samples(self.beat_hz[-1]) / self.waveform.samples_per_half
            window[: int(np.ceil(blind * points))] = 0.0
        return window

    def _blind_samples(self, beat_hz: np.ndarray | float) -> np.ndarray:
        """Samples at the beginning of a half sweep in which a return of a beat is far off its beat.

        There it is still on the other slope, and a beat-shifted sweep lies past the edge of the band, where a
        fraction of a sample of latency turns its phase. Either would pull the beat, by up to 0.4 m at 1500 m. In the
        last of these samples the other slope is no more than `_CLOSE` off, and pulls by 2 mm. These samples are kept:
        where interference fills the middle of the sweep, its edges are all that a method leaves.
        """
        w = self.waveform
        limit_s = float(altitude_to_delay_s(self.settings.max_altitude_m))
        delay_s = np.clip(np.asarray(beat_hz) / w.slope_hz_per_s, 0.0, limit_s)
        return np.maximum(delay_s - np.sqrt(_CLOSE / w.slope_hz_per_s), 0.0) * w.rate_hz

    def _head_table(self) -> tuple[slice, slice, np.ndarray] | None:
        """What the blind part adds to each cell: H outputs of a half sweep, K cells, (H, K) complex64 weights.

        Least squares: the outputs' impulse responses, weighted by a column, add up to the cell's own response to the
        samples of its blind part, and to nothing after it. None where the table would be too large: a sweep of many
        cells that is blind for long.
        """
        w, d, taps = self.waveform, self.decimation, self.decimator.taps
        blind = self._blind_samples(self.beat_hz)
        cells = np.nonzero((blind > 0) & (self.beat_hz < self.search_hz[1] + 1.0 / w.half_sweep_s))[0]
        if not cells.size:
            return slice(0), slice(0), np.zeros((0, 0), dtype=np.complex64)
        middle = taps.size // 2
        first = max(0, middle // d - 2)  # before it the filter only rings
        last = min(int(np.ceil((blind.max() + middle) / d)), self.outputs)
        if (last - first) * cells.size > _LARGEST_HEAD:
            return None
        m, n = np.arange(first, last), np.arange(last * d)[:, None]
        tap = (m + 1) * d - 1 - n
        responses = np.where((tap >= 0) & (tap < taps.size), taps[np.clip(tap, 0, taps.size - 1)], 0.0)
        turns = np.exp(-2j * np.pi * m[:, None] * self._bins[cells] / self.fft_size)
        wanted = (responses @ turns) * np.clip(blind[cells] - n, 0.0, 1.0)
        table = np.linalg.lstsq(responses, wanted, rcond=_SOFT)[0]
        return slice(first, last), slice(cells[0], cells[-1] + 1), table.astype(np.complex64)

    def spectra(self, frames: np.ndarray, quality: np.ndarray | None = None) -> Spectra:
        """Dechirp, decimate and transform (n, N) complex frames; ``quality`` is that of `Spectra`."""
        w = self.waveform
        frames = np.asarray(frames, dtype=np.complex64)
        if frames.ndim != 2 or frames.shape[1] != w.samples_per_frame:
            raise ValueError(f"frames have shape {frames.shape}; expected (n, {w.samples_per_frame})")
        with np.errstate(invalid="ignore", over="ignore"):
            low = self.decimator.mix(frames.reshape(-1, 2, w.samples_per_half), self.mixer)
        return self.of_beats(low, frames, quality)

    def of_beats(
        self, low: np.ndarray, frames: np.ndarray | None = None, quality: np.ndarray | None = None
    ) -> Spectra:
        """Transform ``(n, 2, outputs)`` complex64 dechirped, decimated half sweeps, which are overwritten."""
        w = self.waveform
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            rails = low.view(np.float32).reshape(len(low), 2 * low.shape[1] * low.shape[2])
            scale = np.maximum(rails.max(axis=1), -rails.min(axis=1))
            scale[scale < np.finfo(np.float32).tiny] = 0.0  # denormal: no digits left to measure with
            safe = np.where((scale > 0) & np.isfinite(scale), scale, np.float32(1.0))
            rails /= safe[:, None]
            support = support_of(low, w.samples_per_half / self.decimation)
            cells = self._cells(low)
            power = cells.real**2
            power += cells.imag**2
            power *= self._equaliser
        return Spectra(power, support, self.beat_hz, scale, frames, cells, quality)

    def beyond(self, spectra: Spectra, at: np.ndarray, least: float = WEAKEST) -> np.ndarray:
        """(k,) power of the strongest line beyond the span over that within it, of frames at (k,) places; 0 of none.

        As the received frame shows it. Where that hides it, it is searched for in the frame itself, if the energy
        besides its lines within the span leaves room for one of the ``least`` ratio.
        """
        out = np.zeros(len(at))
        if spectra.frames is None:
            return out
        hidden = np.arange(len(at))
        if spectra.quality is not None:
            out[:] = spectra.quality["beyond"][at]
            hidden = np.flatnonzero(np.isnan(out))
        if hidden.size:
            at = at[hidden]
            scale = spectra.scale[at].astype(float) * self.decimation
            within = spectra.power[at].max(axis=-1).sum(axis=-1) * scale**2
            energy = [np.vdot(spectra.frames[k], spectra.frames[k]).real for k in at]
            room = np.array(energy) / self.waveform.samples_per_half > (1.0 + _ROOM * least) * within
            out[hidden] = 0.0
            out[hidden[room]] = np.nan_to_num(self._beyond_span.ratio(spectra.frames[at[room]]))
        return out

    def moments(self, spectra: Spectra) -> np.ndarray:
        """(n, 2, 3) complex, of the strongest line: second moment of its delays about their mean, cell, power.

        The moment is in squared resolution cells, weighted by complex amplitudes: ``w (1 - w) d^2`` of two returns at a
        distance ``d``, the farther one with the share ``w`` of their sum; a point's is zero. From slope and curvature
        of the spectrum at its peak, whose Taylor series has the moments of window and delays as its factors.
        """
        out = np.full((len(spectra.power), 2, 3), np.nan, dtype=complex)
        if spectra.cells is None:
            return out
        at = np.clip(spectra.power.argmax(axis=-1), 1, spectra.beat_hz.size - 2)
        left, here, right = (
            np.take_along_axis(spectra.cells, (at + step)[..., None], axis=-1)[..., 0] * self._centre**step
            for step in (-1, 0, 1)
        )
        step = 1.0 / self._per_resolution
        with np.errstate(invalid="ignore", divide="ignore"):
            slope, bend = (right - left) / here / (2.0 * step), (left - 2.0 * here + right) / here / step**2
        width = 1.0 - self._blind_samples(self.beat_hz[at]) / self.waveform.samples_per_half
        second, fourth = self._width[0] * width**2, self._width[1] * width**4
        bend += second - fourth * step**2 / 12.0  # of the difference for the derivative
        moment = 2.0 * bend / (fourth - second**2) - (slope / second) ** 2
        rising = np.array(self.waveform.half_slopes) > 0
        out[..., 0] = np.where(rising, moment.conj(), moment)  # cells of a rising half are conjugates
        out[..., 1], out[..., 2] = at, np.abs(here) ** 2
        return out

    def _cells(self, low: np.ndarray) -> np.ndarray:
        """(n, 2, J) complex64 beat cells of decimated half sweeps, both with positive beats."""
        padded = np.zeros((len(low), 2, self.fft_size), dtype=np.complex64)
        for half, slope in enumerate(self.waveform.half_slopes):
            if slope > 0:
                np.conjugate(low[:, half], out=padded[:, half, : self.outputs])
            else:
                padded[:, half, : self.outputs] = low[:, half]
        # a product per frame: BLAS rounds differently with the number of rows
        blind = None if self._head is None else padded[..., self._head[0]] @ self._head[2]
        spectrum = fft.fft(padded, axis=-1, overwrite_x=True)
        reach, top = -self._bins[0], self._bins[-1]
        cells = np.empty((len(low), 2, self._bins.size), dtype=np.complex64)
        cells[..., :reach] = spectrum[..., -reach:]
        cells[..., reach:] = spectrum[..., : top + 1]
        if blind is not None:
            cells[..., self._head[1]] -= blind
        return cells
