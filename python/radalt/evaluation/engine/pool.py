"""Independent tasks over local worker processes that may die or hang without taking the run with them.

The processes are pebble's: it can end a task that hangs in C++ and says which task killed its worker; both are what a
flowgraph does when something is wrong.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from typing import Any

__all__ = ["WorkerError", "answered", "run_tasks"]


class WorkerError(RuntimeError):
    """A task that could not be done; the message is one line for the user."""


def answered(function: Callable[..., Any], *arguments: Any) -> tuple[bool, Any]:
    """(failed, value or message): an error that is meant for the user comes back as its one line.

    `ValueError` and `RuntimeError` are meant for the user, as all of the package's errors are.
    """
    try:
        return False, function(*arguments)
    except (ValueError, RuntimeError) as error:
        return True, str(error) or type(error).__name__


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
    from pebble import ProcessExpired, ProcessPool

    if not tasks:
        return
    # spawned, not forked: a fork would copy GNU Radio's threads and buffers in an unknown state
    context = multiprocessing.get_context("spawn")
    turn = context.Value("i", 0)
    workers = min(jobs, len(tasks))
    with ProcessPool(workers, context=context, initializer=_enter, initargs=(turn,)) as pool:
        todo = iter(enumerate(tasks))
        running: dict[Future, int] = {}

        def hand_out() -> None:
            # one task per worker and no queue behind it, so that a time limit starts with the task
            for index, task in todo:
                running[pool.schedule(answered, (function, task), timeout=time_limit_s)] = index
                return

        # Ctrl-C reaches the whole process group, and the parent decides what becomes of the workers: the pool's
        # threads, and so the workers they start, have it blocked from their first instruction on
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            for _ in range(workers):
                hand_out()
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        try:
            while running:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index = running.pop(future)
                    what = label(tasks[index])
                    try:
                        failed, value = future.result()
                    except TimeoutError:
                        raise WorkerError(
                            f"{what}: not done after {time_limit_s:g} s; raise the time limit (--time-limit-s)"
                        ) from None
                    except ProcessExpired as error:
                        raise WorkerError(
                            f"{what}: the worker process ended ({_cause(error.exitcode)})"
                        ) from None
                    if failed:
                        raise WorkerError(f"{what}: {value}")
                    hand_out()
                    yield index, value
        finally:
            pool.stop()


def _cause(exitcode: int | None) -> str:
    if exitcode is None:
        return "it no longer answers"
    if exitcode >= 0:
        return f"exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"{name}; out of memory? try fewer jobs" if name == "SIGKILL" else name


def _enter(turn: Any) -> None:
    """First thing in a worker: a core of its own, and Ctrl-C ignored by what it starts, too.

    A flowgraph's threads share one interpreter, so a second core wins nothing and every handover between cores costs:
    `none` and `whitening` ran at 0.86 of real time on two cores and at 1.24 on one of them.
    """
    with turn.get_lock():
        number, turn.value = turn.value, turn.value + 1
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[number % len(cores)]})
    signal.signal(signal.SIGINT, signal.SIG_IGN)
