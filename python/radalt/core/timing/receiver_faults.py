"""Faults of a receiver that leave its frames valid and wrong: frozen samples, a quadrature error."""

import numpy as np

from .repeated_frames import RepeatedFrames
from .sweep_finder import SweepFinder

# Number of samples that distinguish frames: hard clipping leaves two bits of each sample, and behind a converter,
# noise of half a step leaves one sample in three unchanged.
_MARKS = 32
_EVERY = 64  # frames between two checks of the quadrature: 8 FFTs each, 0.13 per frame
# Conjugate over sweep, power ratio (-10 dB), from which the quadrature is wrong. A sample between the rails gives
# -2 dB, and moves the altitude by 10 m; an IQ imbalance of 1 dB and 10 degrees, which moves none, gives -19 dB.
_IMAGE_SHARE = 0.1


class ReceiverFaults:
    """Examines frames as they are received, at known timing.

    ``noise``: whether samples carry noise; without it equal frames are no fault. ``fault``: by the last frame:
    ``""``, ``"frozen"`` (it repeats one of the last second) or ``"quadrature"`` (it holds the complex conjugate of
    the sweep too: one rail is dead or delayed).
    """

    def __init__(self, finder: SweepFinder, *, noise: bool) -> None:
        self._finder = finder
        self._repeated = RepeatedFrames(finder.waveform.sweep_s) if noise else None
        self._step = max(1, finder.waveform.samples_per_frame // _MARKS)
        self.fault = ""

    def marks(self, frames: np.ndarray) -> list[bytes]:
        """Samples that distinguish each frame (n, N); empty without noise, and for zeros, which are no signal."""
        if self._repeated is None:
            return [b""] * len(frames)
        marks = frames[:, :: self._step].astype(np.complex64)
        signal = marks.any(axis=1).tolist()
        return [mark.tobytes() if some else b"" for mark, some in zip(marks, signal, strict=True)]

    def found_in(self, samples: np.ndarray, mark: bytes, index: int) -> bool:
        """Whether a frame is faulty, by its samples and its `marks`; sets `fault`."""
        if mark and self._repeated is not None and self._repeated.again(mark):
            self.fault = "frozen"
        elif self.fault == "quadrature" or index % _EVERY == 0:
            self.conjugated(samples)
        else:
            self.fault = ""
        return bool(self.fault)

    def conjugated(self, samples: np.ndarray) -> bool:
        """Whether a frame holds the conjugate of its sweep; sets `fault`."""
        self.fault = "quadrature" if self._finder.image_share(samples) >= _IMAGE_SHARE else ""
        return bool(self.fault)
