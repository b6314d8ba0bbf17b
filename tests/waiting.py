"""What tests that run something else share: where it lies, a limit, and a failure that says what did not come."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent  # of the source tree


def crowd() -> float:
    """How many times as long as alone this process takes on a machine that has more to do: 50 ms of CPU time."""
    begun, used = time.monotonic(), time.thread_time()
    while time.thread_time() < used + 0.05:
        pass
    return max(1.0, (time.monotonic() - begun) / 0.05)


def patient(limit_s: float) -> float:
    """How long, s, something may take here that takes at most ``limit_s`` on a machine that has nothing else to do."""
    return limit_s * crowd()


def over(begun: float, limit_s: float) -> bool:
    """Whether a wait has lasted as long as it may, which is longer where the machine has more to do."""
    spent_s = time.monotonic() - begun
    return spent_s >= limit_s and spent_s >= patient(limit_s)


def wait_for(condition: Callable, what: str, *, process: subprocess.Popen | None = None, limit_s=120.0):
    """Return once the condition holds; fail with ``what`` at the limit, or when the process that should bring it about
    has ended without it. That process is killed then, and what it has written is part of the failure."""
    begun = time.monotonic()
    while not condition():
        ended = process is not None and process.poll() is not None
        if ended and condition():  # its last deed
            return
        if ended or over(begun, limit_s):
            reason = "its process has ended" if ended else f"not within {limit_s:g} s"
            raise AssertionError(f"{what}: {reason}{_left_of(process)}")
        time.sleep(0.02)


def started(*command: object, **options: object) -> subprocess.Popen[str]:
    """A program with a process group of its own; ``options`` are those of `subprocess.Popen`. `end_of` ends both."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    return subprocess.Popen([str(word) for word in command], **pipes | options)


def ran(*command: object, limit_s=120.0, check=False, **options: object) -> subprocess.CompletedProcess[str]:
    """A program that has ended, and what it started, with status 0 if ``check``; ``options`` as of `started`."""
    process = started(*command, **options)
    out, err = end_of(process, limit_s=limit_s)
    assert not (check and process.returncode), f"{process.args} ended with {process.returncode}\n{out}\n{err}"
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def ran_python(*words: object, **options: object) -> subprocess.CompletedProcess[str]:
    """`ran` of this interpreter."""
    return ran(sys.executable, *words, **options)


def written(path: Path) -> Callable[[], bool]:
    """Condition: the file is there, and something is in it."""
    return lambda: path.exists() and path.stat().st_size > 0


def end_of(process: subprocess.Popen, *, limit_s: float = 120.0) -> tuple[str, str]:
    """What a process writes until it ends (stdout, stderr), and the end of its group; at the limit the test fails."""
    begun = time.monotonic()
    try:
        while True:
            with contextlib.suppress(subprocess.TimeoutExpired):
                return process.communicate(timeout=1.0)
            if over(begun, limit_s):
                raise AssertionError(f"{process.args} has not ended within {limit_s:g} s{_left_of(process)}")
    finally:
        _kill(process)


def _kill(process: subprocess.Popen) -> None:
    """Also what it has started, where it has a group of its own."""
    process.kill()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _left_of(process: subprocess.Popen | None) -> str:
    """Kill a process; what it has written that nobody has read."""
    if process is None:
        return ""
    _kill(process)
    try:
        parts = process.communicate(timeout=10)
    except subprocess.TimeoutExpired:  # a child of its own holds the pipes
        return ""
    return "".join(f"\n{text}" for text in parts if text)
