"""Estimated duration of a study, from a short sample of its work on this machine."""

import os
import time
from collections.abc import Sequence
from functools import lru_cache

from .study import Point, Study

AROUND_S = 5.0  # start of the workers, report and figures of a run, s


def estimate(study: Study, points: Sequence[Point], jobs: int) -> float:
    """Estimated seconds to measure the points with ``jobs`` workers on an idle machine; one core's time for one job."""
    jobs = max(1, min(jobs, study.max_jobs or jobs, os.cpu_count() or 1, len(points)))
    return _scale(study.rehearsal()) * sum(study.seconds(point) for point in points) / jobs


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
