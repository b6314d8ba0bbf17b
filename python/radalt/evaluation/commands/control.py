"""Client of ota_remote.py: an example of its protocol, JSON over ZMQ, for any language with a ZMQ binding.

    .venv/bin/python flowgraphs/control_client.py get
    .venv/bin/python flowgraphs/control_client.py set --altitude 200 --overlap 0.5 --sir-db=-20 --methods none,tcae
    .venv/bin/python flowgraphs/control_client.py watch --count 20
    .venv/bin/python flowgraphs/control_client.py stop

The module needs pyzmq only, neither GNU Radio nor this package.
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


def _shown(text: str) -> str:
    """A stranger's text on one line of a terminal, without control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split())[:280])


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
    parser.add_argument("command", choices=("get", "set", "reacquire", "stop", "watch"))
    parser.add_argument("--control", default="tcp://127.0.0.1:5557", help="REP endpoint (%(default)s)")
    parser.add_argument("--telemetry", default="tcp://127.0.0.1:5556", help="PUB endpoint (%(default)s)")
    parser.add_argument("--altitude", type=float, help="set: metres")
    parser.add_argument("--overlap", type=float, help="set: active fraction of the sweep, 0..1")
    parser.add_argument("--sir-db", type=float, help="set: signal-to-interference ratio")
    parser.add_argument("--methods", help="set: names separated by commas")
    parser.add_argument("--count", type=int, default=10, help="watch: number of messages (%(default)s)")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """One command; returns 0, or 2 after one line."""
    parser = _parser()
    args = parser.parse_args(argv)
    numbers = [v for v in (args.altitude, args.overlap, args.sir_db) if v is not None]
    if not all(math.isfinite(v) for v in numbers) or args.count < 0:
        parser.error("numbers have to be finite, --count 0 or above")
    client = Client(args.control, args.telemetry)
    try:
        if args.command == "watch":
            for _, message in zip(range(args.count), client.messages(3600.0), strict=False):
                print(json.dumps(message))
        else:
            changes = {"altitude_m": args.altitude, "overlap": args.overlap, "sir_db": args.sir_db}
            changes = {k: v for k, v in changes.items() if v is not None}
            if args.methods:
                changes["methods"] = args.methods.split(",")
            print(json.dumps(client.request(args.command, **changes), indent=1))
    except (ControlError, zmq.ZMQError, UnicodeError) as error:
        print(f"control_client: {_shown(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:  # the reader has closed the pipe: | head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
