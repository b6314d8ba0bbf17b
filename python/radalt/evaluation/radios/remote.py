"""The flowgraph without end that a remote program drives: ota_b210.grc with altitudes by hand and a control socket."""

from __future__ import annotations

import copy
import functools
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...core.paths import share_dir
from ...core.radio.control import check_endpoint
from ...core.radio.interlock import require_enclosure
from ...core.scene import Scene
from ...core.scene.live import by_hand
from ..flowgraph.run import (
    JAMMER_GATE,
    RADAR_GATE,
    FlowgraphError,
    Prepared,
    generate,
    load_class,
    load_grc,
    prune,
    simulate,
    write_scene,
)

__all__ = ["drive_remotely", "remote"]


def remote(data: dict[str, Any], name: str) -> dict[str, Any]:
    """The same flowgraph without end: altitudes by hand, any altitude accepted, results and requests over ZMQ."""
    data = copy.deepcopy(data)
    blocks = {block["name"]: block for block in data["blocks"]}
    data["options"]["parameters"]["id"] = name
    blocks["frames"]["parameters"]["value"] = "0"
    blocks["frame_segmenter"]["parameters"]["follow_programme"] = "False"
    blocks["chirp_source"]["parameters"]["altitude_m"] = "0.0"
    for gate in (RADAR_GATE, JAMMER_GATE):  # a simulated flowgraph has none
        if gate in blocks:
            blocks[gate]["parameters"]["controlled"] = "bool(control)"
    value = blocks["scene"]["parameters"]["value"]
    blocks["scene"]["parameters"]["value"] = f"by_hand({value})"
    states = blocks["scene"]["states"]
    imports = {"imports": "from gnuradio.radalt.core.scene.live import by_hand"}
    added = [("import_by_hand", "import", imports)]
    for key, label in (("telemetry", "Telemetry (PUB)"), ("control", "Control (REP)")):
        added.append((key, "parameter", {"label": label, "type": "str", "value": '""'}))
    for key, label, kind in (
        ("network", "Other machines", "intx"),
        ("keep_alive_s", "Keep alive (s)", "eng_float"),
    ):
        added.append((key, "parameter", {"label": label, "type": kind, "value": "0"}))
    ports = {"scene": "scene", "telemetry": "telemetry", "control": "control"}
    ports |= {"network": "bool(network)", "keep_alive_s": "keep_alive_s"}
    added.append(("remote_control", "radalt_remote_control", ports))
    data["blocks"] += [
        {"name": n, "id": kind, "parameters": p, "states": copy.deepcopy(states)} for n, kind, p in added
    ]
    return data


@functools.lru_cache(maxsize=4)
def _generated(methods: tuple[str, ...], jammer: bool, sim: bool) -> tuple[Any, Prepared]:
    name = f"ota_remote_{'sim' if sim else 'air'}_{'jam' if jammer else 'clear'}"
    data = load_grc(share_dir() / "flowgraphs" / "ota_b210.grc")
    data = simulate(data, name, realtime=True) if sim else data
    folder = tempfile.TemporaryDirectory(prefix="radalt_")
    module = generate(remote(prune(data, methods, jammer), name), Path(folder.name))
    return folder, Prepared(module, name, methods, ())


def drive_remotely(
    scene: Scene,
    methods: Sequence[str],
    *,
    telemetry: str,
    control: str,
    network: bool = False,
    keep_alive_s: float = 0.0,
    sim: bool = True,
    transmit: bool = False,
    stop: threading.Event | None = None,
    log: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Run until a ``stop`` request (or the event), at real time; returns the last state.

    Parameters
    ----------
    scene : Scene
        Interference, channel, limits; its programme is not flown.
    methods : sequence of str
    telemetry, control : str
        ZMQ endpoints, empty for none.
    network, keep_alive_s
        See `remote_control`.
    sim : bool
        Simulated channel in the place of the radios.
    transmit : bool
        On the air: what the command line says.
    stop : threading.Event, optional
        Ends the run from another thread.
    log : callable
        Receives what is set on the radios, and the endpoints.

    Raises
    ------
    InterlockError, FlowgraphError, ValueError
        One line.
    """
    scene = by_hand(scene)
    for name, endpoint in (("telemetry", telemetry), ("control", control)):
        check_endpoint(name, endpoint, network=network)
    if not sim:
        require_enclosure(scene, transmit)
    _, prepared = _generated(tuple(methods), scene.has_jammer, sim)
    path = write_scene(scene, prepared.module.parent / f"remote_{threading.get_native_id()}.yaml")
    options = {"scene_file": str(path), "telemetry": telemetry, "control": control}
    options |= {"network": int(network), "keep_alive_s": keep_alive_s}
    try:
        top = load_class(prepared)(**options, drop_when_slow=1, transmit=int(transmit))
    finally:
        path.unlink()
    try:
        if not sim:
            from gnuradio import uhd

            from .setup import set_up

            set_up(top, scene, uhd, log=log)
        log(f"telemetry {telemetry or 'off'}, control {control or 'off'}; a 'stop' request or Ctrl-C ends")
        return _run(top, stop or threading.Event())
    finally:
        top.remote_control.close()


def _run(top: Any, stop: threading.Event) -> dict[str, Any]:
    from ...blocks._guard import raise_stored

    top.start()
    waiter = threading.Thread(target=top.wait, daemon=True)
    waiter.start()
    try:
        while waiter.is_alive() and not stop.is_set():
            waiter.join(0.05)
    except KeyboardInterrupt:
        pass
    top.stop()
    waiter.join(10.0)
    if waiter.is_alive():
        raise FlowgraphError("the flowgraph did not stop within 10 s")
    raise_stored([b for b in vars(top).values() if hasattr(b, "work") or hasattr(b, "general_work")])
    return top.remote_control.state()
