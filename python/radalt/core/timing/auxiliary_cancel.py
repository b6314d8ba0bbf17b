"""Adaptive side-lobe cancellation: what a second antenna receives as well, except the return, is subtracted.

P. W. Howells' side-lobe canceller (US patent 3,202,990, 1965) by least squares in each frame, with several taps.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ..altimeter.altimeter_settings import FASTEST_M_PER_S
from ..parsing import Settings, setting
from ..spectral_line import noise_level
from ..waveform import Waveform, checked

LEAST_ISOLATION_DB = 10.0  # isolation below which weights could take the return, and the canceller is off
_LOADING = 1e-7  # diagonal loading over the second channel's mean power: below every converter's noise
_EQUATIONS = 64  # samples per weight in the estimate: noise rises by 1/64, 0.07 dB
_STANDS_OUT = (
    21.0  # power of a line over the noise next to it that is a return: noise reaches it in 1e-6 of frames
)
_VISIBLE = 14.0  # power of a line over the noise next to it that noise exceeds in a cell of a million
_UNSEEN = 2.0  # power, over the noise next to it, that a line may have and not be seen
_ALIVE = 0.01  # least noise of the second channel over the first's: a dead one shows no return either
_TAKEN = 0.3  # largest amplitude of the return that weights may take: 3 dB
_RAISED_DB = 1.0  # rise of the measured isolation per frame: one frame of an interferer's line is no return
_SIDES = np.stack(
    [np.arange(-36, -4), np.arange(5, 37)]
)  # cells on either side of a line, beyond its main lobe
_GUARD_CELLS = 40  # cells beyond the span's beats that hold side lobes of a strong return


@dataclass(frozen=True, kw_only=True)
class CancelSettings(Settings, where="auxiliary_cancel"):
    """Settings of the canceller with a second receive channel."""

    isolation_db: float = setting(20.0, LEAST_ISOLATION_DB, 60.0)
    """How much weaker the second antenna receives the return. The least of it and of what is
    measured holds."""
    reach_s: float = setting(1.07e-6, 0.0, 2e-6)
    """Delays covered, plus and minus: path differences of an interferer and differences of the front ends."""
    order: int = setting(0, 0, 3)
    """Polynomial in time that weights follow within a piece: 0 for static antennas."""
    conjugate: bool = False
    """Use the second channel's complex conjugate as well, at twice the cost: for images of front ends above -45 dB."""
    least_db: float = setting(0.5, 0.1, 20.0)
    """Least fall of a piece's power, below which it passes unchanged."""
    pieces: int = setting(1, 1, 512)
    """Parts of a frame with weights of their own, or the nearest number below that divides its samples: 1 before a
    mixer, one per 55 us of the sweep behind it."""


class AuxiliaryCancel:
    """Least squares of the first channel on delayed copies of the second, for each frame alone.

    ``y[n] = x1[n] - sum_{q,d} h[q,d] P_q(n) x2[n-d]`` with Legendre polynomials ``P_q`` over a piece of the frame.
    Weights are estimated without the return: both channels are dechirped, the beats of the span set to zero, and the
    rest is chirped again. Behind a mixer the span fills the IF, and only the beat of a return that stands out is left
    out; a delay turns the phase along the sweep there, which pieces follow.

    A piece passes where it would lose less than ``least_db``, or weights could take 3 dB of the return (an interferer
    in its direction). A frame passes, to the bit, where all its pieces do, a channel is not finite, the isolation of
    the return is unknown or below 10 dB, or a return that stood out would lose half of its power.

    The isolation is measured on frames in which a return stands out, such as those of the preamble. A line that both
    channels show sets it; where the second channel shows none, its noise gives a lower bound, which may raise it.

    Parameters
    ----------
    waveform : Waveform
    settings : CancelSettings
    max_altitude_m : float
        Highest altitude of a return.
    """

    name = "auxiliary_cancel"

    def __init__(
        self, waveform: Waveform, settings: CancelSettings | None = None, *, max_altitude_m: float = 1500.0
    ) -> None:
        self.waveform, self.settings = checked(waveform), settings or CancelSettings()
        n = self._n = waveform.samples_per_frame
        self._reach = round(self.settings.reach_s * waveform.rate_hz)
        self._pieces = max(p for p in range(1, self.settings.pieces + 1) if n % p == 0)
        time, order = np.linspace(-1.0, 1.0, n // self._pieces), np.eye(self.settings.order + 1)
        self._bases = np.polynomial.legendre.legval(time, order).astype(np.float32)
        weights = (2 * self._reach + 1) * len(self._bases) * (1 + self.settings.conjugate) * self._pieces
        self._step = max(1, n // (_EQUATIONS * weights))
        self._reference = waveform.reference.astype(np.complex64)
        edge = np.linspace(0.0, 20.0, n // 2)  # of each half sweep a Tukey window, a twentieth at either end
        window = 0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, np.minimum(edge, edge[::-1])))
        self._dechirp = (np.tile(window, 2) * self._reference.conj()).astype(np.complex64)
        doppler = waveform.vertical_speed_to_doppler_hz(FASTEST_M_PER_S) * waveform.sweep_s
        self._cells = np.abs(fft.fftfreq(n, 1 / n))
        beats = waveform.altitude_to_beat_hz(max_altitude_m) * waveform.sweep_s + doppler
        self._span = self._cells <= beats + _GUARD_CELLS
        self._notch = 2 * doppler + _GUARD_CELLS if waveform.deramped else None
        self._spin = np.exp(-2j * np.pi * np.arange(n) / n).astype(np.complex64)
        self.reset()

    def reset(self) -> None:
        """Forget the isolation; counters to zero."""
        self.isolation_db: float | None = None
        self.frames = self.cancelled = self.refused = 0  # refused: the return would have been taken

    def status(self) -> dict[str, object]:
        """Counters, measured isolation, and why the canceller is off, if it is."""
        known, off = self.isolation_db, ""
        if known is None:
            off = "isolation not measured: no return has stood out without interference"
        elif known < LEAST_ISOLATION_DB:
            off = f"isolation measured as {known:.1f} dB, below {LEAST_ISOLATION_DB:g}: turn the antenna away"
        counters = {"frames": self.frames, "cancelled": self.cancelled, "refused": self.refused}
        return {"method": self.name, **counters, "isolation_db": known, "off": off}

    def process(self, frames: np.ndarray, auxiliary: np.ndarray) -> np.ndarray:
        """(n, N) complex64 frames of the first and the second channel -> (n, N) complex64, a new array."""
        out = np.array(frames, np.complex64)
        if out.shape != np.shape(auxiliary) or out.ndim != 2 or out.shape[1] != self._n:
            raise ValueError(
                f"{self.name}: channels have shapes {out.shape} and {np.shape(auxiliary)}; expected (n, {self._n})"
            )
        with np.errstate(all="ignore"):  # samples may hold any value
            for first, second in zip(out, np.asarray(auxiliary, np.complex64), strict=True):
                self._process(first, second)
        return out

    def _process(self, first: np.ndarray, second: np.ndarray) -> None:
        """Clean one frame in place, if anything is gained."""
        self.frames += 1
        if not (np.isfinite(first).all() and np.isfinite(second).all()):
            return
        channels = np.stack([first, second]) * self._dechirp
        spectra = fft.fft(channels, axis=-1)
        power = spectra.real**2 + spectra.imag**2
        cell = int(np.argmax(np.where(self._span, power[0], 0)))
        # the larger of both sides: at the edge of a burst's spectrum the other one is quiet
        noise = noise_level(power[:, (cell + _SIDES) % self._n]).max(axis=-1)
        clear = power[0, cell] > _STANDS_OUT * noise[0]
        if clear:
            self._measure(power[:, cell], noise[1], *noise_level(power[:, ::8]))
        known_db = min(self.settings.isolation_db, self.isolation_db or 0.0)
        if known_db < LEAST_ISOLATION_DB:
            return
        if self._notch is None:
            spectra[:, self._span] = 0
        elif clear:  # both half sweeps' beats
            spectra[:, np.abs(self._cells - self._cells[cell]) <= self._notch] = 0
        rest = fft.ifft(spectra, axis=-1, overwrite_x=True)
        rest *= self._reference
        weights, gained = self._estimate(*rest, channels[0])
        taken = (np.abs(weights) ** 2).sum(axis=-1) > (_TAKEN * 10 ** (known_db / 20)) ** 2
        weights[taken | ~gained] = 0
        left = weights.any()
        if left:
            cleaned = first - (weights[:, None] @ self._rows(second)).reshape(-1)
            # the frame's end is not its beginning
            cleaned[: self._reach] = cleaned[self._n - self._reach :] = 0
        if left and clear:
            line = (self._spin[cell * np.arange(self._n) % self._n] * self._dechirp) @ cleaned
            left = abs(line) ** 2 > 0.5 * power[0, cell]
        if left:
            first[:] = cleaned
            self.cancelled += 1
        else:
            self.refused += bool(gained.any())

    def _measure(self, line: np.ndarray, noise: float, floor: float, auxiliary_floor: float) -> None:
        """Isolation from a return's line in both channels; ``noise`` is that next to it in the second."""
        found = 10.0 * np.log10(line[0] / np.clip(line[1] + _UNSEEN * noise, 1e-38, 1e38))  # finite
        known = self.isolation_db
        if line[1] > _VISIBLE * noise:
            self.isolation_db = found if known is None else min(found, known + _RAISED_DB)
        elif auxiliary_floor > _ALIVE * floor and (known is None or found > known):
            self.isolation_db = found if known is None else known + _RAISED_DB

    def _rows(self, x: np.ndarray, step: int = 1) -> np.ndarray:
        """(pieces, weights, samples) complex64 copies of (N,) samples that weights multiply, every ``step``-th one."""
        ring = np.concatenate([x[self._n - self._reach :], x, x[: self._reach]])
        rows = np.lib.stride_tricks.sliding_window_view(ring, self._n)[::-1]
        rows = rows.reshape(len(rows), self._pieces, -1)[..., ::step]
        if self.settings.conjugate:
            rows = np.concatenate([rows, rows.conj()])
        if len(self._bases) > 1:
            rows = np.concatenate([rows * base[::step] for base in self._bases])
        return np.ascontiguousarray(rows.swapaxes(0, 1))

    def _estimate(
        self, target: np.ndarray, x: np.ndarray, first: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Weights (pieces, weights) of ``x`` that leave least of ``target``; which gain ``least_db`` of ``first``."""
        target, first = (y.reshape(self._pieces, 1, -1)[..., :: self._step] for y in (target, first))
        rows = np.concatenate([self._rows(x, self._step), target], axis=1)
        products = (rows.conj() @ rows.swapaxes(1, 2)).astype(np.complex128)
        products[~np.isfinite(products).all(axis=(1, 2))] = 0
        within, across = products[:, :-1, :-1], products[:, :-1, -1:]
        eye = np.eye(within.shape[1])
        load = _LOADING / len(eye) * np.trace(within, axis1=1, axis2=2).real + np.finfo(np.float32).tiny
        weights = np.linalg.solve(within + load[:, None, None] * eye, across)
        fall = (weights.conj() * (2 * across - within @ weights)).real.sum(axis=(1, 2))
        least = (1 - 10 ** (-self.settings.least_db / 10)) * (np.abs(first) ** 2).sum(axis=(1, 2))
        return weights[..., 0].astype(np.complex64), fall > least
