"""Summary of a finished flowgraph for the companion's console: score of each method, and counters."""

from typing import Any

from ...core.mitigation import METHODS
from ...core.scene import Scene
from ..results.score import CORRECT_LIMIT_M, score

_COUNTERS = ("frames", "lost_samples", "dropped_slow", "saturated_frames", "lock_losses")


def scores(top: Any, scene: Scene) -> str:
    """One line per method (Pd, correct and all trials) and the segmenter's counters; the font is proportional.

    ``top`` is the finished flowgraph, with ``altimeter_*`` and ``frame_segmenter`` as attributes; methods that are
    disabled in the companion have no line.
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
