"""Block LMS as the paper sets it, both wirings, and normalised LMS next to it.

Block LMS is explicit Euler on a stiff gradient flow. It is stable only for about ``mu L block P < 2`` with ``P`` the
input power, so in the paper's setting it diverges for an input power above about 6. That is reported as divergence, not
repaired; `Nlms` is the repaired method.
"""

import numpy as np

from ..altimeter.altimeter import Altimeter, AltimeterSettings, shared_altimeter
from ..waveform import Waveform, delay_to_altitude_m
from .base import Mitigation, MitigationError, PlotStyle

# Weights of a filter that maps a signal onto a unit-power one never need to be this large; beyond it the recursion
# has left the region of convergence and the next blocks only overflow.
_WEIGHT_LIMIT = 1e6
_CHECKED = 8  # blocks whose weights are checked together: a check costs as much as a block's product


class BlockLms(Mitigation):
    """Block LMS: ``y = X w``, ``w += mu X^H (d - y)`` once per block.

    On divergence (weights beyond 1e6 or not finite) the rest of the frame is silent, the frame is counted in
    ``diverged_frames`` and adaptation starts anew with the next frame.

    With the reference as input the output is a sum of delayed sweeps whatever is received: noise, Doppler and
    altitudes beyond the filter all become an altitude. A frame is therefore silenced, and counted in
    ``unconfirmed_frames``, unless its strongest beats also exceed the noise of the received frame. Weights that
    change once per block put images next to the return, every ``rate / block`` (75 kHz, 750 m), 25 dB below it in one
    half sweep and as strong as it in the other. Images of a return within the span are harmless; those of a return
    beyond it would be declared.

    - ``length``: filter length ``L`` (paper: 32)
    - ``block``: samples between weight updates (paper: 100); has to divide the frame or the last block is shorter
    - ``step``: step size ``mu`` (paper: 1e-4), not normalised
    - ``wiring``: ``"reference_desired"``: the received frame is filtered towards the reference sweep.
      ``"reference_input"``: the reference sweep is filtered towards the received frame, the output being the part of
      the frame that the reference explains. Delays up to ``length`` samples can be explained (20 m per sample).
    - ``span_m``: with the reference as input: highest altitude up to which the output is checked. None: 1500 m, as in
      the altimeter, or the filter's reach where that is lower.
    - ``restart``: start every frame from zero weights. Kept weights hold the altitude of the last frames, and a frame
      at another altitude then shows the old one. Keeping them helps in a static channel.
    """

    name = "lms"
    style = PlotStyle("#E69F00", "v", (0, (1, 1.2)))
    batch = 64  # frames share the calls per block
    # parameter of `Altimeter.confirms`; 1 is the paper's setting, without a test against noise
    _confirmed_pfa = 1.0

    def __init__(
        self,
        waveform: Waveform,
        *,
        length: int = 32,
        block: int = 100,
        step: float = 1e-4,
        wiring: str = "reference_desired",
        restart: bool = False,
        span_m: float | None = None,
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
            self.name = BlockLmsReferenceInput.name
        if span_m is not None and not 0 < span_m < np.inf:
            raise MitigationError(f"lms.span_m is {span_m!r}; it has to be a finite number of metres above 0")
        self._check = self._altimeter(waveform, span_m) if wiring == "reference_input" else None
        super().__init__(waveform)

    def _altimeter(self, waveform: Waveform, span_m: float | None) -> Altimeter:
        """Beat spectra over the span, as far as the filter's length reaches."""
        reach = float(delay_to_altitude_m(self.length / waveform.rate_hz))
        span = span_m or AltimeterSettings().resolved(waveform).max_altitude_m
        top = min(max(min(reach, span), 2 * waveform.range_resolution_m), waveform.max_unambiguous_altitude_m)
        return shared_altimeter(waveform, AltimeterSettings(max_altitude_m=top))

    def reset(self) -> None:
        """See `Mitigation.reset`: weights and delay line start at zero."""
        super().reset()
        self.unconfirmed_frames = 0
        self.forget()

    def forget(self) -> None:
        """See `Mitigation.forget`: weights and delay line."""
        self.weights = np.zeros(self.length, dtype=np.complex64)
        self._past = np.zeros(self.length - 1, dtype=np.complex64)

    @property
    def _remembers(self) -> bool:
        return not (self.restart or self.independent)

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = np.empty_like(batch)
        reference = self.waveform.reference[None]
        # frames that start from zero weights are independent: one pass over the blocks adapts all of them
        step = 1 if self._remembers else len(batch)
        for first in range(0, len(batch), step):
            frames, cleaned = batch[first : first + step], out[first : first + step]
            if self.wiring == "reference_desired":
                self._filter(frames, reference, cleaned)
            else:
                self._filter(reference, frames, cleaned)
        if self._check is not None:
            unconfirmed = ~self._check.confirms(batch, out, self._confirmed_pfa)
            self.unconfirmed_frames += int(unconfirmed.sum())
            out[unconfirmed] = 0
        return out

    def _filter(self, source: np.ndarray, desired: np.ndarray, out: np.ndarray) -> None:
        """Adapt over frames (n or 1, N), each with weights of its own; ``out`` (n, N) receives the filters' output."""
        past, count, samples = self.length - 1, *out.shape
        line = np.zeros((len(source), past + samples), dtype=np.complex64)
        weights = np.zeros((count, self.length), dtype=np.complex64)
        if self._remembers:
            line[:, :past], weights[:] = self._past, self.weights
        line[:, past:] = source
        adapt = self._adapt_one if count == 1 else self._adapt
        firsts = range(0, samples, self.block)
        with np.errstate(over="ignore", invalid="ignore"):
            peaks, weights = adapt(line, desired, out, weights, firsts)
            diverged = ~(peaks < _WEIGHT_LIMIT)
        self._past, self.weights = line[-1, samples:], weights[-1].copy()
        for row in np.flatnonzero(diverged.any(axis=0)):
            out[row, firsts[int(diverged[:, row].argmax())] :] = 0
            self.diverged_frames += 1
            self._past, self.weights = np.zeros_like(self._past), np.zeros_like(self.weights)

    def _adapt(
        self, line: np.ndarray, desired: np.ndarray, out: np.ndarray, weights: np.ndarray, firsts: range
    ) -> tuple[np.ndarray, np.ndarray]:
        """The recursion: largest weights (blocks, n) after each block, and the last weights (n, L)."""
        taps = np.lib.stride_tricks.sliding_window_view(line, self.length, axis=1)
        peaks = np.empty((len(firsts), len(out)), dtype=np.float32)
        # weights after the last blocks, checked together
        history = np.empty((_CHECKED, *weights.shape), dtype=np.complex64)
        for k, (gain, first) in enumerate(zip(self._gains(line).T[..., None], firsts, strict=True)):
            span = slice(first, first + self.block)
            x = np.ascontiguousarray(taps[:, span])  # overlapping rows are no matrix to BLAS
            filtered = (x @ weights[..., None])[..., 0]
            out[:, span] = filtered
            error = desired[:, span] - filtered
            change = (np.conjugate(error, out=error)[:, None] @ x)[:, 0]
            np.conjugate(change, out=change)
            change *= gain
            weights = np.add(weights, change, out=history[k % _CHECKED])
            if (k + 1) % _CHECKED == 0 or k + 1 == len(firsts):
                peaks[k - k % _CHECKED : k + 1] = np.abs(history[: k % _CHECKED + 1]).max(axis=2)
        return peaks, weights

    def _adapt_one(
        self, line: np.ndarray, desired: np.ndarray, out: np.ndarray, weights: np.ndarray, firsts: range
    ) -> tuple[np.ndarray, np.ndarray]:
        """`_adapt` for one frame, the same to the bit in 0.7 of the time: vectors instead of stacks of one."""
        desired, filtered, weights = desired[0], out[0], weights[0]
        # a row of taps as one element is copied in half the time
        taps = np.ndarray(filtered.shape, f"V{line.itemsize * self.length}", line, strides=line.strides[1:])
        history = np.empty((len(firsts), self.length), dtype=np.complex64)
        for k, (gain, first) in enumerate(zip(self._gains(line)[0], firsts, strict=True)):
            span = slice(first, first + self.block)
            x = taps[span].copy().view(np.complex64).reshape(-1, self.length)
            error = desired[span] - np.dot(x, weights, out=filtered[span])
            change = np.dot(np.conjugate(error, out=error), x)
            np.conjugate(change, out=change)
            change *= gain
            weights = np.add(weights, change, out=history[k])
        return np.abs(history).max(axis=1)[:, None], weights[None]

    def _gains(self, line: np.ndarray) -> np.ndarray:
        """Step size of every block, from the delay lines (m, L - 1 + N): (m, blocks)."""
        blocks = -(-(line.shape[1] - self.length + 1) // self.block)
        return np.full((len(line), blocks), self.step, dtype=np.complex64)

    @property
    def carries_altitude(self) -> bool:
        """See `Mitigation.carries_altitude`: towards the reference, every altitude is filtered to zero."""
        return self.wiring == "reference_input"

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`."""
        return super().status() | {
            "wiring": self.wiring,
            "step": self.step,
            "unconfirmed_frames": self.unconfirmed_frames,
        }


class BlockLmsReferenceInput(BlockLms):
    """`BlockLms` in its other wiring: 96 taps for delays up to 1900 m, a fresh start with every frame.

    It declares 3 to 9 % of frames of noise, and 2 to 5 % of those of interference alone (allowed speeds 150 to 0 m/s;
    ``detection.py --methods lms_reference_input --frames 0 --null-frames 40 --noise-frames 1000 --seed 909``). The
    weights keep a remnant of either, which gives both half sweeps the same delay. `Nlms` checks it against the
    received frame; this class keeps the paper's setting.
    """

    name = "lms_reference_input"
    style = PlotStyle("#CC79A7", "^", (0, (3, 1.2, 1, 1.2)))

    def __init__(
        self,
        waveform: Waveform,
        *,
        wiring: str = "reference_input",
        length: int = 96,
        restart: bool = True,
        **parameters: object,
    ) -> None:
        super().__init__(waveform, wiring=wiring, length=length, restart=restart, **parameters)


class Nlms(BlockLms):
    """Block LMS with the step normalised by the block's energy: ``mu / trace(X^H X)``, 0 < ``mu`` < 2.

    The bound ``mu lambda_max < 2`` then holds for every input power, because the trace of ``X^H X`` bounds its
    largest eigenvalue (S. Haykin, Adaptive Filter Theory, 4th ed., ch. 6).

    The defaults are the best of those measured (docs/stability.md): the reference as input, 96 taps for delays up to
    1900 m, a fresh start with every frame. With the reference as desired signal every altitude comes out as zero.

    The weights keep a remnant of noise, which gives both half sweeps the same delay: 5 % of frames without a return
    would be declared. So the received frame has to show the delay as well, with 1e-4 false alarms per pair of cells.
    That leaves 1 % and costs less than 0.01 in Pd.
    """

    name = "nlms"
    style = PlotStyle("#56B4E9", "D", (0, (5, 1.5)))
    _confirmed_pfa = 1e-4  # probability per pair of cells that noise alone is as strong

    def __init__(
        self,
        waveform: Waveform,
        *,
        length: int = 96,
        block: int = 25,
        step: float = 0.8,
        wiring: str = "reference_input",
        restart: bool = True,
        span_m: float | None = None,
    ) -> None:
        length = min(length, waveform.samples_per_frame)
        super().__init__(
            waveform, length=length, block=block, step=step, wiring=wiring, restart=restart, span_m=span_m
        )
        if not step < 2:
            raise MitigationError(f"nlms.step is {step!r}; it has to be below 2 to be stable")
        self.name = "nlms"

    def _gains(self, line: np.ndarray) -> np.ndarray:
        power = line.real.astype(float) ** 2 + line.imag.astype(float) ** 2
        energy = np.concatenate([np.zeros((len(line), 1)), np.cumsum(power, axis=1)], axis=1)
        in_taps = energy[:, self.length :] - energy[:, : -self.length]  # energy of each tap vector
        trace = np.add.reduceat(in_taps, np.arange(0, in_taps.shape[1], self.block), axis=1)
        # differences of a running sum have no digits left for a block that is far weaker than the frame
        floor = 1e-12 * (1.0 + energy[:, -1:])
        return (self.step / np.maximum(trace, floor)).astype(np.complex64)
