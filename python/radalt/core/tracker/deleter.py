"""Deleter: when a track ends."""

from collections.abc import Iterable

import numpy as np

from .gate import Gate
from .rivals import OWN_CELLS, stands_apart
from .scan import Scan
from .summed_block import Measurement
from .track import Track
from .tracker_settings import TrackerSettings

# Mean over ten blocks of the normalised innovation squared, above which a track contradicts its measurements. A
# consistent track has 1 and exceeds 8 in none of 1e9 blocks (chi square of ten values).
_INCONSISTENT = 8.0
# Resolution cells from the nearest point of spread ground at which a track is another's, a part of it farther off.
_ELSEWHERE_CELLS = 2.0
# Blocks in a row in which a place has to be vacant. One alone may be a fade; with three, a step of the ground costs one
# output more, and no pull-off was found in which that made a difference (docs/tracker.md).
_VACANT_BLOCKS = 2
# Standard deviations of a prediction within which a deleted track's return is expected, and the least and largest width
# in resolution cells: a half, since returns nearer than that are one peak; three, beyond which side lobes are examined
# that interference covers.
_PLACE_SIGMAS, _LEAST_PLACE_CELLS, _MOST_PLACE_CELLS = 4.0, 0.5, 3.0


class Deleter:
    """Ends tracks: after a time without measurements, where measurements contradict them, at a step of the ground.

    After a second without measurement a track ends (`TrackerSettings.coast_s`). The search never stops: a step of the
    ground is a new candidate, which takes over once it is confirmed and nothing is left at the track's place. While
    both are there, neither altitude is given.

    A track that was certain is remembered after its end, until its place is vacant in two blocks in a row: these show
    nothing there that the successor's own lobes do not explain, and at the place itself the successor has the old
    track's Doppler. Before that its successor may be a false return that has pulled the tracker off (range-gate
    pull-off), and is no altitude. There is no time limit, since a pull-off can last.

    ``threshold``: strength from which a return can be held against a track's place. ``predecessor``: the certain
    track that ended last and whose place is not vacant yet.
    """

    def __init__(self, gate: Gate, settings: TrackerSettings, threshold: float) -> None:
        self.gate, self.tables, self.settings, self.threshold = gate, gate.tables, settings, threshold
        self.predecessor: Track | None = None

    def reset(self) -> None:
        """Forget the predecessor."""
        self.predecessor = None

    def missed(self, track: Track) -> bool:
        """Count a block without a measurement of a track; whether the track has coasted for too long."""
        s = self.settings
        track.missed += 1
        # one poor block leaves a certain track what it is, but not one that is just back from coasting
        if track.missed > 1 or not track.resolved or track.hits < s.confirm_outputs:
            track.hits = 0
        return track.missed * s.output_s > s.coast_s

    def inconsistent(self, track: Track, scan: Scan) -> bool:
        """Whether a track's innovations exceed what its filter expects by far, or the nearest ground is elsewhere."""
        off_m = (
            0.0
            if scan.ground is None
            else abs(track.latest.altitude_m - (scan.ground.altitude_m - scan.residual_m))
        )
        return (
            track.filter.nis > _INCONSISTENT
            or off_m > _ELSEWHERE_CELLS * self.tables.waveform.range_resolution_m
        )

    def replaced(self, track: Track, candidates: Iterable[Track]) -> bool:
        """Whether the ground has stepped: nothing is left at the track's place, and a candidate is confirmed."""
        return not track.seen and any(c.hits >= self.settings.confirm_outputs for c in candidates)

    def end(self, track: Track) -> None:
        """Remember a track that has ended, if it was certain and its place is not vacant."""
        if track.resolved and self.predecessor is None and track.vacant < _VACANT_BLOCKS:
            self.predecessor = track

    def watch(self, track: Track | None, scan: Scan) -> None:
        """Count the blocks that show nothing at the place of the predecessor, or of a track that this block misses."""
        watched = self.predecessor
        if watched is None and track is not None and track.missed and track.resolved:
            watched = track
        if watched is None:
            return
        block = scan.block
        found = block.best()
        if found is None or found.strength < self.threshold:
            watched.vacant = 0
            return
        watched.vacant = 0 if self._occupied(watched, scan, scan.corrected(found)) else watched.vacant + 1
        if watched is self.predecessor and watched.vacant >= _VACANT_BLOCKS:
            self.predecessor = None

    def _occupied(self, track: Track, scan: Scan, found: Measurement) -> bool:
        """Whether something stands where a track is expected that the lobes of the strongest return do not explain."""
        t = self.tables
        row = np.array([1.0, -scan.lead_s])
        apart_m = float(row @ track.filter.mean) - found.altitude_m
        sigma_m = float(np.sqrt(row @ track.filter.covariance @ row))
        cell_m = t.waveform.range_resolution_m
        width_m = min(max(_PLACE_SIGMAS * sigma_m, _LEAST_PLACE_CELLS * cell_m), _MOST_PLACE_CELLS * cell_m)
        if abs(apart_m) <= OWN_CELLS * cell_m and not self.gate.near_speed(track, found):
            return True
        blocks = (scan.block,) if scan.sum_received is None else (scan.block, scan.received)
        return any(stands_apart(b, found, apart_m / t.cell_m, width_m / t.cell_m) for b in blocks)
