"""Altimeter sink: frames in, one altitude result per frame out."""

import time

import numpy as np
import pmt
from gnuradio import gr

from ..core.altimeter.altimeter import RESULT_DTYPE, Reason, Spectra, shared_altimeter
from ..core.radio.control import MAX_REQUEST_BYTES
from ..core.radio.endpoint import check_endpoint
from ..core.scene import Scene
from ._frames import quality_of, read_frame_tags
from ._guard import guarded
from ._results import BoundSocket, Ring, json_text, result_fields

MESSAGE_VERSION = 1  # field ``version`` of the messages
# Fewest altitudes among a second's frames before a line in the log: false alarms alone give one in a hundred.
_BLIND_SHARE = 0.1
_ROW_DTYPE = np.dtype(
    [("result", RESULT_DTYPE), ("truth_m", float), ("first_sample", float), ("time_s", float)]
)


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
        self._rows = Ring(int(capacity), _ROW_DTYPE)
        self._second = max(1, round(1.0 / scene.waveform.sweep_s))  # frames per second
        self._counted = self._found = 0  # frames, and altitudes among them, in the current second
        self._blind = False
        self.active = True
        self._port = pmt.intern("result")
        self.message_port_register_out(self._port)
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
        absent = np.isnan(tags)
        index = np.where(absent[:, 0], -1, tags[:, 0]).astype(np.int64)
        offset_s = np.where(absent[:, 2], 0.0, tags[:, 2])
        spectra = self.altimeter.spectra(frames, quality_of(tags))
        results = self.altimeter.detect(spectra, timing_offset_s=offset_s, frame_index=index)
        truth = tags[:, 3]
        if absent[:, 3].any():
            truth = np.where(absent[:, 3], self._programme.altitude_m(index), truth)
        rows = np.empty(len(results), dtype=_ROW_DTYPE)
        rows["result"], rows["truth_m"] = results, truth
        rows["first_sample"], rows["time_s"] = tags[:, 1], time.perf_counter()
        self._rows.append(rows)
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
        blind = self._found < _BLIND_SHARE * self._counted
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
        head = {"version": MESSAGE_VERSION, "method": self.method}
        message = head | result_fields(result) | {"truth_m": truth_m}
        if self._socket is not None:
            self._socket.socket.send_string(json_text(message))
        if self._messages:
            self.message_port_pub(self._port, pmt.to_pmt(message))

    def results(self) -> np.ndarray:
        """Results in order of arrival, at most the last ``capacity``; structured array of `RESULT_DTYPE`.

        Its ``reason`` is a number; ``Reason.NAMES[number]`` is its name.
        """
        return self._rows.last()["result"].copy()

    def truth_m(self) -> np.ndarray:
        """True altitudes in metres of `results`: by the frames' tags where set by hand, else the programme's."""
        return self._rows.last()["truth_m"].copy()

    @property
    def count(self) -> int:
        """Results since the start."""
        return self._rows.count

    @property
    def last_index(self) -> int:
        """Frame index of the last result, -1 before the first."""
        return int(self._rows.last(1)["result"]["frame_index"][0]) if self.count else -1

    def results_since(self, count: int) -> tuple[int, np.ndarray]:
        """Results after the first ``count``, unless overwritten, and the count for the next call; for other threads."""
        now, rows = self._rows.since(count)
        return now, rows["result"]

    def latest(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The last ``count`` results, or fewer, and their true altitudes in metres; for other threads."""
        _, rows = self._rows.since(self.count - count)
        return rows["result"], rows["truth_m"]

    def times(self) -> np.ndarray:
        """(n, 2) sample counter of each kept frame's first sample, and `time.perf_counter` at its result."""
        rows = self._rows.last()
        return np.stack([rows["first_sample"], rows["time_s"]], axis=1)

    def stop(self) -> bool:
        """Close the ZMQ socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        return True
