"""What tests that wait for something else share: a limit, and a failure that says what did not come."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path


def wait_for(
    condition: Callable[[], object],
    what: str,
    *,
    process: subprocess.Popen | None = None,
    limit_s: float = 120.0,
) -> None:
    """Return once the condition holds.

    It fails with ``what`` at the limit, and as soon as the process that should bring it about has ended without it.
    That process is killed then, and what it has written is part of the failure.
    """
    end = time.monotonic() + limit_s
    while not condition():
        ended = process is not None and process.poll() is not None
        if ended and condition():  # its last deed
            return
        if ended or time.monotonic() >= end:
            reason = "its process has ended" if ended else f"not within {limit_s:g} s"
            raise AssertionError(f"{what}: {reason}{_left_of(process)}")
        time.sleep(0.02)


def ran(*command: object, limit_s: float = 120.0, **options: object) -> subprocess.CompletedProcess[str]:
    """A program that has ended, with what it has printed; ``options`` are those of `subprocess.run`."""
    words = [str(word) for word in command]
    return subprocess.run(words, capture_output=True, text=True, timeout=limit_s, check=False, **options)


def ran_python(*words: object, **options: object) -> subprocess.CompletedProcess[str]:
    """`ran` of this interpreter."""
    return ran(sys.executable, *words, **options)


def written(path: Path) -> Callable[[], bool]:
    """Condition: the file is there, and something is in it."""
    return lambda: path.exists() and path.stat().st_size > 0


def end_of(process: subprocess.Popen, *, limit_s: float = 120.0) -> tuple[str, str]:
    """What a process writes until it ends (stdout, stderr); one that does not end is killed, and the test fails."""
    try:
        return process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise AssertionError(
            f"{process.args} has not ended within {limit_s:g} s{_left_of(process)}"
        ) from None


def _left_of(process: subprocess.Popen | None) -> str:
    """Kill a process; what it has written that nobody has read."""
    if process is None:
        return ""
    process.kill()
    try:
        parts = process.communicate(timeout=10)
    except subprocess.TimeoutExpired:  # a child of its own holds the pipes
        return ""
    return "".join(f"\n{text}" for text in parts if text)
