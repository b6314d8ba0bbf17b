"""Frame timing: acquire on the sweep, coast on the sample counter, detect when the counter is wrong.

The correlation of a delayed chirp with the reference peaks at the delay itself. Timing is therefore acquired, to a
fraction of a sample, only where the altitude is known to be zero (the programme's preamble and synchronisation
sections); after that it coasts. Each later frame is only *checked*: the matched filter at the altitude that was
transmitted has to peak at the assumed timing. The check never moves the timing, so it cannot pull an altitude towards
the truth.
"""

from collections import deque
from collections.abc import Callable

import numpy as np

from ..programme import Programme
from ..waveform import Waveform, altitude_to_delay_s
from .frame import Frame
from .leakage import LeakageCanceller
from .leakage_timing import LeakageTiming
from .receiver_faults import ReceiverFaults
from .segmenter_settings import SegmenterSettings
from .slips import MEMORY_FRAMES, MOST_LOST_FRAMES, Slips
from .sweep_check import NOT_CHECKED, SweepCheck
from .sweep_finder import SweepFinder

__all__ = ["Frame", "FrameSegmenter", "SegmenterSettings"]

ACQUIRING, LOCKED, LOST, RESYNC = "acquiring", "locked", "lost", "resync"
_COUNTERS = (
    *("frames", "torn", "discontinuities", "lost_samples", "lock_losses", "unlocked_frames"),
    *("faulty_frames", "acquisitions", "index_corrections"),
)
# Frames without a sweep after which only one in ``confirm_frames + 2`` is searched over all delays, which costs six
# FFTs. Those between are still held, and searched once one of them, or the matched filters, show the sweep again.
_UNSEEN = 8


class FrameSegmenter:
    """Stream of samples in any chunks in, whole aligned frames out.

    `follow` names altitudes that were set by hand; they take precedence over the programme's.

    - ``programme``: what was transmitted when. None (a person sets the altitude): after a lost lock it waits for
      `reacquire`. Unless `follow` says what is sent, frames are then only checked to hold a sweep within the altitude
      span
    - ``max_altitude_m``: highest altitude, for the check without a programme
    - ``true_delay``: whether altitudes come as true delays (with Doppler) or as beat shifts
    - ``point_target``: False for an extended return, which matches no single delay: frames are then checked as without
      a programme. The synchronisation sections are still the programme's
    - ``leakage``: subtracts the transmitter's own leakage from every frame. Timing is then acquired and held on the
      leakage (`LeakageTiming`). Not with beat shifts, which shift the leakage as well
    - ``noise``: whether samples carry noise: frames that repeat one of the last second bit for bit are then a frozen
      receiver's, and are not released. In a simulation without noise, repeated frames are no fault
    - ``counters``: ``frames`` emitted, ``torn`` frames discarded at tagged discontinuities, ``discontinuities``,
      ``lost_samples``, ``lock_losses``, ``unlocked_frames`` not emitted without timing, ``faulty_frames`` not emitted
      because of `fault`, ``acquisitions``, ``index_corrections`` by whole frames that went missing (altitudes set by
      hand)
    - ``lock_loss``: what ended the last lock: sweep, expected altitude, measured altitude; else empty
    - ``unverified_frames``: since the last verified one. A loss without a tag is detected in frames that show the
      sweep; under interference that hides it, and with an extended return, it is not

    A loss of samples without a tag is found by `slips.Slips`: frames that agree on one end the lock. A slip by less
    than a frame shows in ``confirm_frames`` consecutive frames. A slip by whole frames shows only where the altitude
    steps; that frame is never released. With altitudes set by hand, counting then goes on from the sweep that was seen.
    """

    def __init__(
        self,
        waveform: Waveform,
        programme: Programme | None = None,
        settings: SegmenterSettings = SegmenterSettings(),  # noqa: B008 - frozen
        *,
        max_altitude_m: float = 1500.0,
        true_delay: bool = False,
        point_target: bool = True,
        leakage: LeakageCanceller | None = None,
        noise: bool = True,
    ) -> None:
        if leakage is not None and not true_delay:
            raise ValueError(
                "a leakage calibration needs true delays: a beat shift moves the leakage with the return, and the line "
                "at 0 m is then the return of the preamble; leave it out, or set altitude.mode: true_delay"
            )
        self.waveform, self.programme, self.settings = waveform, programme, settings
        self.true_delay, self.point_target = true_delay, point_target
        self._n = waveform.samples_per_frame
        self._finder = SweepFinder(waveform, settings, true_delay=true_delay)
        self._check = SweepCheck(self._finder, max_altitude_m)
        self.leakage = leakage
        self._leakage = None if leakage is None else LeakageTiming(leakage, self._finder)
        self._installation_m = 0.0 if leakage is None else leakage.installation_delay_m
        # spare capacity: the buffer is compacted only every few frames
        self._buffer = np.empty((settings.acquisition_frames + 12) * self._n, dtype=np.complex64)
        self._faults = ReceiverFaults(self._finder, noise=noise)
        self.counters = dict.fromkeys(_COUNTERS, 0)
        self._sent_by_hand: Callable[[int], tuple[float, float]] | None = None
        self.unverified_frames = 0
        self.lock_loss = ""
        self.reference_samples = 0.0  # delay of the sweeps on which timing is acquired
        self.reset()

    def reset(self, first_sample: int = 0) -> None:
        """Start over at sample counter ``first_sample``; counters stay."""
        self.state = ACQUIRING
        self._origin = first_sample  # sample counter of the first waiting sample
        self._first = self._filled = 0  # its place in the buffer, and the number of waiting samples
        self._index = 0
        self._offset_s = 0.0
        self._discard = 0  # samples of a torn frame still to come
        self._unseen = 0  # frames since one showed the sweep
        self._held: deque[tuple[Frame, str]] = deque()
        self._slips = Slips(self.settings.confirm_frames)

    def follow(self, sent: Callable[[int], tuple[float, float]]) -> None:
        """Altitude in metres and range rate in m/s of a sweep by its index, where a person sets it."""
        self._sent_by_hand = sent

    @property
    def sample_counter(self) -> int:
        """Counter of the next sample that is expected."""
        return self._origin + self._filled

    def reacquire(self) -> None:
        """Acquire timing again; the altitude has to be zero."""
        self._held.clear()
        self._slips.clear()
        self.state = ACQUIRING

    def push(self, samples: np.ndarray) -> list[Frame]:
        """Take a chunk of complex64 samples, return the frames that it completed and that are safe to use."""
        out: list[Frame] = []
        taken, n = 0, self._n
        # samples may hold any value, which the verdicts handle
        with np.errstate(invalid="ignore", over="ignore"):
            while taken < samples.size:
                left = samples.size - taken
                if self.state == LOCKED and not (self._filled or self._discard) and left >= n:
                    taken += self._emit_whole(samples[taken : taken + left // n * n], out)
                    continue
                end = self._first + self._filled
                if self._buffer.size - end < left and self._first:
                    self._buffer[: self._filled] = self._buffer[self._first : end].copy()
                    self._first, end = 0, self._filled
                count = min(left, self._buffer.size - end)
                if self.state == LOCKED and self._filled < n:  # whole frames need not wait in the buffer
                    count = min(count, self._discard + n - self._filled)
                self._buffer[end : end + count] = samples[taken : taken + count]
                self._filled += count
                taken += count
                while self._step(out):
                    pass
        self.counters["frames"] += len(out)
        return out

    def jump(self, lost_samples: int) -> list[Frame]:
        """A tagged discontinuity: ``lost_samples`` are missing before the next chunk.

        Timing stays known (the counter advances by what is missing), so only the torn frame is discarded. Frames that
        were held back for the monitor are judged by what it has seen so far.
        """
        if lost_samples == 0:
            return []
        self.counters["discontinuities"] += 1
        self.counters["lost_samples"] += max(0, lost_samples)
        counter = self.sample_counter + lost_samples
        # time that runs backwards says nothing about the sweep
        if self.state == ACQUIRING or lost_samples < 0:
            return self.restart(counter)
        released = self.drain()
        torn = -(-(counter - self._origin) // self._n)
        self.counters["torn"] += torn
        self._index += torn
        self._discard = self._discard_to(self._origin + torn * self._n, counter)
        return released

    def restart(self, counter: int) -> list[Frame]:
        """The next sample is number ``counter``; how many are missing before it is unknown.

        The lock is lost. It is acquired again where the altitude is known to be zero: any other would become zero.
        """
        released = self.drain()
        if self.state != ACQUIRING:
            self._lose_lock(0)
        self._discard = self._discard_to(counter, counter)
        return released

    def _discard_to(self, boundary: int, counter: int) -> int:
        """Empty the buffer at sample ``counter``; returns the samples still to be skipped up to ``boundary``."""
        self._origin, self._first, self._filled = counter, 0, 0
        return boundary - counter

    def drain(self) -> list[Frame]:
        """End of the stream: frames still held back and not contradicted."""
        released = [frame for frame, verdict in self._held if verdict != "contradicted"]
        self._held.clear()
        self.counters["frames"] += len(released)
        return released

    # -- one step of the state machine; True if the buffer may hold more ------------------------------------------

    def _step(self, out: list[Frame]) -> bool:
        if self._discard:
            count = min(self._discard, self._filled)
            self._consume(count)
            self._discard -= count
            if self._discard:
                return False
        if self.state == ACQUIRING:
            return self._acquire()
        if self._filled < self._n:
            return False
        if self.state == LOCKED:
            samples = self._waiting(0, self._n)
            self._first += self._n
            self._filled -= self._n
            return bool(self._emit_whole(samples, out))
        if self.state == RESYNC:
            return self._confirm_index()
        return self._wait_for_sync()

    def _consume(self, count: int) -> None:
        self._first += count
        self._filled -= count
        self._origin += count

    def _waiting(self, first: int, last: int) -> np.ndarray:
        """View of the samples ``first..last-1`` that wait."""
        return self._buffer[self._first + first : self._first + last]

    def _skip_frame(self) -> bool:
        """Drop a frame without timing."""
        self.counters["unlocked_frames"] += 1
        self._consume(self._n)
        self._index += 1
        return True

    def _lock(self, index: int) -> bool:
        """Timing is known from sweep ``index`` on, which begins with the next sample."""
        self.state, self._index = LOCKED, index
        self.counters["acquisitions"] += 1
        return True

    # -- acquisition ----------------------------------------------------------------------------------------------

    def _acquire(self) -> bool:
        """Average frames, correlate, refine; lock or advance a frame. The first frame may precede the transmitter."""
        needed = (self.settings.acquisition_frames + 2) * self._n
        if self._filled < needed:
            return False
        found = self._locate(self._n, needed)
        if found is None or self._faults.conjugated(self._waiting(self._n, 2 * self._n)):
            return self._skip_frame()
        exact = found[1] - self.reference_samples
        self._offset_s = (exact - round(exact)) / self.waveform.rate_hz
        # timing is known, also of earlier frames: go back to the first whole one
        self._consume((found[0] + round(exact)) % self._n)
        # one sample of tolerance: a latency near zero may be estimated slightly below it
        index = (self._origin + self._offset_s * self.waveform.rate_hz + 1.0) / self._n
        return self._lock(int(np.floor(index)))

    def _locate(self, first: int, last: int) -> tuple[int, float] | None:
        """As `SweepFinder.locate`; where the leakage is known, timing is acquired on it alone."""
        samples = self._waiting(first, last)
        if self._leakage is None:
            return self._finder.locate(samples)
        return self._leakage.locate(samples, self._origin + first)

    # -- locked ---------------------------------------------------------------------------------------------------

    def _emit_whole(self, samples: np.ndarray, out: list[Frame]) -> int:
        """Emit the whole frames of ``samples`` until the lock is lost; returns how many samples these are."""
        frames, done = samples.reshape(-1, self._n), 0
        for frame, mark in zip(frames, self._faults.marks(frames), strict=True):
            self._emit(frame.astype(np.complex64), mark, out)
            done += self._n
            if self.state != LOCKED:
                break
        return done

    def _emit(self, samples: np.ndarray, mark: bytes, out: list[Frame]) -> None:
        frame = Frame(self._index, self._origin, samples, self._offset_s)
        self._origin += self._n
        self._index += 1
        if self._faults.found_in(samples, mark, frame.index):  # before anything is subtracted
            self.counters["faulty_frames"] += 1
            return
        slip = None
        if self._leakage is not None:
            slip = self._leakage.slip(samples, frame.index, self._expected(frame.index), self._offset_s)
            frame.samples = samples = self._leakage.canceller.clean(samples, frame.index)
            frame.offset_s += float(altitude_to_delay_s(self._installation_m))
        if not self.settings.monitor:
            out.append(frame)
            return
        sent = self._expected(frame.index)
        seen_before = self._unseen <= _UNSEEN
        found = NOT_CHECKED
        if slip is None:
            near = self._check.near(samples, sent, self._offset_s)
            due = self._unseen % (self.settings.confirm_frames + 2) == 0
            if near is not None or seen_before or due:
                found = self._check.verdict(samples, sent, self._offset_s, near)
        if self._leakage is not None:
            found = self._leakage.verdict(found, slip, sent)
        shown = found[0] in ("verified", "contradicted")
        self._unseen = 0 if shown else self._unseen + 1
        known = sent is not None or slip == 0.0
        self.unverified_frames = 0 if found[0] == "verified" and known else self.unverified_frames + 1
        counted = self._index
        if seen_before or not shown or self._check_back(out):
            moved = self._index - counted
            frame.index += moved
            self._judge(frame, self._verdict(frame) if moved else found, out)

    def _check_back(self, out: list[Frame]) -> bool:
        """Judge the frames from the first unchecked one on, now that the sweep shows; whether the lock holds."""
        held = self._held
        checked = next((n for n, (_, verdict) in enumerate(held) if verdict == NOT_CHECKED[0]), len(held))
        unchecked = [held.pop()[0] for _ in range(len(held) - checked)][::-1]
        counted = self._index
        for number, frame in enumerate(unchecked):
            moved = self._index - counted
            frame.index += moved
            if not self._judge(frame, self._verdict(frame, near=moved != 0), out):
                # and the one that showed the sweep
                self.counters["unlocked_frames"] += len(unchecked) - number
                return False
        return True

    def _judge(self, frame: Frame, found: tuple[str, float, float], out: list[Frame]) -> bool:
        """Hold a frame, and release those that are safe by what `SweepCheck` has ``found``; whether the lock holds."""
        verdict, seen, tolerance = found
        held = self._held
        held.append((frame, verdict))
        if verdict == "contradicted" and self._slipped(frame.index, seen, tolerance):
            self._note_loss(frame.index, seen)
            self._lose_lock(len(held))
            return False
        if verdict == "verified":
            # a verified frame verifies all before it; it waits for the next one itself, since it may be torn
            self._slips.rule_out(lambda: self._sent_delays(frame.index))
            wrong = self._slips.in_time()
            held.pop()
            out.extend(f for f, _ in held if f.index not in wrong)
            self.counters["unlocked_frames"] += sum(f.index in wrong for f, _ in held)
            held.clear()
            held.append((frame, verdict))
        elif len(held) > self.settings.confirm_frames + 1:
            out.append(held.popleft()[0])
        return True

    def _note_loss(self, index: int, seen: float) -> None:
        """``seen`` is the measured delay of sweep ``index`` in samples."""
        sent = self._sent(index)
        expected = "within the altitude span" if sent is None else f"at {sent[0]:g} m"
        seen_m = round(seen / self.waveform.rate_hz / float(altitude_to_delay_s(1.0)), -1) + 0.0
        self.lock_loss = f"sweep {index} was expected {expected} and seen near {seen_m:.0f} m"

    def _lose_lock(self, frames: int) -> None:
        self.counters["lock_losses"] += 1
        self.counters["unlocked_frames"] += frames
        self._held.clear()
        self._slips.clear()
        self.state = LOST

    # -- slips ----------------------------------------------------------------------------------------------------

    def _sent(self, index: int) -> tuple[float, float] | None:
        """Altitude and range rate of the point that a frame was sent for; None where that is not known."""
        if self._sent_by_hand is not None and self.point_target:
            return self._sent_by_hand(index)
        if self.programme is None:
            return None
        return self.programme.at(index) if self.point_target or not self.programme.is_trial(index) else None

    def _expected(self, index: int) -> tuple[float, float] | None:
        """`_sent`, plus the installation delay where timing is acquired on the leakage."""
        sent = self._sent(index)
        return sent if sent is None or self._leakage is None else (sent[0] + self._installation_m, sent[1])

    def _sent_delays(self, index: int) -> np.ndarray:
        """(q,) delays in samples of this frame and the following ones; 0 where the altitude is not known."""
        sent = [self._expected(index + q) or (0.0, 0.0) for q in range(MOST_LOST_FRAMES + 1)]
        return altitude_to_delay_s(np.array([altitude for altitude, _ in sent])) * self.waveform.rate_hz

    def _slipped(self, index: int, seen: float, tolerance: float) -> bool:
        """Note a frame measured at another delay; whether enough frames agree on one slip."""
        agreed, whole = self._slips.note(
            index, seen - self._sent_delays(index), tolerance, known=self._sent(index) is not None
        )
        if self.programme is None and whole:
            self._count_on(whole)
            return False
        return agreed

    def _count_on(self, frames: int) -> None:
        """Correct the index by whole lost frames: timing is right, and altitudes set by hand have no trial numbers."""
        self._index += frames
        self.counters["index_corrections"] += 1
        for frame, verdict in self._held:
            if verdict == "contradicted":
                frame.index += frames
        self._slips.clear()

    def _verdict(self, frame: Frame, *, near: bool = True) -> tuple[str, float, float]:
        """`SweepCheck.verdict` of a frame under its present index; matched filters only if ``near``."""
        sent = self._expected(frame.index)
        found = self._check.near(frame.samples, sent, self._offset_s) if near else None
        return self._check.verdict(frame.samples, sent, self._offset_s, found)

    # -- lock lost ------------------------------------------------------------------------------------------------

    @property
    def next_sync(self) -> tuple[int, int] | None:
        """First sweep and length of the next section in which timing can be acquired; None if none is ahead."""
        section = self.programme.next_sync(self._index - 2) if self.programme else None
        # an altitude set by hand is sent throughout the section, and would be taken for zero
        return section if section is None or (self._sent(section[0]) or (0.0, 0.0))[0] == 0.0 else None

    def _wait_for_sync(self) -> bool:
        """Count frames at the old timing until a synchronisation section has certainly begun, then locate."""
        section = self.next_sync
        count = self.settings.acquisition_frames
        # two frames of margin at either end of the section: the index itself may be wrong by the lost frames
        if section is None or self._index != section[0] + 2:
            return self._skip_frame()
        if self._filled < (count + 1) * self._n:
            return False
        found = self._locate(0, (count + 1) * self._n)
        if found is None:
            return self._skip_frame()
        self._offset_s = found[1] / self.waveform.rate_hz
        self._section_end = section[0] + section[1]
        self._consume(found[0] % self._n)
        self.state = RESYNC
        return True

    def _confirm_index(self) -> bool:
        """Advance to the end of the section, where the altitude steps away from zero: that gives the frame index."""
        waiting = self._waiting(0, self._n)
        if self._leakage is not None:
            waiting = self._leakage.canceller.subtract(waiting[None], self._index)[0]
        peak, significance, _ = self._finder.correlate(waiting)
        delay = peak if peak < self._n // 2 else peak - self._n
        after_s = altitude_to_delay_s(self.programme.altitude_m(self._section_end))
        after = float(after_s) * self.waveform.rate_hz
        stepped = significance >= 0.6 * self.settings.lock_threshold and abs(delay) > 1.0
        overdue = self._index > self._section_end + 4
        if stepped and abs(delay - after) > 1.5 or overdue and after >= 1.0:
            self.state = LOST  # not the step that was due: more samples went missing
        elif stepped or overdue:
            return self._lock(self._section_end if stepped else self._index)
        return self._skip_frame()

    @property
    def fault(self) -> str:
        """What is wrong with the receiver by the last frame: ``""``, ``"frozen"`` or ``"quadrature"``."""
        return self._faults.fault

    @property
    def timing_verified(self) -> bool:
        """Whether one of the last fifty frames was verified."""
        return self.state == LOCKED and self.unverified_frames <= MEMORY_FRAMES

    def status(self) -> dict[str, object]:
        """State, lock quality in dB (correlation over mean), how well timing is known, and counters, for telemetry."""
        return {
            "state": self.state,
            "locked": self.state == LOCKED and not self.fault,
            "fault": self.fault,
            "quality_db": self._finder.quality_db,
            "unverified_frames": self.unverified_frames,
            "timing_verified": self.timing_verified,
            **self.counters,
        }
