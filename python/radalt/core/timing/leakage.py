"""The transmitter's own leakage, a static channel: calibrated once and subtracted from every frame.

Every FMCW altimeter receives its transmitter directly, over a path of about a metre, and the echoes of its own aircraft
(landing gear) a few metres on. All of it is the transmitted sweep at fixed delays, far stronger than the ground from
high altitude. It is measured once without ground in view, stored, and subtracted as a complex waveform. The return of
the ground keeps its power, even at the same delays, since a stored waveform is no filter.

The limit is the stability of the leakage: a phase change of ``p`` rad leaves ``20 log10 p`` dB of it.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from ..waveform import Waveform, altitude_to_delay_s, exp_cycles

# Delays that count as leakage, in metres of altitude from the leakage's own: cables and antennas next to each other to
# the landing gear of an airliner
NEAREST_M, REACH_M = -3.0, 15.0
# Legendre polynomials per half sweep: a beat of half the reach has 0.45 cycles there, and what the next one would add
# is 70 dB down (tests/test_leakage.py)
SHAPES = 6
# Least altitude, and least vertical speed below FITTED_ABOVE_M, at which leakage is learned. A ground that hovers at
# 40 m loses 13 dB to what is learned meanwhile, one at 60 m 1.5 dB, which pulls it by 3.6 m; at FITTED_ABOVE_M the pull
# is 0.3 m. At this speed its phase rotates by 46 cycles within the memory (tests/test_leakage.py).
LEARN_ABOVE_M, LEARN_SPEED_M_PER_S = 60.0, 2.0
# Least altitude of a ground that a fit to each frame leaves alone: the rest of one below appears at up to 90 m
# (tests/test_leakage.py).
FITTED_ABOVE_M = 100.0
# Share of a half sweep at either end that is left out. A sweep as wide as the sampled band ends in the transition of
# the receiver's filters; what they make of 40 dB of leakage there would stand above the ground (tests/test_leakage.py).
_EDGE = 1.0 / 60.0
_MEMORY_FRAMES = 400  # memory of the mean, frames: noise 26 dB down, and 0.4 s to track a change
_RISE = 1.002  # growth per frame of the quietest recent power, so that it forgets
_MOST_WAITING = 4000  # frames that wait for a tracker's output, 4 s of the default sweep
_LEAST_FRAMES = 20  # least frames of a calibration


@dataclass(frozen=True)
class LeakageCalibration:
    """Leakage of one installation, and its delay."""

    waveform: Waveform  # the sweep it was measured with
    coefficients: np.ndarray
    """(2, SHAPES) complex128: of the shapes of `LeakageCanceller`, by half sweep, for timing taken on the leakage
    itself."""
    installation_delay_m: float = 0.0
    """Metres by which altitudes come out too high with timing taken on the leakage: cables to the antennas, less the
    leakage's own path."""

    @classmethod
    def measured(
        cls,
        waveform: Waveform,
        frames: np.ndarray,
        *,
        timing_offset_s: float = 0.0,
        frame_index: np.ndarray | int = 0,
    ) -> "LeakageCalibration":
        """From frames in which nothing but the leakage is: antennas towards the sky, or the aircraft above 60 m.

        - ``frames`` (n, N) complex: 20 or more; 400 bring the noise 26 dB down
        - ``timing_offset_s``: delay of the leakage's line against the frames' first sample, as the segmenter gives it
        - ``frame_index`` (n,) or int: sweep numbers; they matter only where ``B T_h`` is not whole and the sweep is
          not centred

        Raises `ValueError` for fewer frames, or frames that are not finite.
        """
        frames = np.atleast_2d(frames)
        if len(frames) < _LEAST_FRAMES:
            raise ValueError(
                f"leakage calibration has {len(frames)} frames; it takes {_LEAST_FRAMES} or more without any ground"
            )
        canceller = LeakageCanceller(cls(waveform, np.zeros((2, SHAPES), dtype=complex)))
        canceller.align(timing_offset_s)
        found = canceller.project(frames, frame_index).mean(axis=0)
        if not np.isfinite(found).all():
            raise ValueError("leakage calibration has frames that are not finite; record it anew")
        return cls(waveform, found)

    def with_installation(self, measured_m: np.ndarray, true_m: float) -> "LeakageCalibration":
        """The same with the installation delay from altitudes measured at a known one, leakage subtracted.

        ``measured_m`` (n,): with this calibration in use; those that are NaN do not count; ``true_m``: known altitude
        in metres, such as that of the antennas with the wheels on the ground. Raises `ValueError` if fewer than 20
        altitudes are left, or half of them lie more than a metre from their median.
        """
        known = np.asarray(measured_m, dtype=float)
        known = known[np.isfinite(known)]
        if known.size < _LEAST_FRAMES:
            raise ValueError(
                f"installation delay: {known.size} altitudes; it takes {_LEAST_FRAMES} or more at one known altitude"
            )
        middle = float(np.median(known))
        spread = float(np.median(np.abs(known - middle)))
        if spread > 1.0:
            raise ValueError(
                f"installation delay: altitudes are {spread:.1f} m off their median; hold one known altitude"
            )
        return replace(self, installation_delay_m=self.installation_delay_m + middle - float(true_m))


class LeakageCanceller:
    """Subtracts a calibrated leakage from frames, and tracks its slow changes where that is safe.

    A delay within `NEAREST_M` .. `REACH_M` of the leakage rotates the phase of a half sweep by less than a cycle from
    its first to its last sample. All such delays are therefore the sweep at the middle of that reach times a few
    Legendre polynomials of time, and a leakage is ``2 x SHAPES`` complex numbers. They are averaged, not fitted to
    each frame: a fit would remove the ground as well wherever it is as near.

    ``calibrated``: False fits the leakage in every frame, whatever its amplitude and phase (see `uncalibrated`).

    Examples
    --------
    >>> from radalt.core.returns.point import point_return
    >>> w = Waveform()
    >>> leakage = 100.0 * point_return(w, 1.0)
    >>> canceller = LeakageCanceller(LeakageCalibration.measured(w, np.tile(leakage, (20, 1))))
    >>> rest = canceller.subtract(leakage[None])[0]
    >>> bool(np.mean(np.abs(rest) ** 2) < 1e-8 * np.mean(np.abs(leakage) ** 2))
    True
    """

    def __init__(self, calibration: LeakageCalibration, *, calibrated: bool = True) -> None:
        self.waveform, self.calibrated = calibration.waveform, calibrated
        self.coefficients = np.array(calibration.coefficients, dtype=np.complex128)
        self.installation_delay_m = calibration.installation_delay_m
        self.following = False  # whether received frames are remembered for `learn`
        half = self.waveform.samples_per_half
        self._edge = round(_EDGE * half)
        inside = half - 2 * self._edge
        time = (2.0 * np.arange(inside) + 1.0) / inside - 1.0
        polynomials = np.linalg.qr(legendre.legvander(time, SHAPES - 1))[0]  # orthonormal on samples, too
        polynomials *= np.sign(polynomials[-1])  # positive at its end, as they are by definition
        self._polynomials = np.zeros((half, SHAPES))
        self._polynomials[self._edge : half - self._edge] = polynomials
        self._quietest: float | None = None
        self._waiting: dict[int, tuple[np.ndarray, float]] = {}
        self._learned = self.coefficients.copy()
        self._due: deque[tuple[int, np.ndarray]] = deque()
        self.learned_frames = 0
        self.align(0.0)

    @classmethod
    def uncalibrated(cls, waveform: Waveform) -> "LeakageCanceller":
        """One that fits each frame's shapes and takes them out: of no use below `FITTED_ABOVE_M`.

        The ground goes with the leakage there: 13 dB of it at 40 m, 1.5 dB at 60 m, and what is left stands elsewhere.
        """
        return cls(LeakageCalibration(waveform, np.zeros((2, SHAPES), dtype=complex)), calibrated=False)

    def align(self, offset_s: float) -> None:
        """After an acquisition: the leakage's line lies ``offset_s`` after a frame's first sample."""
        w = self.waveform
        middle_s = float(altitude_to_delay_s(0.5 * (NEAREST_M + REACH_M)))
        sweep = exp_cycles(w.phase_cycles(w.sample_times_s - offset_s - middle_s)).reshape(2, -1, 1)
        self._shapes = np.ascontiguousarray((sweep * self._polynomials).astype(np.complex64))
        self._rows = np.ascontiguousarray(np.conj(self._shapes.transpose(0, 2, 1)))
        self._waiting.clear()  # what was remembered belongs to another timing
        self._due.clear()
        self.coefficients = self._learned.copy()
        self._synthesise()

    def _synthesise(self) -> None:
        self.background = (
            (self._shapes @ self.coefficients.astype(np.complex64)[..., None])
            .reshape(-1)
            .astype(np.complex64)
        )
        self.energy = float(np.sum(np.abs(self.coefficients) ** 2))

    def rotation(self, frame_index: np.ndarray | int) -> np.ndarray | complex:
        """Phasor from sweep 0 to a frame's sweep."""
        return 1.0 if self.waveform.cycles_per_frame == 0.0 else self.waveform.frame_rotation(frame_index)

    def project(self, frames: np.ndarray, frame_index: np.ndarray | int = 0) -> np.ndarray:
        """(n, 2, SHAPES) coefficients of frames (n, N)."""
        halves = np.asarray(frames, dtype=np.complex64).reshape(len(frames), 2, -1)
        # a product per frame and half sweep: BLAS rounds differently with the number of rows
        found = (self._rows @ halves[..., None])[..., 0]
        return found * np.conj(np.reshape(self.rotation(frame_index), (-1, 1, 1)))

    def subtract(self, frames: np.ndarray, frame_index: np.ndarray | int = 0) -> np.ndarray:
        """(n, N) complex64 frames less the leakage, zero at the ends of each half sweep."""
        background = self.background
        if not self.calibrated:
            halves = np.asarray(frames, dtype=np.complex64).reshape(len(frames), 2, -1, 1)
            background = (self._shapes @ (self._rows @ halves)).reshape(len(frames), -1)
        elif self.waveform.cycles_per_frame:
            background = (np.reshape(self.rotation(frame_index), (-1, 1)) * background).astype(np.complex64)
        out = frames - background
        halves = out.reshape(len(out), 2, -1)
        halves[..., : self._edge] = halves[..., halves.shape[-1] - self._edge :] = 0.0
        return out

    def clean(self, frame: np.ndarray, frame_index: int) -> np.ndarray:
        """(N,) complex64 one received frame less the leakage; remembered for `learn` if that is on."""
        if self.following:
            self.remember(frame, frame_index)
            due = None
            while self._due and self._due[0][0] <= frame_index:
                due = self._due.popleft()[1]
            if due is not None:
                self.coefficients = due
                self._synthesise()
        return self.subtract(frame[None], frame_index)[0]

    # -- tracking -------------------------------------------------------------------------------------------------

    def remember(self, frame: np.ndarray, frame_index: int) -> None:
        """Keep a received frame's coefficients until `learn` or `forget` says what becomes of them."""
        power = float(np.vdot(frame, frame).real)
        self._waiting[frame_index] = self.project(frame[None], frame_index)[0], power
        if len(self._waiting) > _MOST_WAITING:
            del self._waiting[next(iter(self._waiting))]

    def learn(self, first: int, last: int, due: int | None = None) -> None:
        """Average the leakage over remembered frames ``first .. last``; earlier ones are forgotten.

        Only for frames in which the ground is resolved from the leakage (`ground_is_apart`). A frame's weight is the
        quietest recent power over its own, so that interference has little; a frame that is not finite has none.

        The new mean is subtracted from frame ``due`` on, or at once. With a future frame a run does not depend on
        when its tracker's messages arrive.
        """
        for index in sorted(self._waiting):
            if index > last:
                break
            found, power = self._waiting.pop(index)
            if index < first or not (np.isfinite(power) and power > 0 and np.isfinite(found).all()):
                continue
            self._quietest = power if self._quietest is None else min(_RISE * self._quietest, power)
            share = self._quietest / power / _MEMORY_FRAMES
            self._learned += share * (found - self._learned)
            self.learned_frames += 1
        if due is None:
            self.coefficients = self._learned.copy()
            self._synthesise()
        else:
            self._due.append((due, self._learned.copy()))

    def forget(self, last: int) -> None:
        """Drop remembered frames up to ``last``, in which the ground may not be resolved from the leakage."""
        for index in [i for i in self._waiting if i <= last]:
            del self._waiting[index]


def ground_is_apart(
    normal: bool, altitude_m: float, protection_level_m: float, vertical_speed_m_per_s: float
) -> bool:
    """Whether a tracker's output allows the leakage to be learned: a valid altitude above 60 m, at its worst.

    Up to 100 m the ground has to move by 2 m/s besides.
    """
    lowest_m = altitude_m - protection_level_m
    moves = abs(vertical_speed_m_per_s) >= LEARN_SPEED_M_PER_S
    return bool(normal) and lowest_m > (LEARN_ABOVE_M if moves else FITTED_ABOVE_M)
