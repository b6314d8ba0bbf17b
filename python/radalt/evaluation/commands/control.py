"""Client of ota_remote.py: an example of its protocol, JSON over ZMQ, for any language with a ZMQ binding.

    .venv/bin/python flowgraphs/control_client.py get
    .venv/bin/python flowgraphs/control_client.py set --altitude 200 --overlap 0.5 --sir-db=-20 --methods none,tcae
    .venv/bin/python flowgraphs/control_client.py watch --count 20
    .venv/bin/python flowgraphs/control_client.py descend --altitudes 1200,600,300,100,20 --seconds 1
    .venv/bin/python flowgraphs/control_client.py stop

`descend` is the paper's loop over altitudes: set one, collect results, print the error of each method. The module needs
pyzmq only, neither GNU Radio nor this package.
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

import zmq

PROGRAM, COMMAND = "control_client", "control"
VERSION = 1  # of the protocol
TIMEOUT_MS = 2000  # longest wait for a reply, ms: a flowgraph replies within some tens


class ControlError(RuntimeError):
    """No answer, or the answer is an error; one line."""


class Client:
    """Requests over one socket, results from another.

    Examples
    --------
    >>> client = Client()                                   # doctest: +SKIP
    >>> client.request("set", altitude_m=200.0)["altitude_m"]  # doctest: +SKIP
    200.0
    """

    def __init__(
        self, control: str = "tcp://127.0.0.1:5557", telemetry: str = "tcp://127.0.0.1:5556"
    ) -> None:
        self._context = zmq.Context.instance()
        self._control, self._telemetry = control, telemetry

    def request(self, command: str, **changes: Any) -> dict[str, Any]:
        """Send one request; returns the state after it."""
        # one socket per request: a REQ socket without its reply cannot send again
        with self._context.socket(zmq.REQ) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.connect(self._control)
            socket.send_string(json.dumps({"version": VERSION, "command": command, **changes}))
            if not socket.poll(TIMEOUT_MS):
                raise ControlError(
                    f"no answer from {self._control} in {TIMEOUT_MS / 1000:g} s; is ota_remote.py up?"
                )
            reply = _message(socket.recv())
        if not reply.get("ok"):
            raise ControlError(reply.get("error", "the reply is no ota_remote's"))
        return reply.get("state", {})

    def messages(self, seconds: float) -> Iterator[dict[str, Any]]:
        """Results and states of the next ``seconds`` seconds."""
        with self._context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.subscribe(b"")
            socket.connect(self._telemetry)
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0:
                if socket.poll(left * 1000):
                    yield _message(socket.recv())


def _message(text: bytes) -> dict[str, Any]:
    """A JSON object; anything else raises `ControlError`."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise ControlError("the answer is no JSON object; does another program listen there?")
    return message


def _shown(text: object, most: int) -> str:
    """A stranger's text on one line of a terminal, without control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split())[:most])


def descend(client: Client, altitudes_m: Sequence[float], seconds: float) -> None:
    """Set altitudes in turn and print each method's error."""
    for altitude in altitudes_m:
        client.request("set", altitude_m=altitude)
        errors: dict[str, list[float | None]] = {}
        for message in client.messages(seconds):
            if message.get("type") == "result" and message.get("truth_m") == altitude:
                measured, method = message.get("altitude_m"), _shown(message.get("method"), 40)
                known = isinstance(measured, (int, float)) and abs(measured) < 1e6
                errors.setdefault(method, []).append(abs(measured - altitude) if known else None)
        for method, values in errors.items():
            good = sum(v is not None and v < 5.0 for v in values)
            print(f"{altitude:8.1f} m  {method:12} Pd(5 m) {good / len(values):.3f} of {len(values)} frames")


def _numbers(text: str) -> list[float]:
    """Altitudes in metres, separated by commas."""
    try:
        values = [float(a) for a in text.split(",")]
    except ValueError:
        values = [math.nan]
    if not all(math.isfinite(v) for v in values):
        raise ControlError(f"--altitudes is {text[:60]!r}; give numbers in metres with commas: 1200,600,300")
    return values


class _Parser(argparse.ArgumentParser):
    """Errors in one line, without the usage text."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"control_client: {message[:250]}\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        description=__doc__.partition("\n")[0],
        epilog=__doc__.partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("command", choices=("get", "set", "reacquire", "stop", "watch", "descend"))
    parser.add_argument("--control", default="tcp://127.0.0.1:5557", help="REP endpoint (%(default)s)")
    parser.add_argument("--telemetry", default="tcp://127.0.0.1:5556", help="PUB endpoint (%(default)s)")
    parser.add_argument("--altitude", type=float, help="set: metres")
    parser.add_argument("--overlap", type=float, help="set: active fraction of the sweep, 0..1")
    parser.add_argument("--sir-db", type=float, help="set: signal-to-interference ratio")
    parser.add_argument("--methods", help="set: names separated by commas")
    parser.add_argument("--altitudes", default="1200,600,300,100,20", help="descend: metres (%(default)s)")
    parser.add_argument(
        "--seconds", type=float, default=1.0, help="descend: time at each altitude (%(default)s)"
    )
    parser.add_argument("--count", type=int, default=10, help="watch: number of messages (%(default)s)")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """One command; returns 0, or 2 after one line."""
    parser = _parser()
    args = parser.parse_args(argv)
    numbers = (args.seconds, *(v for v in (args.altitude, args.overlap, args.sir_db) if v is not None))
    if not all(math.isfinite(v) for v in numbers) or not 0 < args.seconds <= 86_400 or args.count < 0:
        parser.error("numbers have to be finite, --seconds within 0..86400, --count 0 or above")
    client = Client(args.control, args.telemetry)
    try:
        if args.command == "watch":
            for _, message in zip(range(args.count), client.messages(3600.0), strict=False):
                print(json.dumps(message))
        elif args.command == "descend":
            descend(client, _numbers(args.altitudes), args.seconds)
        else:
            changes = {"altitude_m": args.altitude, "overlap": args.overlap, "sir_db": args.sir_db}
            changes = {k: v for k, v in changes.items() if v is not None}
            if args.methods:
                changes["methods"] = args.methods.split(",")
            print(json.dumps(client.request(args.command, **changes), indent=1))
    except (ControlError, zmq.ZMQError, UnicodeError) as error:
        print(f"control_client: {_shown(error, 280)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:  # the reader has closed the pipe: | head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
