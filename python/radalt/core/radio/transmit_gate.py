"""Transmit gate in the stream before a transmitter: zeros unless every condition for transmission holds.

The interlock at the start of a flowgraph (`require_enclosure`) can be disabled with its snippet, and does not run where
another program uses the generated class. The gate cannot be bypassed: samples reach the radio through it only.
"""

import time
from collections.abc import Callable

import numpy as np

from ..scene import Scene
from .interlock import InterlockError, require_enclosure

WATCHDOG_S = 1.0  # longest silence of remote control, s; after it a controlled gate passes zeros


class TransmitGate:
    """Samples pass unchanged while transmission is allowed; zeros come out otherwise.

    Transmission is allowed while all of these hold:

    - the scene states an enclosure, its numbers are plausible and ``transmit`` is set (`require_enclosure`, asked once)
    - where the flowgraph is ``controlled`` from outside, `beat` has been called within the last ``watchdog_s``
    - `close` has not been called, and every sample so far was finite and within `full_scale`.

    A gate that has closed for one of the last two stays closed: restart the program to transmit again.

    >>> gate, out = TransmitGate(Scene(), True), np.ones(3, np.complex64)
    >>> gate.pass_into(np.ones(3, np.complex64), out)
    >>> out.any(), gate.why_closed.startswith("transmit refused")
    (False, True)
    """

    def __init__(
        self,
        scene: Scene,
        transmit: bool,
        *,
        controlled: bool = False,
        watchdog_s: float = WATCHDOG_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._watchdog_s, self._clock = watchdog_s, clock
        self._controlled = bool(controlled)
        self._beat_s: float | None = None
        self._closed: str | None = None
        self.zeroed_samples = 0
        self.full_scale = float("inf")  # largest value of I and Q; the radios' set-up sets it
        try:
            require_enclosure(scene, transmit is True)
        except InterlockError as error:
            self._closed = str(error)

    def beat(self) -> None:
        """Signal that control is alive; the next beat has to follow within ``watchdog_s``."""
        self._lapse()  # a beat after the limit does not open the gate
        self._beat_s, self._controlled = self._clock(), True

    def close(self, why: str) -> None:
        """Zeros, for good; the first reason is kept."""
        self._closed = self._closed or why

    @property
    def why_closed(self) -> str | None:
        """Reason for zeros, one line; None while samples pass."""
        self._lapse()
        if self._closed is None and self._controlled and self._beat_s is None:
            return "transmit waits for remote control to come up"
        return self._closed

    def _lapse(self) -> None:
        if self._beat_s is not None and self._clock() - self._beat_s > self._watchdog_s:
            self.close(
                f"transmit stopped: remote control was silent for more than {self._watchdog_s:g} s; start again"
            )

    def pass_into(self, samples: np.ndarray, out: np.ndarray) -> None:
        """(n,) complex64 ``samples``, or zeros, into ``out`` of the same shape."""
        if self.why_closed is None and len(samples):
            rails = samples.view(np.float32)
            # NaN propagates and fails every comparison
            largest = max(float(rails.max()), -float(rails.min()))
            if not np.isfinite(largest):
                # UHD's conversion of NaN to the converter's integers is undefined
                self.close("transmit stopped: a sample that is not finite; start again")
            elif largest > self.full_scale:
                self.close(
                    f"transmit stopped: a sample of {largest:.3g}, and the converter's full scale is "
                    f"{self.full_scale:.3g}; start again with a scene of that level"
                )
        if self.why_closed is None:
            out[:] = samples
        else:
            out[:] = 0
            self.zeroed_samples += len(out)
