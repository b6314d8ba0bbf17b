"""Points of a study on a Dask cluster whose workers have this module installed and need no shared folder.

The study and its files, by SHA-256, are sent once to each worker (a `WorkerPlugin`, which Dask also sends to workers
that join later). A task is then a point and a batch number. It is measured in a separate process beside the worker
(`Slot`), so that a hanging task can be ended and a crash is reported. The scheduler gives the tasks of a lost worker to
another one, and rows are a function of study, point and batch.

Each thread of a Dask worker has one such process. A flowgraph may hang or crash in C++, which would end the tasks of
the worker's other threads. A Dask worker is a daemon of its nanny and cannot have `multiprocessing` children, so the
process is a plain subprocess. It ends with its owner in every case.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import itertools
import json
import logging
import multiprocessing
import os
import pickle
import queue
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ...core.mitigation.tcae import default_model_path
from ...core.parsing import read_text
from ...core.plugins import VARIABLE as PLUGINS
from ..results.folder import versions
from .pool import WorkerError, answered, cause, enter, too_late, uninterrupted
from .study import Study
from .task import Outcome, Task, measure_task

try:
    import distributed
    from distributed.diagnostics.plugin import WorkerPlugin
except ImportError:
    raise WorkerError("--scheduler needs Dask's package distributed: pip install distributed") from None

__all__ = ["Cluster", "Measurer", "Slot", "installed", "serve"]

CONNECT_S = 10.0  # longest wait for the scheduler, s
WORKERS_S = 60.0  # longest time without any worker, s
_FILE_BYTES = 1 << 20  # largest scheduler file, bytes: Dask's have about 1,000
_POLL_S = 2.0  # time between checks of the cluster, s
_AHEAD = 4000  # tasks submitted ahead: enough for every worker of a large cluster
_START_S = (
    120.0  # longest start of a process, s: imports from a cold file system; a task's limit starts afterwards
)
_IDLE_S = 900.0  # a slot whose client was killed ends after this time, s; a new one starts on demand
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "GR_CONF_LOG_LOG_LEVEL": "warn"}
_GO_ON = "go on with --resume, there or without --scheduler"


class Cluster:
    """A connection to a scheduler, and this program's plugin on its workers.

    Parameters
    ----------
    scheduler : str
        ``tcp://host:8786`` (any address of Dask's), or the path of a scheduler file.

    Raises
    ------
    WorkerError
        If no scheduler answers within `CONNECT_S`, or it has no worker within `WORKERS_S`; one line.
    """

    def __init__(self, scheduler: str) -> None:
        # lost connections are reported here, in one line, instead of by Dask's log
        for name in ("distributed", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = _address(scheduler)
        self._name = f"radalt-{uuid.uuid4().hex}"
        self._study: Study | None = None
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

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End this program's processes on the workers, if the scheduler answers."""
        with contextlib.suppress(Exception):  # keep the run's result or error
            if self._study is not None and self._client.status == "running":
                self._client.unregister_worker_plugin(self._name)
        with contextlib.suppress(Exception):
            self._client.close(timeout=2)

    def run_tasks(self, tasks: Sequence[Task], *, time_limit_s: float) -> Iterator[tuple[int, Outcome]]:
        """Yield ``(index, outcome)`` as tasks of one study finish, as `pool.run_tasks` does for local processes.

        Raises
        ------
        WorkerError
            If a task fails, exceeds its time or ends its process; if a worker has another version installed; if the
            scheduler is lost, or all workers for `WORKERS_S`. One line.
        """
        if not tasks:
            return
        self._send(tasks[0].study)
        measure = _by_value()
        finished: queue.SimpleQueue[distributed.Future] = queue.SimpleQueue()
        running: dict[Any, tuple[int, distributed.Future]] = {}
        todo = iter(enumerate(tasks))

        def hand_out(count: int) -> None:
            for index, task in itertools.islice(todo, count):
                call = (self._name, pickle.dumps((task.point, task.batch)), time_limit_s)
                future = self._client.submit(measure, *call, pure=False)
                running[future.key] = index, future
                future.add_done_callback(finished.put)

        try:
            hand_out(_AHEAD)
            while running:
                future = self._waiting(lambda: finished.get(timeout=_POLL_S))
                index, _ = running.pop(future.key)
                failed, value = self._answer(future, tasks[index].label)
                if failed:
                    raise WorkerError(f"{tasks[index].label}: {value}")
                hand_out(1)
                yield index, value
        finally:
            if self._client.status == "running":
                self._client.cancel([future for _, future in running.values()])

    def _send(self, study: Study) -> None:
        """Send study and files to every present and future worker, once for all stages of a run."""
        if study is self._study:
            return
        self._study = study
        try:
            self._client.register_plugin(Measurer(study), name=self._name)
        except WorkerError:
            raise
        except Exception as error:  # from Dask, or from a worker that cannot load this module
            raise WorkerError(
                f"a worker of {self.address} cannot take part ({_first_line(error)}); is gr-radalt installed there?"
            ) from None

    def _answer(self, future: distributed.Future, label: str) -> tuple[bool, Any]:
        try:
            reply = self._waiting(lambda: future.result(timeout=_POLL_S))
        except distributed.KilledWorker as error:
            return (
                True,
                f"{error.allowed_failures + 1} workers were lost while they measured it; out of memory?",
            )
        except (distributed.client.FutureCancelledError, OSError) as error:
            # OSError: the connection broke before its futures were cancelled
            raise WorkerError(
                f"the scheduler at {self.address} was lost ({_first_line(error)}); {_GO_ON}"
            ) from None
        return pickle.loads(reply)

    def _waiting(self, get: Callable[[], Any]) -> Any:
        """Result of ``get``, with a check of the cluster every `_POLL_S`."""
        without = 0.0
        while True:
            try:
                return get()
            except (queue.Empty, distributed.TimeoutError):
                without = 0.0 if self._has_worker() else without + _POLL_S
            if without >= WORKERS_S:
                raise self._no_worker()

    def _has_worker(self) -> bool:
        try:
            return bool(self._client.nthreads())
        except (OSError, RuntimeError, asyncio.CancelledError) as error:
            raise WorkerError(
                f"the scheduler at {self.address} was lost ({_first_line(error)}); {_GO_ON}"
            ) from None

    def _no_worker(self) -> WorkerError:
        return WorkerError(
            f"the scheduler at {self.address} has had no worker for {WORKERS_S:g} s; start one (dask worker "
            f"{self.address}), then {_GO_ON}"
        )


class Measurer(WorkerPlugin):
    """Plugin on a worker: the study, its files in the worker's folder, its processes.

    Parameters
    ----------
    study : Study
        Ready to be measured; its files are read on construction.
    """

    def __init__(self, study: Study) -> None:
        self.wanted = installed(study.needs_network)
        self.study = pickle.dumps(study)
        self.plugins = os.environ.get(PLUGINS, "")
        self.names: dict[str, tuple[str, str]] = {}
        self.contents: dict[str, bytes] = {}
        for name, path in study.files().items():
            content = path.read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            self.names[name], self.contents[digest] = (digest, path.name), content

    async def setup(self, worker: Any) -> None:
        """Store the files and start the first process; errors reach the program that registers the plugin."""
        self.address, self.refused = worker.address, ""
        self.idle: list[Slot] = []
        self.busy: set[Slot] = set()
        self.folder = Path(worker.local_directory) / "radalt"
        try:
            self.idle.append(await asyncio.to_thread(self._start))
        except (WorkerError, OSError) as error:
            self.refused = f"worker {self.address} {error}"
            raise WorkerError(self.refused) from None

    def _start(self) -> Slot:
        return Slot(self.wanted, self.study, self._files(), self.plugins)

    def _files(self) -> dict[str, Path]:
        """Files by their names in the study, each in a folder named by its hash."""
        out = {}
        for name, (digest, file) in self.names.items():
            path = self.folder / digest / file
            content = path.read_bytes() if path.exists() else self.contents[digest]
            if hashlib.sha256(content).hexdigest() != digest:
                raise WorkerError(
                    f"got {file} damaged: its SHA-256 is not {digest[:12]}...; repeat the command"
                )
            if not path.exists():
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(content)
            out[name] = path
        return out

    def measure(self, task: bytes, time_limit_s: float) -> bytes:
        """Measure a task in a thread of the worker; returns the pickled reply of `answered`."""
        if self.refused:
            return pickle.dumps((True, self.refused))
        try:
            slot = self._idle_slot() or self._start()
        except (WorkerError, OSError) as error:
            return pickle.dumps((True, f"worker {self.address} {error}"))
        self.busy.add(slot)
        try:
            failed, value = slot.measure(pickle.loads(task), time_limit_s)
        finally:
            self.busy.discard(slot)
            self.idle.append(slot)
        if not failed:
            value = Outcome(value.rows, f"{self.address} {value.process}", value.peak_bytes)
        return pickle.dumps((failed, value))

    def _idle_slot(self) -> Slot | None:
        with contextlib.suppress(IndexError):  # other threads of the worker take slots from the list
            while True:
                slot = self.idle.pop()
                if slot.alive:
                    return slot
        return None

    def teardown(self, worker: Any) -> None:
        """End the processes; Dask removes the files with the worker's folder."""
        for slot in (*self.idle, *self.busy):
            slot.close()


def _by_value() -> Callable[[str, bytes, float], bytes]:
    """Function of a task. It is local, so it is pickled by value and the scheduler's machine needs Dask only."""

    def measure(name: str, task: bytes, time_limit_s: float) -> bytes:
        from distributed import get_worker

        return get_worker().plugins[name].measure(task, time_limit_s)

    return measure


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


# -- the process that measures --------------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def installed(with_network: bool) -> dict[str, str]:
    """Versions that rows depend on, with digests of this package's sources and of the shipped network."""
    try:
        out = versions(with_network)
    except ImportError:
        out = versions(False)
    if with_network:
        shipped = default_model_path()
        out["shipped network"] = (
            hashlib.sha256(shipped.read_bytes()).hexdigest()[:12] if shipped.exists() else "none"
        )
    digest, package = hashlib.sha256(), Path(__file__).resolve().parents[2]
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    return out | {"radalt source": digest.hexdigest()[:12]}


class Slot:
    """One process, one task at a time.

    Parameters
    ----------
    wanted : mapping
        `installed` of the program that owns the study; it has to be equal on this machine.
    study : bytes
        Pickled study.
    files : mapping of name -> path
        Argument of `Study.with_files`.
    plugins : str
        `RADALT_PLUGINS` of the program that owns the study.

    Raises
    ------
    WorkerError
        If the process does not start, or installed versions differ; the message names both.
    """

    def __init__(
        self, wanted: Mapping[str, str], study: bytes, files: Mapping[str, Path], plugins: str = ""
    ) -> None:
        self._ours, theirs = multiprocessing.Pipe()
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve({theirs.fileno()})"
        )
        with uninterrupted():
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,  # never written: its end of file is the owner's exit
                pass_fds=[theirs.fileno()],
                env=os.environ | _ENVIRONMENT | {PLUGINS: plugins},
            )
        theirs.close()
        try:
            failed, text = self._ask(
                (dict(wanted), study, dict(files)), _START_S, "the measuring process did not start"
            )
            if failed:
                raise WorkerError(text)
        except BaseException:
            self.close()
            raise

    def measure(self, task: Any, time_limit_s: float) -> tuple[bool, Any]:
        """``(failed, Outcome or message)`` of a task (point, batch); raises errors that are not meant for users."""
        try:
            reply = self._ask(task, time_limit_s, too_late(time_limit_s))
        except WorkerError as error:
            self.close()
            return True, str(error)
        if isinstance(reply, BaseException):
            raise reply
        return reply

    @property
    def alive(self) -> bool:
        """Whether the process accepts a task."""
        return self._process.poll() is None

    def _ask(self, message: Any, limit_s: float, timeout: str) -> Any:
        try:
            self._ours.send(message)
            if self._ours.poll(limit_s):
                return self._ours.recv()
        except (EOFError, OSError):
            self._process.wait()
            raise WorkerError(f"the worker process ended ({cause(self._process.returncode)})") from None
        raise WorkerError(timeout)

    def close(self) -> None:
        """End the process in any state."""
        self._process.kill()
        self._process.wait()


def serve(number: int) -> None:
    """Main function of a slot's process; ``number`` is the file descriptor of its pipe."""
    threading.Thread(target=_end_with_owner, daemon=True).start()
    enter()
    connection = Connection(number)
    try:
        wanted, blob, files = connection.recv()
        differs = _difference(wanted)
        study = None
        if not differs:
            try:
                study = pickle.loads(blob).with_files(files)
            except (ImportError, AttributeError) as error:  # a missing plugin
                differs = (
                    f"cannot load the study ({' '.join(str(error).split())}); install there what it needs"
                )
        connection.send((bool(differs), differs))
        while connection.poll(_IDLE_S):
            point, batch = connection.recv()
            try:
                reply = answered(measure_task, Task(study, point, batch))
            except Exception as error:  # sent to the owner, which raises it
                reply = error
            connection.send(reply)
    except (EOFError, OSError):
        pass  # the owner has closed the pipe


def _end_with_owner() -> None:
    os.read(sys.stdin.fileno(), 1)
    os._exit(0)


def _difference(wanted: Mapping[str, str]) -> str:
    """The first difference of versions in words; empty without any."""
    here = installed("onnxruntime" in wanted)
    for name, version in wanted.items():
        if here.get(name) != version:
            return (
                f"has {name} {here.get(name, 'none')}, and this program has {version}; install the same there"
            )
    return ""
