"""Calls in a fresh Python process, whose memory, imports and threads are the call's own."""

import json
import os
import subprocess
import sys
from typing import Any

from .pool import WorkerError

_MARK = "RESULT "  # begins the line of the result; other lines are the called code's own
_CODE = """
import os, sys
if hasattr(os, "sched_setaffinity"):  # a worker keeps to one core, on which BLAS makes no further thread
    os.sched_setaffinity(0, range(os.cpu_count()))
import importlib, json
mark, module, function, arguments = sys.argv[1:]
print(mark + json.dumps(getattr(importlib.import_module(module), function)(*json.loads(arguments))))
"""


def call_apart(
    module: str, function: str, *arguments: Any, threads: int = 1, time_limit_s: float = 300.0
) -> Any:
    """Result of a module's function in a process of its own; arguments and result are JSON.

    The process finds the module by this one's ``sys.path``; ``threads`` are those of BLAS and OpenMP. Raises
    WorkerError if there is no result: the last line that the process wrote.
    """
    env = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))
    env["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = [sys.executable, "-c", _CODE, _MARK, module, function, json.dumps(arguments)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=time_limit_s, check=False)
    found = [line for line in done.stdout.splitlines() if line.startswith(_MARK)]
    if done.returncode or not found:
        raise WorkerError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return json.loads(found[-1].removeprefix(_MARK))
