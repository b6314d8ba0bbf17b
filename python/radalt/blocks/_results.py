"""What the sinks keep and send: a ring of rows, results as plain values for messages, and ZMQ's sockets."""

import json
from typing import Any

import numpy as np

from ..core.altimeter.altimeter import RESULT_DTYPE, Reason
from ..core.parsing import plain_json
from ..core.radio.endpoint import check_free

_LINGER_MS = 200  # longest wait at the end for peers that take what was sent, ms


class Ring:
    """The last ``capacity`` rows of a structured array; one thread may append while others read."""

    def __init__(self, capacity: int, dtype: np.dtype) -> None:
        self._rows = np.zeros(capacity, dtype=dtype)
        self.count = 0  # rows since the start

    def append(self, rows: np.ndarray) -> None:
        """Store (n,) rows over the oldest ones."""
        self._rows[(self.count + np.arange(len(rows))) % self._rows.size] = rows
        self.count += len(rows)

    def last(self, count: int | None = None) -> np.ndarray:
        """Copy of the last ``count`` rows, all that are kept by default, in order of arrival."""
        now = self.count
        kept = min(now, self._rows.size) if count is None else count
        return self._rows[np.arange(now - kept, now) % self._rows.size]

    def since(self, count: int) -> tuple[int, np.ndarray]:
        """Rows after the first ``count``, unless overwritten, and the count for the next call.

        For other threads: neither the reader nor the writer waits.
        """
        now = self.count
        # only half of the ring is returned: the writer may overwrite the other half meanwhile
        first = max(0, count, now - self._rows.size // 2)
        return now, self._rows[np.arange(first, now) % self._rows.size]


def result_fields(result: np.void) -> dict[str, Any]:
    """Fields of one `RESULT_DTYPE` row as plain values, the reason by its name."""
    fields = dict(zip(RESULT_DTYPE.names, result.item(), strict=True))
    return fields | {"reason": Reason.NAMES[fields["reason"]]}


def json_text(message: dict[str, Any]) -> str:
    """JSON of a message, with null for numbers that JSON cannot hold."""
    return json.dumps(plain_json(message))


class BoundSocket:
    """A bound PUB or REP socket, ``socket``, with its ``address``, in a context of its own: none delays another.

    - ``kind``: ``PUB`` or ``REP``
    - ``name``: name of the endpoint in messages
    - ``endpoint``: ``tcp://ADDRESS:PORT`` (``*`` for any of either) or ``ipc://FILE``
    - ``limit_bytes``: longest part of a message from a peer, and longest subscription; longer ones end the connection
    - ``queued``: messages queued for a slow subscriber; more are dropped

    Raises `ValueError` if the endpoint cannot be bound.
    """

    def __init__(self, kind: str, name: str, endpoint: str, *, limit_bytes: int, queued: int = 1000) -> None:
        import zmq  # needed for endpoints only

        check_free(name, endpoint)
        self._context = zmq.Context()
        self.socket = self._context.socket(getattr(zmq, kind))
        options = {"LINGER": 0, "SNDHWM": queued, "MAXMSGSIZE": limit_bytes, "IPV6": int("[" in endpoint)}
        for option, value in options.items():
            self.socket.setsockopt(getattr(zmq, option), value)
        try:
            self.socket.bind(endpoint.replace("//localhost:", "//127.0.0.1:"))
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(
                f"{name} endpoint {endpoint!r} cannot be bound: {error.strerror}; use another"
            ) from None
        self.address = self.socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def close(self) -> None:
        """Free the endpoint."""
        self._context.destroy(_LINGER_MS)
