"""Estimated duration of a study, from a short sample of its work on this machine under its current load."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from .study import Point, Study

__all__ = ["AROUND_S", "estimate", "shared", "slowdown"]

AROUND_S = 5.0  # start of the workers, report and figures of a run, s
_TRIAL_S = 0.2  # length of a load measurement, s
_HOLDS_S = 10.0  # validity of a load measurement, s: a study needs it before its start and at it


def estimate(
    study: Study, points: Sequence[Point], jobs: int, *, here: bool = True, around_s: float = 0.0
) -> float:
    """Estimated seconds of one batch of each point, start and report included.

    Wall time on this machine under its current load; with ``here=False`` time of one idle core.
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
    """CPU time of a sample over its stated time; each is run twice, the first time to fill tables and caches."""
    stated = taken = 0.0
    for study, point in sample:
        study.measure(point)
        begin = time.process_time()
        study.measure(point)
        taken += time.process_time() - begin
        stated += study.seconds(point)
    return taken / stated if stated else 1.0


def slowdown(jobs: int) -> float:
    """Wall time over CPU time of ``jobs`` workers under the machine's current load, from a short measurement."""
    return shared(jobs, _cores(), *_trial())


_last: tuple[float, tuple[float, ...]] | None = None  # end and result of the last load measurement


def _trial() -> tuple[float, ...]:
    """Wall time, CPU time of this process and idle time of all cores in a short work load; cached for `_HOLDS_S`."""
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
    """See `slowdown`: from the CPU time of one process and the idle time of all cores.

    Running processes get equal shares of all cores. If this process waits, its share gives their number; if it does
    not, the busy time of the other cores gives it.
    """
    waited = wall_s / max(own_s, 1e-3)
    busy = cores - 1.0 - idle_s / wall_s
    others = waited * cores - 1.0 if waited > 1.1 else min(max(busy, 0.0), cores - 1.0)
    return max(1.0, (jobs + others) / cores)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _idle_s() -> float:
    """Total idle time of this machine's cores in seconds; wall time where the system does not report it."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
        return (int(fields[4]) + int(fields[5])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return _cores() * time.monotonic()
