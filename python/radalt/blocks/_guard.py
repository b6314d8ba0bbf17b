"""Shared by all blocks: an exception in ``work`` must end the flowgraph, and threads must give way in time."""

from __future__ import annotations

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

__all__ = ["WORK_DONE", "guarded", "in_turns", "raise_stored", "raised"]

WORK_DONE = -1

raised: list[Exception] = []  # what blocks of this program have raised, for whoever has no list of its blocks

# Every block is a thread that holds the interpreter for tens of microseconds at a time. With Python's default of 5 ms a
# block that returns from NumPy waits that long behind a busy one: a flowgraph of five methods then took three times as
# long, most of it waiting.
_SWITCH_S = 1e-4
sys.setswitchinterval(_SWITCH_S)

# Every block is a thread already: BLAS threads of its own only spin beside it (five times the CPU time, measured).
threadpool_limits(1, user_api="blas")

_turn: contextlib.AbstractContextManager = contextlib.nullcontext()


@contextlib.contextmanager
def in_turns() -> Iterator[None]:
    """One block's ``work`` at a time, each to its end: for flowgraphs that only have to end soon, on one core.

    A radio's samples would be late. In a simulation what a block works on stays in the cache, and threads that cannot
    go on are not woken: a run of seven methods took 0.90 to 0.93 of its CPU time.
    """
    global _turn
    _turn = threading.RLock()  # a tracker's work calls that of the altimeter it is
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
            if not isinstance(error, MitigationError):  # whose one line says it all
                traceback.print_exc()
            return WORK_DONE

    return wrapper


def raise_stored(blocks: list) -> None:
    """Raise the first error that a block's ``work`` has stored."""
    for block in blocks:
        error = getattr(block, "error", None)
        if error is not None:
            raise error
