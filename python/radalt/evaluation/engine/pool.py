"""Independent tasks over local worker processes that may die or hang without taking the run with them.

The processes are pebble's: it can end a task that hangs in C++ and says which task killed its worker; both are what a
flowgraph does when something is wrong.
"""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import os
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from multiprocessing import resource_tracker
from multiprocessing.synchronize import Semaphore
from typing import Any

from ...core.interrupts import ctrl_c_waits
from ...core.text import said

__all__ = ["WorkerError", "answered", "cause", "enter", "run_tasks", "too_late", "uninterrupted"]

_START_S = 10.0  # that a worker may take to start before a run ends without it


class WorkerError(RuntimeError):
    """A task that could not be done; the message is one line for the user."""


def answered(function: Callable[..., Any], *arguments: Any) -> tuple[bool, Any]:
    """(failed, value or message): an error that is meant for the user comes back as its one line.

    `ValueError` and `RuntimeError` are meant for the user, as all of the package's errors are; so are a full disk and
    a full memory.
    """
    try:
        return False, function(*arguments)
    except (ValueError, RuntimeError, OSError, MemoryError) as error:
        return True, said(error)


def run_tasks(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    *,
    jobs: int,
    time_limit_s: float,
    label: Callable[[Any], str] = str,
) -> Iterator[tuple[int, Any]]:
    """Yield ``(index, function(task))`` as tasks finish, in no particular order.

    Parameters
    ----------
    function : callable
        Importable by name; called in a spawned process, which does many tasks.
    tasks : sequence
        Picklable.
    jobs : int
        Worker processes, >= 1.
    time_limit_s : float
        Longest time for one task.
    label : callable
        Names a task in error messages.

    Raises
    ------
    WorkerError
        If a worker dies, a task exceeds its time or reports an error that is meant for the user. The other workers
        are stopped.
    """
    from concurrent.futures.process import BrokenProcessPool

    from pebble import ProcessExpired, ProcessPool

    if not tasks:
        return
    # Threads of BLAS would wait for each other on a worker's one core: twice the time. Workers inherit this.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # spawned, not forked: a fork would copy GNU Radio's threads and buffers in an unknown state
    context = multiprocessing.get_context("spawn")
    workers = min(jobs, len(tasks))
    ready = context.Semaphore(0)
    with ProcessPool(workers, context=context, initializer=_enter_pool, initargs=(ready,)) as pool:
        todo = iter(enumerate(tasks))
        running: dict[Future, int] = {}

        def hand_out() -> None:
            # one task per worker and no queue behind it, so that a time limit starts with the task
            for index, task in todo:
                running[pool.schedule(answered, (function, task), timeout=time_limit_s)] = index
                return

        with uninterrupted():
            for _ in range(workers):
                hand_out()
        try:
            while running:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index = running.pop(future)
                    what = label(tasks[index])
                    try:
                        failed, value = future.result()
                    except TimeoutError:
                        raise WorkerError(f"{what}: {too_late(time_limit_s)}") from None
                    except ProcessExpired as error:
                        raise WorkerError(
                            f"{what}: the worker process ended ({cause(error.exitcode)})"
                        ) from None
                    except BrokenProcessPool:  # it ended before it had said that it took the task
                        raise WorkerError(f"{what}: the worker process ended ({cause(None)})") from None
                    if failed:
                        raise WorkerError(f"{what}: {value}")
                    hand_out()
                    yield index, value
        except BaseException:
            pool.stop()
            raise
        finally:
            # a worker that still starts when the pool closes its pipes prints a traceback
            for _ in range(workers):
                if not ready.acquire(timeout=_START_S):
                    break


def too_late(time_limit_s: float) -> str:
    """For a task that hangs."""
    return f"not done after {time_limit_s:g} s; raise the time limit (--time-limit-s)"


def cause(exitcode: int | None) -> str:
    """Why a process ended, in words."""
    if exitcode is None:
        return "it no longer answers"
    if exitcode >= 0:
        return f"exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"{name}; out of memory? try fewer jobs" if name == "SIGKILL" else name


def enter() -> None:
    """First thing in a process that measures: a core of its own.

    A flowgraph's threads share one interpreter, so a second core wins nothing and every handover between cores costs:
    `none` and `whitening` ran at 0.86 of real time on two cores and at 1.24 on one of them.
    """
    if hasattr(os, "sched_setaffinity"):
        for core in sorted(os.sched_getaffinity(0)):
            if _claim(core):
                os.sched_setaffinity(0, {core})
                break


def _enter_pool(ready: Semaphore) -> None:
    """`enter`; a method of the user's that calls ``os._exit(0)`` ends as a failure; then ``ready``.

    pebble takes a worker with status 0 for one that has nothing left to do, and its task would wait for the time limit.
    It sends SIGTERM right after it has closed the pipes. A worker that ends by then holds it back: Python, its handlers
    cleared, would print a traceback; pebble kills one that does not come to its end.
    """
    enter()
    atexit.register(signal.pthread_sigmask, signal.SIG_BLOCK, {signal.SIGTERM})
    leave = os._exit
    os._exit = lambda status: leave(status or 1)
    ready.release()


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Threads and processes that start in this block never see Ctrl-C: it reaches the whole process group, and their
    owner decides what becomes of them. Their imports would else end in a traceback each."""
    resource_tracker.ensure_running()  # its first start would let Ctrl-C through again
    with ctrl_c_waits():
        yield


_claims: list[socket.socket] = []


def _claim(core: int) -> bool:
    """Whether no other process that measures on this machine has this core; kept while this process lives.

    The claim is a name in Linux's abstract socket namespace: there is one such name per machine (or container), and it
    goes with the process however that ends. Worker processes of two runs, or of two Dask workers, thus do not meet on
    one core while another stands idle; those that find every core claimed stay where the system puts them.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0radalt core {core}")
    except OSError:
        claim.close()
        return False
    _claims.append(claim)
    return True
