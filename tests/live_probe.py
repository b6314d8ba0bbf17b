"""Runs the live view in the simulated channel, works its controls, and prints as JSON what was measured; no test.

QT_QPA_PLATFORM=offscreen python tests/live_probe.py FOLDER
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "python"))

LATE = 300  # frames that may be on their way between a control and an altimeter
LOOK = 40  # frames that are then looked at
TIME_LIMIT_S = 90.0

# control -> value, one after the other
STEPS = (
    ("start", {"sir_db": -10}),
    ("higher", {"altitude_m": 700, "method": "nlms"}),
    ("jammed", {"sir_db": -60, "overlap": 1}),
    ("radar only", {"tx_enable": 1}),
    ("off", {"tx_enable": 0}),
)


def share(results: np.ndarray, altitude_m: float) -> float:
    """Part of the frames with a correct altitude."""
    return float(np.mean(results["valid"] & (np.abs(results["altitude_m"] - altitude_m) < 5)))


def main() -> None:
    from PyQt5 import Qt

    from gnuradio.radalt.evaluation import flowgraph

    app = Qt.QApplication(sys.argv[:1])
    folder = Path(sys.argv[1])
    data = flowgraph.load_grc(ROOT / "flowgraphs/ota_live_sim.grc")
    prepared = flowgraph.Prepared(flowgraph.generate(data, folder), "ota_live_sim", (), ())
    top = flowgraph.load_class(prepared)(drop_when_slow=0)
    sys.modules[type(top).__module__].snippets_main_after_init(top)
    top.show()
    top.start()
    deadline = time.monotonic() + TIME_LIMIT_S
    altimeters = {name: getattr(top, f"altimeter_{name}") for name in ("none", "tcae", "selected")}
    report = {}
    for step, controls in STEPS:
        for name, value in controls.items():
            getattr(top, f"set_{name}")(value)
        wanted = min(a.nitems_read(0) for a in altimeters.values()) + LATE + LOOK
        while min(a.nitems_read(0) for a in altimeters.values()) < wanted and time.monotonic() < deadline:
            app.processEvents()
            time.sleep(0.02)
        report[step] = {n: share(a.results()[-LOOK:], top.altitude_m) for n, a in altimeters.items()}
        report[step]["true"] = float(np.ravel(top.altitude_strip.strip.rows[0])[-1])
    report["method"] = top.mitigation_selected.status()["method"]
    report["in time"] = time.monotonic() < deadline
    report["errors"] = [str(b.error) for b in vars(top).values() if getattr(b, "error", None)]
    picture = top.grab()
    picture.save(str(folder / "live.png"))
    top.stop()
    top.wait()
    print("PROBE " + json.dumps(report), flush=True)


if __name__ == "__main__":
    main()
