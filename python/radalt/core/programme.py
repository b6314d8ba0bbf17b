"""Altitude programme: true altitude by frame index (docs/design.md).

The blocks schedule altitudes by frame index, never by sleeping or callbacks, so that a run is a function of its seed.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

_MOST_FRAMES = 2_000_000  # longest run, frames: half an hour of 1 ms sweeps; more trials need more points
_FRAME_BYTES = 80  # memory per frame and method, bytes: results and the altitude table
# altitudes set by hand that are kept: more than are set while a frame travels through the flowgraph
_CHANGES = 1000


@dataclass(frozen=True)
class Programme:
    """Altitude steps framed by synchronisation frames."""

    altitudes_m: tuple[float, ...] = (200.0,)
    """Altitudes in the order they are flown."""
    frames_per_step: int = 15
    """Frames at each altitude (trials)."""
    preamble_frames: int = 8
    """Frames at synthetic altitude zero with the jammer silent, on which the segmenter acquires timing."""
    sync_every_frames: int = 0
    """Trials between further synchronisation sections; 0 for none."""
    sync_frames: int = 8
    """Length of a further synchronisation section, in frames."""
    vertical_speed_m_per_s: float = 0.0
    """Range rate during trials; for true delays only (a beat shift has no Doppler)."""
    speeds_m_per_s: tuple[float, ...] = ()
    """Range rate of each altitude, where returns are drawn; empty where they are not."""
    phases_cycles: tuple[float, ...] = ()
    """Carrier phase of each, likewise."""
    hold_last: bool = False
    """True repeats the last altitude without end; False returns to altitude zero, without trials."""

    def __post_init__(self) -> None:
        if not self.altitudes_m:
            raise ValueError("altitude.programme_m is empty; give at least one altitude in metres")
        bad = [a for a in self.altitudes_m if not (np.isfinite(a) and a >= 0)]
        if bad:
            raise ValueError(
                f"altitude.programme_m holds {bad[0]!r}; altitudes have to be finite and 0 or above"
            )
        if self.frames_per_step < 1:
            raise ValueError(f"altitude.frames {self.frames_per_step} has to be at least 1")
        if self.preamble_frames < 6:
            raise ValueError(f"altitude.preamble_frames {self.preamble_frames} has to be at least 6")
        for name in ("preamble_frames", "sync_every_frames", "sync_frames"):
            if getattr(self, name) > _MOST_FRAMES:
                raise ValueError(f"altitude.{name} {getattr(self, name)} has to be at most {_MOST_FRAMES}")
        if self.sync_every_frames < 0:
            raise ValueError(f"altitude.sync_every_frames {self.sync_every_frames} has to be 0 or above")
        if self.sync_every_frames and self.sync_frames < 8:
            raise ValueError(f"altitude.sync_frames {self.sync_frames} has to be at least 8")
        self._check_length()

    def _check_length(self) -> None:
        """Check the run's length before anything is allocated."""
        sections = (self.trial_frames - 1) // self.sync_every_frames if self.sync_every_frames else 0
        total = self.preamble_frames + self.trial_frames + sections * self.sync_frames
        if total > _MOST_FRAMES:
            raise ValueError(
                f"altitude: {len(self.altitudes_m)} altitudes of frames {self.frames_per_step} make {total:.4g}, "
                f"{total / 3.6e6:.3g} h of sweeps of 1 ms and {total * _FRAME_BYTES / 1e9:.3g} GB of results a method; "
                f"at most {_MOST_FRAMES} frames: lower altitude.frames (--frames)"
            )

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Altitude and trial flag by frame index."""
        trial = np.ones(self.trial_frames, dtype=bool)
        return self._framed(self.altitudes_m), self._framed(trial, each=1)

    @cached_property
    def _speeds(self) -> np.ndarray:
        """Range rate by frame index."""
        speeds = self.speeds_m_per_s or (self.vertical_speed_m_per_s,) * len(self.altitudes_m)
        return self._framed(speeds)

    @cached_property
    def _phases(self) -> np.ndarray:
        """Carrier phase of drawn returns by frame index."""
        return self._framed(self.phases_cycles)

    def _framed(self, values: Sequence[float] | np.ndarray, each: int = 0) -> np.ndarray:
        """A value per altitude by frame index, 0 in the preamble and in synchronisation sections."""
        trials = np.repeat(np.asarray(values), each or self.frames_per_step)
        parts = [np.zeros(self.preamble_frames, trials.dtype)]
        step = self.sync_every_frames or trials.size
        for first in range(0, trials.size, step):
            if first:
                parts.append(np.zeros(self.sync_frames, trials.dtype))
            parts.append(trials[first : first + step])
        return np.concatenate(parts)

    @property
    def total_frames(self) -> int:
        """Frames from the start of the preamble to the last trial."""
        return self._table[0].size

    @property
    def trial_frames(self) -> int:
        """Frames that count as trials."""
        return len(self.altitudes_m) * self.frames_per_step

    def altitude_m(self, frame_index: np.ndarray | int) -> np.ndarray:
        """True altitude of frames, any shape; zero outside the programme."""
        return self._look_up(self._table[0], frame_index)

    def is_trial(self, frame_index: np.ndarray | int) -> np.ndarray:
        """Whether frames count as trials, any shape."""
        return self._look_up(self._table[1], frame_index)

    def speed_m_per_s(self, frame_index: np.ndarray | int) -> np.ndarray:
        """Range rate of frames, any shape."""
        return self._look_up(self._speeds, frame_index)

    def phase_cycles(self, frame_index: int) -> float | None:
        """Carrier phase of a frame's drawn return; None where none is drawn."""
        if not (self.phases_cycles and self.is_trial(frame_index)):
            return None
        return float(self._phases[frame_index])

    def at(self, frame_index: int) -> tuple[float, float]:
        """Altitude and range rate of one frame, without the overhead of arrays."""
        altitude, _ = self._table
        if 0 <= frame_index < altitude.size:
            return float(altitude[frame_index]), float(self._speeds[frame_index])
        return float(self.altitude_m(frame_index)), float(self.speed_m_per_s(frame_index))

    def _look_up(self, table: np.ndarray, frame_index: np.ndarray | int) -> np.ndarray:
        index = np.asarray(frame_index)
        inside = (index >= 0) & (self.hold_last | (index < table.size))
        return np.where(inside, table[np.clip(index, 0, table.size - 1)], np.zeros(1, table.dtype)[0])

    def next_sync(self, frame_index: int) -> tuple[int, int] | None:
        """First synchronisation section that starts at or after a frame: (first frame, length), or None."""
        trial = self._table[1]
        ahead = np.nonzero(~trial[max(0, frame_index) :])[0]
        if frame_index >= trial.size or ahead.size == 0:
            return None
        first = max(0, frame_index) + int(ahead[0])
        if first == frame_index > 0 and not trial[frame_index - 1]:  # inside a section: return the next one
            rest = np.nonzero(trial[first:])[0]
            return None if rest.size == 0 else self.next_sync(first + int(rest[0]))
        length = np.nonzero(trial[first:])[0]
        return first, int(length[0]) if length.size else trial.size - first


class SentAltitudes:
    """Altitude of every transmitted sweep: the programme's, or one of the last thousand set by hand after the preamble.

    One thread may `set` while another reads.

    Examples
    --------
    >>> sent = SentAltitudes(Programme(altitudes_m=(900.0,)))
    >>> sent.set(0, 200.0)
    >>> sent.at(0), sent.at(8)
    ((0.0, 0.0), (200.0, 0.0))
    """

    def __init__(self, programme: Programme) -> None:
        self.programme = programme
        self._changes: deque[tuple[int, float | None]] = deque(maxlen=_CHANGES)

    @property
    def by_hand(self) -> bool:
        """Whether an altitude was ever set by hand."""
        return bool(self._changes)

    def set(self, first_index: int, altitude_m: float | None) -> None:
        """``altitude_m`` metres from sweep ``first_index`` on; None: the programme's again."""
        self._changes.append((first_index, altitude_m))

    def at(self, index: int) -> tuple[float, float]:
        """Altitude in metres and range rate in m/s of one sweep; an altitude set by hand has no rate."""
        if index >= self.programme.preamble_frames:
            for first, altitude in reversed(list(self._changes)):
                if first <= index:
                    if altitude is not None:
                        return altitude, 0.0
                    break
        return self.programme.at(index)

    def altitude_m(self, index: np.ndarray) -> np.ndarray:
        """Altitudes in metres of sweeps, any shape."""
        index = np.asarray(index)
        out = np.asarray(self.programme.altitude_m(index), dtype=float).copy()
        for first, altitude in list(self._changes):  # a copy in one step: another thread may add to it
            here = index >= max(first, self.programme.preamble_frames)
            out[here] = self.programme.altitude_m(index[here]) if altitude is None else altitude
        return out
