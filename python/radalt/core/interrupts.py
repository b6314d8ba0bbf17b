"""Ctrl-C while compiled packages are imported, and as one line."""

import contextlib
import signal
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def stops_in_one_line() -> Iterator[None]:
    """Context or decorator: Ctrl-C prints its message, by default "stopped", and no traceback."""
    try:
        yield
    except KeyboardInterrupt as stop:
        line, before = KeyboardInterrupt(str(stop) or "stopped"), sys.excepthook
        sys.excepthook = lambda *said: print(line, file=sys.stderr) if said[1] is line else before(*said)
        raise line from None


@contextlib.contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """Hold Ctrl-C back until the block ends; threads and processes that start in the block never receive it.

    An interrupted import of a compiled package raises ImportError, as if the package were missing.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
