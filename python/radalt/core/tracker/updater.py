"""Updater: measures tracks in a block, and updates their filter and evidence."""

import numpy as np

from .gate import Gate
from .rivals import is_side_lobe
from .scan import Scan
from .summed_block import Block, Measurement
from .track import Track
from .track_integrity import Integrity

# Blocks in a row in which a track's altitudes contradict its Doppler: what stands there is a grating lobe. One alone
# may be interference that pulls one half sweep.
_LOBE_BLOCKS = 2
# Cells by which the halves of rivals may differ from the track's while its speed counts as known: one, its neighbours.
_KNOWN_SPEED_CELLS = 1.5


# Share of the deviation of the nearest point that is kept per block that shows no spread ground.
_EDGE_FADES = 0.9


class Updater:
    """Measures tracks in blocks, and updates filter, evidence and counters.

    A track is certain once its evidence has ruled out every other pair of cells, of any speed. One that has never
    been certain moves to the next pair (within 40 m) that its blocks together show with more power, unless its
    altitudes contradict that pair's Doppler: then that pair is the lobe.

    The filter takes Doppler in once no grating lobe can pass for it. A Doppler that the altitudes contradict in two
    blocks in a row is a grating lobe's: such a track keeps no candidate out. In one block alone it takes nothing from
    a certain track, nor does one more than four standard deviations off; it is then not used.

    ``integrity``: which speeds and altitudes a track's evidence leaves open.
    """

    def __init__(self, gate: Gate, integrity: Integrity) -> None:
        self.gate, self.integrity = gate, integrity
        self.tables = gate.tables
        # cells to either side of a track that evidence covers
        self.reach = self.tables.last - self.tables.first

    def update(self, track: Track, scan: Scan) -> Measurement | None:
        """The block's measurement of a track, which is updated by it; None where the block does not show the return."""
        return self._update(track, scan, scan.block, cleaned=True)

    def keep(self, track: Track, scan: Scan) -> Measurement | None:
        """Update a track by the received frames, where a method has taken its return away; None where they lack it too.

        Such a track continues without an altitude.
        """
        if scan.sum_received is None:
            return None
        seen = track.seen
        found = self._update(track, scan, scan.received, cleaned=False)
        track.seen |= seen
        return found

    def _update(self, track: Track, scan: Scan, block: Block, *, cleaned: bool) -> Measurement | None:
        mask = self.gate.mask(track, scan)
        found = block.best(block.at_peaks(mask))
        track.seen = False
        if found is None:
            return None
        t = self.tables
        found = scan.corrected(found)
        if cleaned:  # evidence is about what gives the altitude
            track.evidence.add(*block.differences(found, self.reach))
            self._compare_shape(track, scan, found)
        track.seen = found.strength >= self.gate.threshold(mask) and not is_side_lobe(block, found)
        if not (track.seen and self._inside(track, found, scan)):
            return None
        before = track.latest, track.measured_at
        track.append(found, scan.middle)
        track.doppler_m_per_s += (found.speed_m_per_s - track.doppler_m_per_s) / track.evidence.weight
        lowest, highest = self.integrity.open_cells(track)
        # its Doppler does not fit its altitudes, or it is not the Doppler of a track whose ambiguity is resolved
        foreign = lowest > highest or (track.resolved and not self.gate.near_speed(track, found))
        pulled = foreign and self._pulled(track)
        track.contradicted = track.contradicted + 1 if foreign else 0
        if foreign and not pulled:  # a lobe
            track.seen = track.contradicted < _LOBE_BLOCKS
            track.latest, track.measured_at = before
            return None
        open_m, open_speed = self.integrity.farthest(track)
        predicted_m = track.filter.mean[0]
        with_speed = t.doppler and open_speed < _KNOWN_SPEED_CELLS and not foreign
        track.filter.update(found, scan.lead_s, with_speed=with_speed)
        track.filter.mean[1] = np.clip(track.filter.mean[1], -t.max_speed, t.max_speed)  # rate limit
        track.corrected_m = float(abs(track.filter.mean[0] - predicted_m))
        track.hits, track.missed, track.vacant = track.hits + 1, 0, 0
        track.resolved |= open_m == 0.0
        return found if track.resolved or not cleaned else self.resolve(track, scan, found)

    def _compare_shape(self, track: Track, scan: Scan, found: Measurement) -> None:
        """Update the deviation of a track's peak from a point's, in frames as received: a method changes shapes."""
        track.edge_m, track.widened_m = _EDGE_FADES * track.edge_m, _EDGE_FADES * track.widened_m
        if scan.ground is not None:
            track.edge_m = max(track.edge_m, scan.ground.deviation_m)
            track.widened_m = max(track.widened_m, scan.ground.widened_m)
        block = scan.received
        if scan.sum_received is None or block.shows(found, self.integrity.received_threshold):
            track.deviation += (block.shape_deviation(found) - track.deviation) / track.evidence.weight
            moment = scan.moment(found, 1.5 * self.tables.resolution_cells)
            if moment is not None:
                track.moment += (moment - track.moment) / track.evidence.weight

    def _inside(self, track: Track, found: Measurement, scan: Scan) -> bool:
        return self.gate.near(track, found, scan.lead_s) and (
            self.gate.allowed_speed(found) or self._pulled(track)
        )

    def _pulled(self, track: Track) -> bool:
        """Whether interference that pulls one half may explain a Doppler that cannot be."""
        return track.resolved and track.contradicted == 0 and self.integrity.alone(track)

    def resolve(self, track: Track, scan: Scan, found: Measurement) -> Measurement:
        """The track's measurement, or that of the pair next to it that all its blocks together show with more power.

        One block takes a grating lobe for the return more easily than ten do. A track whose ambiguity is resolved
        does not move any more: what has more power then is another return.
        """
        t, block, steps = self.tables, scan.block, self.integrity.better_pair(track)
        if steps is None:
            return found
        at = np.round(found.cells).astype(int) + steps
        near = (np.abs(t.up_cell - at[0]) <= 1) & (np.abs(t.down_cell - at[1]) <= 1)
        other = block.best(block.at_peaks(near))
        if other is None or not self.gate.allowed_speed(other):
            return found
        other = scan.corrected(other)
        lowest, highest = self.integrity.open_cells(track, other)
        if lowest > highest:  # the track's altitudes do not move like that, so this is the lobe
            return found
        track.move(other)
        track.evidence.recentre(steps)
        return other
