"""What a flowgraph says in the companion's console when it has ended: the score of each method, and the counters."""

from __future__ import annotations

from typing import Any

from ...core.mitigation import METHODS
from ...core.scene import Scene
from ..results.score import CORRECT_LIMIT_M, score

__all__ = ["scores"]

_COUNTERS = ("frames", "lost_samples", "dropped_slow", "saturated_frames", "lock_losses")


def scores(top: Any, scene: Scene) -> str:
    """A line per method: Pd, correct of trials; and the segmenter's counters. Numbers first: the font is proportional.

    Parameters
    ----------
    top : object
        Flowgraph that has ended, with ``altimeter_*`` and ``frame_segmenter`` as attributes; a method that is
        disabled in the companion has no line.
    scene : Scene
        As flown.
    """
    lines = [f"Pd, method: correct of trials (detected and within {CORRECT_LIMIT_M:g} m)"]
    for method in METHODS:
        altimeter = getattr(top, f"altimeter_{method}", None)
        if altimeter is not None:
            s = score(altimeter.results(), scene.altitude.programme, altimeter.truth_m())
            pd = f"{s.pd:.3f}" if s.trials else "-"
            lines.append(f"{pd}  {method}: {s.correct} of {s.trials}")
    status = top.frame_segmenter.status()
    lines.append("counters: " + ", ".join(f"{key} {status[key]}" for key in _COUNTERS))
    return "\n".join(lines)
