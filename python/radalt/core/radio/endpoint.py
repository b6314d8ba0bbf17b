"""Public ZMQ endpoints: which ones this machine alone reaches, and which ones are free."""

import errno
import os
import re
import socket
import stat

from ..parsing import shown

_ENDPOINT = re.compile(r"ipc://(?P<path>[^\0\n]+)|tcp://(?P<host>[^\s/]+):(?P<port>\d{1,5}|\*)")
_LOOPBACK = re.compile(r"127(\.\d{1,3}){3}|localhost|\[::1\]")
_PATH_BYTES = 100  # longest path of a Unix socket, bytes: Linux allows 107


def check_endpoint(name: str, endpoint: str, *, network: bool) -> None:
    """Refuse a ZMQ endpoint that other machines reach, unless ``network`` says that this is meant.

    Raises `ValueError`: there is no authentication: whoever reaches an endpoint reads the results, or drives the
    transmitters.
    """
    if not endpoint:
        return
    found = _ENDPOINT.fullmatch(endpoint)
    if not found or len(endpoint) > 200:
        raise ValueError(f"{name} is {shown(endpoint)}; expected tcp://ADDRESS:PORT or ipc://FILE")
    if found["port"] not in (None, "*") and not 1 <= int(found["port"]) <= 65_535:
        raise ValueError(f"{name} is {shown(endpoint)}; a port is within 1..65535")
    if found["path"] and len(os.fsencode(found["path"])) > _PATH_BYTES:
        raise ValueError(f"{name} is {shown(endpoint)}; its path is longer than {_PATH_BYTES} bytes")
    if not network and found["host"] and not _LOOPBACK.fullmatch(found["host"]):
        raise ValueError(
            f"{name} is {shown(endpoint)}: other machines reach it, and there is no authentication; use "
            "tcp://127.0.0.1:PORT, or add --network (the block's parameter network) if that is meant"
        )


def check_free(name: str, endpoint: str) -> None:
    """Refuse an ``ipc://`` file that is no socket or has a living owner: ZMQ deletes whatever is there.

    Raises `ValueError`.
    """
    path = endpoint.removeprefix("ipc://")
    if path == endpoint or not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(os.lstat(path).st_mode):
        raise ValueError(
            f"{name} endpoint {shown(endpoint)}: the file exists and is no socket; name a new one"
        )
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)  # a program whose queue is full answers nobody, and lives
        if probe.connect_ex(path) != errno.ECONNREFUSED:
            raise ValueError(f"{name} endpoint {shown(endpoint)} is in use by another program; name another")
