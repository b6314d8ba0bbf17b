"""Initiator: candidates for a track, from a block's strongest return to their confirmation."""

from collections.abc import Sequence

import numpy as np

from .deleter import Deleter
from .gate import Gate
from .rivals import is_side_lobe
from .scan import Scan
from .summed_block import Measurement
from .track import Evidence, Kalman, Track
from .tracker_settings import TrackerSettings
from .updater import Updater

_MEMORY_OUTPUTS = 10.0  # outputs over which evidence against rival altitudes is remembered
# Number of candidates: one may be a grating lobe, which stays as long as the interference does, so the return needs a
# second one.
_CANDIDATES = 2
# Standard deviation of a first speed over the greatest speed, so that all allowed ones lie within two; least value.
_FIRST_SPEED_SHARE, _LEAST_FIRST_SPEED_M_PER_S = 0.5, 1.0


class Initiator:
    """Holds candidates until enough blocks in a row have shown them.

    A candidate starts from the strongest pair of the whole span, if noise alone gives one as strong in one of 10,000
    blocks (`TrackerSettings.search_pfa`) and both half sweeps show it. A track begins when three blocks in a row
    agree (`TrackerSettings.confirm_outputs`).

    ``updater``: continues candidates as it does tracks; ``deleter``: says which contradict themselves;
    ``lowest_start_m``: below it no candidate starts: leakage is as static as hovering ground, and without a
    calibration nothing distinguishes them.
    """

    def __init__(
        self,
        gate: Gate,
        updater: Updater,
        deleter: Deleter,
        settings: TrackerSettings,
        lowest_start_m: float = -np.inf,
    ) -> None:
        self.lowest_start_m = lowest_start_m
        self.gate, self.updater, self.deleter, self.settings = gate, updater, deleter, settings
        self.tables = gate.tables
        self.candidates: list[Track] = []

    def reset(self) -> None:
        """Forget the candidates."""
        self.candidates = []

    def update(self, scan: Scan, tracks: Sequence[Track]) -> None:
        """Continue the candidates by a block; delete those that it does not show or that are one of ``tracks``."""
        kept: list[Track] = []
        for candidate in sorted(self.candidates, key=lambda c: -c.hits):
            found = self.updater.update(candidate, scan)
            fits = found is not None and not self.deleter.inconsistent(candidate, scan)
            if fits and not self._is_tracked(found, [*tracks, *kept]):
                kept.append(candidate)
        self.candidates = kept

    def search(self, scan: Scan, tracks: Sequence[Track]) -> None:
        """Start a candidate from the strongest return that belongs to no candidate and none of ``tracks``."""
        if len(self.candidates) >= _CANDIDATES:
            return
        block = scan.block
        allowed = np.ones(block.table.shape, dtype=bool)
        for track in tracks:
            allowed &= block.away_from(track.latest)
        found = block.best(allowed)
        strong = found is not None and found.strength >= self.updater.integrity.start_threshold(scan)
        strong = strong and self.gate.allowed_speed(found) and not self._is_tracked(found, self.candidates)
        strong = strong and scan.corrected(found).altitude_m >= self.lowest_start_m
        if strong and not is_side_lobe(block, found, mixed=True):
            self.candidates.append(self.start(scan, scan.corrected(found)))

    def confirmed(self) -> Track | None:
        """Take out the confirmed candidate of most power; None without any."""
        ready = [c for c in self.candidates if c.hits >= self.settings.confirm_outputs]
        if not ready:
            return None
        track = max(ready, key=lambda c: c.latest.power)
        self.candidates = [c for c in self.candidates if c is not track]
        return track

    def start(self, scan: Scan, found: Measurement) -> Track:
        """A track of one measurement. A first Doppler may be a grating lobe's, so it is not used."""
        spread = max(_FIRST_SPEED_SHARE * self.tables.max_speed, _LEAST_FIRST_SPEED_M_PER_S)
        covariance = np.diag([found.altitude_variance_m2 + (spread * scan.lead_s) ** 2, spread**2])
        mean = np.array([found.altitude_m, 0.0])
        pulled = np.array([np.sqrt(found.altitude_variance_m2), 0.0])
        track = Track(Kalman(mean, covariance, pulled=pulled), Evidence(_MEMORY_OUTPUTS))
        track.evidence.add(*scan.block.differences(found, self.updater.reach))
        track.append(found, scan.middle)
        track.doppler_m_per_s = found.speed_m_per_s
        return track

    def _is_tracked(self, found: Measurement, tracks: Sequence[Track]) -> bool:
        """Whether one of these tracks is that of the return that was measured."""
        cells = self.tables.resolution_cells
        return any(np.max(np.abs(found.cells - c.latest.cells)) <= cells for c in tracks)
