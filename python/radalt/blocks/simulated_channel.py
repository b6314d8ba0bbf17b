"""Simulated channel with the front ends of two B210s: replaces the UHD blocks."""

import time

import numpy as np
from gnuradio import gr

from ..core.scene import Scene
from ..core.scene.build import channel_of
from ._frames import RX_TIME_KEY, SENT_KEY, gather_frames, time_tag
from ._guard import guarded

_HELD_FRAMES = 12  # frames per call in real time: 4 ms less latency than sixteen


class simulated_channel(gr.basic_block):
    """Received signal of the radar from both transmitters.

    ``y = D(x_radar) + D_j(x_jammer) + noise`` with the impairments of the scene's ``channel`` (`ChannelSettings`),
    each off by default. The first sample, and the first after every tagged gap, carries ``rx_time`` as UHD sets it.
    The source's tags ``radalt_altitude`` pass.

    Category: [RadAlt]/Channel. Ports: ``radar: complex``, ``jammer: complex`` (optional) ``> out: complex``, and
    ``auxiliary: complex`` (optional).

    Parameters
    ----------
    scene : Scene
        Channel settings, waveform, true-delay programme and seed.
    jammer : bool
        Whether the second input exists.
    realtime : bool
        Limit the throughput to the sample rate, as with radios; for live views. While the flowgraph takes no samples,
        a radio's would wait in its ring; here the clock waits, ``held_up_s`` in total, ``longest_hold_up_s`` at most.
    auxiliary : bool
        Whether the output of the second receive channel exists; the scene has to have the section ``auxiliary``.
    Example
    -------
    ``chan = radalt.simulated_channel(scene, jammer=True)``
    """

    def __init__(
        self, scene: Scene, jammer: bool = True, realtime: bool = False, auxiliary: bool = False
    ) -> None:
        inputs, outputs = [np.complex64] * (2 if jammer else 1), [np.complex64] * (2 if auxiliary else 1)
        gr.basic_block.__init__(self, "radalt_simulated_channel", inputs, outputs)
        if scene.auxiliary is not None and len(scene.auxiliary.directions) > 1:
            raise ValueError(
                f"scene {scene.name}: auxiliary.directions has {len(scene.auxiliary.directions)} entries, and a "
                "flowgraph's jammer has one antenna; give one direction, or use radalt.evaluate or radalt bench"
            )
        self.channel = channel_of(scene)
        if auxiliary and self.channel.auxiliary is None:
            raise ValueError(
                f"scene {scene.name}: it has one receive channel; give it a section auxiliary, or leave auxiliary off"
            )
        self._n = scene.waveform.samples_per_frame
        self._rate = scene.waveform.rate_hz
        self._tagged = scene.channel.drops.tagged
        self._first = 0  # counter of the next input sample
        self._expected: int | None = None  # counter of the next output sample
        self._realtime = bool(realtime)
        self._start_s: float | None = None  # monotonic time of sample 0
        self.held_up_s = self.longest_hold_up_s = 0.0  # time that a radio's samples would have waited
        self.set_tag_propagation_policy(gr.TPP_DONT)
        # in real time, the frames of one call arrive together, so fewer of them mean less latency
        gather_frames(self, self._n, _HELD_FRAMES if realtime else None)

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        """One frame of each input."""
        return [self._n] * ninputs

    @guarded
    def general_work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Write as many frames as are available and fit into the output."""
        out = output_items[0]
        if self._realtime:
            self._wait()
        used = min(len(items) for items in (*output_items, *input_items)) // self._n * self._n
        jammer = input_items[1][:used] if len(input_items) > 1 else None
        done = 0
        second = output_items[1] if len(output_items) > 1 else None
        into = out[:used], None if second is None else second[:used]
        pieces = self.channel.process(input_items[0][:used], jammer, *into) if used else ()
        for counter, samples in pieces:
            if counter != self._expected and (self._tagged or self._expected is None):
                tag = time_tag(counter, self._rate)
                self.add_item_tag(0, self.nitems_written(0) + done, RX_TIME_KEY, tag)
            if counter != self._first + done:  # samples were lost before these
                out[done : done + samples.size] = samples
                if second is not None:
                    begin = counter - self._first
                    second[done : done + samples.size] = second[begin : begin + samples.size].copy()
            done += samples.size
            self._expected = counter + samples.size
        self._first += used
        for tag in self.get_tags_in_window(0, 0, used, SENT_KEY):
            # the value contains its sweep index
            self.add_item_tag(0, self.nitems_written(0), SENT_KEY, tag.value)
        for port in range(len(input_items)):
            self.consume(port, used)
        return done

    def _wait(self) -> None:
        """Sleep while samples are ahead of the clock; a backlog delays the clock instead of being caught up."""
        now, sent_s = time.monotonic(), (self._expected or 0) / self._rate
        if self._start_s is None:
            self._start_s = now - sent_s
        late_s = now - sent_s - self._start_s
        if late_s > 0:
            self._start_s += late_s
            self.held_up_s += late_s
            self.longest_hold_up_s = max(self.longest_hold_up_s, late_s)
        time.sleep(max(0.0, -late_s))
