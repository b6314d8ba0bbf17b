"""Which processor core this interpreter's threads share, once something of theirs runs beside them.

Threads of one interpreter take turns. On one core they do so for less than on two, where every turn moves the lock
and the data between caches: a live path of five blocks took 0.57 s of CPU a second of signal on one core, 0.9 to 1.5 s
on two. So where a method has a process of its own (`OwnProcess`), the interpreter keeps to one core and leaves it the
others.
"""

from __future__ import annotations

import os

__all__ = ["allowed_cores", "join_home", "leave_home", "return_home"]

_home = -1
_beside = 0  # processes of ours that compute beside this one


def allowed_cores() -> list[int]:
    """Cores that this process may use, as far as the system tells."""
    if hasattr(os, "sched_getaffinity"):  # Linux
        return sorted(os.sched_getaffinity(os.getpid()))
    return list(range(os.cpu_count() or 1))


def leave_home() -> list[int]:
    """The cores for a process beside this one: all but the interpreter's own, which the first call chooses.

    Empty, and nothing is chosen, where there is one core only or where the system pins no threads. What was left goes
    back by `return_home`.
    """
    global _home, _beside
    cores = allowed_cores()
    _beside += 1
    if len(cores) < 2 or not hasattr(os, "sched_setaffinity"):
        _home = -1
        return []
    if _home not in cores:
        _home = cores[os.getpid() % len(cores)]  # not the same for every program
    return [core for core in cores if core != _home]


def return_home() -> None:
    """A process beside this one has ended; after the last, threads that start are free again."""
    global _beside
    _beside = max(0, _beside - 1)


def join_home() -> bool:
    """Keep the calling thread to the interpreter's core, if one was chosen; whether it was."""
    if not _beside or _home < 0:
        return False
    os.sched_setaffinity(0, {_home})
    return True
