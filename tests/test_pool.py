"""Worker processes: tasks in any order, and one clear line when one dies, hangs or does not fit."""

import math
import os

import pytest
from waiting import patient

from radalt.evaluation.engine.pool import WorkerError, run_tasks


def test_every_task_is_done_once_and_workers_that_come_too_late_for_one_end_without_a_word(capfd):
    # the first to start does most of it
    for tasks in (7, 0):
        done = dict(run_tasks(math.sqrt, [k * k for k in range(tasks)], jobs=4, time_limit_s=patient(60)))
        assert done == {k: float(k) for k in range(tasks)}
    assert capfd.readouterr().err == ""


def test_an_error_for_the_user_arrives_as_one_line_with_the_task():
    with pytest.raises(WorkerError, match=r"^point -1\.0: math domain error$"):
        list(run_tasks(math.sqrt, [-1.0], jobs=1, time_limit_s=patient(60), label=lambda t: f"point {t}"))


def test_a_worker_that_is_killed_is_named_with_the_signal():
    with pytest.raises(WorkerError, match=r"ended \(SIGKILL; out of memory\? try fewer jobs\)$"):
        list(run_tasks(kill_self, [9], jobs=1, time_limit_s=patient(60)))


def kill_self(number):
    os.kill(os.getpid(), number)
