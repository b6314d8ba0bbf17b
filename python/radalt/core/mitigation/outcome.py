"""What a canceller is and says about a frame: the interface between the cancellers and `Hybrid`."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from .base import Mitigation


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


class Canceller(Mitigation):
    """A method that demodulates an emitter and subtracts it.

    - ``tracked``: frames in which it was tracked from the frame before
    - ``outcome``: of the last frame that `cancel` was given
    - ``outcomes``: one per finite frame of the last call of `process`
    """

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.tracked = 0
        self.outcome, self.outcomes = PASSED, list[Outcome]()
        self.forget()

    def forget(self) -> None:
        """See `Mitigation.forget`: the emitter that is tracked."""
        self._state = None

    @property
    def tracking(self) -> bool:
        """Whether an emitter is known from the frame before, so that ``cancel(frame, search=False)`` may cancel it."""
        return self._state is not None

    @abstractmethod
    def cancel(self, frame: np.ndarray, *, search: bool = True) -> np.ndarray | None:
        """(N,) complex64: a finite frame without its emitter; None if it passes as it came, see ``outcome``.

        ``search=False`` only tracks an emitter of the frame before.
        """

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out, self.outcomes = batch.copy(), []
        for row, frame in zip(out, batch, strict=True):
            cancelled = self.cancel(frame)
            self.outcomes.append(self.outcome)
            if cancelled is not None:
                row[:] = cancelled
        return out
