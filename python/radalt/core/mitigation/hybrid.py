"""OFDM and QPSK are cancelled where they can be demodulated; everything else goes to the network, or is whitened."""

import numpy as np

from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle, unit_peak
from .interference_detector import InterferenceDetector
from .ofdm.return_estimation import ReturnEstimator
from .ofdm.settings import SETTINGS
from .ofdm_cancel import OfdmCancel
from .qpsk_cancel import QpskCancel
from .tcae import LOST_DB, Tcae
from .whitening import Whitening

_OTHERS = ("tcae", "whitening")
# Cost that searches may have per frame, in FFTs of 7,500 points at 7.5 MS/s: a quarter of real time where such an FFT
# takes 40 us (docs/real-time.md), of which tracking, the network and the flowgraph need the rest
_SEARCH_FFTS = 6.25
_RATE_HZ = 7.5e6  # of that figure; a frame of another rate leaves less or more time
# Weight of a burst in what a canceller leaves, below which its part of the frame is lost: error vectors are 30 dB above
# what is next to them there. The network knows such a burst better as it was received; whitening does not
_MIN_WEIGHT = 1e-3
_PARTS, _QUIET = 10, 0.25  # of a frame; power of the quietest, of the mean, below which a frame holds a burst
# `ReturnEstimator.visibility` (18 dB) from which the altimeter needs no mitigation: Pd is 0.99 at 16 dB
_STANDS_OUT = 63.0
_MAX_CREDIT = 600.0  # cost that is saved up at most, in the same FFTs: the longest search


class Hybrid(Mitigation):
    """`OfdmCancel` or `QpskCancel` where one can demodulate what fills the frame; else the network, or whitening.

    Card: *choice by signal.* A frame that shows no interference passes. An emitter that was cancelled in the frame
    before is tracked. Otherwise OFDM and QPSK are searched, unless the return stands out already. A frame that cannot
    be cancelled goes to the network as it is. So does one that was cancelled, but held a burst of QPSK or shows no
    return yet: the network may know what error vectors hide. Where one return alone is left of it, this is the
    result. Otherwise what the canceller left is, through the network if the frame held a burst that was not blanked,
    or if what is left is coloured and not consistent with one return: symbols that the frame cuts, other emitters.

    Every frame is searched that has to be, unless frames may be dropped. Then searches have a budget: each frame adds
    a quarter of the time that it lasts, a search spends its cost in FFTs, and none begins while the balance is
    negative. So searches take a quarter of real time, whatever is received, and what cannot be tracked is searched
    once in some 10 to 100 frames. The balance starts full: the first frame after `reset` is always searched.

    - ``other``: for all other frames: ``"tcae"`` (the shipped network) or ``"whitening"``, which needs no ONNX
      Runtime.
    - ``span_m``: see `OfdmCancel`
    - ``drop_when_slow``: whether frames are dropped where the method is too slow, as the frame segmenter drops them
      with a radio
    - ``cancelled``: frames whose OFDM or QPSK was cancelled
    - ``searched``: frames that were searched

    Raises `MitigationError`: as the methods that it chooses from, or if ``other`` is neither.
    """

    name = "hybrid"
    style = PlotStyle("#4411EE", "X", (0, (8, 1)))
    batch = 1  # the network's last bits depend on the batch
    runs_network = True

    def __init__(
        self,
        waveform: Waveform,
        *,
        other: str = "tcae",
        span_m: float | None = None,
        drop_when_slow: bool = False,
    ) -> None:
        if other not in _OTHERS:
            raise MitigationError(f"hybrid.other is {other!r}; one of {', '.join(_OTHERS)}")
        ofdm = OfdmCancel(waveform, span_m=span_m)
        self._cancellers = (ofdm, QpskCancel(waveform))
        self._returns = ReturnEstimator(waveform, ofdm.span_m, SETTINGS)
        self._other = Tcae(waveform) if other == "tcae" else Whitening(waveform)
        self._detector = InterferenceDetector(waveform)
        self._by: Mitigation = ofdm  # canceller of the last frame that was cancelled
        self._income = _SEARCH_FFTS * _RATE_HZ / waveform.rate_hz if drop_when_slow else np.inf
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.cancelled = self.searched = 0
        self._credit = _MAX_CREDIT
        for method in (*self._cancellers, self._other):
            method.reset()

    def forget(self) -> None:
        """See `Mitigation.forget`: the emitters that are tracked, and what searches have cost."""
        self._credit = _MAX_CREDIT
        for method in self._cancellers:
            method.forget()

    @property
    def sha256(self) -> str | None:
        """SHA-256 of the network's file; None without one."""
        return getattr(self._other, "sha256", None)

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that were cancelled and searched."""
        return super().status() | {"cancelled": self.cancelled, "searched": self.searched}

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out, disturbed = batch.copy(), np.zeros(len(batch), dtype=bool)
        for row, frame in enumerate(batch):
            self._credit = min(self._credit + self._income, _MAX_CREDIT)
            cancelled = self._tracked(frame)
            if cancelled is None and self._detector.present(frame[None])[0]:
                cancelled = self._searched(frame)
                disturbed[row] = cancelled is None
            if cancelled is not None:
                self.cancelled += 1
                out[row], disturbed[row] = self._chosen(frame, cancelled)
        if disturbed.any():
            out[disturbed] = self._other.process(out[disturbed])
        return out

    def _chosen(self, frame: np.ndarray, cancelled: np.ndarray) -> tuple[np.ndarray, bool]:
        """(N,) of a frame and of what a canceller left of it, and whether the network has to clean it."""
        ofdm, burst = self._by is self._cancellers[0], _has_burst(frame)
        if (ofdm or not burst) and self._returns.visibility(cancelled) > _STANDS_OUT:
            return cancelled, False
        received = self._other.process(frame[None])[0]
        if self._detector.residual_db(received[None])[0] < LOST_DB and self._is_consistent(received):
            return received, False
        if ofdm and self._by.outcome.state == "blanked":
            return cancelled, False  # the network has never been trained on a hole
        done = self._detector.white(cancelled[None])[0] or self._is_consistent(cancelled)
        return cancelled, burst or not done

    def _is_consistent(self, frame: np.ndarray) -> bool:
        """Whether one return is left of an (N,) frame; see `ReturnEstimator.is_consistent`."""
        return self._returns.is_consistent(unit_peak(frame[None])[0])

    def _tracked(self, frame: np.ndarray) -> np.ndarray | None:
        """(N,) frame without the emitter of the frame before; None if there was none, or it is lost."""
        for method in self._cancellers:
            out = method.cancel(frame, search=False) if method.tracking else None
            if out is not None:
                self._by = method
                return out
        return None

    def _searched(self, frame: np.ndarray) -> np.ndarray | None:
        """(N,) frame without its OFDM or QPSK; None where neither is there, or needed, or can be searched in time."""
        if self._credit < 0 or self._returns.visibility(frame) > _STANDS_OUT:
            return None
        self.searched += 1
        for method in self._cancellers:
            out = method.cancel(frame)
            self._credit -= method.outcome.ffts
            if out is not None:
                self._by = method
                lost = getattr(method, "burst_weight", 1.0) < _MIN_WEIGHT
                return None if lost and self._other.runs_network else out
        return None


def _has_burst(frame: np.ndarray) -> bool:
    """Whether an (N,) frame has a part that is much quieter than the others."""
    part = frame.size // _PARTS
    power = [np.vdot(x, x).real for x in frame[: part * _PARTS].reshape(_PARTS, part)]
    return min(power) < _QUIET * np.mean(power)
