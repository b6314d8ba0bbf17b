"""CPU affinity of this interpreter's threads while a method runs in a separate process (`OwnProcess`).

Threads of one interpreter share its lock. On two cores every change of thread moves the lock and the data between
caches: a live path of five blocks took 0.57 s of CPU per second of signal on one core, 0.9 to 1.5 s on two. While a
method runs in a separate process, the interpreter therefore keeps to one core and leaves the others to the method.
"""

import os

_home = -1  # the interpreter's core; -1 before one is chosen
_beside = 0  # number of this program's method processes


def allowed_cores() -> list[int]:
    """Cores that this process may use; empty where the system does not report them."""
    if hasattr(os, "sched_getaffinity"):  # Linux
        return sorted(os.sched_getaffinity(os.getpid()))
    return list(range(os.cpu_count() or 1))


def leave_home() -> list[int]:
    """Cores for a method's process: all but the interpreter's, which the first call chooses.

    Empty where there is one core only or where the system has no CPU affinity. `return_home` ends the reservation.
    """
    global _home, _beside
    cores = allowed_cores()
    _beside += 1
    if len(cores) < 2 or not hasattr(os, "sched_setaffinity"):
        _home = -1
        return []
    if _home not in cores:
        _home = cores[os.getpid() % len(cores)]  # programs that start together use different cores
    return [core for core in cores if core != _home]


def return_home() -> None:
    """A method's process has ended; after the last one, new threads may use every core."""
    global _beside
    _beside = max(0, _beside - 1)


def join_home() -> bool:
    """Pin the calling thread to the interpreter's core, if one was chosen; returns whether it was."""
    if not _beside or _home < 0:
        return False
    os.sched_setaffinity(0, {_home})
    return True
