"""The sweep engine with a study small enough to see through: coins with a known probability."""

import os
import re
import shlex
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from waiting import crowd, end_of, ran, started, wait_for, written

from radalt.evaluation.engine import command, pool
from radalt.evaluation.engine.options import Options, Parser, add_options, options_of
from radalt.evaluation.engine.pool import WorkerError, run_tasks
from radalt.evaluation.engine.run import head_of, run
from radalt.evaluation.engine.study import Point, Study
from radalt.evaluation.results.folder import RunFolder
from radalt.evaluation.results.rows import Columns
from radalt.evaluation.results.score import SCORE_COLUMNS, Score


@pytest.fixture(autouse=True)
def idle(monkeypatch):
    """A machine of two cores."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


WHOLE = frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"})


@dataclass(frozen=True)
class Coins(Study):
    """One row per coin: how often it showed its right side."""

    chances: tuple[float, ...] = (0.1, 0.5, 0.97, 1.0)
    seed: int = 1
    pause_s: float = 0.0
    hang: str = ""

    tables: ClassVar[Mapping[str, Columns]] = {
        "rows": Columns(("coin", *SCORE_COLUMNS), text=frozenset({"coin"}), whole=WHOLE)
    }

    def head(self):
        return {"chances": self.chances, "seed": self.seed}

    def points(self):
        return [Point(f"coin {p:g}", frames=100) for p in self.chances]

    def measure(self, point):
        if point.name == self.hang:
            time.sleep(600)
        time.sleep(self.pause_s)
        chance = float(point.name.split()[1])
        rng = np.random.default_rng([self.seed, round(1e6 * chance)])
        right = int((rng.random(point.frames) < chance).sum())
        score = Score(point.frames, point.frames, right, point.frames, squared_detected_m2=point.frames / 3)
        return [{"coin": point.name} | score.row()]

    def report(self, folder, rows, how):
        folder.write_report({"schema": 2, "run": how.as_dict(), "rows": rows["rows"]})
        return folder.write_text("report.md", f"{len(rows['rows'])} coins\n")


def rows_of(folder: Path) -> bytes:
    return (folder / "rows.csv").read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """One uninterrupted run in one process."""
    folder = tmp_path_factory.mktemp("engine") / "run"
    run(Coins(), Options(folder, jobs=1))
    return folder


def test_rows_are_the_same_bytes_for_any_number_of_workers(whole, tmp_path):
    run(Coins(), Options(tmp_path / "b", jobs=2))
    assert rows_of(tmp_path / "b") == rows_of(whole) and rows_of(whole).count(b"\n") == 5


def test_a_point_that_hangs_ends_with_one_line_and_the_others_are_kept(tmp_path):
    limit_s = 2.0 * round(crowd())
    with pytest.raises(WorkerError, match=rf"^coin 0\.97: not done after {limit_s:g} s"):
        run(Coins(hang="coin 0.97"), Options(tmp_path, jobs=1, time_limit_s=limit_s))
    kept = RunFolder(tmp_path, head_of(Coins(hang="coin 0.97")), resume=True).done
    assert set(kept) == {"coin 0.1", "coin 0.5"}


def test_a_dry_run_says_what_it_would_measure_and_writes_nothing(tmp_path, capsys):
    study = Coins(pause_s=30.0)
    assert command.main(study, Options(tmp_path / "run", jobs=2), program="coins", dry_run=True) == 0
    assert capsys.readouterr().out == f"coins: 4 points, 400 frames -> {tmp_path / 'run'}\n"
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [("file", "is a file"), ("others", "that are no run"), ("/proc/x", "be written"), ("/", "no run")],
)
def test_a_dry_run_checks_the_folder(tmp_path, capsys, name, said):
    (tmp_path / "file").touch()
    (tmp_path / "others").mkdir()
    (tmp_path / "others/mine.txt").touch()
    assert command.main(Coins(), Options(tmp_path / name), program="coins", dry_run=True) == 2
    assert said in capsys.readouterr().err


def test_a_worker_leaves_the_cores_that_other_runs_have():
    cores = os.sched_getaffinity(0)
    for core in cores:
        pool._claim(core)  # or another run on this machine has it
    assert list(run_tasks(os.sched_getaffinity, [0], jobs=1, time_limit_s=100.0)) == [(0, cores)]
    while pool._claims:
        pool._claims.pop().close()


def test_progress_counts_frames(tmp_path, measured_here):
    seen = []
    run(Coins(), Options(tmp_path), seen.append)
    assert [(p.done, p.measured, p.frames) for p in seen] == [(k, 100 * k, 400) for k in range(5)]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--jobs", "100000"], "--jobs: it is '100000'; it has to be a whole number within 1..256"),
        (["--time-limit-s", "-1"], "--time-limit-s: it is '-1'"),
        (["--out", ""], "it is empty"),
        (["--resume"], "--resume needs --out"),
    ],
)
def test_options_that_do_not_fit_are_one_line_and_status_2(capsys, arguments, expected):
    parser = Parser("coins", "Coins.")
    add_options(parser)
    with pytest.raises(SystemExit) as caught:
        options_of(parser.parse_args(arguments), parser)
    err = capsys.readouterr().err
    assert caught.value.code == 2 and expected in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("sent", "status", "said"),
    [("SIGKILL", -signal.SIGKILL, ""), ("SIGINT", 130, "stopped"), ("SIGTERM", 143, "terminated")],
)
def test_a_killed_or_stopped_run_resumes_to_the_same_bytes(whole, tmp_path, sent, status, said):
    """Stopped, it prints the command that goes on."""
    program, folder = tmp_path / "program.py", tmp_path / "run"
    program.write_text(
        f"import sys; sys.path[:0] = {[str(Path(__file__).parent), *sys.path]!r}\n"
        "from test_engine import Coins, Options, command, Path\n"
        "from radalt.evaluation.engine.options import terminable\n"
        "if __name__ == '__main__':\n"
        f"    options = Options(Path({str(folder)!r}), jobs=1, resume='--resume' in sys.argv)\n"
        "    coins = Coins(hang='' if options.resume else 'coin 0.97')\n"
        "    with terminable():\n"
        "        sys.exit(command.main(coins, options, program='coins', dry_run=False))\n",
        encoding="utf-8",
    )
    process, journal = started(sys.executable, program), folder / "points.jsonl"
    wait_for(lambda: written(journal)() and journal.read_text().count("\n") == 2, "two", process=process)
    # a batch system's SIGTERM reaches the program, the others the whole group
    process.terminate() if sent == "SIGTERM" else os.killpg(process.pid, getattr(signal, sent))
    _, err = end_of(process)
    assert process.returncode == status and "Traceback" not in err
    words = [sys.executable, str(program), "--out", str(folder), "--resume"]
    line = rf"\s*coins: {said}; [12] of 4 points are kept, go on with: {re.escape(shlex.join(words))}\n"
    assert not said or re.fullmatch(line, err), err  # the second may be in the journal and not counted yet
    done = ran(*words)
    assert (done.returncode, done.stderr) == (0, "")
    assert rows_of(folder) == rows_of(whole)
