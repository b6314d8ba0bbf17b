"""Runs flowgraphs: start, poll, stop, and raise the exceptions of blocks."""

import threading
import time
from collections.abc import Callable
from typing import Any

from ...blocks._guard import raise_stored
from . import FlowgraphError

_STOP_S = 10.0  # longest stop of a flowgraph, s


def blocks_of(top: Any) -> dict[str, Any]:
    """Blocks of a generated flowgraph that are written in Python, by name."""
    return {
        name: block
        for name, block in vars(top).items()
        if hasattr(block, "work") or hasattr(block, "general_work")
    }


def _too_long(limit_s: float) -> str:
    return f"the flowgraph did not end within {limit_s:g} s; raise the limit or use fewer frames"


def run_to_end(
    top: Any,
    *,
    time_limit_s: float | None = None,
    over: Callable[[], bool] | None = None,
    poll_s: float = 0.05,
    too_long: Callable[[float], str] = _too_long,
) -> float:
    """Run a flowgraph that is not yet started until its stream ends or ``over`` says so; returns its wall seconds.

    It has ended when the function returns or raises: FlowgraphError if it does not end within its limit (by
    ``too_long``), or does not stop; an exception of a block's ``work``, unchanged. ``over``, for endless streams and
    for observation, is called every ``poll_s`` seconds during the run, and once after its end.
    """
    begin = time.perf_counter()
    top.start()
    has_ended = threading.Event()  # an interrupted `Thread.join` takes the thread for ended (Python < 3.13)

    def wait() -> None:
        try:
            top.wait()
        finally:
            has_ended.set()

    threading.Thread(target=wait, daemon=True).start()
    timed_out = ended = False
    try:
        while not (ended or timed_out):
            left = float("inf") if time_limit_s is None else begin + time_limit_s - time.perf_counter()
            has_ended.wait(max(0.0, min(left, poll_s)))
            ended = bool(over is not None and over()) or has_ended.is_set()
            timed_out = not ended and left <= 0
        elapsed = time.perf_counter() - begin
    finally:  # also after an interrupt
        top.stop()
        stopped = has_ended.wait(_STOP_S)
    if timed_out:
        raise FlowgraphError(too_long(time_limit_s))
    if not stopped:
        raise FlowgraphError(f"the flowgraph did not stop within {_STOP_S:g} s")
    raise_stored(list(blocks_of(top).values()))
    return elapsed
