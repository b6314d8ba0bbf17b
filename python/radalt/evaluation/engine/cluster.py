"""Points of a study on a Dask cluster whose workers have this module installed and need no shared folder.

The study and its files are sent once to each worker (a `WorkerPlugin`, which Dask also sends to workers that join
later). A task is then a point. A worker measures it in a process of its own, as local workers do (`pool.processes`), so
that a task that hangs can be ended and a crash is reported. The scheduler gives the tasks of a lost worker to another.
"""

import asyncio
import contextlib
import hashlib
import json
import logging
import multiprocessing
import os
import pickle
import queue
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...core.mitigation.tcae import default_model_path
from ...core.parsing import read_text
from ...core.plugins import VARIABLE as PLUGINS
from ..results.folder import versions
from .pool import WorkerError, outcome_of, processes, replied
from .study import Outcome, Point, Study, measure_point

try:
    import distributed
    from distributed.diagnostics.plugin import WorkerPlugin
except ImportError:
    raise WorkerError("--scheduler needs Dask's package distributed: pip install distributed") from None

CONNECT_S = 10.0  # longest wait for the scheduler, s
WORKERS_S = 60.0  # longest time without any worker, s
_FILE_BYTES = 1 << 20  # largest scheduler file, bytes: Dask's have about 1,000
_START_S = 120.0  # longest start of a process, s: imports from a cold file system
_POLL_S = 2.0  # time between checks of the cluster, s
_GO_ON = "go on with --resume, there or without --scheduler"


class Cluster:
    """A connection to a scheduler (its address, or a scheduler file), and this program's plugin on the workers.

    Raises WorkerError if no scheduler answers within `CONNECT_S`, or it has no worker within `WORKERS_S`; one line.
    """

    def __init__(self, scheduler: str) -> None:
        # lost connections are reported here, in one line, instead of by Dask's log
        for name in ("distributed", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = _address(scheduler)
        self._name = f"radalt-{uuid.uuid4().hex}"
        try:
            asyncio.run(asyncio.wait_for(_greet(self.address), CONNECT_S))
            self._client = distributed.Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # no certificate, no Dask at the other end: each has errors of its own
            late = isinstance(error, (OSError, asyncio.TimeoutError))
            reason = f"within {CONNECT_S:g} s" if late else f"({_first_line(error)})"
            raise WorkerError(
                f"--scheduler {scheduler}: no Dask scheduler answers at {self.address} {reason}"
            ) from None
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except distributed.TimeoutError:
            self.close()
            raise self._no_worker() from None

    def close(self) -> None:
        """End this program's processes on the workers, if the scheduler answers."""
        with contextlib.suppress(Exception):  # keep the run's result or error
            if self._client.status == "running":
                self._client.unregister_worker_plugin(self._name)
        with contextlib.suppress(Exception):
            self._client.close(timeout=2)

    def run_tasks(
        self, study: Study, points: Sequence[Point], *, time_limit_s: float
    ) -> Iterator[tuple[int, Outcome]]:
        """Yield ``(index, outcome)`` as points are measured, as `pool.run_tasks` does for local processes.

        Raises WorkerError if a task fails, exceeds its time or ends its process; if a worker has another version
        installed; if the scheduler is lost, or all workers for `WORKERS_S`. One line.
        """
        if not points:
            return
        self._send(study)
        finished: queue.SimpleQueue[distributed.Future] = queue.SimpleQueue()
        tasks = [pickle.dumps(point) for point in points]
        futures = self._client.map(_by_value(self._name, time_limit_s), tasks, pure=False)
        index = {future.key: k for k, future in enumerate(futures)}
        for future in futures:
            future.add_done_callback(finished.put)
        try:
            for _ in points:
                future = self._waiting(lambda: finished.get(timeout=_POLL_S))
                k = index[future.key]
                failed, value = self._answer(future)
                if failed:
                    raise WorkerError(f"{points[k].name}: {value}")
                future.release()
                yield k, value
        finally:
            if self._client.status == "running":
                self._client.cancel(futures)

    def _send(self, study: Study) -> None:
        """Send study and files to every present and future worker."""
        try:
            self._client.register_plugin(Measurer(study), name=self._name)
        except WorkerError:
            raise
        except Exception as error:  # from Dask, or from a worker that cannot load this module
            raise WorkerError(
                f"a worker of {self.address} cannot take part ({_first_line(error)}); is gr-radalt installed there?"
            ) from None

    def _answer(self, future: distributed.Future) -> tuple[bool, Any]:
        """(failed, outcome or message) of a finished task; raises errors that are not meant for users."""
        try:
            return pickle.loads(self._waiting(lambda: future.result(timeout=_POLL_S)))
        except distributed.KilledWorker as error:
            lost = error.allowed_failures + 1
            return True, f"{lost} workers were lost while they measured it; out of memory?"
        except (distributed.client.FutureCancelledError, OSError) as error:
            # OSError: the connection broke before its futures were cancelled
            raise self._lost(error) from None

    def _waiting(self, get: Callable[[], Any]) -> Any:
        """Result of ``get``, with a check of the cluster every `_POLL_S`."""
        without = 0.0
        while without < WORKERS_S:
            try:
                return get()
            except (queue.Empty, distributed.TimeoutError):
                try:
                    without = 0.0 if self._client.nthreads() else without + _POLL_S
                except (OSError, RuntimeError, asyncio.CancelledError) as error:
                    raise self._lost(error) from None
        raise self._no_worker()

    def _lost(self, error: BaseException) -> WorkerError:
        return WorkerError(f"the scheduler at {self.address} was lost ({_first_line(error)}); {_GO_ON}")

    def _no_worker(self) -> WorkerError:
        return WorkerError(
            f"the scheduler at {self.address} has had no worker for {WORKERS_S:g} s; start one (dask worker "
            f"{self.address}), then {_GO_ON}"
        )


def _by_value(name: str, time_limit_s: float) -> Callable[[bytes], bytes]:
    """Function of a task. It is local, so it is pickled by value and the scheduler's machine needs Dask only."""

    def measure(task: bytes) -> bytes:
        from distributed import get_worker

        return get_worker().plugins[name].measure(task, time_limit_s)

    return measure


class Measurer(WorkerPlugin):
    """Plugin on a worker: the study, ready to be measured, its files in the worker's folder, its processes."""

    def __init__(self, study: Study) -> None:
        self.wanted = installed(study.needs_network)
        self.study = pickle.dumps(study)
        self.plugins = os.environ.get(PLUGINS, "")
        # names of files are parts of results and messages, so each has a folder of its own
        self.contents = {name: (path.name, path.read_bytes()) for name, path in study.files().items()}

    async def setup(self, worker: Any) -> None:
        """Compare versions, store the files; errors reach the program that registers the plugin."""
        self.address, self.refused = worker.address, ""
        self.folder = Path(tempfile.mkdtemp(prefix="radalt-", dir=worker.local_directory))
        os.environ |= {PLUGINS: self.plugins, "GR_CONF_LOG_LOG_LEVEL": "warn"}
        # a nanny's daemon could have no processes of its own
        multiprocessing.current_process().daemon = False
        self.processes = processes(worker.state.nthreads)
        try:
            await asyncio.to_thread(self._prepare)
        except (WorkerError, OSError) as error:
            self.refused = f"worker {self.address} {error}"
            raise WorkerError(self.refused) from None

    def _prepare(self) -> None:
        here = installed("onnxruntime" in self.wanted)
        for name, version in self.wanted.items():
            if here.get(name) != version:
                have = here.get(name, "none")
                raise WorkerError(
                    f"has {name} {have}, and this program has {version}; install the same there"
                )
        self.files = tuple(self._files().items())
        call = (self.study, self.files)
        if missing := outcome_of(self.processes.schedule(_missing, call, timeout=_START_S), _START_S):
            raise WorkerError(f"cannot load the study ({missing}); install there what it needs")

    def _files(self) -> dict[str, Path]:
        """Files by their names in the study."""
        out = {}
        for number, (name, (file, content)) in enumerate(self.contents.items()):
            out[name] = self.folder / str(number) / file
            out[name].parent.mkdir()
            out[name].write_bytes(content)
        return out

    def measure(self, task: bytes, time_limit_s: float) -> bytes:
        """Measure a task in a thread of the worker; returns the pickled reply of `replied`."""
        if self.refused:
            return pickle.dumps((True, self.refused))
        call = (_measured, self.study, self.files, pickle.loads(task))
        try:
            waited = self.processes.schedule(replied, call, timeout=time_limit_s)
            failed, value = outcome_of(waited, time_limit_s)
        except WorkerError as error:
            failed, value = True, str(error)
        if not failed:
            value = Outcome(value.rows, f"{self.address} {value.process}", value.peak_bytes)
        return pickle.dumps((failed, value))

    async def teardown(self, worker: Any) -> None:
        """End the processes, remove the files."""
        self.processes.stop()
        await asyncio.to_thread(self.processes.join)
        shutil.rmtree(self.folder, ignore_errors=True)


@lru_cache(maxsize=1)
def _loaded(study: bytes, files: tuple[tuple[str, Path], ...]) -> Study:
    return pickle.loads(study).with_files(dict(files))


def _missing(study: bytes, files: tuple[tuple[str, Path], ...]) -> str:
    """What a study needs and this machine lacks, such as a plugin; empty for nothing."""
    try:
        _loaded(study, files)
    except (ImportError, AttributeError) as error:
        return " ".join(str(error).split())
    return ""


def _measured(study: bytes, files: tuple[tuple[str, Path], ...], point: Point) -> Outcome:
    return measure_point(_loaded(study, files), point)


async def _greet(address: str) -> None:
    """Exchange Dask's greetings, and hang up: its client waits for ever where nothing comes back."""
    greetings = distributed.Security().get_connection_args("client")
    (await distributed.core.connect(address, timeout=CONNECT_S, **greetings)).abort()


def _address(scheduler: str) -> str:
    """Scheduler address, or that of a scheduler file."""
    if "://" in scheduler:
        return scheduler
    remedy = "give an address such as tcp://host:8786, or a scheduler file"
    text = read_text(scheduler, most_bytes=_FILE_BYTES, what="--scheduler", remedy=remedy)
    try:
        return str(json.loads(text)["address"])
    except (ValueError, KeyError, TypeError):
        raise WorkerError(f"--scheduler {scheduler}: no scheduler file of Dask's; {remedy}") from None


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:200]


def installed(with_network: bool) -> dict[str, str]:
    """Versions that rows depend on, with digests of this package's sources and of the shipped network."""
    try:
        out = versions(with_network)
    except ImportError:
        out = versions(False)
    if with_network:
        shipped = default_model_path()
        known = hashlib.sha256(shipped.read_bytes()).hexdigest()[:12] if shipped.exists() else "none"
        out["shipped network"] = known
    digest, package = hashlib.sha256(), Path(__file__).resolve().parents[2]
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    return out | {"radalt source": digest.hexdigest()[:12]}
