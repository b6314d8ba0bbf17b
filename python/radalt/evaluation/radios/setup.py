"""Set-up of a flowgraph with two B210s between its construction and its start, and its end after the programme.

GRC's template sets time before tuning and no start time, so that the range is random at each start. `set_up` replaces
its settings. The snippet ``set_up_radios`` calls it in flowgraphs from the companion, `hardware` and `remote` in those
from the command line.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from ...blocks.transmit_gate import gates_of, transmit_gate
from ...core.radio.calibration import CalibrationKey, load_latency_samples
from ...core.radio.interlock import require_enclosure
from ...core.radio.levels import drive
from ...core.scene import Scene
from ..flowgraph import FlowgraphError
from ..flowgraph.rewrite import CANCELLER, JAMMER_GATE, JAMMER_SINK, RADAR_GATE, RADAR_SINK, RADAR_SOURCE
from .bring_up import bring_up, start_together
from .settings import radio_blocks

FULL_SCALE = 1.0  # full scale of a UHD source's samples, per rail
_CATCH_UP_S = 1.0  # longest delay of a slow method behind the receiver at the end, s of signal
_STARTED_S = 30.0  # longest time of a flowgraph from set-up to start, s
_POLL_S = 0.02  # time between checks of the programme's end, s
_GATED = ((RADAR_SINK, RADAR_GATE), (JAMMER_SINK, JAMMER_GATE))


class Ready(NamedTuple):
    """Radios ready for their start."""

    start_s: float  # common start in device seconds
    latency_samples: float | None  # that the segmenter subtracts; None if none is stored or it is not used
    key: CalibrationKey  # radio, clock and rate of the latency


def set_up(
    top: Any,
    scene: Scene,
    uhd: Any,
    *,
    calibration: Path | str | None = None,
    use_calibration: bool = True,
    log: Callable[[str], None] = print,
    sleep: Callable[[float], None] = time.sleep,
) -> Ready:
    """Set up a flowgraph with radios: interlock, `bring_up`, limit of bursts, full scale, latency, common start.

    A latency stored for this radio, clock and rate is subtracted unless ``use_calibration`` is false; ``log`` receives
    the readback, a line each. Raises InterlockError, FlowgraphError, CalibrationError, one line; nothing has been
    started.
    """
    require_enclosure(scene, bool(top.transmit))
    _check_blocks(top, scene)
    key = _check_radios(top, scene)
    for entry in bring_up(top, scene, uhd, sleep):
        log(str(entry))
    levels = drive(scene)
    getattr(top, RADAR_GATE).gate.full_scale = levels.radar_full_scale
    if scene.has_jammer:
        top.jammer_source.hold_drive()
        getattr(top, JAMMER_GATE).gate.full_scale = levels.jammer_full_scale
    latency = load_latency_samples(key, calibration) if use_calibration else None
    start_s = start_together(top, scene, uhd)
    segmenter = top.frame_segmenter
    segmenter.set_full_scale(FULL_SCALE)
    segmenter.set_calibration(latency)
    segmenter.set_start_time(start_s)
    _watch_edges(top, log)
    return Ready(start_s, latency, key)


def _check_radios(top: Any, scene: Scene) -> CalibrationKey:
    """Refuse radios of another type than the scene's, whose limits would not hold; returns the radar's key."""
    wanted = scene.radio.limits
    for name in radio_blocks(scene):
        info = getattr(top, name).get_usrp_info(0)
        if info["mboard_id"] != wanted.uhd_name:
            raise FlowgraphError(
                f"{name}: the radio is a {info['mboard_id']}, and radio.device {wanted.name} a {wanted.uhd_name}; name "
                "the radio that is there, or the serial of the one that is meant"
            )
    reported = getattr(top, RADAR_SOURCE).get_usrp_info(0)["mboard_serial"]
    serial = scene.radio.radar_serial if reported in ("", "n/a") else reported
    return CalibrationKey(wanted.uhd_name, serial, scene.radio.master_clock_hz, scene.waveform.rate_hz)


def _check_blocks(top: Any, scene: Scene) -> None:
    """Refuse a flowgraph without gates, or with another jammer than the scene's: a radio without set-up would start."""
    for sink, gate in _GATED:
        if hasattr(top, sink) and not isinstance(getattr(top, gate, None), transmit_gate):
            raise FlowgraphError(
                f"the flowgraph has no Transmit Gate {gate} before {sink}; put one of that name between source and sink"
            )
    if hasattr(top, CANCELLER) != (scene.auxiliary is not None):
        raise FlowgraphError(
            f"of scene and flowgraph one has a second receive channel: the scene by its section auxiliary, the "
            f"flowgraph by its block {CANCELLER}; run ota_eval.py, which makes the flowgraph of the scene"
        )
    if hasattr(top, JAMMER_SINK) == scene.has_jammer:
        return
    if scene.has_jammer:
        raise FlowgraphError(
            f"the scene has a jammer and the flowgraph has no block {JAMMER_SINK}; enable it, its gate and its source, "
            "or name a scene without interference"
        )
    raise FlowgraphError(
        f"the scene has no jammer and the flowgraph has the block {JAMMER_SINK}; disable it, its gate and its source "
        "in the companion, or run ota_eval.py, which leaves them out"
    )


def ungated_sinks(top: Any) -> list[str]:
    """Transmitting sinks of a running flowgraph with another input than their gate, and those that have none."""
    feeds: dict[str, set[str]] = {}
    for line in top.edge_list().splitlines():
        source, arrow, target = line.partition("->")
        if arrow:
            feeds.setdefault(target.rpartition(":")[0], set()).add(source.rpartition(":")[0])
    known = {getattr(top, sink).alias(): (sink, gate) for sink, gate in _GATED if hasattr(top, sink)}
    kinds = tuple(getattr(top, sink).name() for sink, _ in known.values())
    wrong = {target for target in feeds if target.startswith(kinds)} - known.keys()
    own = {alias: {getattr(top, gate).alias()} for alias, (_, gate) in known.items()}
    return sorted(wrong) + [sink for alias, (sink, _) in known.items() if feeds.get(alias) != own[alias]]


def _watch_edges(top: Any, log: Callable[[str], None]) -> None:
    """Stop a flowgraph whose sinks are not connected to their gates.

    Edges are known once it runs. Its radios start by the clock, at least a second later (`start_together`).
    """

    wait = threading.Event().wait

    def watch() -> None:
        until = time.monotonic() + _STARTED_S
        while not top.edge_list() and time.monotonic() < until:
            wait(_POLL_S)
        wrong = ungated_sinks(top) if top.edge_list() else []
        if wrong:
            for gate in gates_of(top):
                gate.close(f"transmit stopped: {wrong[0]} is not fed by its Transmit Gate")
            log(
                f"stopped: {wrong[0]} is not fed by its Transmit Gate alone; connect {RADAR_GATE} and {JAMMER_GATE} "
                "directly before their sinks, and no other sink"
            )
            top.stop()

    threading.Thread(target=watch, daemon=True, name="radalt_edges").start()


def programme_over(top: Any, scene: Scene) -> bool:
    """Whether the programme's last frame has been received and measured; a receiver's stream is endless.

    A stop discards the frames between blocks, so a slow method gets a second of signal to catch up. Afterwards the
    last frame counts as lost: dropped, or never segmented for lack of timing.
    """
    programme, n = scene.altitude.programme, scene.waveform.samples_per_frame
    behind = top.frame_segmenter.segmenter.sample_counter - (programme.total_frames + 3) * n
    if behind < 0:
        return False
    sinks = [block for name, block in vars(top).items() if name.startswith("altimeter_")]
    last = programme.total_frames - 1
    measured = all(not sink.active or sink.last_index >= last for sink in sinks)
    return measured or behind > scene.waveform.rate_hz * _CATCH_UP_S


def stop_after_programme(top: Any, scene: Scene) -> threading.Thread:
    """Start and return a thread that stops a flowgraph when its programme is over."""

    def watch() -> None:
        while not programme_over(top, scene):
            time.sleep(_POLL_S)
        top.stop()

    thread = threading.Thread(target=watch, daemon=True, name="radalt_end")
    thread.start()
    return thread
