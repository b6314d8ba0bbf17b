"""Altimeter sink: frames in, one altitude result per frame out."""

from __future__ import annotations

import json
import time

import numpy as np
import pmt
from gnuradio import gr

from ..core.radio.control import MAX_REQUEST_BYTES
from ..core.radio.endpoint import check_endpoint
from ..core.receiver.altimeter import RESULT_DTYPE, Reason, Spectra, shared_altimeter
from ..core.scene import Scene
from ._frames import read_frame_tags
from ._guard import guarded
from ._zmq import BoundSocket

__all__ = ["altimeter_sink"]

MESSAGE_VERSION = 1  # field ``version`` of the messages


class altimeter_sink(gr.sync_block):
    """Dechirp, CFAR, pairing and altitude of every frame; see `Altimeter`.

    ``R = c (f_up - f_down) / 4k``, ``v = c (f_up + f_down) / 4 f_c``.

    Category: [RadAlt]/Receiver. Ports: ``frames: complex vector of N > result: message`` (one dictionary per frame:
    version, method, frame_index, valid, reason, altitude_m, vertical_speed_m_per_s, beat_up_hz, beat_down_hz, snr_db,
    forced_altitude_m, truth_m: true altitude), ``altitude: float`` (optional, in metres, NaN without a detection).

    Parameters
    ----------
    scene : Scene
        Waveform, altimeter settings, programme (for ``truth_m``).
    method : str
        Label of the results. GNU Radio's log has one line when fewer than one in ten of a second's frames give an
        altitude, and one when there are altitudes again.
    endpoint : str
        ZMQ PUB endpoint for the same messages as JSON, for example ``tcp://127.0.0.1:5556``; empty for none.
    messages : bool
        Whether the message port is used; a PDU costs 100 us or more per frame.
    capacity : int
        Number of results kept; older ones are overwritten.
    stream : bool
        Whether the block has the output ``altitude``, one value per frame, for displays.
    network : bool
        Allow an endpoint that other machines reach.
    inputs : int
        Number of inputs; derived blocks use those after the first.

    Raises
    ------
    ValueError
        If the endpoint is not a ZMQ address, is not on this machine, or is in use; the message is one line.

    Example
    -------
    ``alt = radalt.altimeter_sink(scene, method="whitening", endpoint="tcp://127.0.0.1:5556")``
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "none",
        endpoint: str = "",
        messages: bool = True,
        capacity: int = 100_000,
        stream: bool = False,
        network: bool = False,
        inputs: int = 1,
    ) -> None:
        check_endpoint("altimeter_sink.endpoint", endpoint, network=network)
        n = scene.waveform.samples_per_frame
        outputs = [np.float32] if stream else None
        gr.sync_block.__init__(self, f"radalt_{type(self).__name__}", [(np.complex64, n)] * inputs, outputs)
        self.method = method
        self.altimeter = shared_altimeter(scene.waveform, scene.altimeter_settings)
        self._programme = scene.altitude.programme
        self._messages = bool(messages)
        self._store = np.zeros(int(capacity), dtype=RESULT_DTYPE)
        self._when = np.zeros((int(capacity), 2))  # frame's first sample, time of the result
        self._truth = np.zeros(int(capacity))
        self._second = max(1, round(1.0 / scene.waveform.sweep_s))  # frames per second
        self._counted = self._found = 0  # frames, and altitudes among them, in the current second
        self._blind = False
        self._count = 0
        self.active = True
        self._port = pmt.intern("result")
        self.message_port_register_out(self._port)
        self._keys = {
            name: pmt.intern(name) for name in (*RESULT_DTYPE.names, "truth_m", "method", "version")
        }
        self._method_pmt = pmt.intern(method)
        # a slow or dead subscriber loses messages, it never slows the radio
        self._socket = (
            BoundSocket("PUB", "altimeter_sink", endpoint, limit_bytes=MAX_REQUEST_BYTES)
            if endpoint
            else None
        )

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Measure all waiting frames in one batch."""
        frames = input_items[0]
        if not self.active:
            if output_items:
                output_items[0][:] = np.nan
            return len(frames)
        tags = read_frame_tags(self, len(frames))
        results = self._measure(frames, tags)
        if output_items:
            output_items[0][:] = results["altitude_m"]
        return len(frames)

    def _measure(self, frames: np.ndarray, tags: np.ndarray) -> np.ndarray:
        """Measure, store and publish; returns the results."""
        untold = np.isnan(tags)
        index = np.where(untold[:, 0], -1, tags[:, 0]).astype(np.int64)
        offset_s = np.where(untold[:, 2], 0.0, tags[:, 2])
        spectra = self.altimeter.spectra(frames)
        results = self.altimeter.detect(spectra, timing_offset_s=offset_s, frame_index=index)
        at = (self._count + np.arange(len(results))) % self._store.size
        self._store[at] = results
        self._when[at, 0] = tags[:, 1]
        self._when[at, 1] = time.perf_counter()
        truth = tags[:, 3]
        if untold[:, 3].any():
            truth = np.where(untold[:, 3], self._programme.altitude_m(index), truth)
        self._truth[at] = truth
        self._count += len(results)
        self._watch(results)
        if self._messages or self._socket is not None:
            for result, true in zip(results, truth, strict=True):
                self._publish(result, float(true))
        self._track(spectra, tags)
        return results

    def _watch(self, results: np.ndarray) -> None:
        """Log one line after a second of signal with few altitudes, and one when they are back."""
        self._counted += len(results)
        self._found += int(np.count_nonzero(results["valid"]))
        if self._counted < self._second:
            return
        blind = (
            self._found < 0.1 * self._counted
        )  # false alarms alone give an altitude in one of a hundred frames
        if blind != self._blind:
            self.logger.warn(
                f"{self.method}: {self._found} of the last {self._counted} frames gave an altitude"
                + (
                    f" within {self.altimeter.settings.max_altitude_m:g} m, most others: "
                    f"{Reason.NAMES[int(np.bincount(results['reason']).argmax())]}; is the return above noise and "
                    "interference?"
                    if blind
                    else " again"
                )
            )
        self._blind, self._counted, self._found = blind, 0, 0

    def _track(self, spectra: Spectra, tags: np.ndarray) -> None:
        """Hook for `altitude_tracker`, which uses the same spectra."""

    def _publish(self, result: np.void, truth_m: float) -> None:
        if self._socket is not None:
            self._socket.socket.send_string(json.dumps(self._as_mapping(result, truth_m)))
        if self._messages:
            self.message_port_pub(self._port, self._as_pmt(result, truth_m))

    def _as_mapping(self, result: np.void, truth_m: float) -> dict[str, object]:
        """One result for JSON; numbers that are not finite become null."""
        fields = {name: result[name].item() for name in RESULT_DTYPE.names}
        fields["reason"] = Reason.NAMES[int(result["reason"])]
        fields = {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in fields.items()}
        return {"version": MESSAGE_VERSION, "method": self.method, **fields, "truth_m": truth_m}

    def _as_pmt(self, result: np.void, truth_m: float):  # noqa: ANN202 - a pmt
        keys = self._keys
        message = pmt.make_dict()
        message = pmt.dict_add(message, keys["version"], pmt.from_long(MESSAGE_VERSION))
        message = pmt.dict_add(message, keys["method"], self._method_pmt)
        for name in RESULT_DTYPE.names:
            value = result[name].item()
            if name == "reason":
                item = pmt.intern(Reason.NAMES[value])
            elif isinstance(value, bool):
                item = pmt.from_bool(value)
            elif isinstance(value, int):
                item = pmt.from_long(value)
            else:
                item = pmt.from_double(value)
            message = pmt.dict_add(message, keys[name], item)
        return pmt.dict_add(message, keys["truth_m"], pmt.from_double(truth_m))

    def results(self) -> np.ndarray:
        """Results in order of arrival, at most the last ``capacity``; structured array of `RESULT_DTYPE`.

        Its ``reason`` is a number; ``Reason.NAMES[number]`` is its name.
        """
        if self._count <= self._store.size:
            return self._store[: self._count].copy()
        return np.roll(self._store, -(self._count % self._store.size))

    def truth_m(self) -> np.ndarray:
        """True altitudes in metres of `results`: by the frames' tags where set by hand, else the programme's."""
        kept = min(self._count, self._truth.size)
        return self._truth[np.arange(self._count - kept, self._count) % self._truth.size]

    @property
    def count(self) -> int:
        """Results since the start."""
        return self._count

    @property
    def last_index(self) -> int:
        """Frame index of the last result, -1 before the first."""
        return int(self._store["frame_index"][(self._count - 1) % self._store.size]) if self._count else -1

    def results_since(self, count: int) -> tuple[int, np.ndarray]:
        """Results after the first ``count``, unless overwritten, and the count for the next call.

        For other threads: neither the reader nor the block waits.
        """
        now = self._count
        # only half of the store is returned: the block may overwrite the other half meanwhile
        first = max(0, count, now - self._store.size // 2)
        return now, self._store[np.arange(first, now) % self._store.size]

    def latest(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The last ``count`` results, or fewer, and their true altitudes in metres."""
        now, results = self.results_since(self._count - count)
        return results, self._truth[np.arange(now - len(results), now) % self._truth.size]

    def times(self) -> np.ndarray:
        """(n, 2) sample counter of each kept frame's first sample, and `time.perf_counter` at its result."""
        kept = min(self._count, self._store.size)
        return self._when[np.arange(self._count - kept, self._count) % self._store.size]

    def stop(self) -> bool:
        """Close the ZMQ socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        return True
