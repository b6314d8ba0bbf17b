"""Requests of the control socket: JSON into a checked request, or one line about the error.

{"version": 1, "command": "get"}
{"version": 1, "command": "set", "altitude_m": 200, "overlap": 0.5, "sir_db": -20, "methods": ["none", "tcae"]}
{"version": 1, "command": "reacquire"}
{"version": 1, "command": "stop"}
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

from ..parsing import shown

CONTROL_VERSION = 1  # version of the protocol above
COMMANDS = ("get", "set", "reacquire", "stop")
MAX_REQUEST_BYTES = 65_536  # longest request, bytes: a thousand times a usual one
# largest magnitude of an SIR, dB: beyond every method's break-point and converter's range
SIR_LIMIT_DB = 100.0


class RequestError(ValueError):
    """A request that cannot be carried out; the message is the reply's ``error``."""


@dataclass(frozen=True)
class Request:
    """A checked request: the command and, for ``set``, the values to change."""

    command: str
    changes: dict[str, Any] = field(default_factory=dict)


def parse_request(text: bytes, *, max_altitude_m: float, methods: Sequence[str], jammer: bool) -> Request:
    """Check one request, a JSON object in UTF-8, against the flowgraph's limits, methods and jammer.

    Raises `RequestError`: names the key, the value (cut where it is long) and what is allowed.
    """
    data = _object(text)
    version = data.get("version")
    if type(version) is not int or version != CONTROL_VERSION:
        raise RequestError(f"version is {shown(version)}; this program speaks {CONTROL_VERSION}")
    command = data.get("command")
    if not isinstance(command, str) or command not in COMMANDS:
        raise RequestError(f"command is {shown(command)}; allowed: {', '.join(COMMANDS)}")
    changes = {k: v for k, v in data.items() if k not in ("version", "command")}
    allowed = ("altitude_m", "overlap", "sir_db", "methods") if command == "set" else ()
    stray = [k for k in changes if k not in allowed]
    if stray:
        raise RequestError(
            f"unknown key {shown(stray[0])} for {command}; allowed: {', '.join(allowed) or 'none'}"
        )
    if command == "set" and not changes:
        raise RequestError(f"set changes nothing; give one of: {', '.join(allowed)}")
    if not jammer and {"overlap", "sir_db"} & changes.keys():
        raise RequestError("overlap and sir_db need a jammer, and the scene has none")
    limits = {
        "altitude_m": (0.0, max_altitude_m),
        "overlap": (0.0, 1.0),
        "sir_db": (-SIR_LIMIT_DB, SIR_LIMIT_DB),
    }
    for key, (low, high) in limits.items():
        if key in changes:
            changes[key] = _number(key, changes[key], low, high)
    if "methods" in changes:
        changes["methods"] = _methods(changes["methods"], methods)
    return Request(command, changes)


def _object(text: bytes) -> dict[str, Any]:
    """The JSON object of a request, each key once and every number finite."""
    if len(text) > MAX_REQUEST_BYTES:
        raise RequestError(f"{len(text)} bytes; a request has at most {MAX_REQUEST_BYTES}")

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is no JSON number")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError("a key is there twice")
        return found

    try:
        data = json.loads(text.decode("utf-8"), parse_constant=refuse, object_pairs_hook=once)
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise RequestError(f"not JSON: {str(error)[:120]}") from None
    if not isinstance(data, dict):
        raise RequestError("expected an object like {'version': 1, 'command': 'get'}")
    return data


def _number(key: str, value: Any, low: float, high: float) -> float:
    # compare without conversion: an integer of hundreds of digits does not convert to float
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not low <= value <= high:
        raise RequestError(f"{key} is {shown(value)}; it has to be a number within {low:g}..{high:g}")
    return float(value)


def _methods(value: Any, known: Sequence[str]) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(m, str) for m in value):
        raise RequestError(
            f"methods is {shown(value)}; it has to be a list of names out of: {', '.join(known)}"
        )
    unknown = [m for m in value if m not in known]
    if unknown:
        raise RequestError(f"method {shown(unknown[0])} is not in the flowgraph; it has: {', '.join(known)}")
    return tuple(dict.fromkeys(value))
