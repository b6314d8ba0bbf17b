"""Points of a study over a Dask cluster, on workers that have this module installed and share no folder.

What a point needs travels once to each worker (a `WorkerPlugin`, which Dask also gives to workers that join later):
the study, and its files by SHA-256. A task is then a point and a batch number. It is measured in a process of its own
beside the worker (`slot`), so that a task that hangs can be ended and one that dies says so. A worker that is lost
costs what it was measuring: the scheduler hands that to another one, and rows follow from study, point and batch.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import itertools
import json
import logging
import os
import pickle
import queue
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ...core.plugins import VARIABLE as PLUGINS
from .pool import WorkerError
from .run import Outcome, Task
from .slot import Slot, installed
from .study import Study

try:
    import distributed
    from distributed.diagnostics.plugin import WorkerPlugin
except ImportError:
    raise WorkerError("--scheduler needs Dask's package distributed: pip install distributed") from None

__all__ = ["Cluster", "Measurer"]

CONNECT_S = 10.0
WORKERS_S = 60.0  # how long a cluster may be without any worker
_LOOK_S = 2.0
_AHEAD = 4000  # tasks the scheduler has at once; it keeps every worker busy from these
_GO_ON = "go on with --resume, there or without --scheduler"


class Cluster:
    """A connection to a scheduler, and this program's place on its workers.

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
        # what Dask says of lost connections is said here, in one line
        for name in ("distributed", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = _address(scheduler)
        self._name = f"radalt-{uuid.uuid4().hex}"
        self._study: Study | None = None
        try:
            self._client = distributed.Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, ImportError) as error:
            reason = "" if isinstance(error, OSError) else f" ({str(error).splitlines()[0]})"
            raise WorkerError(
                f"--scheduler {scheduler}: no Dask scheduler answers at {self.address} within {CONNECT_S:g} s{reason}"
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
        """Take this program's processes off the workers, as far as the scheduler answers."""
        with contextlib.suppress(Exception):  # the run's own result or error stands
            if self._study is not None and self._client.status == "running":
                self._client.unregister_worker_plugin(self._name)
        with contextlib.suppress(Exception):
            self._client.close(timeout=2)

    def run_tasks(self, tasks: Sequence[Task], *, time_limit_s: float) -> Iterator[tuple[int, Outcome]]:
        """Yield ``(index, outcome)`` as tasks of one study finish, as `pool.run_tasks` does for local processes.

        Raises
        ------
        WorkerError
            If a task fails, exceeds its time or ends its process; if something else is installed on a worker; if the
            scheduler is lost, or all workers are for `WORKERS_S`. One line.
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
                future = self._waiting(lambda: finished.get(timeout=_LOOK_S))
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
        """Study and files to every worker, those to come included; once for all stages of a run."""
        if study is self._study:
            return
        self._study = study
        try:
            self._client.register_plugin(Measurer(study), name=self._name)
        except WorkerError:
            raise
        except Exception as error:  # of Dask's, or of a worker that cannot load this module
            raise WorkerError(
                f"a worker of {self.address} cannot take part ({_first_line(error)}); is gr-radalt installed there?"
            ) from None

    def _answer(self, future: distributed.Future, label: str) -> tuple[bool, Any]:
        try:
            reply = self._waiting(lambda: future.result(timeout=_LOOK_S))
        except distributed.KilledWorker as error:
            return (
                True,
                f"{error.allowed_failures + 1} workers were lost while they measured it; out of memory?",
            )
        except (distributed.client.FutureCancelledError, OSError) as error:
            # an OSError where the connection broke before its futures were cancelled
            raise WorkerError(
                f"the scheduler at {self.address} was lost ({_first_line(error)}); {_GO_ON}"
            ) from None
        return pickle.loads(reply)

    def _waiting(self, get: Callable[[], Any]) -> Any:
        """What ``get`` gives, with a look at the cluster whenever it takes long."""
        without = 0.0
        while True:
            try:
                return get()
            except (queue.Empty, distributed.TimeoutError):
                without = 0.0 if self._has_worker() else without + _LOOK_S
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
    """This program's place on a worker: its study, its files in a folder of the worker's own, its processes.

    Parameters
    ----------
    study : Study
        Ready to be measured; its files are read here.
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
        """Check and keep the files, start the first process; what it raises reaches the program that registers."""
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
        """Files by their names in the study, each in a folder called by its hash."""
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
        """Called in a thread of the worker; the reply is `answered`'s, pickled."""
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
        with contextlib.suppress(IndexError):  # threads of a worker share the list
            while True:
                slot = self.idle.pop()
                if slot.alive:
                    return slot
        return None

    def teardown(self, worker: Any) -> None:
        """End the processes; the files go with the worker's folder."""
        for slot in (*self.idle, *self.busy):
            slot.close()


def _by_value() -> Callable[[str, bytes, float], bytes]:
    """What a task calls; pickled by value since it is local, so that the scheduler's machine needs Dask alone."""

    def measure(name: str, task: bytes, time_limit_s: float) -> bytes:
        from distributed import get_worker

        return get_worker().plugins[name].measure(task, time_limit_s)

    return measure


def _address(scheduler: str) -> str:
    """An address, or what a scheduler file says."""
    if "://" in scheduler:
        return scheduler
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = getattr(error, "strerror", None) or "no scheduler file of Dask's"
        raise WorkerError(
            f"--scheduler {scheduler}: {reason}; give an address such as tcp://host:8786, or a scheduler file"
        ) from None


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:200]
