"""Timing held on the transmitter's leakage: since its delay is constant, a change of it is a timing error."""

import numpy as np
from scipy import fft
from scipy.linalg import blas

from ..waveform import altitude_to_delay_s
from .leakage import LeakageCanceller
from .sweep_check import COARSE, TOLERANCE
from .sweep_finder import ALONE, SweepFinder

# Share of the calibrated amplitude by which a leakage may differ from the calibration: half of it is a phase offset of
# 0.5 rad, or a ground half as strong as the leakage within a sample of it.
_UNLIKE = 0.5
_STEPS, _DERIVED = 2, 1e-3  # Gauss-Newton steps of the delay; step of its derivative, samples
_LEAST_LEFT = 0.3  # share of the leakage that a ground at almost the same place has to leave to it
_NEAR, _FLANK = 2, 3  # samples searched next to its place; samples on either side that belong to one line


class LeakageTiming:
    """Finds the calibrated leakage in received frames, at its place or elsewhere.

    ``canceller``: aligned with the timing that is assumed; ``finder``: of the same sweep.
    """

    def __init__(self, canceller: LeakageCanceller, finder: SweepFinder) -> None:
        self.canceller, self._finder = canceller, finder
        self._present = 0.6 * finder.settings.lock_threshold
        w = canceller.waveform
        self._rate, self._n = w.rate_hz, w.samples_per_frame
        # where the leakage's line peaks, which the echo of a landing gear moves: what timing is taken on
        self._place_samples = finder.delay_samples(canceller.background) or 0.0

    def locate(self, samples: np.ndarray, counter: int) -> tuple[int, float] | None:
        """As `SweepFinder.locate`, of the leakage; None where what is found is not the leakage that was calibrated.

        Without a calibration it is the strongest sweep. ``counter`` is the first sample's, which numbers the sweeps.
        """
        found = self._finder.locate(samples)
        if found is None:
            return None
        if not self.canceller.calibrated:
            self.canceller.align(found[1] / self._rate)
            return found
        total = found[0] + found[1] - self._place_samples
        whole = round(total)
        if not 0 <= whole <= samples.size - self._n:
            return None
        frames = samples[whole : whole + samples[whole:].size // self._n * self._n].reshape(-1, self._n)
        index = (counter + whole + 1) // self._n + np.arange(len(frames))
        mean = (frames * np.conj(np.reshape(self.canceller.rotation(index), (-1, 1)))).mean(axis=0)
        rest = self._refine(mean, total - whole)
        if self.slip(frames[0], int(index[0])) != 0.0:
            return None
        return whole, rest

    def _refine(self, frame: np.ndarray, rest: float) -> float:
        """Align the canceller with one frame; returns samples after its start, from a first estimate of them."""
        known = self.canceller
        for _ in range(_STEPS):
            known.align((rest + _DERIVED) / self._rate)
            later = known.background.copy()
            known.align(rest / self._rate)
            slope = (later - known.background) / _DERIVED
            wrong = np.vdot(slope, frame - known.background).real / np.vdot(slope, slope).real
            rest += float(np.clip(wrong, -0.5, 0.5))
        known.align(rest / self._rate)
        return rest

    def slip(
        self,
        frame: np.ndarray,
        frame_index: int = 0,
        sent: tuple[float, float] | None = None,
        offset_s: float = 0.0,
    ) -> float | None:
        """Samples by which the leakage lies next to its place in a received frame (N,); None where it is hidden.

        The leakage is known by its amplitude and its phase. Where it is known what was ``sent`` (altitude in metres
        and range rate in m/s, timing ``offset_s`` s after the frame's first sample), only what a return there cannot
        be counts: the least-squares estimate of one line next to another.
        """
        n = self._n
        expected, energy = self._expected(frame_index, sent, offset_s)
        rails = frame.view(np.float32)
        received = blas.sdot(rails, rails)
        if not (energy > 0 and np.isfinite(received) and received > 0):
            return None
        near = range(-_NEAR, _NEAR + 1)
        like = [
            blas.cdotc(expected, frame, n=n - abs(s), offx=max(0, -s), offy=max(0, s)) / energy for s in near
        ]
        self._finder.quality_db = 10.0 * np.log10(max(abs(like[_NEAR]) ** 2 * energy * n / received, 1e-9))
        if abs(like[_NEAR] - 1.0) < _UNLIKE and np.argmax(np.real(like)) == _NEAR:
            return 0.0
        return self._elsewhere(frame, expected, energy)

    def _expected(
        self, frame_index: int, sent: tuple[float, float] | None, offset_s: float
    ) -> tuple[np.ndarray, float]:
        """(N,) the leakage less what a return of the frame's altitude has in common with it, and its energy."""
        known = self.canceller
        expected = known.background * np.complex64(known.rotation(frame_index))
        if sent is None:
            return expected, known.energy
        ground = self._finder.expected_frame(*sent, offset_s)
        common = blas.cdotc(ground, expected)
        left = known.energy - abs(common) ** 2
        if left < _LEAST_LEFT * known.energy:
            return expected, known.energy
        return expected - np.complex64(common) * ground, left

    def _elsewhere(self, frame: np.ndarray, expected: np.ndarray, energy: float) -> float | None:
        """Where in a frame the leakage is, in samples from its place; None if nowhere, or not beyond doubt."""
        n = self._n
        like = fft.ifft(fft.fft(frame) * np.conj(fft.fft(expected))) / energy
        power = like.real**2 + like.imag**2
        mean = float(power.mean())
        unlike = np.abs(like - 1.0)
        lag = int(np.argmin(unlike))
        top = float(power[lag])
        if unlike[0] < _UNLIKE or unlike[lag] >= _UNLIKE or top < self._present * mean:
            return None
        flank = np.arange(-_FLANK, _FLANK + 1)
        if float(power[(lag + flank) % n].max()) > ALONE * top:  # the flank of a stronger return
            return None
        power[(lag + flank) % n] = 0.0
        power[(int(np.argmax(power)) + flank) % n] = 0.0  # the ground's line may be as strong
        if top < ALONE * float(power.max()):
            return None
        return float(lag if lag < n // 2 else lag - n)

    def verdict(
        self, found: tuple[str, float, float], slip: float | None, sent: tuple[float, float] | None
    ) -> tuple[str, float, float]:
        """`SweepCheck.verdict` of a frame, the leakage subtracted, together with where the leakage is.

        A leakage off its place contradicts the timing. One at its place verifies it, whatever else a frame shows. So
        whole frames that are lost without a tag are not noticed then, as with altitudes that are set by hand.
        """
        expected = 0.0 if sent is None else float(altitude_to_delay_s(sent[0])) * self._rate
        if slip == 0.0:
            return "verified", expected, TOLERANCE
        if slip is not None:
            return "contradicted", expected + slip, COARSE
        return found
