"""Remote control: results, counters and state out, requests in, as JSON over ZMQ."""

from __future__ import annotations

import json
import threading
from typing import Any

import numpy as np

from ..core.radio.control import CONTROL_VERSION, MAX_REQUEST_BYTES, Request, RequestError, parse_request
from ..core.receiver.altimeter import RESULT_DTYPE, Reason
from ..core.scene import Scene, burst_db

__all__ = ["remote_control"]

_POLL_MS = 20
_STATE_EVERY = 50  # polls between state messages: one second
_QUEUED = 10_000  # messages a slow subscriber may lag behind before it loses some


class remote_control:
    """Publishes a flowgraph's results and state, and lets any language drive it.

    It reads the altimeters' stored results from a thread of its own: neither a subscriber nor a request ever waits in
    the signal path, and a subscriber that is slow or dead loses messages.

    Category: [RadAlt]/Telemetry. No ports. Telemetry (PUB), one JSON object a message, the key ``type`` first:
    ``result`` (all fields of a result, ``method``, ``truth_m``), ``state`` (once a second). Control (REQ/REP): see
    `gnuradio.radalt.core.radio.control`; the reply is ``{"version": 1, "ok": true, "state": {...}}`` or
    ``{"version": 1, "ok": false, "error": "..."}``.

    Parameters
    ----------
    top : object
        The flowgraph (``self`` in a companion's block): its ``chirp_source``, ``jammer_source``, ``frame_segmenter``,
        ``altimeter_*`` and ``mitigation_*`` are found by name.
    scene : Scene
        Limits of what may be set.
    telemetry, control : str
        ZMQ endpoints; loopback by default, since there is no authentication. Empty for none.

    Example
    -------
    ``remote = radalt.remote_control(self, scene, "tcp://127.0.0.1:5556", "tcp://127.0.0.1:5557")``
    """

    def __init__(
        self,
        top: Any,
        scene: Scene,
        telemetry: str = "tcp://127.0.0.1:5556",
        control: str = "tcp://127.0.0.1:5557",
    ) -> None:
        self._top, self._scene = top, scene
        self._read: dict[str, int] = {}
        self.published = 0
        self.requests = 0
        self._sir_db = self._overlap = None
        self._closing = threading.Event()
        self._publisher = self._bind("PUB", telemetry) if telemetry else None
        self._replier = self._bind("REP", control) if control else None
        self._thread = threading.Thread(target=self._serve, daemon=True, name="radalt_remote")
        if telemetry or control:
            self._thread.start()

    def _bind(self, kind: str, endpoint: str):  # noqa: ANN202 - a zmq socket, imported only when asked for
        import zmq

        socket = zmq.Context.instance().socket(getattr(zmq, kind))
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.SNDHWM, _QUEUED)
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        try:
            socket.bind(endpoint)
        except zmq.ZMQError as error:
            socket.close()
            raise ValueError(
                f"remote_control endpoint {endpoint!r} cannot be bound: {error}; use another"
            ) from None
        return socket

    def close(self) -> None:
        """End the thread and free the endpoints."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        for socket in (self._publisher, self._replier):
            if socket is not None:
                socket.close()
        self._publisher = self._replier = None

    # -- the thread ---------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        polls = 0
        while not self._closing.is_set():
            if self._replier is None:
                self._closing.wait(_POLL_MS / 1000)
            elif self._replier.poll(_POLL_MS):
                self._replier.send_string(self._answer(self._replier.recv()))
            if self._publisher is not None and self._running():
                self._publish_results()
                if polls % _STATE_EVERY == 0:
                    self._publish({"type": "state", "version": CONTROL_VERSION, **self.state()})
            polls += 1

    def _publish(self, message: dict[str, Any]) -> None:
        self._publisher.send_string(json.dumps(_finite(message)))
        self.published += 1

    def _publish_results(self) -> None:
        for method, sink in self._altimeters().items():
            self._read[method], results = sink.results_since(self._read.get(method, 0))
            truth = self._truth_m(results["frame_index"])
            for result, true in zip(results, truth, strict=True):
                fields = {name: result[name].item() for name in RESULT_DTYPE.names}
                fields["reason"] = Reason.NAMES[int(result["reason"])]
                head = {"type": "result", "version": CONTROL_VERSION, "method": method}
                self._publish(head | fields | {"truth_m": float(true)})

    def _answer(self, text: bytes) -> str:
        """Reply to one request; whatever is wrong with it goes into the reply."""
        self.requests += 1
        try:
            if not self._running():
                raise RequestError("the flowgraph has not started yet; ask again")
            request = parse_request(
                text,
                max_altitude_m=self._scene.altimeter_settings.max_altitude_m,
                methods=tuple(self._altimeters()),
                jammer=hasattr(self._top, "jammer_source"),
            )
            self._carry_out(request)
        except RequestError as error:
            return json.dumps({"version": CONTROL_VERSION, "ok": False, "error": str(error)})
        return json.dumps(_finite({"version": CONTROL_VERSION, "ok": True, "state": self.state()}))

    def _carry_out(self, request: Request) -> None:
        top, changes = self._top, request.changes
        if request.command == "reacquire":
            top.frame_segmenter.reacquire()
        if request.command == "stop":
            top.stop()
        self._check_drive(changes)
        if "altitude_m" in changes:
            top.chirp_source.set_altitude(changes["altitude_m"])
        if "overlap" in changes:
            self._overlap = changes["overlap"]
            top.jammer_source.set_overlap(self._overlap)
        if "sir_db" in changes:
            self._sir_db = changes["sir_db"]
            top.jammer_source.set_sir_db(self._sir_db)
        if "methods" in changes:
            for method, sink in self._altimeters().items():
                sink.active = method in changes["methods"]
                mitigation = getattr(top, f"mitigation_{method}", None)
                if mitigation is not None:
                    mitigation.active = sink.active

    def _check_drive(self, changes: dict[str, Any]) -> None:
        """On the air the converters' full scale is fixed at the start: a stronger burst would clip."""
        if not hasattr(self._top, "jammer_usrp_sink") or not {"overlap", "sir_db"} & changes.keys():
            return
        state = self._jammer_state() | {k: v for k, v in changes.items() if k in ("overlap", "sir_db")}
        more_db = burst_db(state["sir_db"], state["overlap"]) - self._scene.burst_db
        if state["overlap"] > 0 and more_db > 0.01:
            raise RequestError(
                f"sir_db {state['sir_db']:g} at overlap {state['overlap']:g} makes bursts {more_db:.1f} dB stronger "
                "than the radios were set up for; start with that SIR"
            )

    # -- what is there ------------------------------------------------------------------------------------------------

    def _running(self) -> bool:
        """Whether samples flow; before, blocks may still be missing."""
        segmenter = vars(self._top).get("frame_segmenter")
        return segmenter is not None and segmenter.nitems_read(0) > 0

    def _altimeters(self) -> dict[str, Any]:
        found = list(vars(self._top).items())
        return {n.removeprefix("altimeter_"): b for n, b in sorted(found) if n.startswith("altimeter_")}

    def _truth_m(self, index: np.ndarray) -> np.ndarray:
        source = getattr(self._top, "chirp_source", None)
        if source is None:
            return self._scene.altitude.programme.altitude_m(index)
        return source.altitude_m(index)

    def _jammer_state(self) -> dict[str, float | None]:
        if not hasattr(self._top, "jammer_source"):
            return {"overlap": 0.0, "sir_db": None}
        own = {"overlap": self._overlap, "sir_db": self._sir_db}
        start = {"overlap": max(i.overlap for i in self._scene.interference), "sir_db": self._scene.sir_db}
        return start | {k: v for k, v in own.items() if v is not None}

    def state(self) -> dict[str, Any]:
        """Altitude, jammer, active methods, lock and counters."""
        altimeters = self._altimeters()
        source = getattr(self._top, "chirp_source", None)
        return {
            "altitude_m": None if source is None else source.manual_altitude_m,
            **self._jammer_state(),
            "methods": [m for m, sink in altimeters.items() if sink.active],
            "methods_available": list(altimeters),
            "frames": {m: sink.count for m, sink in altimeters.items()},
            "segmenter": self._top.frame_segmenter.status(),
            "published": self.published,
        }


def _finite(value: Any) -> Any:
    """The same mapping with null for numbers that JSON cannot hold."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
