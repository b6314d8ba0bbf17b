"""Integrity of a track: rivals that could be the ground, and the protection level of its altitude."""

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from .gate import GATE_SIGMAS, SPARE_SIGMAS, Gate, noise_threshold
from .rivals import lobe_from_beyond, second_return
from .scan import Scan
from .summed_block import Block, Measurement
from .track import Track
from .tracker_settings import TrackerSettings

# Distance, resolution cells, of the first grating lobe of a sweep in which a method has left holes.
_GRATING_CELLS = 2.0
# Resolution cells within which side and grating lobes lie; a second return differs from them by being one-sided.
_LOBE_CELLS = 6.0
_LOBE_SHARE = 0.1  # of the altitude, if that is more: ground off nadir, at 150 MHz from 60 m on
# Systematic error, metres, of a peak that a method has distorted; 5 MHz NR behind `tcae` keeps 0.95 m for seconds.
_SYSTEMATIC_M = 1.0
# How far beyond the nearest ground its peak may be: resolution cells per root of the asymmetry (up to 1.02 over five
# kinds of ground), and share of the altitude: the mean over a beam of 40 degrees on ground that scatters alike
# in all directions.
_EXTENT_CELLS, _EXTENT_SHARE = 1.1, 0.045
# Part of the level for a second return within the peak: resolution cells per root of the deviation's energy, and at
# most half a cell, which is the error by an equal one 18 m behind in phase (9 m). Echoes 5 to 16 m behind, 6 dB weaker,
# err by up to 4.4 m; the nearest deviate least, and the level's other parts cover what they exceed this part by.
_ECHO_CELLS, _MOST_ECHO_CELLS = 3.0, 0.5
# Share of the altitude by which the fit errs where no shape is quite the ground's; the level's part for spread ground,
# with a deviation of its nearest point (tests/test_ground.py).
_EDGE_SHARE, _LEAST_EDGE_M = 0.01, 0.1
# Second return within the peak, its phase against the first one constant: of two with the share w of their sum in the
# farther one, the peak errs by |w| d, and the moment is w (1 - w) d^2. So the error is at most the moment's root times
# that of the ratio of amplitudes, 2 (6 dB).
_MOMENT_FACTOR = 1.42
# Powers below a track's, dB, down to which a farther and a nearer return leave it undecided: the ground is the nearest.
_RIVAL_DB, _NEARER_RIVAL_DB = 6.0, 10.0
# Share of the difference of Doppler and the altitudes' slope, below which their sum shows a mirrored Doppler.
_MIRRORED = 0.25


class Integrity:
    """Rivals of a track, and its protection level.

    **Contradictions.** No altitude is given where a measurement moves the predicted one by more than the protection
    level, where the last quarter of the block stands farther off than that and four standard deviations allow, nor
    where altitudes show a vertical speed and Doppler its mirror: I and Q are exchanged then. After two blocks without a
    measurement (one, if the track was never certain) it takes three in a row with one, or one that is strong enough to
    start a track.

    **Protection level.** The sum of a systematic part of 1 m, of the extent or the part for a second return within the
    peak, whichever is greater, and of two bounds, each at half the stated
    risk:

    - *noise*: ``k sigma`` of the filtered altitude, by errors that are independent or all of one sign, whichever is
      greater (interference that lasts pulls every measurement alike), widened by the filter's innovations where they
      exceed what it expects (track consistency);
    - *ambiguity*: the farthest altitude that the evidence of the last blocks does not rule out, with ``k`` standard
      deviations of the frames' own differences. A rival's speed may differ from the track's as far as the altitudes
      of the track leave its speed open, since a grating lobe of one half sweep passes for a speed.

    The *extent* covers how far ground off nadir pulls the peak up. A return of some depth is asymmetric: more power
    stands beyond its peak than before it. The extent grows with the root of that asymmetry, up to 4.5 % of the
    altitude, the mean over a beam of 40 degrees; the peak lies 1 % of the altitude beyond the nearest ground over the
    shipped approach, up to 4 % over ground that scatters alike in all directions.

    *Spread ground* that only a method shows, whose own response widens the rise, begins anywhere between the fitted
    edge and the peak: that distance beyond half a resolution cell is added to its part.

    A *second return within the peak* makes its shape deviate from a point's, in the frames as received. Its part is
    60 m times the root of that deviation's energy (three resolution cells), up to half a resolution cell; a point
    pays 0.1 to 0.5 m. Where interference hides the return the part keeps its value. Of two returns whose phases stay
    as they are, amplitude and phase along the sweep give the second moment of their delays (`BeatSpectra.moments`),
    and 1.42 times its root bounds the error.

    It does not bound errors by returns that cannot be distinguished from the ground. These are a false return on the
    ground's own cells, or one that hides the ground from the start. Another is a radar of the same sweep that drifts
    as slowly as an aircraft and keeps the Doppler of its drift. A step of the ground in the last quarter of a block
    shows in the next.

    ``gate``: of the blocks in which tracks are measured.
    """

    def __init__(self, gate: Gate, settings: TrackerSettings) -> None:
        t = self.tables = gate.tables
        self.gate, self.settings, self.sweep_s = gate, settings, t.waveform.sweep_s
        self.search_threshold = noise_threshold(settings.search_pfa, t.trials)
        # a base station's pattern recurs within the block, which halves the independent frames, for a whole flight
        self.received_threshold = np.sqrt(2.0) * self.search_threshold
        self._shares = tuple(10.0 ** (-db / 10.0) for db in (_RIVAL_DB, _NEARER_RIVAL_DB))
        self._noise_sigmas = float(-ndtri(settings.risk / 4.0))  # half the risk, both sides
        self._rival_sigmas = noise_threshold(settings.risk / 2.0, (t.last - t.first) / t.resolution_cells)

    def start_threshold(self, scan: Scan) -> float:
        """Strength from which a return starts a track; behind a method a base station's pattern may recur, too."""
        return self.search_threshold if scan.sum_received is None else self.received_threshold

    # -- rivals ---------------------------------------------------------------------------------------------------

    def undisputed(self, track: Track, scan: Scan, found: Measurement) -> bool:
        """Whether a track's measurement is the altitude: nothing else in the block could as well be the ground.

        Sets the track's protection level.
        """
        if track.hits < self.settings.confirm_outputs and found.strength < self.start_threshold(scan):
            return False  # back from coasting: few weak returns in a row may be noise
        track.protection_m = self.protection_m(track)
        if track.corrected_m > track.protection_m:
            return False  # prediction and measurement contradict each other: one may be a grating lobe
        if self._mirrored(track):
            return False
        moved_m, sigma_m = scan.block.moved_since(found)
        rest_m, _ = track.filter.innovation(found, scan.lead_s)
        # a step of the ground leaves the peak of the whole block where it was, or a track that has coasted behind it
        if max(abs(moved_m), abs(rest_m + moved_m)) > max(track.protection_m, GATE_SIGMAS * sigma_m):
            return False
        return not self._has_rival(track, scan, found)

    def _mirrored(self, track: Track) -> bool:
        """Whether a track's altitudes contradict the sign of its Doppler, as of a receiver with I and Q exchanged."""
        if not self.tables.doppler:
            return False
        slope, sigma = track.speed_by_altitudes(self.sweep_s, track.latest.altitude_variance_m2)
        apart, both = abs(track.doppler_m_per_s - slope), abs(track.doppler_m_per_s + slope)
        deviation = np.sqrt(sigma**2 + track.latest.speed_variance_m2_per_s2)
        return bool(apart > GATE_SIGMAS * deviation and both < _MIRRORED * apart)

    def _has_rival(self, track: Track, scan: Scan, found: Measurement) -> bool:
        t, block = self.tables, scan.block
        away = block.away_from(found)
        rival = block.strongest(away & self.gate.speeds(track)[:, None])
        # a grating lobe may win by strength alone
        outdone = rival is not None and rival.strength > found.strength and rival.power > found.power
        outdone |= scan.beyond >= self._shares[0]  # farther up
        if scan.ground is None:  # spread ground has its peak within the span
            outdone |= block.beyond_span() > self._shares[0] * found.power
        if outdone or lobe_from_beyond(block, found) or block.contradicted(found):
            return True
        here_m = found.altitude_m + scan.residual_m
        near_m = max(_LOBE_CELLS * t.waveform.range_resolution_m, _LOBE_SHARE * found.altitude_m)
        if self._second(block, found, near_m):
            return True
        if self._rival(block, found.power, here_m, near_m, self.search_threshold):
            return True
        return scan.sum_received is not None and self._received_rival(scan.received, found, here_m, near_m)

    def _second(self, block: Block, found: Measurement, near_m: float) -> bool:
        """Whether another return stands within ``near_m`` of one, and not its own extent."""
        return second_return(block, found, round(near_m / self.tables.cell_m), *self._shares)

    def _received_rival(self, before: Block, found: Measurement, here_m: float, near_m: float) -> bool:
        """Whether the received frames show a rival, near by or far, that a method may have taken away."""
        t = self.tables
        found = replace(found, power=before.power_at(found))
        neighbour = before.strongest(before.away_from(found) & (np.abs(t.altitude_m - here_m) <= near_m))
        if neighbour is not None and neighbour.strength >= self.received_threshold:
            if self._second(before, found, near_m):
                return True
        return self._rival(before, found.power, here_m, near_m, self.received_threshold)

    def _rival(self, block: Block, power: float, here_m: float, near_m: float, least: float) -> bool:
        """Whether a return beyond ``near_m`` of one of some power could be the ground; ``least`` strength."""
        apart = self.tables.altitude_m - here_m
        for mask, share in zip((apart > near_m, apart < -near_m), self._shares, strict=True):
            rival = block.strongest(mask)
            if rival is not None and rival.strength >= least and rival.power >= power * share:
                return True
        return False

    # -- ambiguity and protection level ---------------------------------------------------------------------------

    def open_cells(self, track: Track, found: Measurement | None = None) -> tuple[int, int]:
        """Least and most cells by which a rival's halves may differ more than the track's own, or those of ``found``.

        They stand for the speeds that the track's altitudes leave open; an empty range where its own is not among them.
        """
        t, s = self.tables, self.settings
        if not t.doppler:
            return -1, 1
        found = found or track.latest
        slope, sigma = track.speed_by_altitudes(self.sweep_s, found.altitude_variance_m2)
        moved = s.acceleration_m_per_s2 * s.output_s * np.sqrt(len(track.history))
        variance = sigma**2 + moved**2 + found.speed_variance_m2_per_s2
        spread = self._noise_sigmas * np.sqrt(variance)
        fastest = t.max_speed + SPARE_SIGMAS * np.sqrt(found.speed_variance_m2_per_s2)
        own = found.speed_m_per_s
        low = (max(slope - spread, -fastest) - own) / t.speed_per_cell
        high = (min(slope + spread, fastest) - own) / t.speed_per_cell
        if low > 0.0 or high < 0.0:
            return 1, 0
        return int(np.floor(low)), int(np.ceil(high))

    def farthest(self, track: Track) -> tuple[float, float]:
        """`Evidence.farthest` over the altitudes and speeds that a track may have."""
        t = self.tables
        span = (t.altitude_span_m - track.latest.altitude_m) / t.cell_m
        return track.evidence.farthest(
            self._rival_sigmas, self.open_cells(track), t.resolution_cells, tuple(span)
        )

    def alone(self, track: Track) -> bool:
        """Whether every other pair of cells, of any speed, as far as the grating lobes is ruled out."""
        t = self.tables
        reach = round(_GRATING_CELLS * t.resolution_cells)
        span = (t.altitude_span_m - track.latest.altitude_m) / t.cell_m
        farthest, _ = track.evidence.farthest(
            self._rival_sigmas, (-reach, reach), t.resolution_cells, tuple(span)
        )
        return farthest == 0.0

    def better_pair(self, track: Track) -> tuple[int, int] | None:
        """`Evidence.better_pair` as far as the grating lobes next to a return, over the speeds that are open."""
        t = self.tables
        span = (t.altitude_span_m - track.latest.altitude_m) / t.cell_m
        reach = round(_GRATING_CELLS * t.resolution_cells)
        return track.evidence.better_pair(reach, self.open_cells(track), t.resolution_cells, tuple(span))

    def protection_m(self, track: Track) -> float:
        """See the class: noise and ambiguity, each at half the risk, and the extent."""
        t = self.tables
        variance = max(track.filter.covariance[0, 0], track.filter.pulled[0] ** 2)
        variance *= max(1.0, track.filter.nis)
        noise = self._noise_sigmas * float(np.sqrt(variance))
        cells, _ = self.farthest(track)
        asymmetry = max(0.0, track.evidence.asymmetry(t.resolution_cells))
        extent = _EXTENT_CELLS * float(np.sqrt(asymmetry)) * t.waveform.range_resolution_m
        extent = min(extent, _EXTENT_SHARE * max(0.0, float(track.filter.mean[0])))
        echo = min(_ECHO_CELLS * np.sqrt(track.deviation), _MOST_ECHO_CELLS) * t.waveform.range_resolution_m
        two = _MOMENT_FACTOR * float(np.sqrt(abs(track.moment))) * t.waveform.range_resolution_m
        edge = track.edge_m + _EDGE_SHARE * float(track.filter.mean[0]) * (track.edge_m > _LEAST_EDGE_M)
        edge += track.widened_m
        return _SYSTEMATIC_M + noise + max(extent, float(echo), two, edge) + cells * t.cell_m
