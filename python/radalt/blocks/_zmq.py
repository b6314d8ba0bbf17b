"""A bound ZMQ socket with bounded queues and messages, in a context of its own: none delays another."""

from ..core.radio.endpoint import check_free

_LINGER_MS = 200  # longest wait at the end for peers that take what was sent, ms


class BoundSocket:
    """A bound PUB or REP socket, ``socket``, with its ``address``.

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
