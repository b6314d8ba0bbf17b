"""Independent tasks in local worker processes; a crash or hang of one does not end the others without a message.

The processes are managed by pebble, which can end a task that hangs in C++ and reports which task killed its worker.
Faulty flowgraphs do both.
"""

import atexit
import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from multiprocessing import resource_tracker
from multiprocessing.synchronize import Semaphore
from typing import Any

from ...core.interrupts import ctrl_c_waits
from ...core.text import said

_START_S = 10.0  # longest wait at the end of a run for workers that are starting, s
_MARK = "RESULT "  # begins the line of the result of `call_apart`; other lines are the called code's own
_APART_S = 300.0  # longest call in a process of its own, s
_CODE = """
import os, sys
if hasattr(os, "sched_setaffinity"):  # a worker keeps to one core, on which BLAS makes no further thread
    os.sched_setaffinity(0, range(os.cpu_count()))
import importlib, json
mark, module, function, arguments = sys.argv[1:]
print(mark + json.dumps(getattr(importlib.import_module(module), function)(*json.loads(arguments))))
"""


class WorkerError(RuntimeError):
    """A task that failed; the message is one line for the user."""


def replied(function: Callable[..., Any], *arguments: Any) -> tuple[bool, Any]:
    """(failed, value or message): errors meant for the user are returned as one line.

    These are `ValueError` and `RuntimeError`, the bases of all errors of the package, a full disk and a full memory.
    """
    try:
        return False, function(*arguments)
    except (ValueError, RuntimeError, OSError, MemoryError) as error:
        return True, said(error)


def processes(workers: int, *initialized: Semaphore) -> Any:
    """A pool of pebble with so many processes, each pinned to a core and with one BLAS thread.

    Processes are spawned, not forked: a fork would copy GNU Radio's threads and buffers in an unknown state. They
    inherit the environment.
    """
    from pebble import ProcessPool

    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    spawned = multiprocessing.get_context("spawn")
    return ProcessPool(workers, context=spawned, initializer=_enter, initargs=initialized)


def run_tasks(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    *,
    jobs: int,
    time_limit_s: float,
    label: Callable[[Any], str] = str,
) -> Iterator[tuple[int, Any]]:
    """Yield ``(index, function(task))`` as tasks finish, in no particular order.

    ``function``, importable by name, and the tasks are pickled; each of ``jobs`` spawned processes runs many tasks,
    each task at most ``time_limit_s``. ``label`` names a task in error messages. Raises WorkerError if a worker dies,
    a task exceeds its time or fails with an error meant for the user. The other workers are stopped.
    """
    if not tasks:
        return
    workers = min(jobs, len(tasks))
    ready = multiprocessing.get_context("spawn").Semaphore(0)
    with processes(workers, ready) as pool:
        todo = iter(enumerate(tasks))
        running: dict[Future, int] = {}

        def hand_out() -> None:
            # one task per worker without a queue, so that a time limit starts with the task
            for index, task in todo:
                running[pool.schedule(replied, (function, task), timeout=time_limit_s)] = index
                return

        # Ctrl-C is sent to the process group, and would interrupt the workers' imports: their owner ends them
        resource_tracker.ensure_running()  # its start inside the block would unblock Ctrl-C
        with ctrl_c_waits():
            for _ in range(workers):
                hand_out()
        try:
            while running:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index = running.pop(future)
                    try:
                        failed, value = outcome_of(future, time_limit_s)
                    except WorkerError as error:
                        failed, value = True, error
                    if failed:
                        raise WorkerError(f"{label(tasks[index])}: {value}") from None
                    hand_out()
                    yield index, value
        except BaseException:
            pool.stop()
            raise
        finally:
            # wait for starting workers: they would print a traceback when the pool closes their pipes
            for _ in range(workers):
                if not ready.acquire(timeout=_START_S):
                    break


def outcome_of(future: Future, time_limit_s: float) -> tuple[bool, Any]:
    """Result of `replied` in a pool; raises WorkerError if the process ended or exceeded its time."""
    from concurrent.futures.process import BrokenProcessPool

    from pebble import ProcessExpired

    try:
        return future.result()
    except TimeoutError:
        text = f"not done after {time_limit_s:g} s; raise the time limit (--time-limit-s)"
        raise WorkerError(text) from None
    except ProcessExpired as error:
        raise WorkerError(f"the worker process ended ({_cause(error.exitcode)})") from None
    except BrokenProcessPool:  # the worker ended before it acknowledged the task
        raise WorkerError("the worker process ended (it no longer answers)") from None


def call_apart(module: str, function: str, *arguments: Any, threads: int = 1) -> Any:
    """Result of a module's function in a process of its own; arguments and result are JSON.

    The process finds the module by this one's ``sys.path``; ``threads`` are those of BLAS and OpenMP. Raises
    WorkerError if there is no result: the last line that the process wrote.
    """
    env = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))
    env["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = [sys.executable, "-c", _CODE, _MARK, module, function, json.dumps(arguments)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=_APART_S, check=False)
    found = [line for line in done.stdout.splitlines() if line.startswith(_MARK)]
    if done.returncode or not found:
        raise WorkerError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return json.loads(found[-1].removeprefix(_MARK))


def _cause(exitcode: int) -> str:
    """Why a process ended, in words."""
    if exitcode >= 0:
        return f"exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"{name}; out of memory? try fewer jobs" if name == "SIGKILL" else name


def _enter(*initialized: Semaphore) -> None:
    """Start of a process that measures: pin it to a core, and take ``os._exit(0)`` of a user's method for a failure."""
    # A flowgraph's threads share one interpreter, so a second core gains nothing and changes of core cost time: `none`
    # and `whitening` ran at 0.86 of real time on two cores and at 1.24 on one.
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_setaffinity") else ()
    if (core := next(filter(_claim, sorted(cores)), None)) is not None:
        os.sched_setaffinity(0, {core})
    # pebble sends SIGTERM right after closing the pipes; Python at its end, without handlers, would print a traceback
    if hasattr(signal, "pthread_sigmask"):
        atexit.register(signal.pthread_sigmask, signal.SIG_BLOCK, {signal.SIGTERM})
    # pebble takes status 0 for the regular end of a worker, and the task would wait for its limit
    leave = os._exit
    os._exit = lambda status: leave(status or 1)
    for ready in initialized:
        ready.release()


_claims: list[socket.socket] = []


def _claim(core: int) -> bool:
    """Claim a core by a name that Linux gives one process of the machine at a time; False if another run has it."""
    _claims.append(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    try:
        _claims[-1].bind(f"\0radalt core {core}")
    except OSError:
        _claims.pop().close()
        return False
    return True
