#!/usr/bin/env python3
"""CPU time and FFTs of `hybrid` per frame of a scene, at its lowest SIR and full overlap: how much of it are searches?

.venv/bin/python tools/hybrid_costs.py base_station nr10 --frames 3000
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))

import numpy as np
from threadpoolctl import threadpool_limits

import radalt
from radalt.core.mitigation.hybrid import Hybrid
from radalt.core.mitigation.outcome import PASSED
from radalt.core.scene import load_scene

HEADINGS = (
    *("scene", "frames", "cancelled", "searched", "FFTs per frame, mean", "99 %", "most"),
    *("ms per frame", "of it cancellers", "of it searches"),
)


class Counted(Hybrid):
    """`Hybrid` that adds up the prices of its cancellers' steps, and CPU time in seconds by tracking and searching."""

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.ffts = self.track_s = self.search_s = 0.0

    def _counted(self, step: Callable[[np.ndarray], np.ndarray | None], frame: np.ndarray) -> tuple:
        for method in self._cancellers:
            method.outcome = PASSED
        begin = time.thread_time()
        out = step(frame)
        spent_s = time.thread_time() - begin
        self.ffts += sum(method.outcome.ffts for method in self._cancellers)
        return out, spent_s

    def _tracked(self, frame: np.ndarray) -> np.ndarray | None:
        out, spent_s = self._counted(super()._tracked, frame)
        self.track_s += spent_s
        return out

    def _searched(self, frame: np.ndarray) -> np.ndarray | None:
        out, spent_s = self._counted(super()._searched, frame)
        self.search_s += spent_s
        return out


def row(name: str, frames: int, drop_when_slow: bool) -> str:
    """A row of the table."""
    scene = load_scene(name)
    sir_db = min(scene.sweep.sir_db, default=None)
    method, ffts, spent_s = Counted(scene.waveform, drop_when_slow=drop_when_slow), [], 0.0
    for frame in radalt.simulate(scene, sir_db=sir_db, overlap=1.0, frames=frames)[0]:
        method.ffts, begin = 0.0, time.thread_time()
        method.process(frame[None])
        spent_s += time.thread_time() - begin
        ffts.append(method.ffts)
    ms = 1e3 / len(ffts)
    return (
        f"| {Path(name).stem} | {len(ffts)} | {method.cancelled} | {method.searched} | {np.mean(ffts):.1f} "
        f"| {np.quantile(ffts, 0.99):.0f} | {max(ffts):.0f} | {spent_s * ms:.2f} "
        f"| {(method.track_s + method.search_s) * ms:.2f} | {method.search_s * ms:.2f} |"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Print a row per scene."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", help="shipped ones, or YAML files")
    parser.add_argument("--frames", type=int, default=3000, help="per scene (default: %(default)s)")
    parser.add_argument(
        "--drop-when-slow", action="store_true", help="with the budget of searches, as with a radio"
    )
    args = parser.parse_args(argv)
    threadpool_limits(1, user_api="blas")  # as in a flowgraph
    print(f"| {' | '.join(HEADINGS)} |\n|---|{'---:|' * (len(HEADINGS) - 1)}")
    for name in args.scenes:
        print(row(name, args.frames, args.drop_when_slow), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
