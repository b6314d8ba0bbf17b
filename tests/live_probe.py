"""Runs the live view in the simulated channel, works its controls, and prints as JSON what was measured; no test.

QT_QPA_PLATFORM=offscreen .venv/bin/python tests/live_probe.py FOLDER"""

import contextlib
import json
import os
import sys
import time
from pathlib import Path

import numpy as np
from waiting import ROOT, crowd

sys.path[:0] = [str(ROOT / "python"), str(ROOT / "tests")]

LATE = 300  # frames that may be on their way between a control and an altimeter
LOOK = 40  # frames that are then looked at
TIME_LIMIT_S = 90.0

# control -> value, or block -> method, one after the other
STEPS = (
    ("start", {"sir_db": -10}),
    ("higher", {"altitude_m": 700, "method": "nlms"}),
    # the bare command takes 700 m for zero; the button does not
    ("mistimed", {"frame_segmenter": "reacquire"}),
    ("reacquired", {"reacquire_button": "click"}),
    ("jammed", {"sir_db": -60, "overlap": 1}),
    ("radar only", {"tx_enable": 1}),
    ("off", {"tx_enable": 0}),
)


def wait(app: object) -> None:
    """Let the window and the flowgraph work for a moment."""
    app.processEvents()
    time.sleep(0.02)


def standing(top: object, step: str) -> list[str]:
    """Where the flowgraph stands when its time is up: items that each block has read and written, and the timing."""
    out = [f"{step}: {top.frame_segmenter.status()}"]
    for name, block in vars(top).items():
        counts = []
        for count in ("nitems_read", "nitems_written"):
            with contextlib.suppress(AttributeError, ValueError, RuntimeError):  # no block, no such port
                counts.append(f"{count} {getattr(block, count)(0)}")
        if counts:
            out.append(f"{name}: {', '.join(counts)}")
    return out


def scroll_bars(top: object) -> list:
    return [top.top_scroll.horizontalScrollBar(), top.top_scroll.verticalScrollBar()]


def share(results: np.ndarray, altitude_m: float) -> float:
    """Part of the frames with a correct altitude."""
    return float(np.mean(results["valid"] & (np.abs(results["altitude_m"] - altitude_m) < 5)))


def on_the_air(folder: Path) -> tuple[dict[str, object], list[tuple]]:
    """Recorded doubles in the place of both radios: parameters for an enclosed scene, and what is called on them."""
    import uhd_double
    import yaml
    from gnuradio import uhd

    air = uhd_double.Air()
    uhd.usrp_sink = lambda *args: uhd_double.Sink(air, *args)
    uhd.usrp_source = lambda *args: uhd_double.Source(air, *args)
    radio = {"radar_serial": "R", "jammer_serial": "J", "enclosure": "cabled", "attenuation_db": 40.0}
    scene = {"radio": radio, "interference": {"qpsk": {"sir_db": -10.0, "bandwidth_hz": 2e6}}}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    return {"scene_file": str(path), "transmit": 1, "drop_when_slow": 1}, air.calls


def refusal(cls: type, calls: list[tuple]) -> list:
    """What the view says of the scene as shipped, which states no enclosure, and what it has called on radios then."""
    from radalt.core.radio.interlock import InterlockError

    try:
        cls(transmit=1)
    except InterlockError as error:
        return [str(error), *calls]


def main() -> None:
    from PyQt5 import Qt

    from radalt.evaluation.flowgraph.generate import Prepared, generate
    from radalt.evaluation.flowgraph.rewrite import load_grc
    from radalt.evaluation.flowgraph.run import load_class

    app = Qt.QApplication(sys.argv[:1])
    folder, air = Path(sys.argv[1]), sys.argv[2:] == ["air"]
    name = "ota_live" if air else "ota_live_sim"
    prepared = Prepared(generate(load_grc(ROOT / f"flowgraphs/{name}.grc"), folder))
    parameters, calls = on_the_air(folder) if air else ({"drop_when_slow": 0}, [])
    report: dict[str, object] = {"refused": refusal(load_class(prepared), calls) if air else []}
    top = load_class(prepared)(**parameters)
    sys.modules[type(top).__module__].snippets_main_after_init(top)
    top.show()
    top.start()
    deadline = time.monotonic() + TIME_LIMIT_S * crowd()
    altimeters = {name: getattr(top, f"altimeter_{name}") for name in ("none", "tcae", "selected")}
    for step, controls in STEPS[:1] if air else STEPS:
        for control, value in controls.items():
            if hasattr(top, f"set_{control}"):
                getattr(top, f"set_{control}")(value)
            else:
                getattr(getattr(top, control), value)()
                while top.reacquire.running and time.monotonic() < deadline:
                    wait(app)
        wanted = min(a.nitems_read(0) for a in altimeters.values()) + LATE + LOOK
        while min(a.nitems_read(0) for a in altimeters.values()) < wanted and time.monotonic() < deadline:
            if step == "mistimed" and top.frame_segmenter.status()["state"] == "lost":
                break  # no frames come any more
            wait(app)
        if time.monotonic() >= deadline and "stalled" not in report:
            report["stalled"] = standing(top, step)
        report[step] = {n: share(a.results()[-LOOK:], top.altitude_m) for n, a in altimeters.items()}
        report[step]["timing"] = top.frame_segmenter.status()["state"]
        top.status_timer.timeout.emit()  # now, and not within half a second
        report[step]["status"] = top.status
        report[step]["true"] = float(top.altitude_strip.strip.rows[0, -1])
    report["method"] = top.mitigation_selected.status()["method"]
    report["calls"] = [call[:2] for call in calls]
    # what the guard stored; GNU Radio 3.10.12 keeps a logger in the top block, which has a method of that name
    stored = [getattr(block, "error", None) for block in vars(top).values()]
    report["opened"] = [top.width(), top.height()]
    top.resize(1200, 720)
    for _ in range(5):
        wait(app)
    report["scroll bars"] = [bar.isVisible() for bar in scroll_bars(top)]
    report["errors"] = [str(error) for error in stored if isinstance(error, Exception)]
    top.grab().save(str(folder / "live.png"))
    print("PROBE " + json.dumps(report), flush=True)
    os._exit(0)  # nothing more to be learnt from taking the window down


if __name__ == "__main__":
    main()
