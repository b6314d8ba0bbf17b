"""Block LMS as the paper sets it, both wirings, and normalised LMS beside it.

Block LMS is explicit Euler on a stiff gradient flow: it is stable only for about ``mu L block P < 2`` with ``P`` the
input power (DESIGN.md 4), so in the paper's setting it diverges for an input power above about 6. That is reported as
divergence, not repaired; `Nlms` is the repaired method.
"""

from __future__ import annotations

import numpy as np

from ..waveform import Waveform
from .base import Mitigation, MitigationError

__all__ = ["BlockLms", "Nlms"]

# Weights of a filter that maps a signal onto a unit-power one never need to be this large; beyond it the recursion
# has left the region of convergence and the next blocks only overflow.
_WEIGHT_LIMIT = 1e6


class BlockLms(Mitigation):
    """Block LMS: ``y = X w``, ``w += mu X^H (d - y)`` once a block.

    Parameters
    ----------
    length : int
        Filter length ``L`` (paper: 32).
    block : int
        Samples between weight updates (paper: 100); has to divide the frame or the last block is shorter.
    step : float
        Step size ``mu`` (paper: 1e-4), not normalised.
    wiring : str
        ``"reference_desired"``: the received frame is filtered towards the reference sweep.
        ``"reference_input"``: the reference sweep is filtered towards the received frame, the output being the part
        of the frame that the reference explains. Delays up to ``length`` samples can be explained (20 m a sample).
    restart : bool
        Start every frame from zero weights. Weights that are kept hold the last frames' altitude, and what they make of
        a frame at another one shows the old altitude; they pay where altitude and phase stand still.

    Notes
    -----
    On divergence (weights beyond 1e6 or not finite) the rest of the frame is silent, the frame is counted in
    ``diverged_frames`` and adaptation starts anew with the next frame.
    """

    name = "lms"

    def __init__(
        self,
        waveform: Waveform,
        *,
        length: int = 32,
        block: int = 100,
        step: float = 1e-4,
        wiring: str = "reference_desired",
        restart: bool = False,
    ) -> None:
        if wiring not in ("reference_desired", "reference_input"):
            raise MitigationError(f"lms.wiring is {wiring!r}; allowed: reference_desired, reference_input")
        if not (1 <= length <= waveform.samples_per_frame and 1 <= block <= waveform.samples_per_frame):
            raise MitigationError(
                f"lms.length {length} and lms.block {block} have to be within 1..{waveform.samples_per_frame}"
            )
        if not (np.isfinite(step) and step > 0):
            raise MitigationError(f"lms.step is {step!r}; it has to be a finite number above 0")
        self.length, self.block, self.step, self.wiring = length, block, step, wiring
        self.restart = restart
        if wiring == "reference_input":
            self.name = "lms_reference_input"
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`: weights and delay line start at zero."""
        super().reset()
        self.weights = np.zeros(self.length, dtype=np.complex64)
        self._line = np.zeros(self.length - 1 + self.waveform.samples_per_frame, dtype=np.complex64)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = np.empty_like(batch)
        for frame, cleaned in zip(batch, out, strict=True):
            reference = self.waveform.reference
            if self.wiring == "reference_desired":
                self._filter(frame, reference, cleaned)
            else:
                self._filter(reference, frame, cleaned)
        return out

    def _filter(self, source: np.ndarray, desired: np.ndarray, out: np.ndarray) -> None:
        """Adapt over one frame; ``out`` receives the filter's output."""
        past = self.length - 1
        line = self._line
        if self.restart:
            line[:] = 0
            self.weights = np.zeros_like(self.weights)
        line[:past] = line[line.size - past :]
        line[past:] = source
        taps = np.lib.stride_tricks.sliding_window_view(line, self.length)
        diverged = False
        with np.errstate(over="ignore", invalid="ignore"):
            for first in range(0, source.size, self.block):
                span = slice(first, min(first + self.block, source.size))
                x = taps[span]
                np.matmul(x, self.weights, out=out[span])
                error = desired[span] - out[span]
                self.weights = self.weights + np.complex64(self._gain(x)) * (np.conj(error) @ x).conj()
                if not np.abs(self.weights).max() < _WEIGHT_LIMIT:
                    out[span.start :] = 0
                    diverged = True
                    break
        if diverged:
            self.diverged_frames += 1
            self.weights = np.zeros_like(self.weights)
            self._line[:] = 0

    def _gain(self, x: np.ndarray) -> float:
        """Step size of one block of tap vectors ``x`` (block, L)."""
        return self.step

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`."""
        return super().status() | {"wiring": self.wiring, "step": self.step}


class Nlms(BlockLms):
    """Block LMS with the step normalised by the block's energy: ``mu / (eps + trace(X^H X))``, 0 < ``mu`` < 2.

    The bound ``mu lambda_max < 2`` then holds for every input power, because the trace of ``X^H X`` bounds its largest
    eigenvalue (S. Haykin, Adaptive Filter Theory, 4th ed., ch. 6).

    Notes
    -----
    The defaults are the best of those measured (docs/stability.md): the reference as input, 96 taps for delays up to
    1900 m, a fresh start with every frame. With the reference as desired signal every altitude comes out as zero.
    """

    name = "nlms"

    def __init__(
        self,
        waveform: Waveform,
        *,
        length: int = 96,
        block: int = 25,
        step: float = 1.9,
        wiring: str = "reference_input",
        restart: bool = True,
    ) -> None:
        length = min(length, waveform.samples_per_frame)
        super().__init__(waveform, length=length, block=block, step=step, wiring=wiring, restart=restart)
        if not step < 2:
            raise MitigationError(f"nlms.step is {step!r}; it has to be below 2 to be stable")
        self.name = "nlms"

    def _gain(self, x: np.ndarray) -> float:
        # trace of X^H X: the sum of all eigenvalues, so never below the largest
        first, last = x[:, -1], x[0, :-1]
        energy = np.vdot(first, first).real * self.length
        edge = np.vdot(last, last).real * self.length
        return self.step / (1e-12 + energy + edge)
