"""The plan of `settings` carried out on UHD blocks: settings read back, lock sensors, time, a common start."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...core.scene import Scene
from ..flowgraph import FlowgraphError
from ..flowgraph.rewrite import RADAR_SINK, RADAR_SOURCE
from .settings import Step, plan, radio_blocks

_LOCK_S = 2.0  # longest lock of an LO or reference, s
_PPS_S = 1.5  # wait for a pulse, s: one comes every second
_GAIN_DB = 1.0  # largest error of a gain, dB: a radio's steps are finer
_ALIGNED_S = 0.5  # latest arming of both radios after a pulse, s: well before the next one


@dataclass(frozen=True)
class Readback:
    """A setting of a radio: value asked for and value set."""

    block: str
    what: str
    asked: float | str
    got: float | str

    def __str__(self) -> str:
        asked, got = (v if isinstance(v, str) else f"{v:.9g}" for v in (self.asked, self.got))
        return f"{self.block:18} {self.what:20} asked {asked:>16}   set {got:>16}"


def bring_up(top: Any, scene: Scene, uhd: Any, sleep: Callable[[float], None] = time.sleep) -> list[Readback]:
    """Carry out the plan on the UHD blocks of a flowgraph that is not yet started; returns what was read back.

    Steps for blocks that the flowgraph lacks are left out: a receiver alone has one. ``uhd`` is the module
    ``gnuradio.uhd``, ``sleep`` waits. Raises FlowgraphError if a rate or the master clock differs from the setting, a
    gain exceeds it, or a lock is missing.
    """
    readback = []
    blocks = [name for name in radio_blocks(scene) if hasattr(top, name)]
    for step in (s for s in plan(scene) if s.block in blocks):
        block, args = getattr(top, step.block), step.args
        if step.call == "set_center_freq":
            args = (uhd.tune_request(*args[0]), *args[1:])
        getattr(block, step.call)(*args)
        readback += _read_back(step, block)
    for name in blocks:
        clock = getattr(top, name).get_clock_rate(0)
        readback.append(Readback(name, "master clock Hz", scene.radio.master_clock_hz, clock))
    for entry in readback:
        exact = entry.what in ("rate S/s", "master clock Hz")
        if exact and not math.isclose(entry.asked, entry.got, rel_tol=1e-9):
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
        return [Readback(step.block, "gain dB", step.args[0], block.get_gain(step.args[1]))]
    if step.call == "set_antenna":
        return [Readback(step.block, "antenna", step.args[0], block.get_antenna(step.args[1]))]
    if step.call == "set_center_freq":
        return [Readback(step.block, "centre Hz", step.args[0][0], block.get_center_freq(step.args[1]))]
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
            sensors.append(("lo_locked", block.get_sensor, "frequency and LO offset"))
        else:
            missing.append(Readback(name, "lo_locked", "true", "no such sensor"))
        if scene.radio.clock_source != "internal":
            sensors.append(("ref_locked", block.get_mboard_sensor, "reference cable"))
        for sensor, read, remedy in sensors:
            waited = 0.0
            while not read(sensor, 0).to_bool():
                if waited >= _LOCK_S:
                    raise FlowgraphError(f"{name}: {sensor} is false after {_LOCK_S:g} s; check the {remedy}")
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
