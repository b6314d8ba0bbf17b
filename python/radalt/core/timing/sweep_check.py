"""Whether a frame shows its sweep at the delay it was sent with: a verdict per frame, which never moves the timing."""

import numpy as np

from ..waveform import altitude_to_delay_s
from .sweep_finder import ALONE, SweepFinder

# Largest error of a delay, samples: by the matched filter, by the correlation.
TOLERANCE, COARSE = 0.4, 1.0
NOT_CHECKED = "not checked", 0.0, COARSE


class SweepCheck:
    """Compares the sweep that a frame shows with the one that was sent.

    ``finder``: of the same sweep; ``max_altitude_m``: highest altitude, for frames whose altitude is not known.
    """

    def __init__(self, finder: SweepFinder, max_altitude_m: float) -> None:
        self._finder, waveform = finder, finder.waveform
        self._rate, self._n = waveform.rate_hz, waveform.samples_per_frame
        self._present = 0.6 * finder.settings.lock_threshold
        self._max_delay_samples = float(altitude_to_delay_s(max_altitude_m)) * waveform.rate_hz
        # delay in samples by which Doppler moves a half sweep's peak, per m/s of range rate
        doppler_hz = float(waveform.vertical_speed_to_doppler_hz(1.0))
        self._coupling = doppler_hz / waveform.slope_hz_per_s * waveform.rate_hz
        self._strength = 0.0  # strength of the last sweep that was found near the delay it was sent with

    def near(
        self, samples: np.ndarray, sent: tuple[float, float] | None, offset_s: float
    ) -> tuple[float, float] | None:
        """Delay of the sweep near the one it was sent with, see `SweepFinder.shift`; None if that is not known.

        ``samples`` (N,) complex64; ``sent`` (float, float) or None: altitude in metres and range rate in m/s that the
        frame was sent for, where that is known; ``offset_s``: delay of the sweep against the frame's first sample.
        """
        return None if sent is None else self._finder.shift(samples, sent, offset_s)

    def verdict(
        self,
        samples: np.ndarray,
        sent: tuple[float, float] | None,
        offset_s: float,
        near: tuple[float, float] | None,
    ) -> tuple[str, float, float]:
        """``verified``, ``contradicted`` or ``undetermined``; measured delay of the sweep; its tolerance.

        Delays are in samples, less ``offset_s``. ``near`` is what `near` returned for the same frame.
        """
        expected = 0.0 if sent is None else float(altitude_to_delay_s(sent[0])) * self._rate
        if near is not None and near[0] == 0 and near[1] >= 0.5 * self._strength:
            self._strength = near[1]
            return "verified", expected, TOLERANCE
        offset = offset_s * self._rate
        peak, significance, alone = self._finder.correlate(samples, expected + offset)
        delay = float((peak if peak < self._n // 2 else peak - self._n) - offset)
        present = significance >= self._present and alone >= ALONE
        moved = 0.0 if sent is None else abs(sent[1]) * self._coupling
        # the line may be the rest of a torn frame's sweep, or the flank of a sweep farther away
        if near is not None and not (present and abs(delay - expected - near[0]) > 2.5 + moved):
            self._strength = near[1]
            # at the end of the filters' reach it may be the flank of a sweep up to a sample farther away
            tolerance = COARSE if abs(near[0]) >= 2 else TOLERANCE
            return ("contradicted" if near[0] else "verified"), expected + near[0], tolerance
        if not present or moved > COARSE:  # a half sweep's peak alone shows no timing of a fast target
            return "undetermined", 0.0, COARSE
        self._finder.quality_db = 10.0 * np.log10(significance)
        inside = sent is None and -1.5 <= delay <= self._max_delay_samples + 1.5
        return ("verified" if inside else "contradicted"), delay, COARSE
