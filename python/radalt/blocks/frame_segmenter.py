"""Frame segmenter: aligned frames from a stream of samples."""

import time
from collections import deque
from collections.abc import Callable

import numpy as np
import pmt
from gnuradio import gr

from ..core.altimeter.frame_quality import FrameQuality
from ..core.parsing import shown
from ..core.programme import SentAltitudes
from ..core.radio.calibration import CalibrationError
from ..core.scene import Scene
from ..core.scene.build import segmenter_of
from ..core.timing.auxiliary_samples import AuxiliarySamples
from ..core.timing.leakage import ground_is_apart
from ..core.timing.segmenter import ACQUIRING, LOCKED, LOST, Frame
from ..core.tracker.tracker_settings import Status
from ..core.waveform import altitude_to_delay_s
from ._frames import (
    FRAME_KEY,
    RX_TIME_KEY,
    SENT_KEY,
    TagError,
    frame_ring,
    frame_tag,
    read_sent_tag,
    say_once,
    time_counter,
)
from ._guard import guarded

_STATUS_EVERY = 1000  # frames between periodic status messages: 1 s of the default sweep
# Frames queued next to the ring while the methods are delayed (0.38 s of the default sweep), and bytes for wider ones.
_HELD_UP, _HELD_UP_BYTES = 384, 384 << 16
# Longest wait in this queue, s: a method that needs longer is too slow, and its frames are dropped.
_SLOW_S = 1.0
# Time before a learned leakage is subtracted, s: longer than frames take to the tracker.
_LEARNED_S = 1.0
_LARGEST = 1e15  # largest sample: its square, summed over a frame, stays within float32
_POLL_S = 1e-3  # wait for room in the output, s: one default sweep
# Least number of vectors for which the scheduler has to offer room, at most a quarter of the ring. Without input the
# scheduler halves its offer down to this number and calls `forecast` each time, at more cost than the useful calls.
_PLACES = 32

# Messages about faults of the receiver, one line each (`FrameSegmenter.fault`).
_FAULTS = {
    "frozen": "the receiver repeats samples bit for bit, so no frames: restart it (a simulation without noise needs "
    "channel.snr_db: null)",
    "quadrature": "the sweep comes with its complex conjugate, so no frames: one rail of I and Q is dead or delayed; "
    "check the receiver",
}


class frame_segmenter(gr.basic_block):
    """Acquires the sweep's timing to a fraction of a sample, then coasts; see `FrameSegmenter`.

    Each output vector carries a tag ``radalt_frame`` = (sweep index, sample counter, residual delay in seconds, true
    altitude in metres or NaN, and the fields of `QUALITY_DTYPE`). ``rx_time`` tags set the counter; an incomplete
    frame is discarded and counted. A frame is released when the next one has confirmed the timing (1 ms). A loss of
    lock, or a second of signal without a sweep, writes one line with its remedy to GNU Radio's log.

    With a leakage calibration in the scene the leakage is subtracted from every frame. Where a tracker's ``tracked``
    is connected, the calibration tracks slow changes, only in blocks in which the track holds the ground above 60 m.

    Category: [RadAlt]/Receiver. Ports: ``in: complex``, ``command: message`` (the symbol ``reacquire``), ``tracked:
    message`` (optional: `altitude_tracker`'s) ``> frames: complex vector of N``, ``status: message`` (dictionary of
    state, lock quality and counters). With ``auxiliary`` also ``auxiliary: complex > auxiliary: complex vector of
    N``, cut at the same sample counters.

    Parameters
    ----------
    scene : Scene
        Waveform, programme, segmenter settings.
    follow_programme : bool
        True checks frames against the scene's programme, and against altitudes set by hand in the chirp source's
        stream tags ``radalt_altitude``. The simulated channel passes these tags, radios do not: with radios, an
        altitude set by hand needs `follow`, or False here. With False and no ``altimeter.max_altitude_m`` one line
        says where the search ends.
    drop_when_slow : bool
        Drop frames, counted as ``dropped_slow``, when a method cannot keep up, so that a USRP never overflows. During
        a delay up to 479 frames wait (0.48 s of the default sweep): 95 in the ring, 384 in this block. Frames that
        wait here for a second, or exceed this number, are dropped, and for a second afterwards none wait here. At
        most 95 frames therefore wait for a method that is always too slow. Leave it off in simulation, where waiting
        loses nothing.
    auxiliary : bool
        Whether the ports of the second receive channel exist.
    Example
    -------
    ``seg = radalt.frame_segmenter(scene)``
    """

    def __init__(
        self,
        scene: Scene,
        follow_programme: bool = True,
        drop_when_slow: bool = False,
        auxiliary: bool = False,
    ) -> None:
        n, ports = scene.waveform.samples_per_frame, 1 + bool(auxiliary)
        gr.basic_block.__init__(
            self, "radalt_frame_segmenter", [np.complex64] * ports, [(np.complex64, n)] * ports
        )
        self._rate = scene.waveform.rate_hz
        self._sent = SentAltitudes(scene.altitude.programme)
        self._known: Callable[[int], tuple[float, float]] | None = self._sent.at if follow_programme else None
        self._follows_programme = bool(follow_programme)
        self.segmenter = segmenter_of(scene, follow_programme=bool(follow_programme))
        self._second = AuxiliarySamples(self.segmenter) if auxiliary else None
        if not follow_programme and scene.altimeter.max_altitude_m is None:
            self.logger.warn(
                f"altitudes above {scene.altimeter_settings.max_altitude_m:g} m, the highest of altitude.programme_m, "
                "are not searched; altimeter.max_altitude_m says how high to search"
            )
        if scene.auxiliary is not None and not auxiliary:
            self.logger.warn(
                f"scene {scene.name} has two receive channels, and this flowgraph uses the first alone"
            )
        self.drop_when_slow = bool(drop_when_slow)
        self.dropped_slow = 0
        self.saturated_frames = 0
        self.bad_tags = 0
        self._unusable = False
        self._start_counter = 0
        self._calibrated: float | None = None
        # from transmitter to receiver, fraction included, by the last frame
        self.latency_samples = float("nan")
        # (sample counter, time) of each chunk, for measurements of latency
        self.arrivals: deque[tuple[int, float]] | None = None
        self._quality = FrameQuality(scene.waveform, scene.altimeter_settings.max_altitude_m)
        adc = scene.channel
        # largest value of the scene's converter; without a converter nothing saturates
        self._full_scale = adc.full_scale * (1 - 2.0 ** (1 - adc.adc_bits)) if adc.adc_bits > 1 else np.inf
        self._ready: deque[Frame] = deque()
        self._started = False
        # for other threads: reading the scheduler's counters while a flowgraph starts is a segmentation fault
        self.has_heard = False
        self._reacquire = False
        self._reported: tuple[str, str, bool, int] = ("", "", False, 0)
        self._silent_from: int | None = None  # sample counter from which there is no timing
        self._said = False
        self.set_tag_propagation_policy(gr.TPP_DONT)
        places = min(_PLACES, frame_ring(self, n) // 4)
        self.set_output_multiple(places)
        # with less room the scheduler would not call this block, and the radio would overflow
        self._kept_free = places if drop_when_slow else 0
        self._most_waiting = min(_HELD_UP, _HELD_UP_BYTES // (8 * n))
        self._waits_from, self._dropped_at = 0, -np.inf  # by the input's sample counter
        self._leakage = self.segmenter.leakage
        self._block_frames = round(scene.tracker.output_s / scene.waveform.sweep_s)
        self._later = round(_LEARNED_S / scene.waveform.sweep_s)
        tracked = pmt.intern("tracked")
        self.message_port_register_in(tracked)
        self.set_msg_handler(tracked, self._on_tracked)
        self._status_port = pmt.intern("status")
        self.message_port_register_out(self._status_port)
        command = pmt.intern("command")
        self.message_port_register_in(command)
        self.set_msg_handler(command, self._on_command)

    def _on_command(self, message) -> None:  # noqa: ANN001
        """``reacquire``: acquire the timing again at the next opportunity."""
        if pmt.is_symbol(message) and pmt.symbol_to_string(message) == "reacquire":
            self.reacquire()

    def _on_tracked(self, message) -> None:  # noqa: ANN001
        """Learn the leakage from the frames of a tracker's output, if the ground is resolved from it."""
        if self._leakage is None or not self._leakage.calibrated or not pmt.is_dict(message):
            return
        output = pmt.to_python(message)
        self._leakage.following = True
        last = int(output["frame_index"])
        normal = output["status"] == Status.NAMES[Status.NORMAL]
        known = (output[name] for name in ("altitude_m", "protection_level_m", "vertical_speed_m_per_s"))
        if ground_is_apart(normal, *known):
            self._leakage.learn(last - self._block_frames + 1, last, last + self._later)
        else:
            self._leakage.forget(last)

    def reacquire(self) -> None:
        """Acquire the timing again at the next opportunity; for other threads."""
        self._reacquire = True

    def follow(self, sent: Callable[[int], tuple[float, float]]) -> None:
        """Set altitude and range rate by sweep index (`fmcw_chirp_source.sent`), instead of the programme's."""
        self._known = sent
        self.segmenter.follow(sent)

    def set_full_scale(self, full_scale: float) -> None:
        """Rail value from which a sample counts as saturated; 1.0 for a UHD source. Raises ValueError."""
        self._full_scale = _number("full_scale", full_scale, 1e-30, 1e30)

    def set_start_time(self, seconds: float) -> None:
        """Device time of the transmitter's first sample, the origin of ``rx_time``; call it before the start.

        Raises ValueError.
        """
        seconds = _number("start time", seconds, 0.0, 1e12)
        self._start_counter = round(seconds * self._rate)

    def set_calibration(self, latency_samples: float | None) -> None:
        """Subtract a calibrated latency instead of the one measured at altitude zero: the external path remains.

        Raises ValueError.
        """
        if latency_samples is not None:
            latency_samples = _number("latency in samples", latency_samples, -1e9, 1e9)
        self._calibrated = latency_samples

    def set_reference(self, altitude_m: float) -> None:
        """Altitude in metres of the sweeps on which timing is acquired, default 0: that of a recording's beginning.

        Raises ValueError.
        """
        altitude_m = _number("reference altitude", altitude_m, 0.0, 1e6)
        self.segmenter.reference_samples = float(altitude_to_delay_s(altitude_m)) * self._rate

    def status(self) -> dict[str, object]:
        """State, lock quality and counters."""
        own = ("dropped_slow", "saturated_frames", "bad_tags")
        return self.segmenter.status() | {name: getattr(self, name) for name in own}

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        """One sample, or none while finished frames wait."""
        return [0 if self._ready else 1] * ninputs

    @guarded
    def general_work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Feed the segmenter between time tags, hand finished frames on."""
        out = output_items[0]
        if self._reacquire:
            self._reacquire = False
            self.segmenter.reacquire()
        # consume no more samples than the output, or the queue of this block, has room for
        room = len(out) - self._kept_free - len(self._ready)
        bite = input_items[0][: min(len(items) for items in input_items)]
        if room > 0 or not self.drop_when_slow:
            bite = bite[: max(1, room) * out.shape[1]]
        elif not bite.size:
            time.sleep(_POLL_S)  # the scheduler would call again at once: it cannot wait for output room only
        if self.segmenter.state == ACQUIRING and bite.size and not self._unusable:
            self._unusable = not np.abs(bite.view(np.float32)).max() <= _LARGEST  # NaN fails the comparison
        self._take(bite, input_items[-1])
        self.has_heard |= bite.size > 0
        if self.arrivals is not None:
            self.arrivals.append((self.segmenter.sample_counter, time.perf_counter()))
        done = self._hand_on(output_items)
        for port in range(len(input_items)):
            self.consume(port, bite.size)  # from here on the input buffer may be overwritten
        if self.drop_when_slow:
            self._drop()
        self._report()
        return done

    def _take(self, samples: np.ndarray, second: np.ndarray) -> None:
        first, at = self.nitems_read(0), 0
        for tag in self.get_tags_in_window(0, 0, samples.size, SENT_KEY):
            self._on_sent(tag.value)
        for tag in sorted(self.get_tags_in_window(0, 0, samples.size, RX_TIME_KEY), key=lambda t: t.offset):
            cut = tag.offset - first
            self._push(samples[at:cut], second[at:cut])
            self._release(self._on_time(tag.value))
            at = cut
        self._push(samples[at:], second[at : samples.size])

    def _push(self, samples: np.ndarray, second: np.ndarray) -> None:
        if self._second is not None:
            self._second.push(second)
        self._release(self.segmenter.push(samples))

    def _release(self, frames: list[Frame]) -> None:
        """Frames are ready, with the second channel's samples of their time."""
        if self._second is not None:
            for frame, row in zip(frames, self._second.cut(frames), strict=True):
                frame.auxiliary = row
        self._ready.extend(frames)

    def _on_sent(self, value) -> None:  # noqa: ANN001 - a pmt
        """Store an altitude set by hand by the source's tag, unless `follow` gives the altitudes."""
        try:
            read_sent_tag(value, self._sent)
        except TagError as error:
            say_once(self, error)
            return
        if self._known is None or self._known == self._sent.at:
            self.follow(self._sent.at)

    def _on_time(self, value) -> list[Frame]:  # noqa: ANN001
        """Set the counter by an ``rx_time`` tag; the first one sets the origin, and ends an earlier lock."""
        try:
            counter = time_counter(value, self._rate) - self._start_counter
        except TagError as error:
            say_once(self, error)
            return []
        if not self._started:
            self._started = True
            if self.segmenter.sample_counter:
                return self.segmenter.restart(counter)
            self.segmenter.reset(counter)
            return []
        return self.segmenter.jump(counter - self.segmenter.sample_counter)

    def _hand_on(self, outputs: list[np.ndarray]) -> int:
        out = outputs[0]
        first, done = self.nitems_written(0), max(0, min(len(self._ready), len(out) - self._kept_free))
        frames = [self._ready.popleft() for _ in range(done)]
        for row, frame in zip(out, frames, strict=False):
            row[:] = frame.samples
        if self._second is not None:
            for row, frame in zip(outputs[1], frames, strict=False):
                row[:] = frame.auxiliary
        quality = self._quality(out[:done])
        if np.isfinite(self._full_scale):
            self.saturated_frames += int(np.count_nonzero(quality["peak"] >= 0.9999 * self._full_scale))
        for place, frame in enumerate(frames, first):
            self._measure_latency(frame)
            sent_m = self._known(frame.index)[0] if self._known is not None else float("nan")
            self.add_item_tag(0, place, FRAME_KEY, frame_tag(frame, sent_m, quality[place - first]))
        return done

    def _drop(self) -> None:
        """Drop waiting frames that are too many, have waited too long, or follow a drop within `_SLOW_S`."""
        now, lasting = self.nitems_read(0), _SLOW_S * self._rate
        if not self._ready:
            self._waits_from = now
        elif (
            len(self._ready) > self._most_waiting
            or now - self._waits_from > lasting
            or now - self._dropped_at < lasting
        ):
            self.dropped_slow += len(self._ready)
            self._ready.clear()
            self._dropped_at = now

    def _measure_latency(self, frame: Frame) -> None:
        """Store the latency, and replace the measured one by a calibrated one."""
        n = frame.samples.size
        before = frame.start_sample - frame.index * n
        self.latency_samples = before + frame.offset_s * self._rate
        if self._calibrated is not None:
            path = self.latency_samples - self._calibrated
            if not -2.0 <= path <= n / 4:
                raise CalibrationError(
                    f"the stored latency of {self._calibrated:g} samples does not fit the {self.latency_samples:.2f} "
                    "found; calibrate anew"
                )
            frame.offset_s = (self._calibrated - before) / self._rate

    def _report(self) -> None:
        """Send a status message on every change of state or of verified timing, and every thousand frames."""
        seg = self.segmenter
        now = (
            seg.state,
            seg.fault,
            seg.timing_verified,
            seg.counters["discontinuities"] + seg.counters["frames"] // _STATUS_EVERY,
        )
        if now != self._reported:
            lost = seg.state == LOST and self._reported[0] != LOST
            faulty = seg.fault and seg.fault != self._reported[1]
            self._reported = now
            self.message_port_pub(self._status_port, pmt.to_pmt(self.status()))
            if lost:
                self.logger.warn(self._why_lost())
            if faulty:
                self.logger.warn(_FAULTS[seg.fault])
        self._watch()

    def _why_lost(self) -> str:
        """Cause and remedy of a loss of lock, one line."""
        seg = self.segmenter
        section = seg.next_sync
        again = (
            f"taken again from sweep {section[0]} on"
            if section is not None
            else "not taken again: send the command reacquire at altitude zero, or set altitude.sync_every_frames"
        )
        cause = "samples were lost without a tag, or time ran backwards"
        if self._follows_programme and not self._sent.by_hand and self._known == self._sent.at:
            cause += (
                "; or the altitude is set by hand and no tag says so: frame_segmenter.follow(chirp_source.sent), "
                "follow_programme False, or altitude_m None at the source"
            )
        return f"timing lost, no frames: {seg.lock_loss or 'tagged time'}; {cause}. Timing is {again}"

    def _watch(self) -> None:
        """Log one line after a second of signal without a sweep."""
        seg = self.segmenter
        if seg.state == LOCKED:
            self._unusable = False
            self._silent_from, self._said = None, False
        elif self._silent_from is None:
            self._silent_from = seg.sample_counter
        elif (
            seg.state == ACQUIRING and not self._said and seg.sample_counter - self._silent_from >= self._rate
        ):
            self._said = True
            self.logger.warn(f"no sweep found in a second of signal, so no frames: {self._why_silent()}")

    def _why_silent(self) -> str:
        if self._unusable:
            return f"samples are not finite, or beyond {_LARGEST:g}; check the block before the segmenter"
        return (
            "is the radar transmitting the scene's waveform, at altitude zero (timing is acquired there), and received "
            "above the noise?"
        )

    def start(self) -> bool:
        """Handle a second start: samples between are lost, and where it was locked the content of its rings."""
        if self.has_heard:
            self.logger.warn(
                "the flowgraph was reconfigured or started again, which loses samples and with them the timing: build "
                "it anew, or send the command reacquire at altitude zero"
            )
        return True

    def stop(self) -> bool:
        """Log the reason where a stream has ended without a frame."""
        seg = self.segmenter
        if self.has_heard and not seg.counters["frames"] and not self._said:
            seconds = seg.sample_counter / self._rate
            self.logger.warn(f"{seconds:.3g} s of signal without a frame: {self._why_silent()}")
        return True


def _number(what: str, value: float, low: float, high: float) -> float:
    """A finite number within limits; raises ValueError with one line."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not low <= number <= high:
        raise ValueError(f"{what} is {shown(value)}; it has to be a number within {low:g}..{high:g}")
    return number
