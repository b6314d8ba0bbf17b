"""Telemetry and control: any program can drive the loop, and none can stop it by accident."""

import contextlib
import json
import socket
import threading
import time
from itertools import islice
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import uhd_double
import zmq
from gnuradio import gr, radalt
from hostile import assert_line, refused
from waiting import ROOT, patient, wait_for

from radalt.core.radio.control import RequestError, parse_request
from radalt.core.radio.endpoint import check_endpoint
from radalt.core.scene import parse_scene
from radalt.evaluation.commands import control as control_client
from radalt.evaluation.flowgraph.rewrite import load_grc, prune, remote
from radalt.evaluation.radios.remote import drive_remotely

LIMITS = {"max_altitude_m": 1500.0, "methods": ("none", "whitening"), "jammer": True}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"{", "not JSON"),
        (b"[" * 60_000, "not JSON"),
        (b" " * 100_000, "100000 bytes; a request has at most 65536"),
        (b'{"command": "get"}', "version is None"),
        (b'{"version": 2, "command": "get"}', "speaks 1"),
        (b'{"version": 1, "command": "set"}', "changes nothing"),
        (b'{"version": 1, "command": "set", "altitude_m": 1501}', "within 0..1500"),
        (b'{"version": 1, "command": "set", "altitude_m": NaN}', "NaN is no JSON number"),
        (b'{"version": 1, "command": "set", "altitude_m": 1, "altitude_m": 2}', "a key is there twice"),
        (b'{"version": 1, "command": "set", "altitude_m": true}', "within 0..1500"),
        (b'{"version": 1, "command": "set", "methods": []}', "list of names"),
    ],
)
def test_a_malformed_request_is_named(text, message):
    with refused(RequestError, message):
        parse_request(text, **LIMITS)


@pytest.mark.parametrize(
    "endpoint",
    ["tcp://*:6557", "tcp://0.0.0.0:6557", "tcp://[::]:6557", "tcp://192.168.1.7:6557", "tcp://bench:6557"],
)
def test_an_endpoint_that_other_machines_reach_needs_a_second_flag(endpoint):
    with pytest.raises(ValueError, match="other machines reach it.*--network"):
        check_endpoint("control", endpoint, network=False)
    check_endpoint("control", endpoint, network=True)


def test_an_endpoint_of_this_machine_needs_none_and_what_is_no_endpoint_is_named():
    for good in ("", "tcp://127.0.0.1:6557", "tcp://localhost:6557", "ipc://telemetry.sock", "tcp://[::1]:7"):
        check_endpoint("control", good, network=False)
    for bad in ("6557", "udp://127.0.0.1:1", "tcp://127.0.0.1", "tcp://127.0.0.1:1/x", "ipc://a\0b"):
        with pytest.raises(ValueError, match="expected tcp://ADDRESS:PORT"):
            check_endpoint("control", bad, network=True)
    for port in (70000, 0):
        with pytest.raises(ValueError, match="a port is within 1..65535"):
            check_endpoint("control", f"tcp://127.0.0.1:{port}", network=False)


@contextlib.contextmanager
def client_of(endpoint):
    """A socket that asks."""
    with zmq.Context.instance().socket(zmq.REQ) as asking:
        asking.setsockopt(zmq.LINGER, 0)
        asking.connect(endpoint)
        yield asking


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    """A running flowgraph and a client of it, until the last of its tests stops it."""
    folder = tmp_path_factory.mktemp("loop")
    endpoints = {name: f"ipc://{folder}/{name}" for name in ("telemetry", "control")}
    qpsk = {"sir_db": -5.0, "overlap": 0.5, "bandwidth_hz": 2.0025e6}
    scene = parse_scene({"altitude": {"programme_m": [1000.0]}, "interference": {"qpsk": qpsk}})
    stop, ended = threading.Event(), []

    def run() -> None:
        ended.append(drive_remotely(scene, ("none", "whitening"), stop=stop, log=lambda _: None, **endpoints))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    client, states = control_client.Client(**endpoints), []

    def answered() -> bool:
        with contextlib.suppress(control_client.ControlError):
            states.append(client.request("get"))
        return bool(states)

    wait_for(answered, "an answer of remote control")
    assert states[0]["methods"] == ["none", "whitening"]
    yield client, endpoints, thread, ended
    stop.set()
    thread.join(patient(20))
    assert not thread.is_alive()


def until(client, condition, seconds=20.0):
    """The first result that meets the condition."""
    for message in client.messages(seconds):
        if message["type"] == "result" and condition(message):
            return message
    raise AssertionError("no such result")


def test_altitude_follows_what_is_set(loop):
    client, *_ = loop
    for altitude in (321.0, 45.0):
        assert client.request("set", altitude_m=altitude)["altitude_m"] == altitude
        message = until(client, lambda m, a=altitude: m["truth_m"] == a)
        assert message["version"] == 1
        assert abs(message["altitude_m"] - altitude) < 5.0


def test_jammer_and_methods_are_set(loop):
    client, _, _, _ = loop
    state = client.request("set", altitude_m=100.0, sir_db=-50.0, overlap=1.0, methods=["none"])
    assert (state["sir_db"], state["overlap"], state["methods"]) == (-50.0, 1.0, ["none"])
    # at -50 dB nothing is left to be seen without mitigation
    seen = until(client, lambda m: m["truth_m"] == 100 and (not m["valid"] or abs(m["altitude_m"] - 100) > 5))
    assert seen["method"] == "none"
    before = client.request("get")["frames"]
    assert {m["method"] for m in client.messages(0.5) if m["type"] == "result"} == {"none"}
    after = client.request("get")["frames"]
    assert after["whitening"] == before["whitening"] and after["none"] > before["none"]


def test_malformed_requests_are_answered_and_change_nothing(loop):
    client, endpoints, _, _ = loop
    before = client.request("get")
    with client_of(endpoints["control"]) as asking:
        for parts in (
            [b""],
            [b"{"],
            [b"\x00" * 1000],
            [b'{"version": 1, "command": "set", "altitude_m": 5, "overlap": 9}'],
            [b'{"version": 1, "command": "set", "altitude_m": 18446744073709551616}'],
            [b'{"version": 1, "command": "get"}', b"and more"],
            [b""] * 100,
        ):
            asking.send_multipart(parts)
            assert asking.poll(1000 * patient(2))
            reply = json.loads(asking.recv())
            assert (reply["ok"], reply["version"]) == (False, 1)
            assert_line(reply["error"])
    after = client.request("get")
    assert (after["altitude_m"], after["overlap"]) == (before["altitude_m"], before["overlap"])
    assert (after["errors"], after["transmit"]) == (0, "none")


def test_a_subscriber_that_never_reads_slows_nothing(loop):
    client, endpoints, _, _ = loop
    with zmq.Context.instance().socket(zmq.SUB) as dead:
        dead.setsockopt(zmq.LINGER, 0)
        dead.setsockopt(zmq.RCVHWM, 1)
        dead.subscribe(b"")
        dead.connect(endpoints["telemetry"])
        first = client.request("get")
        received = list(islice(client.messages(patient(20)), 1000))
        last = client.request("get")
    assert last["frames"]["none"] > first["frames"]["none"]
    assert len(received) == 1000 and last["published"] >= first["published"] + 1000


def test_stop_stops(loop):
    client, _, thread, ended = loop
    client.request("stop")
    thread.join(patient(20))
    assert ended[0]["frames"]["none"] > 0


def test_while_a_flowgraph_starts_the_scheduler_is_not_asked(bench):
    """Its counts point nowhere until all buffers are there: reading them then is a segmentation fault."""
    bench.top.frame_segmenter = Mock(spec=["has_heard", "nitems_read"], has_heard=False)
    bench.start()
    reply = bench.ask(b'{"version": 1, "command": "get"}')
    assert "has not started yet" in reply["error"]
    bench.top.frame_segmenter.nitems_read.assert_not_called()


@pytest.mark.parametrize("parts", [[b"x" * 60_000] * 4, [b""] * 5000], ids=["bytes", "parts"])
def test_a_message_of_many_parts_is_bounded_in_all_of_them(bench, parts):
    """The socket's own limit is on one part; what is beyond is not read on, and the next client is answered."""
    control = bench.start()
    with client_of(f"ipc://{bench.address()}") as asking:
        asking.send_multipart(parts)
        wait_for(lambda: control.errors == 1, "the counted refusal")
    assert bench.ask(b'{"version": 1, "command": "get"}')["error"].startswith("the flowgraph has not started")
    wait_for(lambda: bench.gates[0].why_closed is None, "an open gate")


def test_peers_that_say_nothing_keep_nobody_out(bench):
    bench.start()
    address = bench.address()
    idle = []
    for _ in range(115):
        idle.append(socket.socket(socket.AF_UNIX))
        idle[-1].connect(address)
    assert "has not started" in bench.ask(b'{"version": 1, "command": "get"}')["error"]
    for peer in idle:
        peer.close()


def test_a_file_is_never_replaced_and_a_path_has_one_owner(bench, tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(ValueError, match="exists and is no socket; name a new one"):
        radalt.remote_control(bench.top, parse_scene({}), "", f"ipc://{notes}")
    assert notes.read_text() == "mine"
    bench.start()
    with pytest.raises(ValueError, match="in use by another program"):
        radalt.remote_control(bench.top, parse_scene({}), "", f"ipc://{bench.address()}")
    assert "has not started" in bench.ask(b'{"version": 1, "command": "get"}')["error"]  # the first goes on
    with socket.socket(socket.AF_UNIX) as busy, socket.socket(socket.AF_UNIX) as waiting:
        busy.bind(f"{tmp_path}/busy")
        busy.listen(0)
        waiting.connect(f"{tmp_path}/busy")  # its queue is full: nobody else gets an answer
        with pytest.raises(ValueError, match="in use by another program"):
            radalt.remote_control(bench.top, parse_scene({}), "", f"ipc://{tmp_path}/busy")
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(f"{tmp_path}/dead")
    dead.close()
    radalt.remote_control(bench.top, parse_scene({}), "", f"ipc://{tmp_path}/dead").close()


# -- control is lost while transmitting --------------------------------------------------------------------------------
@pytest.fixture
def bench(tmp_path, capfd):
    """Two open gates of a flowgraph that is made, but hears nothing; its control, and a way to ask it."""
    radio = {"radar_serial": "R", "enclosure": "cabled", "attenuation_db": 60.0}
    scene = parse_scene({"radio": radio})
    top = SimpleNamespace(stopped=0)
    top.stop = lambda: setattr(top, "stopped", top.stopped + 1)
    top.radar_gate = radalt.transmit_gate(scene, True, True)
    top.jammer_gate = radalt.transmit_gate(scene, True, True)
    made = []

    def start(**options):
        made.append(radalt.remote_control(top, scene, "", f"ipc://{tmp_path}/control{len(made)}", **options))
        return made[-1]

    def ask(*parts: bytes) -> dict:
        with client_of(f"ipc://{tmp_path}/control{len(made) - 1}") as asking:
            asking.send_multipart(parts)
            assert asking.poll(1000 * patient(60))
            return json.loads(asking.recv())

    yield SimpleNamespace(
        top=top, gates=(top.radar_gate.gate, top.jammer_gate.gate), start=start, ask=ask,
        address=lambda: f"{tmp_path}/control{len(made) - 1}",
    )  # fmt: skip
    for control in made:
        control.close()


def opened(bench):
    """Return once both gates are open."""
    wait_for(lambda: all(gate.why_closed is None for gate in bench.gates), "open gates")


def closed(bench, why):
    """Return once both gates are closed, for this reason."""

    def both() -> bool:
        return all(gate.why_closed and why in gate.why_closed for gate in bench.gates)

    wait_for(both, f"closed gates {why}")


def test_gates_open_with_control_and_close_when_it_ends(bench):
    assert [gate.why_closed for gate in bench.gates] == ["transmit waits for remote control to come up"] * 2
    control = bench.start()
    opened(bench)
    control.close()
    closed(bench, "silent for more than 1 s")


def test_gates_close_when_the_serving_thread_hangs(bench, monkeypatch):
    control = bench.start()
    opened(bench)
    hung = threading.Event()
    monkeypatch.setattr(control, "_answer", lambda parts: hung.wait(20) and "")
    with client_of(f"ipc://{bench.address()}") as asking:
        asking.send(b"{}")
        closed(bench, "")
        hung.set()


def test_the_thread_survives_every_exception_and_counts_it(bench, monkeypatch):
    control = bench.start()
    opened(bench)
    monkeypatch.setattr(control, "_carry_out", lambda request: 1 / 0)
    monkeypatch.setattr(control, "_running", lambda: True)
    reply = bench.ask(b'{"version": 1, "command": "get"}')
    assert reply["ok"] is False and "ZeroDivisionError" in reply["error"]
    monkeypatch.setattr(control, "_answer", lambda parts: 1 / 0)  # not even an answer: the socket is replaced
    with client_of(f"ipc://{bench.address()}") as asking:
        asking.send(b"{}")
        wait_for(lambda: control.errors == 2, "the second counted error")
    monkeypatch.undo()

    def answers() -> bool:  # a request that meets the old socket just before it is replaced is lost with it
        try:
            reply = bench.ask(b'{"version": 1, "command": "get"}')
        except AssertionError:
            return False
        return reply["error"].startswith("the flowgraph has not started")

    wait_for(answers, "an answer of the new socket")
    assert control._threads[0].is_alive() and control.errors == 2
    assert all(gate.why_closed is None for gate in bench.gates)


def test_stop_is_carried_out_before_the_first_sample(bench):
    """The receiver may never hear anything while the transmitters send."""
    bench.start()
    opened(bench)
    assert bench.ask(b'{"version": 1, "command": "stop"}')["ok"] is True
    assert bench.top.stopped == 1
    assert {gate.why_closed for gate in bench.gates} == {"transmit stopped: by request"}


def test_gates_close_when_nobody_asks_for_as_long_as_agreed(bench):
    bench.start(keep_alive_s=0.5)
    closed(bench, "no request for more than 0.5 s")


def test_garbage_keeps_no_transmission_alive(bench):
    bench.start(keep_alive_s=0.5)

    def all_closed() -> bool:
        assert bench.ask(b"{")["ok"] is False
        return all("no request for more than 0.5 s" in (gate.why_closed or "") for gate in bench.gates)

    wait_for(all_closed, "gates that close among garbage")


class Transmitter(gr.hier_block2):
    def __init__(self, gate) -> None:
        signature = gr.io_signature(1, 1, gr.sizeof_gr_complex)
        gr.hier_block2.__init__(self, "transmitter", signature, gr.io_signature(0, 0, 0))
        self.gates = [gate]


@pytest.mark.parametrize(
    "put",
    [Transmitter, lambda gate: {gate}, lambda gate: SimpleNamespace(gates=(gate,))],
    ids="hier set object".split(),
)
def test_gates_are_closed_wherever_an_attribute_holds_them(bench, put):
    gate = radalt.transmit_gate(parse_scene({}), True, True)
    gate.gate._closed = None  # as if the scene stated an enclosure
    bench.top.transmitter = put(gate)
    bench.start()
    wait_for(lambda: gate.gate.why_closed is None, "an open gate")
    bench.ask(b'{"version": 1, "command": "stop"}')
    assert gate.gate.why_closed == "transmit stopped: by request"


class Listened(uhd_double.Air):
    """No echo and no memory: how much each transmitter took, and when it last took anything but zeros."""

    def __init__(self) -> None:
        super().__init__(ticking=True)
        self.taken, self.loud = {}, {}

    def send(self, device, samples):
        if samples.any():
            self.loud[device] = time.monotonic()
        self.taken[device] = self.taken.get(device, 0) + samples.size
        time.sleep(samples.size / 7.5e6)  # a radio takes them at its rate

    def receive(self, first, count):
        time.sleep(count / 7.5e6)
        return np.zeros(count, np.complex64)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # one is made to end
@pytest.mark.parametrize("lost", ["the thread hangs", "the thread ends", "the client is silent"])
def test_transmission_of_a_running_flowgraph_ends_where_control_is_lost(tmp_path, monkeypatch, lost):
    """Two radios send; within the second (or the agreed silence) and what is under way both get zeros alone."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    air = Listened()
    uhd_double.install(monkeypatch, air)
    radio = uhd_double.RADIO | {"attenuation_db": 60.0, "clock_source": "internal"}
    scene = parse_scene({"radio": radio, "interference": {"qpsk": {"sir_db": -5, "bandwidth_hz": 2.0025e6}}})
    answer, go_on, stop = radalt.remote_control._answer, threading.Event(), threading.Event()

    def lose(self, parts):
        if parts != [b"lose"]:
            return answer(self, parts)
        if lost == "the thread ends":
            raise SystemExit
        return go_on.wait(30) and ""

    monkeypatch.setattr(radalt.remote_control, "_answer", lose)
    options = {"telemetry": "", "control": f"ipc://{tmp_path}/control", "sim": False, "transmit": True}
    options |= {"stop": stop, "log": lambda line: None}
    options |= {"keep_alive_s": 1.0} if lost == "the client is silent" else {}
    thread = threading.Thread(target=drive_remotely, args=(scene, ("none",)), kwargs=options, daemon=True)
    thread.start()
    try:
        with client_of(options["control"]) as asking:
            wait_for(lambda: len(air.loud) == 2, "power from both radios")
            if lost != "the client is silent":
                asking.send(b"lose")
            # after how long is the gate's own test, which has a clock of its own
            wait_for(lambda: time.monotonic() - max(air.loud.values()) > 0.5, "silence")
            last, taken = dict(air.loud), dict(air.taken)
            wait_for(lambda: all(air.taken[device] > taken[device] for device in taken), "zeros after it")
            assert air.loud == last
    finally:
        go_on.set()
        stop.set()
        thread.join(patient(20))
        assert not thread.is_alive()


@pytest.mark.parametrize("jammer", [True, False])
def test_the_remote_flowgraph_for_the_air_is_controlled(jammer):
    data = prune(load_grc(ROOT / "flowgraphs/ota_b210.grc"), ["none"], jammer)
    made = {block["name"]: block["parameters"].get("controlled") for block in remote(data, "it")["blocks"]}
    assert made["radar_gate"] == made["jammer_gate"] == "bool(control)"
