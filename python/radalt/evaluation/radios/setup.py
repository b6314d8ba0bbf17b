"""Set-up of two B210s: a plan made without hardware, carried out in the order that gives a repeatable range.

The order is clock and time source, rate, antenna, gain, frequency with the LO offset out of the band, lock sensors,
time, on both radios within one second, and a common start time. GRC's template sets time before tuning and no start
time, so that the range is random at each start. `set_up` therefore runs on its blocks before their start and replaces
its settings. The snippet ``set_up_radios`` calls it in flowgraphs from the companion, `hardware` and `remote` in those
from the command line.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...blocks.transmit_gate import gates_of, transmit_gate
from ...core.radio.calibration import CalibrationKey, load_latency_samples
from ...core.radio.interlock import InterlockError, require_enclosure
from ...core.radio.levels import drive, rx_level_dbm
from ...core.scene import Scene
from ..flowgraph import FlowgraphError
from ..flowgraph.rewrite import JAMMER_GATE, JAMMER_SINK, RADAR_GATE, RADAR_SINK, RADAR_SOURCE

__all__ = [
    "FULL_SCALE",
    "Readback",
    "Ready",
    "Step",
    "bring_up",
    "describe",
    "plan",
    "programme_over",
    "set_up",
    "start_together",
    "stop_after_programme",
]

FULL_SCALE = 1.0  # full scale of a UHD source's samples, per rail
_LOCK_S = 2.0  # longest lock of an LO or reference, s
_PPS_S = 1.5  # wait for a pulse, s: one comes every second
_CATCH_UP_S = 1.0  # longest delay of a slow method behind the receiver at the end, s of signal
_STARTED_S = 30.0  # longest time of a flowgraph from set-up to start, s
_POLL_S = 0.02  # time between checks of the programme's end, s
_GAIN_DB = 1.0  # largest error of a gain, dB: a radio's steps are finer
_ALIGNED_S = 0.5  # latest arming of both radios after a pulse, s: well before the next one


@dataclass(frozen=True)
class Step:
    """One call on one UHD block."""

    block: str  # name in the flowgraph
    call: str  # method of gr-uhd's block
    args: tuple[Any, ...]  # plain values; frequencies of ``set_center_freq`` are (centre, LO offset) in hertz


@dataclass(frozen=True)
class Readback:
    """A setting of a radio: value asked for and value set."""

    block: str
    what: str
    asked: float | str
    got: float | str

    def __str__(self) -> str:
        return f"{self.block:18} {self.what:20} asked {_text(self.asked):>16}   set {_text(self.got):>16}"


@dataclass(frozen=True)
class Ready:
    """Radios ready for their start."""

    start_s: float  # common start in device seconds
    # stored latency that the segmenter subtracts; None if there is none or it is not used
    latency_samples: float | None
    key: CalibrationKey  # radio, clock and rate of the latency


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.9g}"


def radio_blocks(scene: Scene) -> tuple[str, ...]:
    """UHD blocks of a scene: radar sink and source, and the jammer's sink if there is one."""
    return (RADAR_SINK, RADAR_SOURCE, JAMMER_SINK) if scene.has_jammer else (RADAR_SINK, RADAR_SOURCE)


def plan(scene: Scene) -> tuple[Step, ...]:
    """Every setting of a scene's radios, in order; lock sensors, time and start come afterwards."""
    radio, w = scene.radio, scene.waveform
    blocks = radio_blocks(scene)
    # a device has one clock and one time, shared by source and sink of the radar
    devices = tuple(b for b in blocks if b != RADAR_SINK)
    gain = {
        RADAR_SINK: radio.radar_tx_gain_db,
        RADAR_SOURCE: radio.radar_rx_gain_db,
        JAMMER_SINK: radio.jammer_tx_gain_db,
    }
    tx, rx = radio.limits.tx_antenna, radio.limits.rx_antenna
    antenna = {RADAR_SINK: tx, RADAR_SOURCE: rx, JAMMER_SINK: tx}
    steps = [Step(b, "set_clock_source", (radio.clock_source, 0)) for b in devices]
    steps += [Step(b, "set_time_source", (radio.clock_source, 0)) for b in devices]
    steps += [Step(b, "set_samp_rate", (w.rate_hz,)) for b in blocks]
    for block in blocks:
        steps.append(Step(block, "set_antenna", (antenna[block], 0)))
        steps.append(Step(block, "set_gain", (gain[block], 0)))
        steps.append(Step(block, "set_center_freq", ((w.carrier_hz, radio.lo_offset_hz), 0)))
    return tuple(steps)


def describe(scene: Scene) -> tuple[list[str], bool]:
    """The plan in words, and whether the interlock allows it with ``--transmit``."""
    radio, w = scene.radio, scene.waveform
    levels, limits = drive(scene), radio.limits
    lines = [
        f"radar {limits.title:8}serial {radio.radar_serial or '(first found)'}: {limits.tx_antenna} transmits, "
        f"{limits.rx_antenna} receives",
        f"jammer {limits.title:7}"
        + (
            f"serial {radio.jammer_serial or '(first found)'}: {limits.tx_antenna} transmits {scene.interference_name}"
            if scene.has_jammer
            else "not needed: the scene has no jammer"
        ),
        f"master clock  {radio.master_clock_hz / 1e6:g} MHz, divided by {radio.master_clock_hz / w.rate_hz:g} "
        f"to {w.rate_hz / 1e6:g} MS/s",
        f"sweep         {w.carrier_hz / 1e6:g} MHz, {w.rate_hz / 1e6:g} MHz wide, "
        f"LO {radio.lo_offset_hz / 1e6:g} MHz off",
        f"enclosure     {radio.enclosure}, {radio.attenuation_db:g} dB between transmitters and receiver",
        f"drive         radar {levels.radar_dbm:.1f} dBm mean, full scale at {levels.radar_full_scale:.3g}"
        + (
            f"; jammer {levels.jammer_dbm:.1f} dBm mean, full scale at {levels.jammer_full_scale:.3g}"
            if scene.has_jammer
            else ""
        ),
        f"receiver      at most {rx_level_dbm(radio, scene.has_jammer):.1f} dBm arrives, "
        f"limit {limits.max_rx_dbm:g} dBm",
    ]
    divider = round(radio.master_clock_hz / w.rate_hz)
    if divider > 1 and divider % 2:
        lines.append(
            f"warning: the master clock is divided by {divider}, an odd number: a B200 then decimates without its "
            "half-band filters, and its CIC filter rolls off within the band; choose a clock divided by 2 or 4n"
        )
    lines += [f"{k:3}. {s.block}.{s.call}{s.args}" for k, s in enumerate(plan(scene), 1)]
    pulse = "set_time_now(0)" if radio.clock_source == "internal" else "set_time_next_pps(0), same second"
    lines += [
        f"     wait for lo_locked{'' if radio.clock_source == 'internal' else ' and ref_locked'} on all",
        f"     {pulse}; set_start_time on all; start",
    ]
    try:
        require_enclosure(scene, True)
    except InterlockError as error:
        return [*lines, str(error)], False
    return [*lines, "interlock: would transmit with --transmit"], True


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
    """Set up a flowgraph with radios between its construction and its start.

    Checks the interlock again, calls `bring_up` with its readback, limits the jammer's bursts, sets the segmenter's
    full scale and calibration, and finally a common start time.

    Raises InterlockError, FlowgraphError, CalibrationError, one line; nothing has been started.

    Parameters
    ----------
    top : object
        Flowgraph with its UHD blocks, ``frame_segmenter`` and ``transmit`` as attributes.
    scene : Scene
    uhd : module
        ``gnuradio.uhd``.
    calibration : path, optional
        Calibration file, default `calibration_path`; a latency stored for this radio, clock and rate is subtracted
        unless ``use_calibration`` is false.
    log : callable
        Receives the readback, a line each.
    sleep : callable
        For waiting.

    Returns
    -------
    Ready
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
    segmenter = top.frame_segmenter
    segmenter.set_full_scale(FULL_SCALE)
    latency = None
    if use_calibration:
        latency = load_latency_samples(key, calibration)
    segmenter.set_calibration(latency)
    start_s = start_together(top, scene, uhd)
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
    for sink, gate in ((RADAR_SINK, RADAR_GATE), (JAMMER_SINK, JAMMER_GATE)):
        if hasattr(top, sink) and not isinstance(getattr(top, gate, None), transmit_gate):
            raise FlowgraphError(
                f"the flowgraph has no Transmit Gate {gate} before {sink}; put one of that name between source and sink"
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
    """Transmitting sinks of a running flowgraph with another input than their gate."""
    feeds: dict[str, set[str]] = {}
    for line in top.edge_list().splitlines():
        source, arrow, target = line.partition("->")
        if arrow:
            feeds.setdefault(target.rpartition(":")[0], set()).add(source.rpartition(":")[0])
    pairs = [(s, g) for s, g in ((RADAR_SINK, RADAR_GATE), (JAMMER_SINK, JAMMER_GATE)) if hasattr(top, s)]
    return [s for s, g in pairs if feeds.get(getattr(top, s).alias()) != {getattr(top, g).alias()}]


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
                f"stopped: {wrong[0]} is not fed by its Transmit Gate alone; connect the gate directly before the sink"
            )
            top.stop()

    threading.Thread(target=watch, daemon=True, name="radalt_edges").start()


def programme_over(top: Any, scene: Scene) -> bool:
    """Whether the programme's last frame has been received and measured; a receiver's stream is endless.

    A stop discards the frames between blocks, so a slow method gets a second of signal to catch up. Afterwards the last
    frame counts as lost: dropped, or never segmented for lack of timing.
    """
    programme, n = scene.altitude.programme, scene.waveform.samples_per_frame
    behind = top.frame_segmenter.segmenter.sample_counter - (programme.total_frames + 3) * n
    if behind < 0:
        return False
    sinks = [block for name, block in vars(top).items() if name.startswith("altimeter_")]
    return behind > scene.waveform.rate_hz * _CATCH_UP_S or all(
        not sink.active or sink.last_index >= programme.total_frames - 1 for sink in sinks
    )


def stop_after_programme(top: Any, scene: Scene) -> threading.Thread:
    """Start and return a thread that stops a flowgraph when its programme is over."""

    def watch() -> None:
        while not programme_over(top, scene):
            time.sleep(_POLL_S)
        top.stop()

    thread = threading.Thread(target=watch, daemon=True, name="radalt_end")
    thread.start()
    return thread


def bring_up(top: Any, scene: Scene, uhd: Any, sleep: Callable[[float], None] = time.sleep) -> list[Readback]:
    """Carry out the plan on the UHD blocks of a flowgraph that is not yet started.

    Raises FlowgraphError if a rate or the master clock differs from the setting, or a lock is missing.

    Parameters
    ----------
    top : object
        Flowgraph with the UHD blocks as attributes; the plan's steps for blocks that it lacks are left out.
    uhd : module
        ``gnuradio.uhd`` (time_spec and tune_request are taken from it).
    sleep : callable
        For waiting.

    Returns
    -------
    list of Readback
    """
    readback = []
    blocks = [name for name in radio_blocks(scene) if hasattr(top, name)]  # a receiver alone has one
    for step in (s for s in plan(scene) if s.block in blocks):
        block = getattr(top, step.block)
        args = step.args
        if step.call == "set_center_freq":
            args = (uhd.tune_request(*args[0]), *args[1:])
        getattr(block, step.call)(*args)
        readback += _read_back(step, block)
    for name in blocks:
        clock = getattr(top, name).get_clock_rate(0)
        readback.append(Readback(name, "master clock Hz", scene.radio.master_clock_hz, clock))
    for entry in readback:
        if entry.what in ("rate S/s", "master clock Hz") and not math.isclose(
            entry.asked, entry.got, rel_tol=1e-9
        ):
            raise FlowgraphError(
                f"{entry.block}: {entry.what} is {entry.got:.9g}, asked was {entry.asked:.9g}; "
                "choose a master clock that divides to the rate by a whole number"
            )
        if entry.what == "gain dB" and entry.got > entry.asked + _GAIN_DB:
            raise FlowgraphError(
                f"{entry.block}: {entry.what} is {entry.got:g}, asked was {entry.asked:g}; the level at the receiver "
                "was computed for what was asked: choose a gain that the radio has"
            )
    readback += _wait_for_locks(top, scene, blocks, sleep)
    _align_time(top, scene, uhd, blocks, sleep)
    return readback


def _read_back(step: Step, block: Any) -> list[Readback]:
    if step.call == "set_samp_rate":
        return [Readback(step.block, "rate S/s", step.args[0], block.get_samp_rate())]
    if step.call == "set_gain":
        return [Readback(step.block, "gain dB", step.args[0], block.get_gain(0))]
    if step.call == "set_antenna":
        return [Readback(step.block, "antenna", step.args[0], block.get_antenna(0))]
    if step.call == "set_center_freq":
        return [Readback(step.block, "centre Hz", step.args[0][0], block.get_center_freq(0))]
    return []


def _wait_for_locks(
    top: Any, scene: Scene, blocks: Sequence[str], sleep: Callable[[float], None]
) -> list[Readback]:
    """Wait for every lock sensor there is; returns what was asked of a device that has no ``lo_locked``."""
    missing = []
    for name in blocks:
        block = getattr(top, name)
        sensors = []
        if "lo_locked" in block.get_sensor_names(0):
            sensors.append(("lo_locked", lambda b: b.get_sensor("lo_locked", 0)))
        else:
            missing.append(Readback(name, "lo_locked", "true", "no such sensor"))
        if scene.radio.clock_source != "internal":
            sensors.append(("ref_locked", lambda b: b.get_mboard_sensor("ref_locked", 0)))
        for sensor, read in sensors:
            waited = 0.0
            while not read(block).to_bool():
                if waited >= _LOCK_S:
                    raise FlowgraphError(
                        f"{name}: {sensor} is false after {_LOCK_S:g} s; check the "
                        + ("reference cable" if sensor == "ref_locked" else "frequency and LO offset")
                    )
                sleep(0.05)
                waited += 0.05
    return missing


def _align_time(
    top: Any, scene: Scene, uhd: Any, blocks: Sequence[str], sleep: Callable[[float], None]
) -> None:
    """Set time zero on every device, after all other settings."""
    devices = [getattr(top, b) for b in blocks if b != RADAR_SINK]
    if scene.radio.clock_source == "internal":
        for device in devices:
            device.set_time_now(uhd.time_spec(0.0), 0)
        return
    first = devices[0]
    edge, waited = first.get_time_last_pps(0).get_real_secs(), 0.0
    while first.get_time_last_pps(0).get_real_secs() == edge:
        if waited >= _PPS_S:
            raise FlowgraphError(
                f"no PPS pulse in {_PPS_S:g} s on {scene.radio.clock_source} time; check the cable, or use "
                "radio.clock_source: internal"
            )
        sleep(0.01)
        waited += 0.01
    begin = first.get_time_now(0).get_real_secs()
    for device in devices:
        device.set_time_next_pps(uhd.time_spec(0.0))
    if first.get_time_now(0).get_real_secs() - begin > _ALIGNED_S:
        raise FlowgraphError("the radios were not armed within one second of a pulse; start again")
    sleep(1.1)
    seconds = [device.get_time_last_pps(0).get_real_secs() for device in devices]
    if len(set(seconds)) > 1:
        raise FlowgraphError(
            f"the radios' seconds differ after a common pulse: {seconds}; check the PPS cables"
        )


def start_together(top: Any, scene: Scene, uhd: Any) -> float:
    """Set a common start time on every block, a second ahead; returns it in device seconds."""
    now = getattr(top, RADAR_SOURCE).get_time_now(0).get_real_secs()
    at = float(math.floor(now) + 2)
    for name in (b for b in radio_blocks(scene) if hasattr(top, b)):
        getattr(top, name).set_start_time(uhd.time_spec(at))
    return at
