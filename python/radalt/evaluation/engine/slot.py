"""A process that measures beside its owner, for as long as the owner lives: a thread of a Dask worker has one each.

A flowgraph may hang or die in C++, and a Dask worker that did so would take the tasks of its other threads with it.
Dask's own worker is a daemon of its nanny and may have no `multiprocessing` children, so this is a plain subprocess. It
ends with its owner, however that ends. Nothing here imports Dask.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Mapping
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ...core.mitigation.tcae import default_model_path
from ...core.plugins import VARIABLE as PLUGINS
from ..results.folder import versions
from .pool import WorkerError, answered, cause, enter, too_late, uninterrupted
from .run import Task, measure_task

__all__ = ["Slot", "installed", "serve"]

_START_S = 120.0  # imports of a cold file system; a task's own limit starts after that
_IDLE_S = 900.0  # a slot whose client was killed goes after this, a new one comes when it is needed
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "GR_CONF_LOG_LOG_LEVEL": "warn"}


@lru_cache(maxsize=2)
def installed(with_network: bool) -> dict[str, str]:
    """Versions that rows depend on, and digests of this package's sources, which a version number may lag behind, and
    of the shipped network, which goes without the check that others get."""
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
        `installed` of the program that owns the study; it has to be the same here.
    study : bytes
        Pickled.
    files : mapping of name -> path
        For `Study.with_files`.
    plugins : str
        `RADALT_PLUGINS` of that program.

    Raises
    ------
    WorkerError
        If it does not start, or what is installed differs: names both versions.
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
                stdin=subprocess.PIPE,  # never written to: its end tells that the owner is gone
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
        """``(failed, Outcome or message)`` of a task (point, batch); raises what is no error for the user."""
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
        """Whether it takes a task."""
        return self._process.poll() is None

    def _ask(self, message: Any, limit_s: float, late: str) -> Any:
        try:
            self._ours.send(message)
            if self._ours.poll(limit_s):
                return self._ours.recv()
        except (EOFError, OSError):
            self._process.wait()
            raise WorkerError(f"the worker process ended ({cause(self._process.returncode)})") from None
        raise WorkerError(late)

    def close(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.wait()


def serve(number: int) -> None:
    """Main function of the process; ``number`` is the descriptor of its end of the pipe."""
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
            except (ImportError, AttributeError) as error:  # a plugin that is not there
                differs = (
                    f"cannot load the study ({' '.join(str(error).split())}); install there what it needs"
                )
        connection.send((bool(differs), differs))
        while connection.poll(_IDLE_S):
            point, batch = connection.recv()
            try:
                reply = answered(measure_task, Task(study, point, batch))
            except Exception as error:  # travels to the program that asked, which raises it
                reply = error
            connection.send(reply)
    except (EOFError, OSError):
        pass  # the owner is done with this process


def _end_with_owner() -> None:
    os.read(sys.stdin.fileno(), 1)
    os._exit(0)


def _difference(wanted: Mapping[str, str]) -> str:
    """The first thing that is not the same here, in words; empty where all is."""
    here = installed("onnxruntime" in wanted)
    for name, version in wanted.items():
        if here.get(name) != version:
            return (
                f"has {name} {here.get(name, 'none')}, and this program has {version}; install the same there"
            )
    return ""
