"""Telemetry and control: any program can drive the loop, and none can stop it by accident."""

import json
import threading
import time

import control_client
import pytest
import zmq

from gnuradio.radalt.core.radio.control import RequestError, parse_request
from gnuradio.radalt.core.scene import parse_scene
from gnuradio.radalt.evaluation.radios.remote import drive_remotely

pytestmark = pytest.mark.timeout(60)

LIMITS = {"max_altitude_m": 1500.0, "methods": ("none", "whitening"), "jammer": True}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"\xff\xfe", "not JSON"),
        (b"{", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"[1]", "expected an object"),
        (b'{"command": "get"}', "version is None"),
        (b'{"version": 2, "command": "get"}', "speaks 1"),
        (b'{"version": 1, "command": "fly"}', "allowed: get, set"),
        (b'{"version": 1, "command": "get", "altitude_m": 1}', "unknown key 'altitude_m' for get"),
        (b'{"version": 1, "command": "set"}', "changes nothing"),
        (b'{"version": 1, "command": "set", "altitude": 1}', "unknown key 'altitude'"),
        (b'{"version": 1, "command": "set", "altitude_m": 1501}', "within 0..1500"),
        (b'{"version": 1, "command": "set", "altitude_m": NaN}', "within 0..1500"),
        (b'{"version": 1, "command": "set", "altitude_m": true}', "within 0..1500"),
        (b'{"version": 1, "command": "set", "overlap": "1"}', "within 0..1"),
        (b'{"version": 1, "command": "set", "methods": []}', "list of names"),
        (b'{"version": 1, "command": "set", "methods": ["tcae"]}', "not in the flowgraph"),
    ],
)
def test_a_malformed_request_is_named(text, message):
    with pytest.raises(RequestError, match=message):
        parse_request(text, **LIMITS)


def test_a_request_is_read():
    text = b'{"version": 1, "command": "set", "altitude_m": 200, "methods": ["none"]}'
    request = parse_request(text, **LIMITS)
    assert request.changes == {"altitude_m": 200.0, "methods": ("none",)}
    with pytest.raises(RequestError, match="need a jammer"):
        parse_request(b'{"version": 1, "command": "set", "overlap": 1}', **LIMITS | {"jammer": False})


@pytest.fixture
def loop(tmp_path):
    """A running flowgraph and a client of it."""
    endpoints = {name: f"ipc://{tmp_path}/{name}" for name in ("telemetry", "control")}
    scene = parse_scene(
        {
            "altitude": {"programme_m": [1000.0]},
            "interference": {"qpsk": {"sir_db": -5.0, "overlap": 0.5, "bandwidth_hz": 2.0025e6}},
        }
    )
    stop, ended = threading.Event(), []

    def run() -> None:
        ended.append(drive_remotely(scene, ("none", "whitening"), stop=stop, log=lambda _: None, **endpoints))

    thread = threading.Thread(target=run)
    thread.start()
    client = control_client.Client(**endpoints)
    for _ in range(200):
        try:
            state = client.request("get")
            break
        except control_client.ControlError:
            time.sleep(0.05)
    assert state["methods"] == ["none", "whitening"]
    yield client, endpoints, thread, ended
    stop.set()
    thread.join(20)


def results(client, seconds=1.0):
    return [m for m in client.messages(seconds) if m["type"] == "result"]


def until(client, condition, seconds=20.0):
    """The first result that meets the condition."""
    for message in client.messages(seconds):
        if message["type"] == "result" and condition(message):
            return message
    raise AssertionError("no such result")


def test_altitude_follows_what_is_set_and_stop_stops(loop):
    client, _, thread, ended = loop
    for altitude in (321.0, 45.0):
        assert client.request("set", altitude_m=altitude)["altitude_m"] == altitude
        message = until(client, lambda m, a=altitude: m["truth_m"] == a)
        assert message["version"] == 1
        assert abs(message["altitude_m"] - altitude) < 5.0
    client.request("stop")
    thread.join(20)
    assert ended[0]["frames"]["none"] > 0


def test_jammer_and_methods_are_set(loop):
    client, _, _, _ = loop
    state = client.request("set", altitude_m=100.0, sir_db=-50.0, overlap=1.0, methods=["none"])
    assert (state["sir_db"], state["overlap"], state["methods"]) == (-50.0, 1.0, ["none"])
    # at -50 dB nothing is left to be seen without mitigation
    seen = until(
        client, lambda m: m["truth_m"] == 100.0 and (not m["valid"] or abs(m["altitude_m"] - 100) > 5)
    )
    assert seen["method"] == "none"
    before = client.request("get")["frames"]
    assert {m["method"] for m in results(client, 0.5)} == {"none"}
    after = client.request("get")["frames"]
    assert after["whitening"] == before["whitening"]
    assert after["none"] > before["none"]


def test_malformed_requests_are_answered_and_change_nothing(loop):
    client, endpoints, _, _ = loop
    before = client.request("get")
    with zmq.Context.instance().socket(zmq.REQ) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(endpoints["control"])
        for text in (
            b"",
            b"{",
            b"\x00" * 1000,
            b'{"version": 1, "command": "set", "altitude_m": 5, "overlap": 9}',
        ):
            socket.send(text)
            assert socket.poll(2000)
            reply = json.loads(socket.recv())
            assert reply["ok"] is False
            assert reply["version"] == 1
            assert "\n" not in reply["error"]
    after = client.request("get")
    assert (after["altitude_m"], after["overlap"]) == (before["altitude_m"], before["overlap"])


def test_a_subscriber_that_never_reads_slows_nothing(loop):
    client, endpoints, _, _ = loop
    with zmq.Context.instance().socket(zmq.SUB) as dead:
        dead.setsockopt(zmq.LINGER, 0)
        dead.setsockopt(zmq.RCVHWM, 1)
        dead.subscribe(b"")
        dead.connect(endpoints["telemetry"])
        first = client.request("get")
        heard = results(client, 1.5)
        last = client.request("get")
    assert last["frames"]["none"] > first["frames"]["none"]
    assert len(heard) > 100
    assert last["published"] > first["published"]
