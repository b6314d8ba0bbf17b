"""Independent tasks over worker processes that may die or hang without taking the run with them.

`concurrent.futures` can neither stop a task that hangs in C++ nor say which task killed its worker; both are what
a flowgraph does when something is wrong, so each worker here has its own pipe and its own clock.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

__all__ = ["WorkerError", "run_tasks"]


class WorkerError(RuntimeError):
    """A task that could not be done; the message is one line for the user."""


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    task: int = -1  # index of the task in hand; -1 for none
    deadline: float = float("inf")


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
        Longest time for one task, the worker's own start included.
    label : callable
        Names a task in error messages.

    Raises
    ------
    WorkerError
        If a worker dies, a task exceeds its time or reports an error that is meant for the user (`ValueError`,
        `RuntimeError`, as all of the package's errors are, a full disk or memory). The other workers are stopped.
    """
    # spawned, not forked: a fork would copy GNU Radio's threads and buffers in an unknown state
    context = multiprocessing.get_context("spawn")
    todo = iter(range(len(tasks)))
    workers: list[_Worker] = []
    try:
        for number in range(min(jobs, len(tasks))):
            workers.append(_start(context, function, number))
            _hand_out(workers[-1], tasks, todo, time_limit_s)
        while busy := [w for w in workers if w.task >= 0]:
            patience = max(0.0, min(w.deadline for w in busy) - time.monotonic())
            ready = wait([w.pipe for w in busy], timeout=patience)
            for worker in busy:
                if worker.pipe in ready:
                    yield worker.task, _receive(worker, label(tasks[worker.task]))
                    _hand_out(worker, tasks, todo, time_limit_s)
                elif time.monotonic() > worker.deadline:
                    what = label(tasks[worker.task])
                    raise WorkerError(
                        f"{what}: not done after {time_limit_s:g} s; raise the time limit (--time-limit-s)"
                    )
    finally:
        _stop(workers)


def _start(context: Any, function: Callable[[Any], Any], number: int) -> _Worker:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, function, number), daemon=True)
    process.start()
    theirs.close()  # so that the worker's death shows as the end of the pipe
    return _Worker(process, ours)


def _hand_out(worker: _Worker, tasks: Sequence[Any], todo: Iterator[int], time_limit_s: float) -> None:
    worker.task = next(todo, -1)
    if worker.task < 0:
        return
    worker.deadline = time.monotonic() + time_limit_s
    try:
        worker.pipe.send(tasks[worker.task])
    except BrokenPipeError:
        pass  # it died while idle: the pipe's end is noticed on receipt, where the exit code is told


def _receive(worker: _Worker, label: str) -> Any:
    try:
        failed, value = worker.pipe.recv()
    except (EOFError, ConnectionResetError):
        worker.process.join(5.0)
        raise WorkerError(f"{label}: the worker process ended ({_cause(worker.process.exitcode)})") from None
    if failed:
        raise WorkerError(f"{label}: {value}")
    return value


def _cause(exitcode: int | None) -> str:
    if exitcode is None:
        return "it no longer answers"
    if exitcode >= 0:
        return f"exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"{name}; out of memory? try fewer jobs" if name == "SIGKILL" else name


def _stop(workers: Sequence[_Worker]) -> None:
    """End all workers: idle ones by the end of their pipe, busy ones by force."""
    for worker in workers:
        worker.pipe.close()
        if worker.task >= 0:
            worker.process.kill()
    for worker in workers:
        worker.process.join(5.0)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()


def _keep_to_one_core(number: int) -> None:
    """Worker ``number`` on a core of its own.

    A flowgraph's threads share one interpreter, so a second core wins nothing and every handover between cores costs:
    `none` and `whitening` ran at 0.86 of real time on two cores and at 1.24 on one of them.
    """
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[number % len(cores)]})


def _serve(pipe: Connection, function: Callable[[Any], Any], number: int) -> None:
    """Life of a worker: tasks until the pipe ends."""
    _keep_to_one_core(number)
    # Ctrl-C reaches the whole process group; the parent decides what becomes of the workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task = pipe.recv()
        except (EOFError, ConnectionResetError):
            return
        try:
            answer = (False, function(task))
        except (ValueError, RuntimeError, OSError, MemoryError) as error:
            answer = (True, str(error) or type(error).__name__)
        try:
            pipe.send(answer)
        except (BrokenPipeError, ConnectionResetError):
            sys.exit(1)  # the parent is gone
