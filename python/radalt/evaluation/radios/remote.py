"""The endless flowgraph for remote control: ota_b210.grc with altitudes by hand and a control socket."""

import contextlib
import functools
import threading
from collections.abc import Callable, Sequence
from typing import Any

from ...core.radio.endpoint import check_endpoint
from ...core.radio.interlock import require_enclosure
from ...core.scene import Scene
from ...core.scene.live import by_hand
from ..flowgraph.generate import Prepared, generated_here, shipped
from ..flowgraph.rewrite import prune, remote, simulate, with_second_channel
from ..flowgraph.run import load_class, run_to_end


@functools.lru_cache(maxsize=4)
def _prepared(methods: tuple[str, ...], jammer: bool, sim: bool, two: bool) -> Prepared:
    name = f"ota_remote_{'sim' if sim else 'air'}_{'jam' if jammer else 'clear'}{'_two' if two else ''}"
    data = simulate(shipped(), name, realtime=True) if sim else shipped()
    data = remote(prune(data, methods, jammer), name)
    return Prepared(generated_here(with_second_channel(data) if two else data), methods)


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
    """Run in real time until a ``stop`` request or the event ``stop``; returns the last state.

    The scene gives interference, channel and limits; its programme is not used. Endpoints are ZMQ's, empty for none;
    the other options are those of `remote_control`. Raises InterlockError, FlowgraphError, ValueError, one line.
    """
    scene = by_hand(scene)
    for name, endpoint in (("telemetry", telemetry), ("control", control)):
        check_endpoint(name, endpoint, network=network)
    if not sim:
        require_enclosure(scene, transmit)
    prepared = _prepared(tuple(methods), scene.has_jammer, sim, scene.auxiliary is not None)
    options = {"telemetry": telemetry, "control": control, "drop_when_slow": int(not sim)}
    options |= {"network": int(network), "keep_alive_s": keep_alive_s}
    options |= {} if sim else {"transmit": int(transmit)}
    top = load_class(prepared)(scene_file=scene, **options)
    try:
        if not sim:
            from gnuradio import uhd

            from .setup import set_up

            set_up(top, scene, uhd, log=log)
        log(f"telemetry {telemetry or 'off'}, control {control or 'off'}; a 'stop' request or Ctrl-C ends")
        with contextlib.suppress(KeyboardInterrupt):
            run_to_end(top, over=None if stop is None else stop.is_set)
        return top.remote_control.state()
    finally:
        top.remote_control.close()
