"""A method in a process of its own, so that it computes next to the interpreter that everything else shares."""

import dataclasses
import mmap
import os
import pickle
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

import numpy as np

from ..altimeter.frame_quality import QUALITY_DTYPE
from ..cores import leave_home, return_home
from ..waveform import Waveform
from .base import Mitigation, MitigationError

_FRAMES = 64  # received frames, and cleaned frames, in the shared memory
_START_S = 120.0  # longest wait until a method is built, s: a network on a loaded machine takes tens
_END_S = 5.0  # longest wait until a closed process has ended, s
# Messages are bytes, since pickled objects cost a tenth of a frame. Requests: the method's parameters (pickled), then a
# span of frames, and whether their quality is known, or one of these two words. Answers, distinguished by their first
# byte: nanoseconds of CPU time and diverged frames, a status (pickled), or the text of an error.
_RESET, _STATUS = b"reset", b"status"
_SPAN, _DONE = struct.Struct("<ii?"), struct.Struct("<cqq")
# Environment of the process: one thread of linear algebra, since matrices are small, and a second would take the
# flowgraph's core; freed memory is kept (glibc, up to 1 GB), or a request's arrays would be mapped page by page again.
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"} | dict.fromkeys(
    ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"), str(1 << 30)
)
# Program of the process. It imports this module by the parent's name and path, so that the parent's plugins register
# with the same package, and no GNU Radio.
_PROGRAM = "import sys; sys.path[:] = {path!r}; from {module} import serve; serve({link}, {memory})"


class OwnProcess(Mitigation):
    """Any registered method, computed by a process of its own; the results are the method's, bit for bit.

    The threads of a flowgraph share one interpreter and wait for each other. A process shares the frames only,
    through memory that both have mapped: one copy each way, no pickling.

    ``method``: registry name; ``batch``: frames that the method gets at once; ``**parameters``: of the method. Raises
    `MitigationError` for whatever the method refuses, when it is built or later, and if its process ends.

    Examples
    --------
    >>> import numpy as np
    >>> from radalt.core.waveform import Waveform
    >>> w = Waveform()
    >>> frames = np.stack([w.reference] * 3)
    >>> apart = OwnProcess("none", w)
    >>> bool((apart.process(frames) == frames).all())
    True
    """

    def __init__(self, method: str, waveform: Waveform, *, batch: int = 4, **parameters: object) -> None:
        self.name, self._batch = method, int(batch)
        n = waveform.samples_per_frame
        with tempfile.TemporaryFile(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as file:
            file.truncate(_FRAMES * (2 * n * np.dtype(np.complex64).itemsize + QUALITY_DTYPE.itemsize))
            self._received, self._cleaned, self._quality = _map(file.fileno(), n)
            self._link, theirs = Pipe()
            self._process = _start(theirs, file.fileno())
        theirs.close()
        self._finalizer = weakref.finalize(self, _end, self._link, self._process)
        self._lock = threading.Lock()  # a status may be asked for while frames are under way
        self._ask(pickle.dumps((method, dataclasses.asdict(waveform), parameters, leave_home())))
        if not self._link.poll(_START_S):
            raise MitigationError(f"{method}: its process was not ready after {_START_S:g} s")
        self._carries = self._status_now()["carries_altitude"]
        # the base class would reset a method that is new
        self.waveform = waveform
        self.frames = self.diverged_frames = self.beyond_frames = 0

    @property
    def process_id(self) -> int:
        """Of the process next to this one."""
        return self._process.pid

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        with self._lock:
            self._ask(_RESET)
            self._done()
        self.frames = 0

    def close(self) -> None:
        """End the process; also done when this object, or the program, goes."""
        self._finalizer()

    def process_into(self, frames: np.ndarray, out: np.ndarray, quality: np.ndarray | None = None) -> None:
        """See `Mitigation.process_into`; while some frames are computed others are copied."""
        self.frames += len(frames)
        for first in range(0, len(frames), _FRAMES):
            there, back = frames[first : first + _FRAMES], out[first : first + _FRAMES]
            if quality is not None:
                self._quality[: len(there)] = quality[first : first + _FRAMES]
            spans = [slice(i, min(i + self._batch, len(there))) for i in range(0, len(there), self._batch)]
            with self._lock:
                for span in spans:
                    self._received[span] = there[span]
                    self._ask(_SPAN.pack(span.start, span.stop, quality is not None))
                for span in spans:
                    self._done()
                    back[span] = self._cleaned[span]

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        raise NotImplementedError("the method cleans in its own process")

    def _ask(self, request: bytes) -> None:
        try:
            self._link.send_bytes(request)
        except OSError:
            raise self._gone() from None

    def _answer(self) -> bytes:
        try:
            answer = self._link.recv_bytes()
        except (EOFError, OSError):
            raise self._gone() from None
        if answer[:1] == b"E":
            raise MitigationError(answer[1:].decode())
        return answer

    def _done(self) -> None:
        """Wait until a request is done."""
        _, cpu_ns, self.diverged_frames = _DONE.unpack(self._answer())
        self.outside_cpu_ns += cpu_ns

    def _status_now(self) -> dict[str, object]:
        """The method's status, after what was asked before."""
        return pickle.loads(self._answer()[1:])

    def _gone(self) -> MitigationError:
        try:
            code = self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            code = "still running"
        return MitigationError(f"{self.name}: its process ended ({code}); leave out own_process to see why")

    @property
    def carries_altitude(self) -> bool:
        """See `Mitigation.carries_altitude`."""
        return bool(self._carries)

    def status(self) -> dict[str, object]:
        """The method's own status; waits for frames that are under way."""
        with self._lock:
            self._ask(_STATUS)
            status = self._status_now()
        return status | {"frames": self.frames, "process_id": self.process_id}


def _map(memory: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Received and cleaned frames, each (frames, N) complex64, and their quality, in the memory of a file."""
    shared, count = mmap.mmap(memory, 0), 2 * _FRAMES * samples
    both = np.frombuffer(shared, dtype=np.complex64, count=count).reshape(2, _FRAMES, samples)
    return both[0], both[1], np.frombuffer(shared, dtype=QUALITY_DTYPE, offset=both.nbytes)


def _start(link: Connection, memory: int) -> subprocess.Popen:
    program = _PROGRAM.format(path=sys.path, module=__name__, link=link.fileno(), memory=memory)
    return subprocess.Popen(
        [sys.executable, "-c", program],
        pass_fds=(link.fileno(), memory),
        stdin=subprocess.DEVNULL,
        env=os.environ | _ENVIRONMENT,
    )


def _end(link: Connection, process: subprocess.Popen) -> None:
    """Close the link, which ends the process, and wait for it."""
    return_home()
    link.close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def serve(link: int, memory: int) -> None:
    """What the process does: build the method, then clean spans of the shared frames until the link closes."""
    from . import create

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the flowgraph, which then closes the link
    with Connection(link) as requests:
        try:
            name, waveform, parameters, cores = pickle.loads(requests.recv_bytes())
            if cores:
                os.sched_setaffinity(0, cores)
            method = create(name, Waveform(**waveform), **parameters)
            received, cleaned, quality = _map(memory, method.waveform.samples_per_frame)
            request = _STATUS
            while True:
                begin = time.process_time_ns()
                if request == _STATUS:
                    requests.send_bytes(b"S" + pickle.dumps(method.status()))
                elif request == _RESET:
                    method.reset()
                else:
                    first, last, known = _SPAN.unpack(request)
                    span = slice(first, last)
                    method.process_into(received[span], cleaned[span], quality[span] if known else None)
                if request != _STATUS:
                    spent = time.process_time_ns() - begin
                    requests.send_bytes(_DONE.pack(b"D", spent, method.diverged_frames))
                request = requests.recv_bytes()
        except (EOFError, ConnectionError):
            return  # the other side is done
        except MitigationError as error:
            requests.send_bytes(b"E" + str(error).encode())
