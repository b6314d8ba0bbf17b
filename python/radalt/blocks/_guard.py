"""Shared by all blocks: an exception in ``work`` ends the flowgraph, and threads release the interpreter in time."""

import contextlib
import functools
import sys
import threading
import traceback
from collections.abc import Callable, Iterator

import scipy.linalg.blas  # noqa: F401 - SciPy brings a BLAS of its own, which has to be there to be limited
from threadpoolctl import threadpool_limits

from ..core.cores import join_home
from ..core.mitigation.base import MitigationError
from ..core.parsing import InputError

WORK_DONE = -1  # GNU Radio's return value of a ``work`` whose stream has ended

# exceptions of all blocks of this program, for callers without a list of its blocks
raised: list[Exception] = []

# Switch interval of the interpreter, s. A block holds the interpreter for tens of microseconds; with Python's default
# of 5 ms a block that returns from NumPy waits up to 5 ms, and a flowgraph of five methods took three times as long.
_SWITCH_S = 1e-4
sys.setswitchinterval(_SWITCH_S)

# Every block is a thread already: BLAS threads next to it only spin (five times the CPU time, measured).
threadpool_limits(1, user_api="blas")

_turn: contextlib.AbstractContextManager = contextlib.nullcontext()


@contextlib.contextmanager
def in_turns() -> Iterator[None]:
    """Run one block's ``work`` at a time: for simulations on one core, where only throughput matters.

    With radios, samples would overflow. In a simulation a block's data stay in the cache and blocked threads are not
    woken: a run of seven methods took 0.90 to 0.93 of its CPU time.
    """
    global _turn
    _turn = threading.RLock()  # re-entrant: a tracker's work calls the altimeter's
    sys.setswitchinterval(5e-3)
    try:
        yield
    finally:
        sys.setswitchinterval(_SWITCH_S)
        _turn = contextlib.nullcontext()


def guarded(work: Callable) -> Callable:
    """Store whatever ``work`` raises in ``self.error`` and end the stream; the runner re-raises it.

    GNU Radio's scheduler cannot carry a Python exception out of its thread, hence the broad catch.
    """

    @functools.wraps(work)
    def wrapper(self, input_items, output_items):  # noqa: ANN001, ANN202 - GNU Radio's signature
        if getattr(self, "thread_id", None) != threading.get_native_id():
            self.thread_id = threading.get_native_id()  # for CPU time by block
            self.calls = 0
            join_home()
        self.calls += 1
        try:
            with _turn:
                return work(self, input_items, output_items)
        except Exception as error:
            self.error = error
            raised.append(error)
            # their messages are complete without a traceback
            if not isinstance(error, (InputError, MitigationError)):
                traceback.print_exc()
            return WORK_DONE

    return wrapper


def raise_stored(blocks: list) -> None:
    """Raise the first error that a block's ``work`` has stored."""
    for block in blocks:
        error = getattr(block, "error", None)
        if error is not None:
            raise error
