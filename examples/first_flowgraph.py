#!/usr/bin/env python3
"""A radar altimeter, a jammer and two methods in one flowgraph, without the companion and without radios.

PYTHONPATH=python .venv/bin/python examples/first_flowgraph.py
"""

import numpy as np
from gnuradio import gr, radalt

from radalt.core.scene import parse_scene

# Everything the run depends on. What is not said has a default: docs/scene-reference.md
scene = parse_scene(
    {
        "altitude": {"programme_m": [900.0, 300.0, 60.0], "frames": 40},
        "interference": {"qpsk": {"sir_db": -28.0, "overlap": 0.5}},
        "channel": {"snr_db": 10.0},
        "seed": 7,
    }
)
programme = scene.altitude.programme
METHODS = ("none", "whitening")


class FirstFlowgraph(gr.top_block):
    """Sweep and jammer through the simulated channel; every method gets the same frames."""

    def __init__(self) -> None:
        gr.top_block.__init__(self, "first flowgraph")
        sweeps = programme.total_frames + 3  # the last frames wait for those that confirm them
        self.radar = radalt.fmcw_chirp_source(scene, frames=sweeps)
        self.jammer = radalt.jammer_source(scene, frames=sweeps)
        self.air = radalt.simulated_channel(scene)
        self.segmenter = radalt.frame_segmenter(scene)
        self.connect(self.radar, (self.air, 0))
        self.connect(self.jammer, (self.air, 1))
        self.connect(self.air, self.segmenter)
        # Keep every block as an attribute: GNU Radio does not keep Python blocks alive by itself.
        self.methods = [radalt.mitigation(scene, name) for name in METHODS]
        self.altimeters = [radalt.altimeter_sink(scene, name, messages=False) for name in METHODS]
        for method, altimeter in zip(self.methods, self.altimeters, strict=True):
            self.connect(self.segmenter, method, altimeter)


def main() -> int:
    """Run to the end of the programme and print what each method measured."""
    top = FirstFlowgraph()
    top.run()
    for name, altimeter in zip(METHODS, top.altimeters, strict=True):
        results = altimeter.results()
        truth_m = programme.altitude_m(results["frame_index"])
        flown = truth_m > 0  # timing is taken in the first frames, at altitude zero
        error_m = np.abs(results["altitude_m"] - truth_m)[flown]
        declared = results["valid"][flown]
        correct = declared & (error_m < 5.0)
        print(f"{name:10} {flown.sum()} frames, declared {declared.sum()}, within 5 m {correct.sum()}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
