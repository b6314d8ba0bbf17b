"""Altitude tracker: beat spectra in, 25 altitudes per second out, each with a status and a bound of its error.

These are its parts, in the order of processing. The *integrator* sums frames to a block (`integrator.py`). The
*initiator* takes the best return of the whole span. The *gate* says which returns may continue a track. The *Kalman
filter* updates altitude and vertical speed. *Evidence* remembers how well every rival altitude is ruled out. The
*deleter* ends a track. *Integrity* says whether something else could be the ground, and bounds the error
(`track_integrity.py`). A track's life: search, confirm, track, coast, lost.

A wrong altitude that is called NORMAL is the hazard, a missing one an inconvenience. So a block without a measurement
gives no altitude, and neither does one with a rival that could as well be the ground.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..waveform import delay_to_altitude_m
from .altimeter import Altimeter, Spectra
from .integrator import Integrator
from .leakage import REACH_M
from .summed_block import Block, Measurement
from .track import Evidence, Kalman, Track
from .track_integrity import SPARE_SIGMAS, Integrity, noise_threshold
from .tracker_settings import OUTPUT_DTYPE, State, Status, TrackerSettings

__all__ = ["OUTPUT_DTYPE", "AltitudeTracker", "State", "Status", "TrackerSettings"]

_GATE_SIGMAS = 4.0
# least error of one measurement; interference keeps it up from block to block, so that a mean is no better
_ALTITUDE_FLOOR_M, _SPEED_FLOOR_M_PER_S = 0.25, 1.5
_INCONSISTENT = 8.0  # innovation squared over its variance, mean of ten blocks, that ends a track
_LONGEST_GAP_S = 10.0  # missing frames that are answered by outputs; after more the tracker starts anew
_SAME_TIMING_S = 2e-9  # 0.3 m: frames of one block share their timing
_CANDIDATES = 2  # beside the track: a grating lobe's may hold one place for as long as it lasts
_LOBE_BLOCKS = 2  # in a row in which altitudes contradict the Doppler: what stands there is a grating lobe


class AltitudeTracker:
    """Beat spectra of frames in, outputs out; keeps its state from call to call, however frames are split up.

    Parameters
    ----------
    altimeter : Altimeter
        The one that makes the spectra; its span of altitudes and its limit of vertical speed hold here, too.
    settings : TrackerSettings

    Raises
    ------
    ValueError
        If ``output_s`` holds fewer than eight frames.

    Notes
    -----
    What the protection level is made of, and what it does not bound, stands at `track_integrity.Integrity`.

    Examples
    --------
    >>> import numpy as np
    >>> from radalt.core.waveform import Waveform
    >>> from radalt.core.returns.point import point_return
    >>> w = Waveform()
    >>> altimeter = Altimeter(w)
    >>> rng = np.random.default_rng(1)
    >>> noise = rng.standard_normal((200, 7500, 2), dtype=np.float32).view(np.complex64)[..., 0]
    >>> out = AltitudeTracker(altimeter).process(altimeter.spectra(noise + point_return(w, np.full(200, 300.0))))
    >>> len(out), int(out["status"][-1]) == Status.NORMAL, bool(abs(out["altitude_m"][-1] - 300.0) < 1.0)
    (5, True, True)
    """

    def __init__(self, altimeter: Altimeter, settings: TrackerSettings = TrackerSettings()) -> None:  # noqa: B008
        self.settings = settings
        self.sweep_s, self._doppler_lead_s = altimeter.waveform.sweep_s, altimeter.waveform.doppler_lead_s
        self.frames = round(settings.output_s / self.sweep_s)
        self.integrator = Integrator(
            altimeter,
            self.frames,
            doppler=settings.doppler is not False and altimeter.waveform.separates_doppler,
            max_speed_m_per_s=settings.max_vertical_speed_m_per_s,
        )
        t = self.integrator
        leakage_m = REACH_M if settings.leakage_m is None and t.doppler else settings.leakage_m or -np.inf
        self._lowest_start_m = leakage_m
        self._possible_m = altimeter.settings.min_altitude_m, altimeter.settings.max_altitude_m
        # a narrow cell is crossed within an output
        self._widest_m = max(2.0 * altimeter.waveform.range_resolution_m, t.max_speed * settings.output_s)
        self._reach = t.last - t.first
        # a speed lies that far from its row's at most
        self._slack = 1.01 * t.speed_per_cell if t.doppler else np.diff(t.speeds).max(initial=0.0)
        self._integrity = Integrity(t, settings, self.sweep_s)
        cells = altimeter.beat_hz.size
        self._ratio = np.empty((self.frames, 2, cells), dtype=np.float32)
        self._received = np.empty_like(self._ratio)
        self._offset_s = np.empty(self.frames)
        self._here = np.empty(self.frames, dtype=np.int8)
        self.reset()

    def reset(self) -> None:
        """Forget the track and the frames that wait."""
        self._track: Track | None = None
        self._candidates: list[Track] = []
        self._block: int | None = None  # number of the block that is being filled
        self._next_index = 0
        self._beside = False  # whether the received frames come beside the cleaned ones

    # -- frames to blocks -----------------------------------------------------------------------------------------

    def process(
        self,
        spectra: Spectra,
        *,
        frame_index: np.ndarray | int | None = None,
        timing_offset_s: np.ndarray | float = 0.0,
        received: Spectra | None = None,
    ) -> np.ndarray:
        """Outputs of the blocks that these frames complete.

        A block is the frames ``k M .. (k + 1) M - 1`` by index; missing ones leave it with fewer. Outputs for blocks
        that are missing altogether say FAILURE. An index that runs backwards, or ahead by more than ten seconds, starts
        the tracker anew.

        Parameters
        ----------
        spectra : Spectra
            Of n frames of the altimeter given.
        frame_index : (n,) int, optional
            Rising; default counts on from the last call.
        timing_offset_s : (n,) or scalar
            As in `Altimeter.process`.
        received : Spectra, optional
            Of the same frames before mitigation. A return that they show and ``spectra`` do not is a rival: a method
            may take the weaker of two returns for interference.

        Returns
        -------
        (k,) structured array of `OUTPUT_DTYPE`; ``altitude_m``, ``vertical_speed_m_per_s`` and ``protection_level_m``
        are NaN unless ``status`` is NORMAL.
        """
        n = len(spectra.power)
        index = self._next_index + np.arange(n) if frame_index is None else np.broadcast_to(frame_index, n)
        offset = np.broadcast_to(np.asarray(timing_offset_s, dtype=float), n)
        out: list[tuple] = []
        if n:
            ratio = self.integrator.normalise(spectra)
            raw = ratio if received is None else self.integrator.normalise(received)
            self._beside = received is not None
            index = np.asarray(index)
            cuts = np.nonzero((np.diff(index) <= 0) | (np.diff(index // self.frames) != 0))[0] + 1
            for first, last in zip([0, *cuts], [*cuts, n], strict=True):
                part = slice(first, last)
                self._take(ratio[part], raw[part], index[part], offset[part], out)
            self._next_index = int(index[-1]) + 1
        return np.array(out, dtype=OUTPUT_DTYPE)

    def _take(
        self, ratio: np.ndarray, raw: np.ndarray, index: np.ndarray, offset: np.ndarray, out: list[tuple]
    ) -> None:
        """Frames of one block, index rising."""
        number = int(index[0]) // self.frames
        if self._block is not None and (number != self._block or index[0] < self._next_in_block):
            gap = number - self._block
            if not 0 < gap <= _LONGEST_GAP_S / self.settings.output_s:
                self.reset()
            else:
                for _ in range(gap):
                    out.append(self._close())
        if self._block is None or number != self._block:
            self._open(number)
            self._started_at = int(index[0]) % self.frames
        at = index - number * self.frames
        self._ratio[at], self._received[at], self._offset_s[at] = ratio, raw, offset
        self._here[at] = np.where(np.isnan(ratio[:, 0, 0]) | np.isnan(raw[:, 0, 0]), 2, 1)
        self._next_in_block = int(index[-1]) + 1
        if at[-1] == self.frames - 1:
            out.append(self._close())

    def _open(self, number: int) -> None:
        self._block = number
        self._here[:] = 0
        self._next_in_block = number * self.frames

    def _close(self) -> tuple:
        """Judge the block that was being filled, and open the next."""
        last = (self._block + 1) * self.frames - 1
        output = self._judge(last)
        self._open(self._block + 1)
        self._started_at = 0
        return output

    # -- one block ------------------------------------------------------------------------------------------------

    def _judge(self, last: int) -> tuple:
        s = self.settings
        for track in (self._track, *self._candidates):
            if track is not None:
                track.filter.predict(s.output_s, s.acceleration_m_per_s2)
        at = np.nonzero(self._here == 1)[0]
        if at.size:
            at = at[np.abs(self._offset_s[at] - self._offset_s[at[-1]]) <= _SAME_TIMING_S]
        if 2 * at.size < self.frames:
            self._candidates = []
            state = self._missed()
            failed = 2 * np.sum(self._here == 1) < self.frames - self._started_at
            status = Status.FAILURE if failed else Status.NO_COMPUTED_DATA
            return self._output(last, status, state, 0.0, at.size)
        block = self.integrator.integrate(self._ratio[at], at.astype(float))
        self._at, self._before = at, None
        self._shift_m = float(delay_to_altitude_m(self._offset_s[at[-1]]))
        # from the instant that was measured to the block's end; a sawtooth measures an instant ahead (or behind)
        self._lead_s = (self.frames - 0.5 - block.middle) * self.sweep_s - self._doppler_lead_s
        middle = last - self.frames + 1 + block.middle
        return self._follow(block, last, middle)

    def _follow(self, block: Block, last: int, middle: float) -> tuple:
        """Continue the track, look for a better one, and say what is known."""
        strongest = block.strongest()
        strength = 0.0 if strongest is None else strongest.strength
        normal = False
        if self._track is not None:
            found = self._continue(self._track, block, middle)
            kept = found or self._kept(self._track, middle)
            state = State.TRACK if kept else self._missed()
            if kept and self._track.filter.nis > _INCONSISTENT:
                found, state, self._track = None, State.LOST, None
            normal = found is not None and self._undisputed(self._track, block, found)
        else:
            state = State.SEARCH
        self._try_others(block, middle)
        if self._track is None and self._candidates:
            state = State.CONFIRM if state == State.SEARCH else state
            confirmed = [c for c in self._candidates if c.hits >= self.settings.confirm_outputs]
            if confirmed:
                self._track = max(confirmed, key=lambda c: c.latest.power)
                self._candidates = [c for c in self._candidates if c is not self._track]
                state = State.TRACK
                normal = self._undisputed(self._track, block, self._track.latest)
        status = Status.NORMAL if normal else Status.NO_COMPUTED_DATA
        return self._output(last, status, state, strength, block.count)

    def _output(self, last: int, status: int, state: int, strength: float, frames: int) -> tuple:
        altitude = speed = level = age = np.nan
        if self._track is not None:
            age = (last + 0.5 - self._track.measured_at) * self.sweep_s
            if status == Status.NORMAL:
                level = self._track.protection_m
                altitude, speed = (float(v) for v in self._track.filter.mean)
                lowest, highest = self._possible_m
                nowhere = altitude + level < lowest or altitude - level > highest
                if nowhere or not level <= self.settings.max_protection_m:
                    status, altitude, speed, level = Status.NO_COMPUTED_DATA, np.nan, np.nan, np.nan
        return last, status, state, altitude, speed, level, age, strength, frames

    # -- gate and update ------------------------------------------------------------------------------------------

    def _gate(self, track: Track) -> np.ndarray:
        """Mask of the table's entries that may continue a track; a return lies half a cell from its entry at most."""
        t, f = self.integrator, track.filter
        row = np.array([1.0, -self._lead_s])
        sigma = np.sqrt(row @ f.covariance @ row + track.latest.altitude_variance_m2)
        expected = row @ f.mean + self._shift_m
        mask = np.abs(t.altitude_m - expected) <= min(_GATE_SIGMAS * sigma, self._widest_m) + 0.51 * t.cell_m
        return mask & (self._speeds(track) & self._same_pair(track))[:, None]

    def _speeds(self, track: Track) -> np.ndarray:
        """Rows of the table whose speed a track may have."""
        t, f = self.integrator, track.filter
        return np.abs(t.row_speed - f.mean[1]) <= _GATE_SIGMAS * np.sqrt(f.covariance[1, 1]) + self._slack

    def _same_pair(self, track: Track) -> np.ndarray:
        """Rows of the table of the track's latest Doppler: peak and lobes move alike, so a pair keeps its own."""
        t, last = self.integrator, track.latest
        spread = _GATE_SIGMAS * np.sqrt(last.speed_variance_m2_per_s2) + self._slack if t.doppler else np.inf
        return np.abs(t.row_speed - last.speed_m_per_s) <= spread

    def _inside(self, track: Track, found: Measurement) -> bool:
        """Whether a measurement lies within a track's gate."""
        rest, variance = track.filter.innovation(found, self._lead_s)
        near = abs(rest) <= min(_GATE_SIGMAS * np.sqrt(variance), self._widest_m)
        return near and (self._possible(found) or self._pulled(track))

    def _pulled(self, track: Track) -> bool:
        """Whether interference that pulls one half may explain a Doppler that cannot be: once, and of nothing else."""
        return track.settled and track.contradicted == 0 and self._integrity.alone(track)

    def _possible(self, found: Measurement) -> bool:
        """Whether a measurement's speed is one that is allowed, as far as it is known."""
        t = self.integrator
        spare = SPARE_SIGMAS * np.sqrt(found.speed_variance_m2_per_s2)
        return not t.doppler or abs(found.speed_m_per_s) <= t.max_speed + spare

    def _kept(self, track: Track, middle: float) -> Measurement | None:
        """The received frames' measurement of a track that a method has taken away: it goes on, without an altitude."""
        if not self._beside:
            return None
        seen = track.seen
        found = self._continue(track, self._received_block(), middle, cleaned=False)
        track.seen |= seen
        return found

    def _continue(
        self, track: Track, block: Block, middle: float, *, cleaned: bool = True
    ) -> Measurement | None:
        """The block's measurement of a track, which is updated by it; None where the return is not there."""
        mask = self._gate(track)
        found = block.best(block.prominent(block.at_peaks(mask)))  # a grating lobe may win the votes
        track.seen = False
        if found is None:
            return None
        t = self.integrator
        found = self._calibrated(found)
        if cleaned:  # evidence is about what gives the altitude
            track.evidence.add(*block.differences(found, self._reach))
        threshold = noise_threshold(self.settings.gate_pfa, mask.sum() / t.resolution_cells**2)
        track.seen = found.strength >= threshold and not self._is_side_lobe(block, found)
        if not (track.seen and self._inside(track, found)):
            return None
        before = track.latest, track.measured_at
        track.take(found, middle)
        lowest, highest = self._integrity.open_cells(track)
        foreign = lowest > highest  # its Doppler is none that its altitudes allow
        pulled = foreign and self._pulled(track)
        track.contradicted = track.contradicted + 1 if foreign else 0
        if foreign and not pulled:  # a lobe's
            track.seen = track.contradicted < _LOBE_BLOCKS
            track.latest, track.measured_at = before
            return None
        open_m, open_speed = self._integrity.farthest(track)
        predicted_m = track.filter.mean[0]
        with_speed = t.doppler and open_speed < 1.5 and not foreign
        track.filter.update(found, self._lead_s, with_speed=with_speed)
        track.filter.mean[1] = np.clip(track.filter.mean[1], -t.max_speed, t.max_speed)  # rate limit
        track.corrected_m = float(abs(track.filter.mean[0] - predicted_m))
        track.hits, track.missed = track.hits + 1, 0
        track.settled |= open_m == 0.0
        return found if track.settled or not cleaned else self._settled(track, block, found)

    def _settled(self, track: Track, block: Block, found: Measurement) -> Measurement:
        """The track's measurement, or that of the pair beside it that all its blocks together show with more power.

        One block takes a grating lobe for the return more easily than ten do. A track whose altitude was certain once
        does not move any more: what outdoes it then is another return.
        """
        t, steps = self.integrator, self._integrity.better_pair(track)
        if steps is None:
            return found
        at = np.round(found.cells).astype(int) + steps
        near = (np.abs(t._up - at[0]) <= 1) & (np.abs(t._down - at[1]) <= 1)
        other = block.best(block.at_peaks(near))
        if other is None or not self._possible(other):
            return found
        other = self._calibrated(other)
        lowest, highest = self._integrity.open_cells(track, other)
        if lowest > highest:  # the track's altitudes do not move like that, so this is the lobe
            return found
        track.move(other)
        track.evidence.recentre(steps)
        return other

    def _calibrated(self, found: Measurement) -> Measurement:
        """The measurement less the residual delay, its variances raised by what every measurement has at least."""
        return replace(
            found,
            altitude_m=found.altitude_m - self._shift_m,
            altitude_variance_m2=found.altitude_variance_m2 + _ALTITUDE_FLOOR_M**2,
            speed_variance_m2_per_s2=found.speed_variance_m2_per_s2 + _SPEED_FLOOR_M_PER_S**2,
        )

    def _is_side_lobe(self, block: Block, found: Measurement, *, ghosts: bool = False) -> bool:
        """Whether a stronger return explains this one: side lobes of an unweighted sweep, with 6 dB to spare.

        With ``ghosts`` also what shares a half with it, if it has more power too: a lobe may win the votes alone.
        """
        t = self.integrator
        other = block.strongest(block.away_from(found))
        if other is None or other.strength <= found.strength:
            return False
        near, far = np.sort(np.abs(np.array(other.cells) - found.cells)) / t.resolution_cells
        if near < 1.0 <= far:  # one half of the stronger return with the other half's side lobe
            return ghosts and other.power > found.power
        return bool(near >= 1.0 and found.power < other.power * 4.0 / (np.pi * near) ** 2)

    # -- initiator and deleter ------------------------------------------------------------------------------------

    def _try_others(self, block: Block, middle: float) -> None:
        """Carry the candidates on, and start one from the strongest return that is not the track's or theirs."""
        track, enough = self._track, self.settings.confirm_outputs
        here = [track] if track is not None and track.missed == 0 else []
        kept: list[Track] = []
        for candidate in sorted(self._candidates, key=lambda c: -c.hits):
            found = self._continue(candidate, block, middle)
            fits = found is not None and candidate.filter.nis <= _INCONSISTENT
            if fits and not self._is_followed(found, here + kept):
                kept.append(candidate)
        if track is not None and not track.seen and any(c.hits >= enough for c in kept):
            self._track = None  # the ground has stepped: the old altitude is no longer there
        if len(kept) < _CANDIDATES:
            allowed = block.away_from(track.latest) if here else np.ones(block.table.shape, dtype=bool)
            found = block.best(block.prominent(allowed))
            strong = found is not None and found.strength >= self._integrity.search_threshold
            strong = strong and self._possible(found) and not self._is_followed(found, kept)
            # leakage stands still as hovering ground does, and nobody knows it apart without a calibration
            strong = strong and found.altitude_m - self._shift_m >= self._lowest_start_m
            if strong and not self._is_side_lobe(block, found, ghosts=True):
                kept.append(self._start(block, self._calibrated(found), middle))
        self._candidates = kept

    def _is_followed(self, found: Measurement, tracks: list[Track]) -> bool:
        """Whether one of these tracks is that of the return that was measured."""
        cells = self.integrator.resolution_cells
        return any(np.max(np.abs(found.cells - c.latest.cells)) <= cells for c in tracks)

    def _start(self, block: Block, found: Measurement, middle: float) -> Track:
        t = self.integrator
        spread = max(t.max_speed / 2.0, 1.0)
        covariance = np.diag([found.altitude_variance_m2 + (spread * self._lead_s) ** 2, spread**2])
        # a first Doppler may be a grating lobe's: the speed starts from what is allowed
        mean = np.array([found.altitude_m, 0.0])
        pulled = np.array([np.sqrt(found.altitude_variance_m2), 0.0])
        track = Track(Kalman(mean, covariance, pulled=pulled), Evidence(self.settings.memory_outputs))
        track.evidence.add(*block.differences(found, self._reach))
        track.take(found, middle)
        return track

    def _missed(self) -> int:
        """A block without measurement: coast, and delete the track when that has lasted too long."""
        track, s = self._track, self.settings
        if track is None:
            return State.SEARCH
        track.missed += 1
        # one poor block leaves a certain track what it is, but not one that is just back from coasting
        if track.missed > 1 or not track.settled or track.hits < s.confirm_outputs:
            track.hits = 0
        if track.missed * s.output_s > s.coast_s:
            self._track = None
            return State.LOST
        return State.COAST

    # -- what is known --------------------------------------------------------------------------------------------

    def _undisputed(self, track: Track, block: Block, found: Measurement) -> bool:
        """Whether a measured track is the altitude: nothing else in the block could as well be the ground."""
        if track.hits < self.settings.confirm_outputs and found.strength < self._integrity.search_threshold:
            return False  # back from coasting: few weak returns in a row may be noise
        track.protection_m = self._integrity.protection_m(track)
        if track.corrected_m > track.protection_m:
            return False  # what was predicted and what was measured contradict each other: one may be a grating lobe
        moved_m, sigma_m = block.moved_since(found)
        rest_m, _ = track.filter.innovation(found, self._lead_s)
        # a step of the ground leaves the peak of the whole block where it was, or a track that has coasted behind it
        if max(abs(moved_m), abs(rest_m + moved_m)) > max(track.protection_m, _GATE_SIGMAS * sigma_m):
            return False
        here_m = found.altitude_m + self._shift_m
        received = self._received_block if self._beside else None
        return self._integrity.undisputed(
            block, found, here_m, self._speeds(track)[:, None], received=received
        )

    def _received_block(self) -> Block:
        """The block's frames as they were received, summed once and only if asked for."""
        if self._before is None:
            self._before = self.integrator.integrate(self._received[self._at], self._at.astype(float))
        return self._before
