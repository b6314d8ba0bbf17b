#!/usr/bin/env python3
"""Samples of your own receiver, as a file of complex64, through the blocks: timing, mitigation, altitude.

PYTHONPATH=python .venv/bin/python examples/own_samples.py samples.cf32 500
"""

import os
import sys

import numpy as np
from gnuradio import blocks, gr, radalt

from radalt.core.altimeter.altimeter import Reason
from radalt.core.scene import parse_scene

# The sweep that was sent, and how high to search. What is not said has a default: docs/scene-reference.md
scene = parse_scene(
    {
        "waveform": {
            "bandwidth_hz": 7.5e6,
            "sweep_s": 1.0e-3,
            "rate_hz": 7.5e6,
        },  # a frame: up and down in 1 ms
        "altimeter": {"max_altitude_m": 1500.0},
    }
)


class OwnSamples(gr.top_block):
    """A file in place of a receiver; any block with complex samples at the waveform's rate will do."""

    def __init__(self, file: str, reference_m: float) -> None:
        gr.top_block.__init__(self, "own samples")
        self.samples = blocks.file_source(gr.sizeof_gr_complex, file, False)
        # no programme was flown: any altitude within the span keeps the lock
        self.segmenter = radalt.frame_segmenter(scene, follow_programme=False)
        self.segmenter.set_reference(reference_m)  # altitude of the first sweeps, on which timing is acquired
        self.method = radalt.mitigation(scene, "whitening")
        self.altimeter = radalt.altimeter_sink(scene, "whitening", messages=False)
        self.connect(self.samples, self.segmenter, self.method, self.altimeter)


def main() -> int:
    """Run to the end of the file and print the altitudes and why frames have none."""
    if len(sys.argv) not in (2, 3) or os.path.isdir(sys.argv[1]):  # GNU Radio reads a folder without end
        print("usage: own_samples.py FILE [ALTITUDE_OF_THE_FIRST_SWEEPS_M]", file=sys.stderr)
        return 2
    try:
        top = OwnSamples(sys.argv[1], float(sys.argv[2]) if len(sys.argv) == 3 else 0.0)
    except (RuntimeError, ValueError) as error:  # no such file, an empty one, or no altitude
        print(f"own_samples: {' '.join(sys.argv[1:])}: {error}", file=sys.stderr)
        return 2
    top.run()
    results = top.altimeter.results()
    altitude_m = results["altitude_m"][results["valid"]]
    if altitude_m.size:
        print(f"{altitude_m.size} altitudes from {altitude_m[0]:.1f} m to {altitude_m[-1]:.1f} m")
    for reason, frames in zip(*np.unique(results["reason"], return_counts=True), strict=True):
        print(f"{frames} frames {Reason.NAMES[reason]}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
