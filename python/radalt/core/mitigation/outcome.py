"""What a canceller says about a frame: the interface between the cancellers and `Hybrid`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """Result of one frame."""

    state: str = "passed"
    """``"passed"``: nothing was found, or nothing that can be demodulated; the frame is as it came. ``"visible"``:
    the return stands out already; nothing was searched, and the frame is as it came. ``"blanked"``: a short loud
    burst was set to zero. ``"acquired"``: an emitter was found by search, and subtracted. ``"tracked"``: the emitter
    of the frame before was subtracted, without a search."""
    suppression_db: float = 0.0
    """Power of the frame over the power of what is left, at least 0 where something was subtracted."""
    evm: float = 0.0
    """Root mean square error of the emitter's symbols relative to their own; 0 where nothing was demodulated."""
    ffts: float = 0.0
    """Cost in FFTs of 7,500 points, counted from the operations that ran: the same on every machine."""

    @property
    def cancelled(self) -> bool:
        """Whether the frame was changed."""
        return self.state in ("blanked", "acquired", "tracked")


PASSED = Outcome()
