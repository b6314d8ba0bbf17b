"""How long other programs held up the cores during a run of the live path."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from ...core.cores import allowed_cores

# lateness of a wake-up above which it is added up, ms: about the path's latency (docs/real-time.md)
_LONG_MS = 20.0
# a process per core that sleeps 5 ms at a time, with the standard library alone: it shares neither interpreter nor lock
_WATCHER = """
import os, sys, threading, time
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {core})
done = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), done.set()), daemon=True).start()
ended = longest = total = 0.0
before = time.monotonic()
while not ended:  # the last wait counts, too
    ended, now = done.wait(0.005), time.monotonic()
    gap = 1e3 * (now - before) - 5.0
    longest, total, before = max(longest, gap), total + gap * (gap > {long}), now
print(longest, total)
"""


@dataclass(frozen=True)
class Outside:
    """Findings of one run."""

    steal_s: float
    """Core seconds that the host of a virtual machine took, as the kernel counts them; NaN where it does not."""
    longest_ms: tuple[float, ...]  # by core: the latest wake-up of a process that only sleeps
    total_ms: tuple[float, ...]  # by core: the sum of lateness above 20 ms


class OutsideWatch:
    """One sleeping process per core, from its construction to `end`; each takes some 0.5 % of its core."""

    def __init__(self) -> None:
        self._steal_s = _steal_s()
        self._watchers = [
            subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _WATCHER.format(core={core}, long=_LONG_MS)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for core in allowed_cores()
        ]

    def end(self) -> Outside:
        """Stop watching."""
        said = [watcher.communicate("")[0].split() for watcher in self._watchers]
        longest, total = zip(*(map(float, words) for words in said), strict=True)
        return Outside(_steal_s() - self._steal_s, longest, total)


def _steal_s() -> float:
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        return int(fields[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError):
        return float("nan")
