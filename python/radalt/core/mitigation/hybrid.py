"""Two methods, one of them per frame: OFDM that fills the frame is cancelled, all else goes to the other."""

from __future__ import annotations

import numpy as np

from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .ofdm_cancel import OfdmCancel
from .tcae import Tcae
from .whitening import Whitening

__all__ = ["Hybrid"]

_BURST = 0.45  # of a frame: of a shorter burst the other method leaves enough of the sweep
_OTHERS: dict[str, type[Mitigation]] = {"tcae": Tcae, "whitening": Whitening}


class Hybrid(Mitigation):
    """`OfdmCancel` where it can demodulate what fills the frame, the network or whitening where it cannot.

    Card: *choice by signal.* Each frame goes through one method. A chain of both gains nothing, since the first leaves
    a signal that the second is not made for. The choice depends on whether OFDM was demodulated, not on which output
    looks better. So no frame is chosen for its altitude, and false altitudes are as rare as those of the method that
    had the frame.

    Parameters
    ----------
    other : str
        For frames without OFDM: ``"tcae"`` (the shipped network) or ``"whitening"``, which needs no ONNX Runtime.
    span_m : float or None
        See `OfdmCancel`.

    Attributes
    ----------
    cancelled : int
        Frames whose OFDM was cancelled.

    Raises
    ------
    MitigationError
        As the two methods, or if ``other`` is neither.
    """

    name = "hybrid"
    style = PlotStyle("#000000", "X", (0, (8, 1)))
    batch = 1  # the network's last bits depend on the batch
    runs_network = True

    def __init__(self, waveform: Waveform, *, other: str = "tcae", span_m: float | None = None) -> None:
        if other not in _OTHERS:
            raise MitigationError(f"hybrid.other is {other!r}; one of {', '.join(_OTHERS)}")
        self._cancel = OfdmCancel(waveform, span_m=span_m)
        self._other = _OTHERS[other](waveform)
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.cancelled = 0
        self._cancel.reset()
        self._other.reset()

    @property
    def sha256(self) -> str | None:
        """SHA-256 of the network's file; None without one."""
        return getattr(self._other, "sha256", None)

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that were cancelled."""
        return super().status() | {"cancelled": self.cancelled}

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = np.empty_like(batch)
        for row, frame in zip(out, batch, strict=True):
            cancelled = self._cancel.cancel(frame)
            if cancelled is None or self._cancel.busy < _BURST:
                row[:] = self._other.process(frame)
            else:
                row[:] = cancelled
                self.cancelled += 1
        return out
