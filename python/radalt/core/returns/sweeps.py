"""Transmitted sweeps by index, with the beat shift of a synthetic altitude."""

from functools import lru_cache

import numpy as np

from ..programme import SentAltitudes
from ..waveform import Waveform, read_only
from .point import point_return


class SentSweeps:
    """Transmitted sweeps of the radar, one per frame; a ``silent`` one transmits nothing in trials.

    Drawn returns (`Programme.phases_cycles`) are played with delay and Doppler. Otherwise up sweeps are shifted by ``-k
    tau`` and down sweeps by ``+k tau`` (`Waveform.beat_shifted`), ``tau = 2 R / c``; without ``synthetic`` they are
    sent plain, and the channel simulates true delays.
    """

    def __init__(
        self, waveform: Waveform, sent: SentAltitudes, *, synthetic: bool = True, silent: bool = False
    ) -> None:
        self.waveform, self.sent, self.synthetic, self.silent = waveform, sent, synthetic, silent

    def sweep(self, index: int) -> np.ndarray:
        """(N,) complex64 sweep number ``index``; not to be written into."""
        if self.silent and self.sent.programme.is_trial(index):
            return np.zeros(self.waveform.samples_per_frame, dtype=np.complex64)
        phase = self.sent.programme.phase_cycles(index)
        if phase is not None and not self.sent.by_hand:
            altitude_m, speed = self.sent.at(index)
            drawn = {"vertical_speed_m_per_s": speed, "phase_cycles": phase, "frame_index": index}
            return point_return(self.waveform, np.array([altitude_m]), **drawn)[0]
        altitude_m = self.sent.at(index)[0] if self.synthetic else 0.0
        table = _shifted(self.waveform, altitude_m)
        if self.waveform.cycles_per_frame:
            table = table * np.complex64(self.waveform.frame_rotation(index))
        return table


@lru_cache(maxsize=64)  # 60 KB each at the default waveform
def _shifted(waveform: Waveform, altitude_m: float) -> np.ndarray:
    return read_only(waveform.beat_shifted(altitude_m))
