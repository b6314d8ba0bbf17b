"""A ZMQ socket behind a `BoundedListener`; control and telemetry have separate contexts: neither delays the other."""

from functools import lru_cache
from typing import Any

from ..core.radio.endpoint import BoundedListener

_LINGER_MS = 200  # for the last results on their way to the listener, on this machine


@lru_cache(maxsize=2)
def _context(kind: str) -> Any:
    """Context of all sockets of a kind. It is never destroyed, since that waits for every socket."""
    import zmq  # needed for endpoints only

    return zmq.Context()


class BoundSocket:
    """A bound PUB or REP socket.

    Parameters
    ----------
    kind : str
        ``PUB`` or ``REP``.
    name, endpoint : str
        See `BoundedListener`.
    limit_bytes : int
        Largest request with its framing, or all subscriptions of a peer.
    queued : int
        Messages queued for a slow subscriber; more are dropped.

    Raises
    ------
    ValueError
        One line, if the endpoint cannot be bound.
    """

    def __init__(self, kind: str, name: str, endpoint: str, *, limit_bytes: int, queued: int = 1000) -> None:
        import zmq

        self.listener = BoundedListener(name, endpoint, limit_bytes=limit_bytes, answered=kind == "REP")
        inproc = endpoint.startswith("inproc://")  # such names belong to one context
        self.socket = (zmq.Context.instance() if inproc else _context(kind)).socket(getattr(zmq, kind))
        for option, value in ((zmq.LINGER, 0), (zmq.SNDHWM, queued), (zmq.MAXMSGSIZE, limit_bytes)):
            self.socket.setsockopt(option, value)
        try:
            self.socket.bind(self.listener.behind)
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(f"{name} endpoint {endpoint!r} cannot be bound: {error}; use another") from None

    def close(self) -> None:
        """Free the endpoint."""
        self.socket.close(linger=_LINGER_MS)
        self.listener.close()
