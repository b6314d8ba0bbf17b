"""Altitude tracker: beat spectra in, 25 altitudes per second out, each with a status and a bound of its error.

Its parts, in the order of processing: the *integrator* sums frames to a block (`integrator.py`, `summed_block.py`). The
*gate* says which returns may continue a track, and the *updater* measures the track, updates its Kalman filter and its
evidence against rival altitudes. The *deleter* ends tracks. The *initiator* starts candidates from the strongest return
of the whole span and confirms them. *Integrity* says whether something else could be the ground, and bounds the error
(`track_integrity.py`). The states of a track are search, confirm, track, coast, lost.

A wrong altitude that is called NORMAL is the hazard, a missing one an inconvenience. So a block without a measurement
gives no altitude, and neither does one with a rival that could as well be the ground.
"""

import numpy as np

from ..altimeter.altimeter import Altimeter, Spectra
from ..timing.leakage import REACH_M
from ..timing.repeated_frames import RepeatedFrames, RepeatedNoise
from ..waveform import delay_to_altitude_m
from .deleter import Deleter
from .gate import Gate
from .initiator import Initiator
from .integrator import Integrator
from .scan import Scan
from .spread_ground import SpreadGround
from .summed_block import Block, Measurement
from .track import Track
from .track_integrity import Integrity
from .tracker_settings import OUTPUT_DTYPE, State, Status, TrackerSettings
from .updater import Updater

__all__ = ["OUTPUT_DTYPE", "AltitudeTracker", "State", "Status", "TrackerSettings"]

# Longest gap of missing frames, s, for which outputs are given. After a longer one the tracker restarts: an aircraft
# that climbs at 150 m/s has left the span of altitudes by then.
_LONGEST_GAP_S = 10.0
# Largest difference in seconds of the residual timing offsets within one block: 0.3 m of altitude, a third of the
# protection level's systematic part.
_SAME_TIMING_S = 2e-9
# Cells of each half sweep that distinguish frames: eight values of noise agree by chance in none of 1e20.
_MARKED_CELLS = 4
# One frame of so many is searched for lines beyond the span, five per block.
_BEYOND_STEP = 8


class AltitudeTracker:
    """Beat spectra of frames in, outputs out; keeps its state from call to call, however frames are split up.

    Parameters
    ----------
    altimeter : Altimeter
        Makes the spectra; its span of altitudes and its limit of vertical speed hold here, too.
    settings : TrackerSettings
    noise : bool
        Whether the frames carry noise. Those that repeat one of the last second bit for bit, or the noise of those of
        the last minute, are then a frozen receiver's, and count as missing. A simulation without noise repeats frames
        rightly.

    Raises
    ------
    ValueError
        If ``output_s`` holds fewer than eight frames.

    Notes
    -----
    `track_integrity.Integrity` says what the protection level is made of, and what it does not bound.

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

    def __init__(
        self,
        altimeter: Altimeter,
        settings: TrackerSettings = TrackerSettings(),  # noqa: B008 - frozen
        *,
        noise: bool = True,
    ) -> None:
        self.settings = settings
        self.sweep_s, self._doppler_lead_s = altimeter.waveform.sweep_s, altimeter.waveform.doppler_lead_s
        self.frames = round(settings.output_s / self.sweep_s)
        self.integrator = Integrator(
            altimeter,
            self.frames,
            doppler=settings.doppler is not False and altimeter.waveform.separates_doppler,
            max_speed_m_per_s=settings.max_vertical_speed_m_per_s,
        )
        lowest_start_m = settings.leakage_m or -np.inf
        if settings.leakage_m is None and self.integrator.doppler:
            lowest_start_m = REACH_M
        self._beyond_span, self._moments_of = altimeter.beyond, altimeter.moments
        self._possible_m = altimeter.settings.min_altitude_m, altimeter.settings.max_altitude_m
        gate = Gate(self.integrator, settings.gate_pfa)
        self._integrity = Integrity(gate, settings)
        self.spread = SpreadGround(self.integrator, altimeter.settings.window)
        self._repeated = RepeatedFrames(self.sweep_s) if noise else None
        moves = settings.doppler is not False  # the return of a synthetic altitude keeps its phase
        self._repeated_noise = RepeatedNoise(altimeter, self.frames) if noise and moves else None
        self._updater = Updater(gate, self._integrity)
        self._deleter = Deleter(gate, settings, self._integrity.search_threshold)
        self._initiator = Initiator(gate, self._updater, self._deleter, settings, lowest_start_m)
        cells = altimeter.beat_hz.size
        self._ratio = np.empty((self.frames, 2, cells), dtype=np.float32)
        self._received = np.empty_like(self._ratio)
        self._offset_s, self._beyond = np.empty((2, self.frames))
        self._moments = np.empty((self.frames, 2, 3), dtype=complex)
        self._here = np.empty(self.frames, dtype=np.int8)
        self.reset()

    def reset(self) -> None:
        """Forget the track and the frames that wait for a whole block."""
        self._track: Track | None = None
        self._initiator.reset()
        self._deleter.reset()
        for repeated in (self._repeated, self._repeated_noise):
            if repeated is not None:
                repeated.reset()
        self._block: int | None = None  # number of the block that is being filled
        self._next_index = 0
        self._beside = False  # whether the received frames come next to the cleaned ones

    @property
    def false_alarms_per_output(self) -> float:
        """Upper bound of the share of outputs that are NORMAL in white noise alone.

        One block has to start a candidate, and each of the next ones to confirm it within its gate. While such a
        track coasts, as many blocks in a row within the gate make it NORMAL again.
        """
        s = self.settings
        confirmed = s.search_pfa * s.gate_pfa ** (s.confirm_outputs - 1)
        coasted = (s.coast_s / s.output_s + 1.0) * s.gate_pfa**s.confirm_outputs
        return confirmed * (1.0 + coasted) / (1.0 - s.gate_pfa)

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
        that are missing altogether say FAILURE. An index that runs backwards, or ahead by more than ten seconds,
        starts the tracker anew.

        Parameters
        ----------
        spectra : Spectra
            Of n frames, by this tracker's altimeter.
        frame_index : (n,) int, optional
            Rising; default counts on from the last call.
        timing_offset_s : (n,) or scalar
            As in `Altimeter.process`.
        received : Spectra, optional
            Of the same frames before mitigation. A return that they show and ``spectra`` do not is a rival: a method
            may take the weaker of two returns for interference.

        Returns
        -------
        (k,) structured array of OUTPUT_DTYPE
            ``altitude_m``, ``vertical_speed_m_per_s`` and ``protection_level_m`` are NaN unless ``status`` is NORMAL.
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
            before = spectra if received is None else received
            frozen, moments = self._frozen(before, spectra), self._moments_of(before)
            beyond = np.full(n, np.nan)
            some = np.nonzero(index % _BEYOND_STEP == 0)[0]
            beyond[some] = self._beyond_span(before, some)
            if frozen.any():
                ratio = np.where(frozen[:, None, None], np.float32(np.nan), ratio)
            cuts = np.nonzero((np.diff(index) <= 0) | (np.diff(index // self.frames) != 0))[0] + 1
            for first, last in zip([0, *cuts], [*cuts, n], strict=True):
                part = slice(first, last)
                self._take(
                    ratio[part], raw[part], index[part], offset[part], beyond[part], moments[part], out
                )
            self._next_index = int(index[-1]) + 1
        return np.array(out, dtype=OUTPUT_DTYPE)

    def _frozen(self, spectra: Spectra, cleaned: Spectra) -> np.ndarray:
        """(n,) bool: frames with a signal that repeat an earlier one, by cells of their spectra."""
        usable = (spectra.scale > 0) & np.isfinite(spectra.scale)
        again = np.zeros(len(usable), dtype=bool)
        if self._repeated is not None:
            again[usable] = self._repeated.check(spectra.power[usable, :, :_MARKED_CELLS])
        if self._repeated_noise is not None:
            again[usable] |= self._repeated_noise.check(spectra, cleaned, usable)
        return again

    def _take(
        self,
        ratio: np.ndarray,
        raw: np.ndarray,
        index: np.ndarray,
        offset: np.ndarray,
        beyond: np.ndarray,
        moments: np.ndarray,
        out: list[tuple],
    ) -> None:
        """Store frames of one block, index rising."""
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
        self._ratio[at], self._received[at] = ratio, raw
        self._offset_s[at], self._beyond[at], self._moments[at] = offset, beyond, moments
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
        """Output of the block whose last frame is ``last``."""
        s = self.settings
        for track in (self._track, self._deleter.predecessor, *self._initiator.candidates):
            if track is not None:
                track.filter.predict(s.output_s, s.acceleration_m_per_s2)
        at = np.nonzero(self._here == 1)[0]
        if at.size:
            at = at[np.abs(self._offset_s[at] - self._offset_s[at[-1]]) <= _SAME_TIMING_S]
        if 2 * at.size < self.frames:
            self._initiator.reset()
            state = self._missed()
            failed = 2 * np.sum(self._here == 1) < self.frames - self._started_at
            status = Status.FAILURE if failed else Status.NO_COMPUTED_DATA
            return self._output(last, status, state, 0.0, at.size)
        scan = self._scan(at, last)
        status, state = self._update(scan)
        strongest = scan.block.strongest()
        strength = 0.0 if strongest is None else strongest.strength
        return self._output(last, status, state, strength, scan.block.count)

    def _scan(self, at: np.ndarray, last: int) -> Scan:
        """The frames at these places of the block that ends with frame ``last``."""
        ground, places = self.spread.find(self._received[at]), at.astype(float)
        if ground is None and self._beside:  # interference may hide it there
            ground = self.spread.find(self._ratio[at], cleaned=True)
        weights = np.float32(1.0) if ground is None else ground.weights
        block = Block(self.integrator, self._ratio[at] * weights, places)
        beyond = self._beyond[at][np.isfinite(self._beyond[at])]
        return Scan(
            block,
            middle=last - self.frames + 1 + block.middle,
            # a sawtooth measures the altitude of an instant ahead of the block's middle, or behind it
            lead_s=(self.frames - 0.5 - block.middle) * self.sweep_s - self._doppler_lead_s,
            residual_m=float(delay_to_altitude_m(self._offset_s[at[-1]])),
            beyond=float(np.median(beyond)) if beyond.size else 0.0,
            ground=ground,
            moments=self._moments[at],
            sum_received=(lambda: Block(self.integrator, self._received[at] * weights, places))
            if self._beside
            else None,
        )

    def _update(self, scan: Scan) -> tuple[int, int]:
        """Continue the track, search for a better one; status and state."""
        found: Measurement | None = None
        state = State.SEARCH
        normal = False
        if self._track is not None:
            found = self._updater.update(self._track, scan)
            measured = found or self._updater.keep(self._track, scan)
            state = State.TRACK if measured else self._missed()
            if measured and self._deleter.inconsistent(self._track, scan):
                found, state = None, State.LOST
                self._end()
            normal = found is not None and self._integrity.undisputed(self._track, scan, found)
        measured_tracks = [self._track] if self._track is not None and self._track.missed == 0 else []
        self._initiator.update(scan, measured_tracks)
        self._deleter.watch(self._track, scan)
        if self._track is not None and self._deleter.replaced(self._track, self._initiator.candidates):
            self._end()
        self._initiator.search(scan, measured_tracks)
        if self._track is None and self._initiator.candidates:
            state = State.CONFIRM if state == State.SEARCH else state
            self._track = self._initiator.confirmed()
            if self._track is not None:
                state = State.TRACK
                normal = self._integrity.undisputed(self._track, scan, self._track.latest)
        normal = normal and self._deleter.predecessor is None
        return (Status.NORMAL if normal else Status.NO_COMPUTED_DATA), state

    def _missed(self) -> int:
        """State after a block without a measurement of the track, if there is one."""
        if self._track is None:
            return State.SEARCH
        if self._deleter.missed(self._track):
            self._end()
            return State.LOST
        return State.COAST

    def _end(self) -> None:
        """End the track."""
        self._deleter.end(self._track)
        self._track = None

    def _output(self, last: int, status: int, state: int, strength: float, frames: int) -> tuple:
        """One record of `OUTPUT_DTYPE`; an altitude beyond the span or the highest protection level is not given."""
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
