"""Delay of the sweep in received samples: by correlation at any delay, by matched filters near an expected one."""

import math

import numpy as np
from scipy import fft
from scipy.linalg import blas

from ..altimeter.altimeter import AltimeterSettings, shared_altimeter
from ..spectral_line import peak_curve, peak_offset
from ..waveform import Waveform, altitude_to_delay_s, sum_of_waves
from .segmenter_settings import SegmenterSettings

_FRACTION = 0.25  # least fractional delay that is reported, samples: 5 m at the default rate
# correlation over mean from which a quarter of a sample is six standard deviations, at a rate of the bandwidth
_FINE_STRENGTH = 100.0
# Least power of the sweep's peak over any other beyond its flanks (samples): a burst of narrow-band interference
# correlates with a piece of the sweep at many delays, all about as strong.
ALONE, _FLANK = 4.0, 3
# largest spread between the frames of one acquisition; 0.02 is usual at an SNR of -10 dB
_MAX_SPREAD_SAMPLES = 0.2


class SweepFinder:
    """Tables of one sweep, and the three measurements that `FrameSegmenter` makes: locate, correlate, shift.

    ``true_delay``: whether altitudes come as true delays (with Doppler) or as beat shifts. ``quality_db``:
    correlation over mean of the last sweep that was measured, in decibels; NaN before the first.
    """

    def __init__(self, waveform: Waveform, settings: SegmenterSettings, *, true_delay: bool) -> None:
        self.waveform, self.settings, self._true_delay = waveform, settings, true_delay
        self._n = waveform.samples_per_frame
        # separate halves: a beat shift rotates their phases apart by k tau^2 cycles, so they add in power only
        halves = np.zeros((2, self._n), dtype=np.complex64)
        halves[0, : self._n // 2] = waveform.reference[: self._n // 2]
        halves[1, self._n // 2 :] = waveform.reference[self._n // 2 :]
        self._reference_fft = np.conj(fft.fft(halves, axis=1))
        span = 3.0 * waveform.range_resolution_m
        self._fine = shared_altimeter(
            waveform,
            AltimeterSettings(min_altitude_m=-span, max_altitude_m=span, max_vertical_speed_m_per_s=0.0),
        )
        self._spectrum = fft.fft(waveform.reference)
        # of its bins the first below the band, which is -B/2..B/2 or 0..B
        self._wraps = (self._n + 1) // 2 if waveform.centered else self._n
        flank = float(np.sinc(waveform.bandwidth_hz / waveform.rate_hz))  # response a sample off the peak
        self._fine_strength = _FINE_STRENGTH * ((1.0 + flank) / (1.0 - flank)) ** 2
        self._peak_curve = peak_curve(np.ones(512), waveform.bandwidth_hz / waveform.rate_hz / 512)
        self._expected: dict[tuple[float, float, float], np.ndarray] = {}
        self.quality_db = float("nan")

    def locate(self, samples: np.ndarray) -> tuple[int, float] | None:
        """Sweep start within ``samples`` (at least acquisition_frames + 1 frames): whole samples and rest, or None."""
        n, count = self._n, self.settings.acquisition_frames
        rotation = np.conj(self.waveform.frame_rotation(np.arange(count))).reshape(-1, 1)
        folded = (samples[: count * n].reshape(count, n) * rotation).mean(axis=0).astype(np.complex64)
        peak, significance, _ = self.correlate(folded)
        if significance < 0.6 * self.settings.lock_threshold:
            return None
        aligned = samples[peak : peak + count * n].reshape(count, n)
        each = self._fine.process((aligned * rotation).astype(np.complex64))
        delays = altitude_to_delay_s(each["altitude_m"]) * self.waveform.rate_hz
        if not each["valid"].all() or np.ptp(delays) > _MAX_SPREAD_SAMPLES:
            return None  # a frame among them is torn, or there is no sweep
        total = peak + float(np.mean(delays))
        whole = round(total)
        return whole, total - whole

    def delay_samples(self, frame: np.ndarray) -> float | None:
        """Delay in samples at which `locate` finds the strongest line of one frame (N,), near zero, or None."""
        found = self._fine.process(frame[None])[0]
        delay_s = float(altitude_to_delay_s(found["altitude_m"]))
        return delay_s * self.waveform.rate_hz if found["valid"] else None

    def correlate(self, frame: np.ndarray, sent: float = 0.0) -> tuple[int, float, float]:
        """Circular correlation of one frame with the sweep, halves added in power.

        Peak lag, its power over the mean, and over the greatest that is part neither of it nor of a sweep at the lag
        ``sent``: a torn frame has both.
        """
        power = self._power(frame)
        peak = int(np.argmax(power))
        top, mean = float(power[peak]), float(power.mean())
        if not (np.isfinite(mean) and mean > 0):
            return peak, 0.0, 0.0
        for lag in (peak, round(sent)):
            power[np.arange(lag - _FLANK, lag + _FLANK + 1) % self._n] = 0.0
        return peak, top / mean, top / max(float(power.max()), 1e-3 * mean)

    def image_share(self, frame: np.ndarray) -> float:
        """Power of the sweep's complex conjugate over that of the sweep in one frame; 0 where none stands out alone.

        A quadrature error gives the conjugate: one rail dead (0 dB), one rail a sample late (-2 dB). Of a centred
        sweep the conjugate is the sweep half a frame later, so it does not show a receiver with I and Q exchanged.
        """
        power, mirrored = self._power(frame), self._power(np.conj(frame))
        peak, mean = int(np.argmax(power)), float(power.mean())
        if not (np.isfinite(mean) and mean > 0):
            return 0.0
        near = (peak + np.arange(-_FLANK, _FLANK + 1)) % self._n
        image = float(mirrored[near].max())
        mirrored[near] = 0.0
        mirrored[(near + self._n // 2) % self._n] = 0.0  # where a centred sweep's own conjugate lies
        alone = image >= max(self.settings.lock_threshold * mean, ALONE * float(mirrored.max()))
        return image / float(power[peak]) if alone else 0.0

    def _power(self, frame: np.ndarray) -> np.ndarray:
        """(N,) power of the circular correlation of one frame with the sweep, halves added in power."""
        response = fft.ifft(fft.fft(frame) * self._reference_fft, axis=1)
        return (response.real**2 + response.imag**2).sum(axis=0)

    def shift(
        self, samples: np.ndarray, sent: tuple[float, float], offset_s: float
    ) -> tuple[float, float] | None:
        """Samples between the assumed and the true timing, -2..2, and strength; None if no sweep is found that near.

        Matched filters at the altitude and range rate sent, up to two samples either side. Whole samples, unless the
        sweep is strong enough to measure a fraction of a quarter or more.
        """
        x, n = samples, self._n
        # whole samples apart, the expected frames are one frame shifted; the two samples that leave at an end are left
        # out. SciPy's BLAS, since NumPy's takes newer processors for an old one (docs/real-time.md)
        expected = self.expected_frame(*sent, offset_s)
        response = [
            abs(blas.cdotc(expected, x, n=n - abs(shift), offx=max(0, -shift), offy=max(0, shift)))
            for shift in range(-2, 3)
        ]
        rails = x.view(np.float32)
        energy = blas.sdot(rails, rails)
        if not (math.isfinite(energy) and energy > 0):
            return None
        best = response.index(max(response))
        strength = response[best] ** 2 * self._n / energy
        self.quality_db = 10.0 * math.log10(max(strength, 1e-9))
        away = max(response[: max(0, best - 1)] + response[best + 2 :])
        if strength < self.settings.lock_threshold or response[best] ** 2 < ALONE * away**2:
            return None
        if strength < self._fine_strength or not 0 < best < 4:
            return float(best - 2), strength
        fraction = float(peak_offset(np.square(response[best - 1 : best + 2]), self._peak_curve))
        return best - 2 + (fraction if abs(fraction) > _FRACTION else 0.0), strength

    def expected_frame(self, altitude_m: float, rate_m_per_s: float, offset_s: float) -> np.ndarray:
        """(N,) complex64 frame of an altitude and a range rate, delayed by timing's fraction, of unit energy."""
        key = altitude_m, rate_m_per_s, offset_s
        if key not in self._expected:
            if len(self._expected) >= 64:
                self._expected.clear()
            w, delay_s = self.waveform, float(altitude_to_delay_s(altitude_m))
            if self._true_delay:  # the sweep before ends as this one does
                spectrum = self._spectrum * self._delay(offset_s + delay_s)
            else:
                half = self._ramp(-w.slope_hz_per_s * delay_s / w.rate_hz, self._n // 2 + 1)
                frame = w.reference * np.concatenate([half[:-1], half[:0:-1]])
                spectrum = fft.fft(frame) * self._delay(offset_s)
            frame = fft.ifft(spectrum) * np.float32(1 / np.sqrt(self._n))
            if self._true_delay and rate_m_per_s:
                frame *= self._ramp(-float(w.vertical_speed_to_doppler_hz(rate_m_per_s)) / w.rate_hz, self._n)
            self._expected[key] = frame
        return self._expected[key]

    def _delay(self, delay_s: float) -> np.ndarray:
        """(N,) complex64 factors of a sweep's spectrum that delay it."""
        factors = self._ramp(-delay_s * self.waveform.rate_hz / self._n, self._n)
        factors[self._wraps :] *= np.complex64(np.exp(2j * np.pi * delay_s * self.waveform.rate_hz))
        return factors

    @staticmethod
    def _ramp(step_cycles: float, count: int) -> np.ndarray:
        """(count,) complex64 unit phasors that advance by so many cycles per sample."""
        return sum_of_waves(np.ones(1), np.array([step_cycles]), count).astype(np.complex64)
