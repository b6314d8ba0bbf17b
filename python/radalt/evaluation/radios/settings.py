"""Settings of the two B210s of a scene: a plan that needs no hardware, in the order that gives a repeatable range.

The order is clock and time source, rate, antenna, gain, frequency with the LO offset out of the band; `bring_up` waits
for the lock sensors afterwards and sets the time.
"""

from typing import Any, NamedTuple

from ...core.radio.interlock import InterlockError, require_enclosure
from ...core.radio.levels import drive, rx_level_dbm
from ...core.scene import Scene
from ..flowgraph.rewrite import JAMMER_SINK, RADAR_SINK, RADAR_SOURCE, SUBDEVICES


class Step(NamedTuple):
    """One call on one UHD block."""

    block: str  # name in the flowgraph
    call: str  # method of gr-uhd's block
    args: tuple[Any, ...]  # plain values; frequencies of ``set_center_freq`` are (centre, LO offset) in hertz


def radio_blocks(scene: Scene) -> tuple[str, ...]:
    """UHD blocks of a scene: radar sink and source, and the jammer's sink if there is one."""
    return (RADAR_SINK, RADAR_SOURCE, JAMMER_SINK) if scene.has_jammer else (RADAR_SINK, RADAR_SOURCE)


def plan(scene: Scene) -> tuple[Step, ...]:
    """Every setting of a scene's radios, in order; lock sensors, time and start come afterwards."""
    radio, w = scene.radio, scene.waveform
    blocks = radio_blocks(scene)
    # a device has one clock and one time, shared by source and sink of the radar
    devices = tuple(b for b in blocks if b != RADAR_SINK)
    antenna_and_gain = {
        RADAR_SINK: (radio.limits.tx_antenna, radio.radar_tx_gain_db),
        RADAR_SOURCE: (radio.limits.rx_antenna, radio.radar_rx_gain_db),
        JAMMER_SINK: (radio.limits.tx_antenna, radio.jammer_tx_gain_db),
    }
    steps = [Step(b, "set_clock_source", (radio.clock_source, 0)) for b in devices]
    steps += [Step(b, "set_time_source", (radio.clock_source, 0)) for b in devices]
    if scene.auxiliary is not None:
        steps.append(Step(RADAR_SOURCE, "set_subdev_spec", (SUBDEVICES, 0)))
    steps += [Step(b, "set_samp_rate", (w.rate_hz,)) for b in blocks]
    for block in blocks:
        antenna, gain_db = antenna_and_gain[block]
        gains_db = [gain_db]
        if block == RADAR_SOURCE and scene.auxiliary is not None:
            gains_db.append(radio.auxiliary_rx_gain_db)
            steps += [Step(block, "set_rx_agc", (False, channel)) for channel in (0, 1)]
        for channel, gain_db in enumerate(gains_db):
            steps.append(Step(block, "set_antenna", (antenna, channel)))
            steps.append(Step(block, "set_gain", (gain_db, channel)))
            steps.append(Step(block, "set_center_freq", ((w.carrier_hz, radio.lo_offset_hz), channel)))
    return tuple(steps)


def describe(scene: Scene) -> tuple[list[str], bool]:
    """The plan in words, and whether the interlock allows it with ``--transmit``."""
    radio, w, limits = scene.radio, scene.waveform, scene.radio.limits
    levels, divider = drive(scene), radio.master_clock_hz / w.rate_hz
    jammer, jammer_drive = "not needed: the scene has no jammer", ""
    if scene.has_jammer:
        serial = radio.jammer_serial or "(first found)"
        jammer = f"serial {serial}: {limits.tx_antenna} transmits {scene.interference_name}"
        level = f"{levels.jammer_dbm:.1f} dBm mean, full scale at {levels.jammer_full_scale:.3g}"
        jammer_drive = f"; jammer {level}"
    lines = [
        f"radar {limits.title:8}serial {radio.radar_serial or '(first found)'}: {limits.tx_antenna} transmits, "
        f"{limits.rx_antenna} receives",
        f"jammer {limits.title:7}{jammer}",
        f"master clock  {radio.master_clock_hz / 1e6:g} MHz, divided by {divider:g} to {w.rate_hz / 1e6:g} MS/s",
        f"sweep         {w.carrier_hz / 1e6:g} MHz, {w.rate_hz / 1e6:g} MHz wide, "
        f"LO {radio.lo_offset_hz / 1e6:g} MHz off",
        f"enclosure     {radio.enclosure}, {radio.attenuation_db:g} dB between transmitters and receiver",
        f"drive         radar {levels.radar_dbm:.1f} dBm mean, full scale at {levels.radar_full_scale:.3g}"
        f"{jammer_drive}",
        f"receiver      at most {rx_level_dbm(radio, scene.has_jammer):.1f} dBm arrives, "
        f"limit {limits.max_rx_dbm:g} dBm",
    ]
    if scene.auxiliary is not None:
        level_dbm = rx_level_dbm(radio, scene.has_jammer, radio.auxiliary_attenuation_db)
        lines.append(f"2nd channel   {limits.rx_antenna} of side B, at most {level_dbm:.1f} dBm arrives")
    if round(divider) > 1 and round(divider) % 2:
        lines.append(
            f"warning: the master clock is divided by {divider:.0f}, an odd number: a B200 then decimates without its "
            "half-band filters, and its CIC filter rolls off within the band; choose a clock divided by 2 or 4n"
        )
    if 2 * w.rate_hz > limits.link_hz:
        lines.append(
            f"warning: {w.rate_hz / 1e6:g} MS/s both ways are {8e-6 * w.rate_hz:.0f} MB/s; USB 3 carries some "
            f"{4e-6 * limits.link_hz:.0f} MB/s, {limits.link_hz / 2e6:g} MS/s both ways: expect lost samples"
        )
    lines += [f"{k:3}. {s.block}.{s.call}{s.args}" for k, s in enumerate(plan(scene), 1)]
    internal = radio.clock_source == "internal"
    lines += [
        f"     wait for lo_locked{'' if internal else ' and ref_locked'} on all",
        f"     {'set_time_now(0)' if internal else 'set_time_next_pps(0), same second'}; set_start_time on all; start",
    ]
    try:
        require_enclosure(scene, True)
    except InterlockError as error:
        return [*lines, str(error)], False
    return [*lines, "interlock: would transmit with --transmit"], True
