"""Deleter: when a track ends."""

from __future__ import annotations

from collections.abc import Iterable

from .track import Track
from .tracker_settings import TrackerSettings

__all__ = ["Deleter"]

# Mean over ten blocks of the normalised innovation squared, above which a track contradicts its measurements. A
# consistent track has 1 and exceeds 8 in none of 1e9 blocks (chi square of ten values).
_INCONSISTENT = 8.0


class Deleter:
    """Ends tracks: after a time without measurements, where they contradict themselves, where the ground has stepped.

    Parameters
    ----------
    settings : TrackerSettings
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self.settings = settings

    def missed(self, track: Track) -> bool:
        """Count a block without a measurement of a track; whether the track has coasted for too long."""
        s = self.settings
        track.missed += 1
        # one poor block leaves a certain track what it is, but not one that is just back from coasting
        if track.missed > 1 or not track.resolved or track.hits < s.confirm_outputs:
            track.hits = 0
        return track.missed * s.output_s > s.coast_s

    def inconsistent(self, track: Track) -> bool:
        """Whether a track's innovations exceed what its filter expects by far."""
        return track.filter.nis > _INCONSISTENT

    def replaced(self, track: Track, candidates: Iterable[Track]) -> bool:
        """Whether the ground has stepped: nothing is left at the track's place, and a candidate is confirmed."""
        return not track.seen and any(c.hits >= self.settings.confirm_outputs for c in candidates)
