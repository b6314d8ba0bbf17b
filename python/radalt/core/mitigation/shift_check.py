"""Is the return that a network puts out a true one? A return moves with the frame, a false return does not.

The received frame is beat-shifted by a known altitude, cleaned again and shifted back. A return is then where it was
before; a false return is not. A frame that shows no interference needs no second run: its
altitude has to be the one measured before the network. So does an altitude from a weak peak: a network can lift a peak
of the noise, which moves with the frame as a return does.
"""

from collections.abc import Callable

import numpy as np

from ..altimeter.altimeter import Altimeter, AltimeterSettings, Reason, shared_altimeter
from ..altimeter.altimeter_settings import FASTEST_M_PER_S
from ..altimeter.frame_quality import levels
from ..waveform import Waveform, exp_cycles
from .base import peak_scale
from .interference_detector import InterferenceDetector

_SHIFT_CELLS = 5.0  # shift, resolution cells; 3, 5 and 8 find the same
_WEAK_DB = 12.0  # few peaks that a network lifts from noise are stronger (bench/sweeps.yaml, 3 MHz)
_SLOW_M_PER_S = 10.0  # vertical speed that almost no frame of a flight exceeds
# so low a threshold that whatever is declared later is checked here
_PFA = 20.0 * AltimeterSettings.pfa_per_frame
# False alarms per frame at which a received frame has to show a weak peak: `_PFA` passes five times as many.
_WEAK_PFA = 5.0 * AltimeterSettings.pfa_per_frame


class ShiftCheck:
    """The shift test.

    Altitudes are searched over the altimeter's default span (1500 m, or the sweep's limit where that is lower). The
    search is made twice: for half sweeps that differ by a Doppler of up to 150 m/s, and for those that agree to a
    cell, where a cell is wider than the Doppler of 10 m/s (in a longer sweep no return's halves agree). The altitudes
    have to agree within a quarter of a resolution cell (5 m). A frame without a declared altitude passes.

    Costs a second run of the network in frames that show interference, an FFT, and two calls of an altimeter.
    """

    def __init__(self, waveform: Waveform) -> None:
        searches = [(FASTEST_M_PER_S, _PFA)]
        if waveform.vertical_speed_to_doppler_hz(_SLOW_M_PER_S) * waveform.sweep_s / 2.0 < 1.0:
            # allowing Doppler raises a pair's threshold, to that of this search at a twentieth of the rate
            searches.append((0.0, _PFA / 20.0))

        def altimeters(share: float) -> list[Altimeter]:
            settings = (
                AltimeterSettings(max_vertical_speed_m_per_s=v, pfa_per_frame=share * pfa)
                for v, pfa in searches
            )
            return [shared_altimeter(waveform, each) for each in settings]

        self._altimeters, self._strict = altimeters(1.0), altimeters(_WEAK_PFA / _PFA)
        self._detector = InterferenceDetector(waveform)
        top_m = self._altimeters[0].settings.max_altitude_m
        self.shift_m = min(_SHIFT_CELLS * waveform.range_resolution_m, 0.25 * top_m)
        self._tolerance_m = 0.25 * waveform.range_resolution_m
        time = waveform.sample_times_s
        beat_hz = float(waveform.altitude_to_beat_hz(self.shift_m))
        # opposite sign in each half sweep and back to zero at the end, as `Waveform.beat_shifted`
        self._up = exp_cycles(-beat_hz * np.minimum(time, waveform.sweep_s - time))
        self._down = self._up.conj()
        half = waveform.samples_per_half
        self._mix = waveform.reference[half:].conj()
        # conjugate phase step per sample of a beat in the middle of the span
        self._middle = np.exp(
            -2j * np.pi * float(waveform.altitude_to_beat_hz(0.5 * top_m)) / waveform.rate_hz
        )

    def holds(
        self,
        received: np.ndarray,
        cleaned: np.ndarray,
        clean: Callable[[np.ndarray], np.ndarray],
        *,
        disturbed: bool = False,
    ) -> np.ndarray:
        """(n,) bool: whether altitudes found in cleaned frames were in the received ones, or none is found.

        ``received``, ``cleaned`` (n, N) complex64: finite frames before and after the network; ``clean``: the
        network: (k, N) complex64 in and out. ``disturbed``: whether the same detector has already found interference
        in all frames, so that it need not run again.
        """
        n = len(received)
        before = received.copy()
        shown = np.ones(n, dtype=bool) if disturbed else self._detector.present(received)
        if shown.any():
            before[shown] = self._moved_and_back(received[shown], cleaned[shown], clean)
        both = np.concatenate([cleaned, before])
        held, moving_m = np.ones(n, dtype=bool), None
        for altimeter, strict in zip(self._altimeters, self._strict, strict=True):
            result = altimeter.process(both)
            declared, altitude = _declared(result)
            found, again = altitude[:n], altitude[n:]  # NaN where nothing is found
            if moving_m is None:
                moving_m = again
            # halves that agree to a cell before may just disagree afterwards: in a long sweep by the speed
            again = np.where(result["reason"][n:] == Reason.SWEEPS_DISAGREE, moving_m, again)
            held &= ~declared[:n] | (np.abs(again - found) <= self._tolerance_m)
            weak = held & shown & declared[:n] & ~(result["snr_db"][:n] >= _WEAK_DB)
            if weak.any():
                plain_m = _declared(strict.process(received[weak]))[1]
                held[weak] = np.abs(plain_m - found[weak]) <= self._tolerance_m
        return held

    def _moved_and_back(
        self, frames: np.ndarray, cleaned: np.ndarray, clean: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """(k, N) frames shifted by the altitude, cleaned, and shifted back."""
        out = np.zeros_like(frames)
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # a rail of 1e38 overflows when its phase is rotated
            there = np.where(self._is_low(cleaned)[:, None], self._up, self._down)
            moved = frames * there
            fits = np.isfinite(levels(moved)["peak"])
            if fits.any():
                out[fits] = clean(moved[fits]) * there[fits].conj()
        return out

    def _is_low(self, cleaned: np.ndarray) -> np.ndarray:
        """(k,) bool: whether the beat is below the middle of the span, by its phase from sample to sample."""
        beat = cleaned[:, -self._mix.size :] * self._mix / peak_scale(cleaned)
        return (np.einsum("ks,ks->k", beat[:, 1:], beat[:, :-1].conj()) * self._middle).imag < 0


def _declared(result: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) bool and altitudes of results that are declared where fewer speeds are allowed, too; NaN elsewhere."""
    declared = result["valid"] | (result["reason"] == Reason.AMBIGUOUS)
    return declared, np.where(declared, result["forced_altitude_m"], np.nan)
