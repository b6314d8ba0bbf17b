"""Remote control: publishes results, counters and state, and answers requests, as JSON over ZMQ."""

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.radio.control import CONTROL_VERSION, MAX_REQUEST_BYTES, Request, RequestError, parse_request
from ..core.radio.endpoint import check_endpoint
from ..core.scene import Scene, burst_db
from ._results import BoundSocket, json_text, result_fields
from .transmit_gate import gates_of

_POLL_MS = 20  # time between polls of both threads, ms: fifty beats within the gates' limit of 1 s
_STATE_EVERY = 50  # polls between state messages: one second
_WAIT_S = 0.1  # pause of a thread after an error, s
_MOST_PARTS = 1000  # most parts of a message that is received completely and replied to
_QUEUED = 10_000  # messages queued for a slow subscriber: 1.4 s of seven methods; more are dropped


class remote_control:
    """Publishes a flowgraph's results and state, and answers requests from any language.

    One thread publishes the altimeters' stored results, another one answers requests, so neither delays the signal
    path or the other. A slow subscriber loses messages. Queues and messages are bounded.

    Category: [RadAlt]/Telemetry. No ports. Telemetry (PUB), one JSON object per message, the key ``type`` first:
    ``result`` (all fields of a result, ``method``, ``truth_m``), ``state`` (once a second). Control (REQ/REP): see
    `radalt.core.radio.control`; the reply is ``{"version": 1, "ok": true, "state": {...}}`` or ``{"version": 1, "ok":
    false, "error": "..."}``. Every message gets a reply, whatever it holds; ``stop`` works before the first sample,
    too. Errors in the thread are counted in ``errors`` and do not end it.

    While it can answer requests, the thread sends the flowgraph's transmit gates a heartbeat every 20 ms. After a
    second without one, gates pass zeros (`TransmitGate`).

    Parameters
    ----------
    top : object
        The flowgraph (``self`` in a companion's block): its ``chirp_source``, ``jammer_source``, ``frame_segmenter``,
        ``altimeter_*`` and ``mitigation_*`` are found by name.
    scene : Scene
        Limits of the settings.
    telemetry, control : str
        ZMQ endpoints; loopback by default, since there is no authentication. Empty for none.
    network : bool
        Allow endpoints that other machines reach.
    keep_alive_s : float
        Longest silence of the controlling client, in seconds: without any request for this long transmission stops
        for good. 0 sets no limit.

    Raises
    ------
    ValueError
        If an endpoint is not a ZMQ address, is not on this machine, or is in use; the message is one line.
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
        network: bool = False,
        keep_alive_s: float = 0.0,
    ) -> None:
        check_endpoint("telemetry", telemetry, network=network)
        check_endpoint("control", control, network=network)
        if not 0 <= keep_alive_s <= 86_400:
            raise ValueError(f"keep_alive_s is {keep_alive_s:g}; it has to be within 0..86400 seconds")
        self._top, self._scene = top, scene
        self._control, self._keep_alive_s = control, keep_alive_s
        self._asked_s = time.monotonic()
        self._read: dict[str, int] = {}
        self.published = 0
        self.requests = 0
        self.errors = 0
        self._sir_db = self._overlap = None
        self._closing = threading.Event()
        self._replier = self._bind_control() if control else None
        try:
            self._publisher = (
                BoundSocket("PUB", "telemetry", telemetry, limit_bytes=MAX_REQUEST_BYTES, queued=_QUEUED)
                if telemetry
                else None
            )
        except ValueError:
            if self._replier is not None:
                self._replier.close()
            raise
        self._threads: list[threading.Thread] = []
        if telemetry or control:
            self._start("control", self._serve)
        if telemetry:
            self._start("telemetry", self._publish_loop)

    def _start(self, name: str, target: Callable[[], None]) -> None:
        self._threads.append(threading.Thread(target=target, daemon=True, name=f"radalt_{name}"))
        self._threads[-1].start()

    def _bind_control(self) -> BoundSocket:
        return BoundSocket("REP", "control", self._control, limit_bytes=2 * MAX_REQUEST_BYTES)

    def close(self) -> None:
        """End the threads and free the endpoints."""
        self._closing.set()
        for thread in self._threads:
            thread.join()
        for bound in (self._publisher, self._replier):
            if bound is not None:
                bound.close()
        self._publisher = self._replier = None

    # -- thread of control: never uses telemetry, which may be slow ----------------------------------------------------

    def _serve(self) -> None:
        while not self._closing.is_set():
            # the thread that answers 'stop' must survive every error
            try:
                self._serve_once()
            except Exception as error:
                self._count_error("control", error)
                self._closing.wait(_WAIT_S)

    def _serve_once(self) -> None:
        if self._replier is None and self._control:
            self._replier = self._bind_control()  # closed after an error
        if self._replier is None:
            self._closing.wait(_POLL_MS / 1000)
        elif self._replier.socket.poll(_POLL_MS):
            self._reply()
        self._beat()

    def _reply(self) -> None:
        """Receive and answer one message; a failed socket is replaced."""
        try:
            self._replier.socket.send_string(self._answer(self._receive()))
        except Exception:
            self._replier.close()
            self._replier = None
            raise

    def _receive(self) -> list[bytes]:
        """The parts of one message, limited in number and total size."""
        parts = []
        while True:
            parts.append(self._replier.socket.recv())
            if not self._replier.socket.rcvmore:
                return parts
            if len(parts) >= _MOST_PARTS or sum(map(len, parts)) > MAX_REQUEST_BYTES:
                raise RequestError(
                    f"a message of more than {_MOST_PARTS} parts or {MAX_REQUEST_BYTES} bytes; send one part"
                )

    def _count_error(self, where: str, error: Exception) -> None:
        self.errors += 1
        if self.errors == 1:  # only the first is printed; `errors` counts all
            text = " ".join(str(error).split())[:200]
            print(f"remote_control: {where}: {type(error).__name__}: {text}", file=sys.stderr, flush=True)

    def _beat(self) -> None:
        """Send the transmit gates a heartbeat."""
        silent_s = time.monotonic() - self._asked_s
        for gate in gates_of(self._top):
            if self._keep_alive_s and silent_s > self._keep_alive_s:
                gate.close(
                    f"transmit stopped: no request for more than {self._keep_alive_s:g} s (keep_alive_s); start again"
                )
            gate.beat()

    # -- the thread of telemetry --------------------------------------------------------------------------------------

    def _publish_loop(self) -> None:
        polls = 0
        while not self._closing.wait(_POLL_MS / 1000):
            try:
                if self._running():
                    self._publish_results()
                    if polls % _STATE_EVERY == 0:
                        self._publish({"type": "state", "version": CONTROL_VERSION, **self.state()})
            except Exception as error:  # a flowgraph that is ending; the thread continues
                self._count_error("telemetry", error)
                self._closing.wait(_WAIT_S)
            polls += 1

    def _publish(self, message: dict[str, Any]) -> None:
        self._publisher.socket.send_string(json_text(message))
        self.published += 1

    def _publish_results(self) -> None:
        for method, sink in self._altimeters().items():
            self._read[method], results = sink.results_since(self._read.get(method, 0))
            truth = self._truth_m(results["frame_index"])
            for result, true in zip(results, truth, strict=True):
                head = {"type": "result", "version": CONTROL_VERSION, "method": method}
                self._publish(head | result_fields(result) | {"truth_m": float(true)})

    def _answer(self, parts: list[bytes]) -> str:
        """Reply to one message; errors go into the reply."""
        self.requests += 1
        try:
            if len(parts) != 1:
                raise RequestError(f"a message of {len(parts)} parts; a request has one")
            request = parse_request(
                parts[0],
                max_altitude_m=self._scene.altimeter_settings.max_altitude_m,
                methods=tuple(self._altimeters()),
                jammer=hasattr(self._top, "jammer_source"),
            )
            self._asked_s = time.monotonic()  # valid requests only: other messages do not count as control
            if request.command == "stop":  # also before the first sample, which may never come
                return self._stop()
            if not self._running():
                raise RequestError("the flowgraph has not started yet; ask again")
            self._carry_out(request)
            return _reply(state=self.state())
        except RequestError as error:
            return _reply(error=str(error))
        except Exception as error:  # every request gets a reply
            self._count_error("control", error)
            return _reply(error=f"not carried out ({type(error).__name__}); the flowgraph may be ending")

    def _stop(self) -> str:
        for gate in gates_of(self._top):
            gate.close("transmit stopped: by request")
        self._top.stop()
        return _reply(state=self.state() if self._running() else {})

    def _carry_out(self, request: Request) -> None:
        top, changes = self._top, request.changes
        if request.command == "reacquire":
            top.frame_segmenter.reacquire()
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
        """Refuse bursts that clip: with radios the converters' full scale is fixed at the start."""
        if not hasattr(self._top, "jammer_usrp_sink") or not {"overlap", "sir_db"} & changes.keys():
            return
        state = self._jammer_state() | {k: v for k, v in changes.items() if k in ("overlap", "sir_db")}
        more_db = burst_db(state["sir_db"], state["overlap"]) - self._scene.burst_db
        if state["overlap"] > 0 and more_db > 0.01:
            raise RequestError(
                f"sir_db {state['sir_db']:g} at overlap {state['overlap']:g} makes bursts {more_db:.1f} dB stronger "
                "than the radios were set up for; start with that SIR"
            )

    # -- the flowgraph's state ----------------------------------------------------------------------------------------

    def _running(self) -> bool:
        """Whether samples flow; before that, blocks may be missing."""
        segmenter = vars(self._top).get("frame_segmenter")
        return segmenter is not None and segmenter.has_heard

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
        why = [gate.why_closed for gate in gates_of(self._top)]
        return {
            "altitude_m": None if source is None else source.manual_altitude_m,
            **self._jammer_state(),
            "methods": [m for m, sink in altimeters.items() if sink.active],
            "methods_available": list(altimeters),
            "frames": {m: sink.count for m, sink in altimeters.items()},
            "segmenter": self._top.frame_segmenter.status(),
            "published": self.published,
            "requests": self.requests,
            "errors": self.errors,
            "transmit": next((w for w in why if w), "on") if why else "none",  # without gates
        }


def _reply(*, state: dict[str, Any] | None = None, error: str = "") -> str:
    """JSON of a reply: a state, or an error."""
    outcome = {"ok": False, "error": error[:300]} if error else {"ok": True, "state": state}
    return json_text({"version": CONTROL_VERSION, **outcome})
