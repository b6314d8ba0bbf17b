"""A sweep over a Dask cluster on this machine: the same rows as in one process, whatever happens to a worker."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import ota_eval
import pytest
from hostile import draw_nothing, ended, measure_here, refused
from test_engine import Coins, rows_of
from test_ota_eval import stable
from waiting import crowd, end_of, started, wait_for, written

from radalt.core.parsing import InputError
from radalt.core.scene import load_scene
from radalt.evaluation.engine.options import Options
from radalt.evaluation.engine.pool import WorkerError
from radalt.evaluation.engine.run import run
from radalt.evaluation.overlap.study import OverlapStudy

cluster = pytest.importorskip("radalt.evaluation.engine.cluster")
SWEEP = "--methods none,tcae,custom --overlap 0,1 --sir-db=-28 --altitudes 600,40 --frames 3".split()


class Processes:
    """A scheduler and its workers, each with a process group of its own."""

    def __init__(self, folder: Path, root: Path) -> None:
        self.folder, self.file = folder, folder / "scheduler.json"
        self.workers: list[subprocess.Popen] = []
        paths = [str(root / "python"), str(root / "tests"), str(root / "flowgraphs")]
        self._env = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "RADALT_TEST_WORKER": "1"}
        self._env["DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED"] = "False"  # a sample every 10 ms
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0", env=dict(os.environ))
        wait_for(written(self.file), "the scheduler's file", process=self.scheduler)
        self.address = json.loads(self.file.read_text(encoding="utf-8"))["address"]

    def _start(self, kind, *arguments, env):
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", "--scheduler-file", self.file]
        log = (self.folder / "log.txt").open("a")
        command += "--no-dashboard", *arguments
        return started(*command, cwd=self.folder, env=env, stdout=log, stderr=log)

    def add_worker(self, *arguments) -> None:
        options = ("--nthreads", "1", "--local-directory", str(self.folder / f"worker{len(self.workers)}"))
        self.workers.append(self._start("worker", *options, *arguments, env=self._env))

    def end(self, process: subprocess.Popen) -> None:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(30)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in (*self.workers, self.scheduler):
            self.end(process)


@pytest.fixture(scope="module")
def dask(tmp_path_factory, root):
    """A scheduler with two workers, one below a nanny, as the command starts it, and one without."""
    with Processes(tmp_path_factory.mktemp("dask"), root) as processes:
        processes.add_worker()
        processes.add_worker("--no-nanny")
        yield processes


@pytest.fixture(scope="module")
def mortal_dask(tmp_path_factory, root):
    """A scheduler with one worker, for tests that kill a part of it; the last one kills the scheduler."""
    with Processes(tmp_path_factory.mktemp("mortal"), root) as processes:
        processes.add_worker("--no-nanny")
        yield processes


def on(dask, folder, **options) -> Options:
    return Options(folder, scheduler=dask.address, **options)


def test_rows_are_the_same_bytes_on_a_cluster(dask, tmp_path):
    run(Coins(), Options(tmp_path / "here", jobs=1))
    run(Coins(), Options(tmp_path / "there", scheduler=str(dask.file)))
    assert rows_of(tmp_path / "here") == rows_of(tmp_path / "there")


def test_a_task_that_hangs_is_ended_with_one_line_and_its_worker_goes_on(dask, tmp_path):
    limit_s = float(round(crowd()))
    with pytest.raises(WorkerError, match=rf"coin 0\.97: not done after {limit_s:g} s; raise the time limit"):
        run(Coins(hang="coin 0.97"), on(dask, tmp_path / "hangs", time_limit_s=limit_s))
    run(Coins(), on(dask, tmp_path / "goes on"))
    # nothing of either run is left on the workers
    wait_for(lambda: not measuring(dask), "an end of all measuring")


def test_what_a_dead_worker_was_measuring_is_measured_by_another(mortal_dask, tmp_path):
    study, ended = Coins(pause_s=0.7), []

    def end_one(progress):
        if progress.rows and not ended:  # it is measuring: three of four are not there yet
            ended.append(mortal_dask.workers[0].pid)
            os.killpg(ended[0], signal.SIGKILL)
            mortal_dask.add_worker("--no-nanny")  # joins while it runs

    run(study, on(mortal_dask, tmp_path / "there"), end_one)
    run(replace(study, pause_s=0.0), Options(tmp_path / "here", jobs=1))
    assert rows_of(tmp_path / "there") == rows_of(tmp_path / "here")


def measuring(dask) -> list[int]:
    """Processes that measure next to the workers."""
    # a worker is a process of its nanny
    nannies = {w.pid for w in dask.workers if "--no-nanny" not in w.args}
    found = []
    for page in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            spawned = b"spawn_main" in page.read_bytes()
            parent, group = map(int, page.with_name("stat").read_text().rpartition(")")[2].split()[1:3])
        except OSError:
            continue
        if spawned and group in {w.pid for w in dask.workers} and parent not in nannies:
            found.append(int(page.parent.name))
    return found


@dataclass(frozen=True)
class Broken(Coins):
    """Every coin raises an error."""

    error: Exception = ValueError("the coin stands on its edge")

    def measure(self, point):
        raise self.error


def test_an_error_of_a_task_is_the_users_line_and_a_mistake_in_it_is_raised(dask, tmp_path):
    with pytest.raises(WorkerError, match=r"^coin 0\.1: the coin stands on its edge$"):
        run(Broken((0.1,)), on(dask, tmp_path / "a"))
    with pytest.raises(KeyError, match="mistake"):
        run(Broken((0.1,), error=KeyError("mistake")), on(dask, tmp_path / "b"))


def test_another_version_on_a_worker_is_refused_in_one_line(dask, tmp_path, monkeypatch):
    real, name = cluster.installed(False), "radalt source"
    monkeypatch.setattr(cluster, "installed", lambda _: real | {name: "0.0.7"})
    with refused(WorkerError, f"^worker tcp://.*has {name} {real[name]}, and this program has 0.0.7"):
        run(Coins(), on(dask, tmp_path))


def test_what_cannot_be_reached_is_one_line_and_leaves_no_folder(dask, tmp_path, monkeypatch):
    """A silent server, or one that says something else, is none; a file is read as far as a scheduler's may reach."""
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    silent, other = (socket.create_server(("127.0.0.1", 0)) for _ in range(2))
    threading.Thread(target=lambda: other.accept()[0].sendall(b"HTTP/1.1 400 Bad" * 9), daemon=True).start()
    at = [f"tcp://127.0.0.1:{server.getsockname()[1]}" for server in (silent, other)]
    for scheduler, line in (
        ("tcp://127.0.0.1:1", "no Dask scheduler answers at tcp://127.0.0.1:1 within 1 s"),
        (at[0], f"no Dask scheduler answers at {at[0]} within 1 s"),
        (at[1], f"no Dask scheduler answers at {at[1]} (Unable to allocate"),
        ("tls://127.0.0.1:1", "no Dask scheduler answers at tls://127.0.0.1:1 (TLS expects"),
        ("ucx://127.0.0.1:1", "no Dask scheduler answers at ucx://127.0.0.1:1 ("),
        ("no://such", "no Dask scheduler answers at no://such (unknown address scheme 'no'"),
        (str(tmp_path / "none.json"), "(No such file or directory); give an address such as tcp://host:8786"),
        ("/dev/zero", "cannot be read (it is a pipe or device); give an address"),
        (__file__, "no scheduler file of Dask's; give an address"),
    ):
        with pytest.raises((WorkerError, InputError)) as caught:
            run(Coins(), Options(tmp_path / "run", scheduler=scheduler))
        assert str(caught.value).startswith(f"--scheduler {scheduler}: ") and line in str(caught.value)
    with pytest.raises(WorkerError, match="--capture writes its recordings where the flowgraph runs"):
        run(OverlapStudy(load_scene("clear"), capture=True), on(dask, tmp_path / "run"))
    assert not (tmp_path / "run").exists()


OWN = """import os
if "RADALT_TEST_WORKER" in os.environ:
    assert "only_here" not in __file__, "a worker read the file of another machine"

def mitigate(frames, waveform):
    return 0.5 * frames
"""


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Options of a sweep with a network and a method of one's own, and its folder from one local process."""
    folder = tmp_path_factory.mktemp("only_here")
    (folder / "own.py").write_text(OWN, encoding="utf-8")
    options = [*SWEEP, "--method-file", folder / "own.py"]
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        measure_here(patch)
        assert ended(ota_eval.main, "--sim", *options, "--out", folder / "run", "--jobs", 1) == (0, "")
    return options, folder / "run"


def test_a_lost_scheduler_is_one_line_and_the_run_is_completed_here(
    mortal_dask, sweep, tmp_path, measured_here, undrawn
):
    options, whole = sweep
    words = ("--sim", *options, "--out", tmp_path / "run")
    process = started(sys.executable, ota_eval.__file__, *words, "--scheduler", mortal_dask.file)
    wait_for(written(tmp_path / "run" / "points.jsonl"), "the first point", process=process)
    mortal_dask.end(mortal_dask.scheduler)
    _, err = end_of(process)
    assert process.returncode == 2
    assert f"the scheduler at {mortal_dask.address} was lost" in err and err.count("\n") == 1
    assert ended(ota_eval.main, *words, "--resume", "--jobs", 1) == (0, "")
    assert stable(tmp_path / "run") == stable(whole)
