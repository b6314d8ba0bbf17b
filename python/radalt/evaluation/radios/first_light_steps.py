"""What each step of the first hour measures; limits and causes are in first_light.yaml."""

import dataclasses
import re
from collections.abc import Iterator

import numpy as np

from ...core.channel.settings import ChannelSettings
from ...core.radio.path_measures import (
    burst_share,
    clipped_percent,
    db,
    mean_power,
    ripple_and_image,
    strongest_lines,
)
from ...core.scene import Scene
from ..flowgraph.rewrite import RADAR_GATE
from ..results.score import score
from ..simulation import run_chain
from .first_light import Bench, Flight, Measure, Measured, simulated_samples

_HEARD_DB = 3.0  # above the noise: something arrives
_LISTENED = 40  # frames
_ALTITUDES_M = (10.0, 30.0, 100.0, 300.0, 1000.0, 1500.0)
_OVERLAPS, _METHODS = (0.25, 0.5, 1.0), ("none", "whitening", "tcae")
_WIRE_BYTES = 4  # of a complex sample between host and radio


def _devices(bench: Bench) -> Iterator[Measured]:
    if bench.simulated:
        yield Measured("found", None, cause="simulated channel")
        return
    from gnuradio import uhd

    from . import hardware

    radio, rate_hz = bench.scene.radio, bench.scene.waveform.rate_hz
    texts = [d.to_string() for d in uhd.find(uhd.device_addr(f"type={radio.limits.uhd_type}"))]
    found = [serial for text in texts for serial in re.findall(r"serial=(\w+)", text)]
    wanted = [radio.radar_serial, radio.jammer_serial][: 1 + bench.scene.has_jammer]
    bench.serials |= {*found, *wanted}
    lacking = " ".join(serial for serial in wanted if serial and serial not in found)
    cause = f"no radio {lacking}: UHD found {' '.join(found) or 'none'}; check cable, power, serials"
    yield Measured("found", 0 if lacking else min(len(texts), len(wanted)), cause=cause, low=len(wanted))
    for role, serial, ways in zip(("radar", "jammer"), wanted, (2, 1), strict=False):
        speed = hardware.link_bytes_per_s(serial or (found or [""])[0])
        if speed is None:
            yield Measured(
                "link", None, role, "uhd_usrp_probe (package uhd-host) does not say; see lost samples"
            )
        else:
            yield Measured("link", speed / 1e6, role, low=ways * rate_hz * _WIRE_BYTES / 1e6)


def _receiver(bench: Bench) -> Iterator[Measured]:
    frames = bench.listen(_LISTENED)
    noise = mean_power(frames)
    dc, line, at_hz = strongest_lines(frames, bench.scene.waveform.rate_hz)
    yield from (
        Measured("noise", db(noise)),
        Measured("dc", dc),
        Measured("line", line, f"{at_hz / 1e3:+.0f} kHz"),
    )
    if noise > 0:
        bench.known["noise"] = noise


def _counters(*flights: Flight) -> Iterator[Measured]:
    """What the transmitters reported, what was lost on the way, and how much of what was recorded is clipped."""
    for key, name in (("late", "tx_late"), ("underflows", "tx_underflows"), ("lost", "lost_samples")):
        yield Measured(key, sum(int(f.result.segmenter.get(name, 0)) for f in flights))
    recorded = [clipped_percent(f.samples) for f in flights if f.samples.size]
    if recorded:
        yield Measured("clipped", max(recorded))


def _radar(bench: Bench) -> Iterator[Measured]:
    scene = bench.programme(300.0)
    flight = bench.fly(scene, capture="radar")
    known = bool(np.isfinite(flight.latency))
    last = scene.altitude.preamble_frames + bench.frames
    heard = flight.frames(2, last) if known else flight.samples
    level, noise = mean_power(heard), bench.known["noise"]
    yield from _counters(flight)
    above = db(level) - db(noise)
    yield Measured("above", above, cause=_who_receives(bench, scene) if above < _HEARD_DB else "")
    yield from (Measured("level", db(level)), Measured("lock", float(known)))
    if not known:
        return
    bench.known |= {"level": level, "latency": flight.latency}
    right = score(flight.result.results["none"], scene.altitude.programme)
    yield from (Measured("flat", _ripple_and_image(flight)[0]), Measured("right", right.pd))
    centred = bench.fly(bench.programme(300.0, frames=1, **bench.lo_centred), capture="radar_lo_centred")
    yield Measured("image", _ripple_and_image(centred)[1] if np.isfinite(centred.latency) else np.nan)


def _ripple_and_image(flight: Flight) -> tuple[float, float]:
    sweeps = flight.frames(1, flight.scene.altitude.preamble_frames - 1)
    return ripple_and_image(flight.scene.waveform, sweeps, flight.latency % 1.0, first=1)


def _who_receives(bench: Bench, scene: Scene) -> str:
    """Nothing arrives: whether it does with both radios exchanged."""
    radio = scene.radio
    if bench.scene.has_jammer and not bench.simulated:
        serials = {"radar_serial": radio.jammer_serial, "jammer_serial": radio.radar_serial}
        other = dataclasses.replace(scene, radio=dataclasses.replace(radio, **serials))
        heard = bench.fly(other, capture="radar_exchanged").samples
        if db(mean_power(heard)) - db(bench.known["noise"]) >= _HEARD_DB:
            return "the other radio receives: cables swapped between the radios, or serials exchanged"
    return "nothing arrives: dead antenna port or cable, RX2 not connected, or the transmitter's port open"


def _muted(bench: Bench) -> Iterator[Measured]:
    """Zeros through an open transmitter, with the LO inside the band."""
    w = bench.scene.waveform
    radio = dataclasses.replace(bench.scene.radio, lo_offset_hz=w.rate_hz / 8)
    heard = bench.fly(bench.programme(0.0, radio=radio), capture="muted", silent=(RADAR_GATE,)).samples
    frames = heard.reshape(-1, w.samples_per_frame)[1:]
    frames = frames[np.isfinite(frames).all(axis=1)]
    if not len(frames):
        yield Measured("rest", np.nan, cause="no whole frame was received")
        return
    dc, line, at_hz = strongest_lines(frames, w.rate_hz)
    yield Measured(
        "leakage", max(dc, line) - db(bench.known["level"]), f"{at_hz / 1e3:+.0f} kHz" if line > dc else "DC"
    )
    yield Measured("rest", db(mean_power(frames)) - db(bench.known["noise"]))


def _starts(bench: Bench) -> Iterator[Measured]:
    """Latencies of several starts, for this master clock and for others that divide to the rate."""
    radio, rate_hz = bench.scene.radio, bench.scene.waveform.rate_hz
    low, high = radio.limits.master_clock_hz
    others = [
        k * rate_hz for k in (2, 4, 6, 8) if k * rate_hz != radio.master_clock_hz and not bench.simulated
    ]
    fit = [c for c in others if low <= c <= high and abs(radio.lo_offset_hz) <= 0.5 * (c - rate_hz)]
    for clock_hz in (radio.master_clock_hz, *fit):
        count = bench.starts if clock_hz == radio.master_clock_hz else min(bench.starts, 3)
        # another seed is other noise in simulation; on the air it changes nothing that is sent
        same = {"frames": 1, "radio": dataclasses.replace(radio, master_clock_hz=clock_hz)}
        seeds = range(bench.scene.seed, bench.scene.seed + count)
        found = [bench.fly(bench.programme(300.0, seed=seed, **same)).latency for seed in seeds]
        detail = f"{np.mean(found):.2f} at {clock_hz / 1e6:g} MHz, {count} starts"
        yield Measured("spread", float(np.ptp(found)), detail)


def _reference(bench: Bench, scene: Scene) -> Scene:
    """The scene in the simulated channel at the bench's SNR, with another seed than a simulated bench."""
    snr_db = min(40.0, db(bench.known["level"]) - db(bench.known["noise"]))
    return dataclasses.replace(scene, channel=ChannelSettings(snr_db=snr_db), seed=scene.seed + 1)


def _altitudes(bench: Bench) -> Iterator[Measured]:
    scene = bench.programme(*_ALTITUDES_M)
    flown = bench.fly(scene, capture="altitudes").result
    simulated = run_chain(_reference(bench, scene), ("none",))
    for altitude_m in _ALTITUDES_M:
        found = []
        for result in (flown, simulated):
            frames = result.results["none"]
            sent = scene.altitude.programme.altitude_m(frames["frame_index"])
            here = frames["altitude_m"][(sent == altitude_m) & frames["valid"]]
            found.append(float(np.median(here)) if here.size else np.nan)
        yield Measured("error", abs(found[0] - found[1]), f"{altitude_m:g} m: {found[0]:.2f} m,")


def _radar_db(bench: Bench, scene: Scene) -> float:
    """dBFS at which the radar has to arrive in a scene, by its level alone and both drives."""
    alone = db(bench.known["level"] - bench.known["noise"])
    return alone + bench.drive_db(scene) - bench.drive_db(bench.programme(300.0))


def _jammer(bench: Bench) -> Iterator[Measured]:
    """The radar silent: the interference's power against the radar's alone, and its share of the time."""
    scene = bench.programme(300.0, jammer=True).at(overlap=0.5)
    flight = bench.fly(scene, capture="jammer", silent=(RADAR_GATE,))
    yield from _counters(flight)
    first, noise = scene.altitude.preamble_frames, bench.known["noise"]
    played = flight.frames(first + 1, first + bench.frames - 1, bench.known["latency"])
    sir_db = _radar_db(bench, scene) - db(mean_power(played) - noise)
    yield Measured("sir", sir_db - scene.sir_db, f"{scene.sir_db:g}")
    # of the same interference in simulation: sweeps and pulses do not fill their bursts
    ideal = dataclasses.replace(_reference(bench, scene), seed=scene.seed)
    n = scene.waveform.samples_per_frame
    sent = simulated_samples(ideal, radar_sends=False)[(first + 1) * n : (first + bench.frames - 1) * n]
    share = burst_share(sent, 10.0 ** (-ideal.channel.snr_db / 10.0))
    yield Measured("share", burst_share(played.ravel(), noise) - share, f"{share:.3f}")


def _both(bench: Bench) -> Iterator[Measured]:
    flights: list[Flight] = []
    for overlap in _OVERLAPS:
        scene = bench.programme(300.0, 100.0, 30.0, jammer=True).at(overlap=overlap)
        flights.append(bench.fly(scene, _METHODS, capture=f"both_{overlap:g}"))
        simulated = run_chain(_reference(bench, scene), _METHODS)
        for method in _METHODS:
            results = (flights[-1].result.results[method], simulated.results[method])
            here, there = (score(r, scene.altitude.programme) for r in results)
            lowest = there.interval[0] - (here.interval[1] - here.pd)  # both intervals overlap
            yield Measured(
                "pd", here.pd, f"overlap {overlap:g}, {method}; simulated {there.pd:.2f}", low=lowest
            )
    yield from _counters(*flights)
    if np.isfinite(flights[-1].latency):
        alone = mean_power(flights[-1].frames(2, scene.altitude.preamble_frames - 1)) - bench.known["noise"]
        yield Measured("scale", db(alone) - _radar_db(bench, scene))


def _endurance(bench: Bench) -> Iterator[Measured]:
    count = max(40, round(bench.minutes * 60.0 / bench.scene.waveform.sweep_s))
    scene = bench.programme(300.0, frames=count, jammer=bench.scene.has_jammer)
    if bench.scene.has_jammer:  # both radios stream throughout; most frames stay clear for the drift
        scene = scene.at(overlap=_OVERLAPS[0])
    flight = bench.fly(scene, time_limit_s=4 * count * scene.waveform.sweep_s + 30.0)
    yield from _counters(flight)
    counted, frames = flight.result.segmenter, flight.result.results["none"]
    yield Measured("losses", counted["lock_losses"])
    yield Measured("dropped", counted.get("dropped_slow", 0))
    good = frames["altitude_m"][frames["valid"] & scene.altitude.programme.is_trial(frames["frame_index"])]
    quarter = good.size // 4
    yield Measured(
        "drift", float(np.median(good[-quarter:]) - np.median(good[:quarter])) if quarter else np.nan
    )


_ALL = (_devices, _receiver, _radar, _muted, _starts, _altitudes, _jammer, _both, _endurance)
MEASURES: dict[str, Measure] = {step.__name__.lstrip("_"): step for step in _ALL}
