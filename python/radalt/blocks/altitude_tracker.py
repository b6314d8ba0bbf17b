"""Altitude tracker: 25 altitudes per second, each with status and protection level."""

import numpy as np
import pmt

from ..core.altimeter.altimeter import Spectra
from ..core.scene import Scene
from ..core.tracker.tracker import OUTPUT_DTYPE, AltitudeTracker, State, Status
from ._guard import guarded
from ._results import Ring
from .altimeter_sink import altimeter_sink

TRACKED_VERSION = 1  # field ``version`` of the messages


class altitude_tracker(altimeter_sink):
    """An altimeter sink with a tracker on its spectra, summed over 40 ms; see `AltitudeTracker`.

    Altitude by the joint peak of both half sweeps' summed spectra over altitude and vertical speed, then a Kalman
    filter; ``protection level = 1 m + extent + k sigma + ambiguity``.

    Category: [RadAlt]/Receiver. Ports: ``frames: complex vector of N, received: complex vector of N`` (with
    ``received``), ``timing: message`` (optional: the segmenter's ``status``; without lock there are no frames, and
    the status becomes FAILURE at once) ``> result: message, altitude: float`` (as in `altimeter_sink`), ``tracked:
    message`` (one dictionary per output: version, method, frame_index, status, state, altitude_m,
    vertical_speed_m_per_s, protection_level_m, age_s, strength, frames, timing_verified, line). Altitude, speed and
    protection level are NaN unless status is ``normal``; ``line`` is the status as one line of text.

    Parameters
    ----------
    scene : Scene
        Waveform, settings of altimeter and tracker, programme.
    method, endpoint, messages, capacity, stream, network
        As in `altimeter_sink`; ``messages`` concerns ``result`` only.
    received : bool
        A second input for the frames before mitigation, from the segmenter. A return that is present only in them
        makes the altitude doubtful: a method may remove the weaker of two returns as interference.
    Example
    -------
    ``tracker = radalt.altitude_tracker(scene, method="whitening")``
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "none",
        endpoint: str = "",
        messages: bool = False,
        capacity: int = 100_000,
        stream: bool = False,
        network: bool = False,
        received: bool = False,
    ) -> None:
        altimeter_sink.__init__(
            self, scene, method, endpoint, messages, capacity, stream, network, inputs=1 + bool(received)
        )
        self._received: np.ndarray | None = None
        self.tracker = AltitudeTracker(self.altimeter, scene.tracker_settings, noise=scene.has_noise)
        self._outputs = Ring(max(1, int(capacity) // self.tracker.frames), OUTPUT_DTYPE)
        self._lost = False
        self._verified = True
        self.line = "NO COMPUTED DATA (search)"  # the last output as text
        self._tracked_port = pmt.intern("tracked")
        self.message_port_register_out(self._tracked_port)
        timing = pmt.intern("timing")
        self.message_port_register_in(timing)
        self.set_msg_handler(timing, self._on_timing)

    def _on_timing(self, message) -> None:  # noqa: ANN001 - a pmt
        """Handle the segmenter's status: after a loss of lock there are no frames, and the output must not be stale."""
        if not pmt.is_dict(message):
            return
        status = pmt.to_python(message)
        self._verified = bool(status.get("timing_verified", True))
        if status.get("locked") is False and not self._lost:
            self._lost = True
            output = np.full(1, 0, dtype=OUTPUT_DTYPE)[0]
            output["frame_index"], output["status"], output["state"] = (
                self.last_index,
                Status.FAILURE,
                State.LOST,
            )
            for name in ("altitude_m", "vertical_speed_m_per_s", "protection_level_m", "age_s"):
                output[name] = np.nan
            self._report(output)
        elif status.get("locked"):
            self._lost = False

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """See `altimeter_sink.work`; a loss of lock resets the tracker."""
        if self._lost:
            self.tracker.reset()
        self._received = input_items[1] if len(input_items) > 1 else None
        return altimeter_sink.work(self, input_items, output_items)

    def _track(self, spectra: Spectra, tags: np.ndarray) -> None:
        index = tags[:, 0]
        known = bool(np.isfinite(index).all())
        outputs = self.tracker.process(
            spectra,
            frame_index=index.astype(np.int64) if known else None,
            timing_offset_s=np.nan_to_num(tags[:, 2]),
            received=None
            if self._received is None
            else self.altimeter.spectra(self._received, spectra.quality),
        )
        self._outputs.append(outputs)
        for output in outputs:
            self._report(output)

    def outputs(self) -> np.ndarray:
        """Outputs in order of time, at most those of the last ``capacity`` frames; array of `OUTPUT_DTYPE`."""
        return self._outputs.last()

    def _report(self, output: np.void) -> None:
        fields = {name: output[name].item() for name in OUTPUT_DTYPE.names}
        fields["status"], fields["state"] = Status.NAMES[fields["status"]], State.NAMES[fields["state"]]
        fields |= {"version": TRACKED_VERSION, "method": self.method, "timing_verified": self._verified}
        self.line = status_line(output)
        self.message_port_pub(self._tracked_port, pmt.to_pmt(fields | {"line": self.line}))


def status_line(output: np.void) -> str:
    """One output as a line for a display.

    Examples
    --------
    >>> output = np.zeros(1, dtype=OUTPUT_DTYPE)[0]
    >>> output["status"], output["state"] = Status.NO_COMPUTED_DATA, State.COAST
    >>> status_line(output)
    'NO COMPUTED DATA (coast)'
    """
    name = Status.NAMES[output["status"]].replace("_", " ").upper()
    if output["status"] != Status.NORMAL:
        return f"{name} ({State.NAMES[output['state']]})"
    return (
        f"{name}  {output['altitude_m']:.1f} m +/- {output['protection_level_m']:.1f} m  "
        f"{output['vertical_speed_m_per_s']:+.1f} m/s"
    )
