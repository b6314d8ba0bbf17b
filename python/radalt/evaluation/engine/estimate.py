"""How long a study may take, from a short sample of its own work on this machine as busy as it is."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from .study import Point, Study

__all__ = ["AROUND_S", "estimate", "shared", "slowdown"]

AROUND_S = 5.0  # start of the workers, report and figures of a whole run
_TRIAL_S = 0.2
_HOLDS_S = 10.0  # that a trial is good for: a study asks before it starts and again when it does


def estimate(
    study: Study, points: Sequence[Point], jobs: int, *, here: bool = True, around_s: float = 0.0
) -> float:
    """Seconds that one batch of each point may take, and what goes on around them.

    Wall time on this machine as busy as it is; with ``here=False`` time of one core that does nothing else.
    """
    if not points:
        return 0.0
    alone = _scale(study.rehearsal()) * sum(study.seconds(point) for point in points)
    if not here:
        return alone
    jobs = max(1, min(jobs, study.max_jobs or jobs, _cores(), len(points)))
    return (alone / jobs + around_s) * slowdown(jobs)


@lru_cache(maxsize=4)
def _scale(sample: tuple[tuple[Study, Point], ...]) -> float:
    """CPU time of a sample over what is stated of it; each is measured twice, the first time for tables and caches."""
    stated = taken = 0.0
    for study, point in sample:
        study.measure(point)
        begin = time.process_time()
        study.measure(point)
        taken += time.process_time() - begin
        stated += study.seconds(point)
    return taken / stated if stated else 1.0


def slowdown(jobs: int) -> float:
    """Wall time over CPU time of so many workers beside what else computes here now, from a moment's work."""
    return shared(jobs, _cores(), *_trial())


_last: tuple[float, tuple[float, ...]] | None = None  # end of the last trial, and what it gave


def _trial() -> tuple[float, ...]:
    """Seconds of a moment's work by the clock, of this process and of idle cores; a trial holds for `_HOLDS_S`."""
    global _last
    if _last is not None and time.monotonic() < _last[0] + _HOLDS_S:
        return _last[1]
    begin = time.monotonic(), time.process_time(), _idle_s()
    while time.monotonic() < begin[0] + _TRIAL_S:
        sum(range(1000))
    end = time.monotonic(), time.process_time(), _idle_s()
    _last = end[0], tuple(b - a for a, b in zip(begin, end, strict=True))
    return _last[1]


def shared(jobs: int, cores: int, wall_s: float, own_s: float, idle_s: float) -> float:
    """See `slowdown`: from what one process got of the cores for itself, and what nobody took of them.

    Processes that want a core get equal shares of all cores. So one that waits says how many others there are; beside
    one that does not wait they are what keeps the other cores from being idle.
    """
    waited = wall_s / max(own_s, 1e-3)
    busy = cores - 1.0 - idle_s / wall_s
    others = waited * cores - 1.0 if waited > 1.1 else min(max(busy, 0.0), cores - 1.0)
    return max(1.0, (jobs + others) / cores)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _idle_s() -> float:
    """Seconds that this machine's cores have been idle, all together; grows with time where nothing says it."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
        return (int(fields[4]) + int(fields[5])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return _cores() * time.monotonic()
