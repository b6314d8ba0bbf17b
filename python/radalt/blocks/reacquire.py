"""Reacquire: acquires the timing again at a button's press, at altitude zero and with the jammer silent."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pmt
from gnuradio import gr

from ..core.scene import Scene

_MARGIN_FRAMES = 64  # frames after the source's last one: the chunk in preparation, and a radio's latency
_ARRIVE_S = 10.0  # longest time from source to segmenter, s: all rings of a flowgraph far below real time
_LOCK_S = 3.0  # longest wait for the lock, s
_POLL_S = 0.02  # time between checks, s: not noticeable at a button


class reacquire(gr.basic_block):
    """On any message, sends the segmenter the command ``reacquire`` once altitude zero has come in.

    The segmenter takes the measured delay for altitude zero, so an altitude set by hand would become an offset. The
    block therefore sets altitude zero, mutes the jammer and waits until the segmenter has received this (by the
    sample counter). It then sends the command, waits for the lock, and restores both, except an altitude changed
    meanwhile. A jammer that was off stays off. One line is printed at the end.

    Category: [RadAlt]/Receiver. Ports: ``pressed: message > command: message`` (the symbol ``reacquire``).

    Parameters
    ----------
    top : object
        The flowgraph (``self`` in a companion's block): its variable ``altitude_m`` and its blocks ``chirp_source``,
        ``frame_segmenter`` and, if there, ``jammer_switch`` (a mute) are found by name.
    scene : Scene
        Waveform.
    Example
    -------
    ``again = radalt.reacquire(self, scene)``
    """

    def __init__(self, top: Any, scene: Scene) -> None:
        gr.basic_block.__init__(self, "radalt_reacquire", [], [])
        self._top = top
        self._n = scene.waveform.samples_per_frame
        self._thread: threading.Thread | None = None
        self._command = pmt.intern("command")
        self.message_port_register_out(self._command)
        pressed = pmt.intern("pressed")
        self.message_port_register_in(pressed)
        self.set_msg_handler(pressed, self._on_press)

    @property
    def running(self) -> bool:
        """Whether a reacquisition is under way; further presses are ignored meanwhile."""
        return self._thread is not None and self._thread.is_alive()

    def _on_press(self, message) -> None:  # noqa: ANN001 - a pmt, whatever its value
        if not self.running:
            # a message handler must not wait: it runs in the block's thread
            self._thread = threading.Thread(target=self._run, daemon=True, name="radalt_reacquire")
            self._thread.start()

    def _run(self) -> None:
        top = self._top
        jammer = getattr(top, "jammer_switch", None)
        altitude_m = top.altitude_m
        was_muted = jammer is not None and jammer.mute()
        top.set_altitude_m(0.0)
        if jammer is not None:
            jammer.set_mute(True)
        try:
            print(f"reacquire: {self._acquire()}", flush=True)
        finally:
            if top.altitude_m == 0.0:
                top.set_altitude_m(altitude_m)
            if jammer is not None:
                jammer.set_mute(was_muted)

    def _acquire(self) -> str:
        """Wait for altitude zero, send the command, wait for the lock; returns the outcome."""
        segmenter = self._top.frame_segmenter.segmenter
        sent = [self._top.chirp_source.nitems_written(0)]
        if hasattr(self._top, "jammer_switch"):
            sent.append(self._top.jammer_switch.nitems_written(0))
        mark = max(sent) + _MARGIN_FRAMES * self._n
        if not _wait(lambda: segmenter.sample_counter >= mark, _ARRIVE_S):
            return f"nothing that was sent came in within {_ARRIVE_S:g} s; timing stays as it was"
        before = segmenter.counters["acquisitions"]
        self.message_port_pub(self._command, pmt.intern("reacquire"))
        if not _wait(lambda: segmenter.counters["acquisitions"] > before, _LOCK_S):
            return f"no sweep found within {_LOCK_S:g} s; is the radar transmitting?"
        return "timing taken anew"


def _wait(done: Callable[[], bool], limit_s: float) -> bool:
    """Poll ``done`` for at most ``limit_s``; returns its last value."""
    end = time.monotonic() + limit_s
    while not done():
        if time.monotonic() > end:
            return False
        time.sleep(_POLL_S)
    return True
