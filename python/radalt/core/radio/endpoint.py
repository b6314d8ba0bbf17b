"""Public endpoints, and a listener that bounds their input before ZMQ receives it.

libzmq collects a multipart message without limit before it delivers it, keeps every subscription and every idle
connection, and unlinks an ``ipc://`` path before it binds it. It therefore binds a private socket, and this listener
relays the public endpoint to it.
"""

import asyncio
import contextlib
import errno
import os
import re
import socket
import stat
import tempfile
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

from ..parsing import shown

CONNECTIONS = 16  # most connections, four descriptors each; one more closes the one idle for longest
CHUNK_BYTES = 65_536  # bytes per read from a connection: the default size of a pipe
_DELIVERY_S = 0.5  # s, for what was sent before the end, to a peer that takes it
_ENDPOINT = re.compile(r"ipc://(?P<path>[^\0\n]+)|inproc://.+|tcp://(?P<host>[^\s/]+):(?P<port>\d{1,5}|\*)")
_LOOPBACK = re.compile(r"127(\.\d{1,3}){3}|localhost|\[::1\]")
_PONG_BYTES = 32  # longest write that is no reply, bytes: ZMTP answers a heartbeat with at most 25 (RFC 37)
_PATH_BYTES = 100  # longest path of a Unix socket, bytes: Linux allows 107


def check_endpoint(name: str, endpoint: str, *, network: bool) -> None:
    """Refuse a ZMQ endpoint that other machines reach, unless ``network`` says that this is meant.

    Raises
    ------
    ValueError
        One line: there is no authentication: whoever reaches an endpoint reads the results, or drives the transmitters.
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


class BoundedListener:
    """Relays bytes between the clients of an endpoint and a ZMQ socket bound to `behind`.

    A connection is closed when its peer has sent more than ``limit_bytes``: since the last answer where
    ``answered``, else in total (a subscriber only sends its subscriptions). A peer that does not receive delays only
    itself: ZMQ drops messages for it.

    Parameters
    ----------
    name : str
        Name of the endpoint in messages.
    endpoint : str
        ``tcp://ADDRESS:PORT`` (``*`` for any of either), ``ipc://FILE`` or ``inproc://NAME``, which is not relayed.
    limit_bytes : int
    answered : bool

    Attributes
    ----------
    behind : str
        Endpoint for the ZMQ socket, to be bound after the listener is created.
    address : str
        Address for clients: the endpoint with its port.
    refused : int
        Connections closed for too many bytes, or for a newer connection.

    Raises
    ------
    ValueError
        One line, if the endpoint is in use or names a file that is no socket.
    """

    def __init__(self, name: str, endpoint: str, *, limit_bytes: int, answered: bool) -> None:
        self._name, self._endpoint = name, endpoint
        self._limit, self._answered = limit_bytes, answered
        self.refused = 0
        self.behind = self.address = endpoint
        self._loop: asyncio.AbstractEventLoop | None = None
        self._path: str | None = None
        if endpoint.startswith("inproc://"):
            return
        self._folder = tempfile.TemporaryDirectory(prefix="radalt_", ignore_cleanup_errors=True)
        self._inside = f"{self._folder.name}/zmq"
        self.behind = f"ipc://{self._inside}"
        self._open: OrderedDict[asyncio.Task, asyncio.StreamWriter] = OrderedDict()
        try:
            listening = self._listen()
        except OSError as error:
            self._folder.cleanup()
            raise ValueError(
                f"{name} endpoint {shown(endpoint)} cannot be bound: {error.strerror or error}; use another"
            ) from None
        except ValueError:
            self._folder.cleanup()
            raise
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()  # not loop.stop(): that is lost where the listener is still starting
        self._thread = threading.Thread(
            target=self._run, args=(listening,), daemon=True, name=f"radalt_{name}"
        )
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the listener runs."""
        return self._loop is None or self._thread.is_alive()

    def close(self) -> None:
        """End all connections once what the ZMQ socket has left is delivered, and free the endpoint."""
        if self._loop is None:
            return
        with contextlib.suppress(RuntimeError):  # the loop may have ended
            self._loop.call_soon_threadsafe(lambda: self._loop.create_task(self._end()))
        self._thread.join()
        if self._path:
            Path(self._path).unlink(missing_ok=True)
        self._folder.cleanup()

    # -- binding ------------------------------------------------------------------------------------------------------

    def _listen(self) -> socket.socket:
        found = _ENDPOINT.fullmatch(self._endpoint)
        if found["path"]:
            return self._listen_at(found["path"])
        host, port = found["host"], 0 if found["port"] == "*" else int(found["port"])
        host = "0.0.0.0" if host == "*" else host.strip("[]")
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.create_server(address, family=family)
        self.address = f"tcp://{found['host']}:{listening.getsockname()[1]}"
        return listening

    def _listen_at(self, path: str) -> socket.socket:
        """A Unix socket at ``path``. A stale socket is replaced, any other file is refused."""
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            if path.startswith("@"):  # Linux's abstract names: no file, and bound once only
                listening.bind("\0" + path[1:])
            else:
                with _exclusive(Path(path).absolute().parent):
                    self._bind(listening, path)
                self._path = path
            listening.listen()
        except (OSError, ValueError):
            listening.close()
            raise
        return listening

    def _bind(self, listening: socket.socket, path: str) -> None:
        try:
            listening.bind(path)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            self._check_dead(path)
            os.unlink(path)
            listening.bind(path)

    def _check_dead(self, path: str) -> None:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise ValueError(
                f"{self._name} endpoint {shown(self._endpoint)}: the file exists and is no socket; name a new one"
            )
        with (
            socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe,
            contextlib.suppress(ConnectionRefusedError),
        ):
            probe.setblocking(False)  # a program whose queue is full answers nobody, and lives
            with contextlib.suppress(BlockingIOError):
                probe.connect(path)
            raise ValueError(
                f"{self._name} endpoint {shown(self._endpoint)} is in use by another program; name another"
            )

    # -- the thread ---------------------------------------------------------------------------------------------------

    def _run(self, listening: socket.socket) -> None:
        asyncio.set_event_loop(self._loop)
        start = asyncio.start_unix_server if listening.family == socket.AF_UNIX else asyncio.start_server
        server = self._loop.run_until_complete(start(self._connected, sock=listening))
        try:
            self._loop.run_until_complete(self._ended.wait())
        finally:
            server.close()
            tasks = asyncio.all_tasks(self._loop)
            for task in tasks:
                task.cancel()
            self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
            self._loop.close()

    async def _end(self) -> None:
        if self._open:
            await asyncio.wait(set(self._open), timeout=_DELIVERY_S)
        await asyncio.sleep(0)  # what is closing is written out
        self._ended.set()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One peer, to its end."""
        task = asyncio.current_task()
        if len(self._open) >= CONNECTIONS:
            oldest, _ = self._open.popitem(last=False)
            self.refused += 1
            oldest.cancel()
        self._open[task] = writer
        inner = None
        try:
            inner_reader, inner = await asyncio.open_unix_connection(self._inside)
            pending = [0]
            both = [
                asyncio.ensure_future(self._inward(reader, inner, pending, task)),
                asyncio.ensure_future(self._outward(inner_reader, writer, pending)),
            ]
            try:
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for pump in both:
                    pump.cancel()
                await asyncio.gather(*both, return_exceptions=True)
        except OSError:
            pass  # a peer has closed the connection
        finally:
            self._open.pop(task, None)
            for end in filter(None, (writer, inner)):
                end.close()
            with contextlib.suppress(OSError, asyncio.TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), _DELIVERY_S)

    async def _inward(
        self, reader: asyncio.StreamReader, inner: asyncio.StreamWriter, pending: list[int], task: Any
    ) -> None:
        while data := await reader.read(CHUNK_BYTES):
            pending[0] += len(data)
            if pending[0] > self._limit:
                self.refused += 1
                return
            if task in self._open:
                self._open.move_to_end(task)
            inner.write(data)
            await inner.drain()

    async def _outward(
        self, inner: asyncio.StreamReader, writer: asyncio.StreamWriter, pending: list[int]
    ) -> None:
        while data := await inner.read(CHUNK_BYTES):
            if self._answered and len(data) > _PONG_BYTES:
                pending[0] = 0
            writer.write(data)
            await writer.drain()


@contextlib.contextmanager
def _exclusive(folder: Path):  # noqa: ANN202 - a context
    """Lock a folder against other programs that replace a socket in it at the same time."""
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
