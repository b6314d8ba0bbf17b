"""Losses of samples without a tag: which slip of timing and frame index explains the measured delays of the sweep."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

MOST_LOST_FRAMES = 64  # most whole frames that are lost at once without a tag
MEMORY_FRAMES = 50  # frames for which a contradicted frame is remembered, and timing counts as verified


@dataclass
class _Doubt:
    """A frame measured at another timing, and the slips that would explain it."""

    index: int  # the frame's, as it was counted
    frames: np.ndarray  # (h,) int: whole frames lost, by slip
    samples: np.ndarray  # (h,) float: timing error of each slip, in samples
    tolerance: float  # largest error of the measured delay, in samples

    def keep(self, which: np.ndarray) -> bool:
        """Drop all slips but some; whether any is left."""
        self.frames, self.samples = self.frames[which], self.samples[which]
        return bool(self.frames.size)

    def possible(self) -> bool:
        """Whether any slip explains it: samples are lost whole."""
        whole = np.rint(self.samples)
        return self.keep(
            (np.abs(self.samples - whole) <= self.tolerance) & ((whole != 0) | (self.frames > 0))
        )

    @property
    def in_time(self) -> bool:
        """Whether a slip of whole frames alone explains it: timing is right, the index is not."""
        return bool(np.any(self.whole_frames))

    @property
    def whole_frames(self) -> np.ndarray:
        """(h,) bool: True where a whole number of frames was lost."""
        return (np.abs(self.samples) <= self.tolerance) & (self.frames > 0)


class Slips:
    """Frames measured at other delays than they were sent with, until enough of them agree on one slip.

    A loss of samples without a tag shifts timing by ``s`` samples and the index by ``q`` frames, and both shifts
    last. A frame measured at another delay than it was sent with gives one ``s`` for every ``q`` from 0 to
    `MOST_LOST_FRAMES`. Frames agree if they give the same pair, and a frame between them that contradicts the pair
    rules it out.

    ``confirm_frames``: frames that have to agree.
    """

    def __init__(self, confirm_frames: int) -> None:
        self._confirm_frames = confirm_frames
        self._doubts: list[_Doubt] = []

    def clear(self) -> None:
        """Forget all frames."""
        self._doubts.clear()

    def note(self, index: int, samples: np.ndarray, tolerance: float, *, known: bool) -> tuple[bool, int]:
        """Note a frame measured at another delay.

        - ``index``: the frame's, as it was counted
        - ``samples`` (MOST_LOST_FRAMES + 1,) float: delay measured less delay sent, in samples, for each number of
          whole frames lost
        - ``tolerance``: tolerance of the measured delay, in samples
        - ``known``: whether the delay sent is known. A frame that no slip explains is then left out.

        Returns ``agreed``: whether enough frames agree on one slip; ``whole``: frames lost, if it may be whole ones
        alone; else 0.
        """
        frames = np.arange(samples.size)
        doubt = _Doubt(index, frames, samples, tolerance)
        if known and not doubt.possible():
            return False, 0
        agreeing = np.ones(doubt.frames.size, dtype=int)
        for other in self._doubts:
            rest = np.full(frames.size, np.inf)
            rest[other.frames] = other.samples
            agreeing += np.abs(rest[doubt.frames] - doubt.samples) <= max(tolerance, other.tolerance)
        self._doubts = [d for d in self._doubts if index - d.index < MEMORY_FRAMES or d.keep(d.whole_frames)]
        self._doubts.append(doubt)
        agreed = agreeing >= self._confirm_frames
        whole = doubt.frames[agreed & doubt.whole_frames]
        return bool(agreed.any()), int(whole[0]) if whole.size else 0

    def rule_out(self, delays: Callable[[], np.ndarray]) -> None:
        """Forget the slips that contradict a frame measured at the delay it was sent with.

        ``delays``: returns (MOST_LOST_FRAMES + 1,) delays in samples that this frame and the following ones were sent
        with. Called only if there is a doubt.
        """
        if self._doubts:
            sent = delays()
            self._doubts = [
                d for d in self._doubts if d.keep(np.abs(sent[d.frames] + d.samples - sent[0]) <= d.tolerance)
            ]

    def in_time(self) -> set[int]:
        """Indices of noted frames that whole lost frames alone explain: their timing is right, their index is not."""
        return {doubt.index for doubt in self._doubts if doubt.in_time}
