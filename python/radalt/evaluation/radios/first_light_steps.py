"""Steps of the first hour, in order: each yields measured values, their limits, and the likely cause of a failure."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import shutil
import subprocess
from collections.abc import Iterator

import numpy as np

from ...core.channel.simulated import ChannelSettings
from ...core.scene import Scene
from ..flowgraph.rewrite import RADAR_GATE
from ..results.score import score
from ..simulation import run_chain
from .first_light import Bench, Check, Flight, Step, skipped

__all__ = ["STEPS"]

# Limits. Powers in dBFS count a complex sample of magnitude 1 (a full-scale tone) as 0 dB.
_QUIET_DBFS = (
    -110.0,
    -40.0,
)  # noise without a signal: a 12-bit converter's is near -74; zeros are below, signals above
_DC_DBFS = -40.0  # before UHD's correction of an AD9361 it may be -30
_SPUR_DBFS = -60.0  # beat of a return 40 dB below a radar at -20 dBFS
_LEVEL_DBFS = (-40.0, -3.0)  # received radar: above the spurs by 20 dB, below full scale
# least received power over noise: for any signal, and for timing to a hundredth of a sample
_HEARD_DB, _ABOVE_NOISE_DB = 3.0, 20.0
_RIPPLE_DB = 3.0  # over the inner 80 % of the band, outside of which the radios' half-band filters roll off
_IMAGE_DBC = -25.0  # AD9361 data sheet: -50 dBc calibrated; -25 is that of a calibration that did not run
_LEAKAGE_DBC = -20.0  # largest power of a muted transmitter over the radar's: LO leakage
_SPREAD_SAMPLES = 0.05  # 1 m of altitude
_OFF_M = 1.0  # between bench and simulation, in the median
_LEVEL_ERROR_DB, _OVERLAP_ERROR = (
    1.0,
    0.05,
)  # largest errors of a level, as of a radio's gain, and of an overlap
_DRIFT_M = 0.5  # over the last step
_INNER = 0.8  # part of the band for flatness: the radios' half-band filters roll off outside
_LISTENED, _PIECES, _SMOOTH = 40, 30, 75  # frames; pieces of a half sweep; samples of an envelope's mean
_ALTITUDES_M = (10.0, 30.0, 100.0, 300.0, 1000.0, 1500.0)  # over the default span, evenly in the logarithm
_OVERLAPS = (0.25, 0.5, 1.0)  # of the comparison with the simulation
_METHODS = ("none", "whitening", "tcae")
_WIRE_BYTES = 4  # bytes per complex sample between host and radio
_PROBE_S = 60.0  # longest run of uhd_usrp_probe, s


def _db(power: float) -> float:
    return float(10.0 * np.log10(max(float(power), 1e-30)))


def _power(samples: np.ndarray) -> float:
    """Mean power of the finite samples."""
    there = samples[np.isfinite(samples)]
    return float(np.mean(np.abs(there) ** 2)) if there.size else 0.0


def _strongest_line(frames: np.ndarray) -> tuple[float, float, float]:
    """(dBFS of DC, dBFS of the strongest other line, its cycles per sample) of (k, N) frames; Hann window."""
    n = frames.shape[1]
    window = np.hanning(n)
    power = np.mean(np.abs(np.fft.fft(frames * window, axis=1) / window.sum()) ** 2, axis=0)
    power -= np.median(power)  # the noise in a bin
    dc = power[[-1, 0, 1]].max()
    power[[-2, -1, 0, 1, 2]] = 0.0
    return _db(dc), _db(power.max()), float(np.fft.fftfreq(n)[power.argmax()])


def _link_bytes_per_s(serial: str) -> float | None:
    """Rate of the radio's link by the driver, bytes per second: 53.2e6 on USB 2; None if not reported."""
    program = shutil.which("uhd_usrp_probe")
    if program is None:
        return None
    command = [program, f"--args=serial={serial}", "--double=/mboards/0/link_max_rate"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        out = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_S, check=True).stdout
        found = re.findall(r"^[\d.e+]+$", out, re.MULTILINE)
        return float(found[-1]) if found else None
    return None


def _devices(bench: Bench) -> Iterator[Check]:
    if bench.simulated:
        yield skipped("devices", "radios found", "simulated channel")
        return
    from gnuradio import uhd

    radio, rate_hz = bench.scene.radio, bench.scene.waveform.rate_hz
    texts = [d.to_string() for d in uhd.find(uhd.device_addr(f"type={radio.limits.uhd_type}"))]
    found = [serial for text in texts for serial in re.findall(r"serial=(\w+)", text)]
    wanted = [radio.radar_serial, radio.jammer_serial][: 1 + bench.scene.has_jammer]
    lacking = [serial for serial in wanted if serial and serial not in found]
    cause = f"no radio {', '.join(lacking)}: UHD found {', '.join(found) or 'none'}; check cable, power and serials"
    there = 0 if lacking else min(len(texts), len(wanted))
    yield Check("devices", "radios found", there, "", len(wanted), cause=cause)
    for role, serial, ways in zip(("radar", "jammer"), wanted, (2, 1), strict=False):
        speed = _link_bytes_per_s(serial or (found or [""])[0])
        if speed is None:
            yield skipped(
                "devices", f"link of the {role}", "uhd_usrp_probe does not say; see lost samples below"
            )
        else:
            needed = ways * rate_hz * _WIRE_BYTES / 1e6
            cause = "a USB 2 port, hub or cable; use USB 3 ports of different controllers"
            yield Check("devices", f"link of the {role}", speed / 1e6, "MB/s", needed, cause=cause)


def _receiver(bench: Bench) -> Iterator[Check]:
    frames = bench.listen(_LISTENED)
    noise = _power(frames)
    dc, line, cycles = _strongest_line(frames)
    low, high = _QUIET_DBFS
    frozen = (
        "zeros: the receiver is frozen"
        if _db(noise) < low
        else "something transmits, or radar_rx_gain_db is too high"
    )
    yield Check("receiver", "noise", _db(noise), "dBFS", low, high, frozen)
    yield Check(
        "receiver",
        "DC",
        dc,
        "dBFS",
        high=_DC_DBFS,
        cause="DC correction of the receiver did not run (UHD issue 892)",
    )
    at_khz = cycles * bench.scene.waveform.rate_hz / 1e3
    yield Check(
        "receiver",
        f"strongest line, at {at_khz:+.0f} kHz",
        line,
        "dBFS",
        high=_SPUR_DBFS,
        cause="a spur, or a signal outside",
    )
    if low <= _db(noise) <= high:
        bench.known["noise"] = noise


def _clipped(samples: np.ndarray) -> float:
    """Share of samples with a rail at full scale, percent."""
    rails = samples[np.isfinite(samples)].view(np.float32)
    return float(200.0 * np.mean(np.abs(rails) >= 0.998)) if rails.size else 0.0


def _radar(bench: Bench) -> Iterator[Check]:
    scene = bench.programme(300.0)
    flight = bench.fly(scene, capture="radar")
    first = scene.altitude.preamble_frames
    known = np.isfinite(flight.latency)
    heard = (
        flight.frames(2, first + bench.frames)
        if known
        else flight.samples[2 * scene.waveform.samples_per_frame :]
    )
    level = _power(heard)
    yield from _counters("radar", flight)
    above = _db(level) - _db(bench.known["noise"])
    cause = "too little arrives: more attenuation than stated, or too little gain; compare with radio.attenuation_db"
    if above < _HEARD_DB:
        cause = _who_receives(bench, scene)
    yield Check("radar", "above the noise", above, "dB", _ABOVE_NOISE_DB, cause=cause)
    cause = "too much arrives: lower radar_rx_gain_db, or more attenuation"
    if _db(level) < _LEVEL_DBFS[0]:
        cause = "too little arrives: more attenuation than stated, or too little gain"
    yield Check("radar", "level", _db(level), "dBFS", *_LEVEL_DBFS, cause)
    cause = "the sweep is not found in what is received; see the checks above"
    yield Check("radar", "timing lock", float(known), "", 1, 1, cause)
    if not known:
        return
    bench.known |= {"level": level, "latency": flight.latency}
    ripple, image = _ripple_and_image(flight)
    cause = "filter roll-off (odd divider of the master clock?), reflections on an open port, or clipping"
    yield Check("radar", "flatness, inner 80 % of the band", ripple, "dB", 0, _RIPPLE_DB, cause)
    yield Check(
        "radar",
        "IQ image",
        image,
        "dBc",
        high=_IMAGE_DBC,
        cause="IQ correction did not run; uhd_cal_tx_iq_balance",
    )
    right = score(flight.result.results["none"], scene.altitude.programme)
    cause = "timing or level, by the checks above"
    yield Check("radar", "altitudes right at 300 m", right.pd, "of 1", 0.9, cause=cause)


def _counters(step: str, *flights: Flight) -> Iterator[Check]:
    """Events of the transmitters, lost samples, and the share of clipped samples in the recordings."""

    def total(name: str) -> int:
        return sum(int(f.result.segmenter.get(name, 0)) for f in flights)

    cause = "the flowgraph started after the common start time: a slow or busy host; start again, close other programs"
    yield Check(step, "transmitter late", total("tx_late"), "times", 0, 0, cause)
    cause = "USB or host too slow: another port, no hub, CPU governor performance"
    yield Check(step, "transmitter underflows", total("tx_underflows"), "times", 0, 0, cause)
    yield Check(step, "samples lost", total("lost_samples"), "", 0, 0, cause)
    recorded = [_clipped(f.samples) for f in flights if f.samples.size]
    if recorded:
        cause = "clipping: lower radar_rx_gain_db, or more attenuation"
        yield Check(step, "samples clipped", max(recorded), "%", 0, 0, cause)


def _who_receives(bench: Bench, scene: Scene) -> str:
    """Nothing arrives: whether the same bench with both radios exchanged receives."""
    dead = "nothing arrives: dead antenna port or cable, RX2 not connected, or the transmitter's port open"
    radio = scene.radio
    if bench.simulated or not bench.scene.has_jammer:
        return dead
    other = dataclasses.replace(radio, radar_serial=radio.jammer_serial, jammer_serial=radio.radar_serial)
    flight = bench.fly(dataclasses.replace(scene, radio=other), capture="radar_exchanged")
    if _db(_power(flight.samples)) - _db(bench.known["noise"]) < _HEARD_DB:
        return dead
    return "the other radio receives: cables swapped between the radios, or radar_serial and jammer_serial exchanged"


def _ripple_and_image(flight: Flight) -> tuple[float, float]:
    """(peak-to-peak dB, dBc) of the preamble's mean sweep, which lies at altitude zero.

    The sweep's frequency is a function of time, so its power over time is the path's response. The image is the
    conjugate sweep, fitted by least squares beside the sweep and a constant.
    """
    w = flight.scene.waveform
    first, last = 1, flight.scene.altitude.preamble_frames - 1
    turned = flight.frames(first, last) * np.conj(w.frame_rotation(np.arange(first, last)))[:, None]
    mean = turned.mean(axis=0).astype(complex)
    late_s = (flight.latency - np.floor(flight.latency)) / w.rate_hz
    time_s = np.mod(w.sample_times_s - late_s, w.sweep_s)
    sweep = np.exp(2j * np.pi * w.phase_cycles(time_s))
    parts = np.stack([sweep, np.conj(sweep), np.ones_like(sweep)], axis=1)
    direct, image, _ = np.linalg.lstsq(parts, mean, rcond=None)[0]
    since = np.minimum(time_s, w.sweep_s - time_s)
    hz = w.slope_hz_per_s * since - (w.bandwidth_hz / 2 if w.centered else 0.0)
    hz = np.mod(hz + w.rate_hz / 2, w.rate_hz) - w.rate_hz / 2
    inner = np.abs(hz) < _INNER * w.rate_hz / 2
    piece = np.floor((hz[inner] / w.rate_hz + 0.5) * _PIECES).astype(int)
    count = np.bincount(piece)
    levels = np.bincount(piece, np.abs(mean[inner]) ** 2)[count > 0] / count[count > 0]
    return float(np.ptp(10 * np.log10(levels))), 2 * _db(abs(image) / abs(direct))


def _muted(bench: Bench) -> Iterator[Check]:
    """Zeros through an open transmitter, with the LO inside the band."""
    offset_hz = bench.scene.waveform.rate_hz / 8
    radio = dataclasses.replace(bench.scene.radio, lo_offset_hz=offset_hz)
    flight = bench.fly(bench.programme(0.0, radio=radio), capture="muted", silent=(RADAR_GATE,))
    n = flight.scene.waveform.samples_per_frame
    frames = flight.samples[n : n * (flight.samples.size // n)].reshape(-1, n)
    frames = frames[np.isfinite(frames).all(axis=1)]
    dc, line, cycles = _strongest_line(frames)
    level = _db(bench.known["level"])
    at_khz = cycles * flight.scene.waveform.rate_hz / 1e3
    what = f"line with LO in the band, at {at_khz:+.0f} kHz"
    cause = "LO leakage of the transmitter or receiver: keep radio.lo_offset_hz beyond the band; uhd_cal_tx_dc_offset"
    yield Check("muted", what, max(line, dc) - level, "dBc", high=_LEAKAGE_DBC, cause=cause)
    rest = _db(_power(frames)) - _db(bench.known["noise"])
    cause = (
        "muted samples leave more than LO leakage: noise of the transmitter; lower its gain, more attenuation"
    )
    yield Check("muted", "above the noise, transmitter muted", rest, "dB", high=_HEARD_DB, cause=cause)


def _starts(bench: Bench) -> Iterator[Check]:
    """Latencies of several starts, for this master clock and for others that divide to the rate."""
    radio, rate_hz = bench.scene.radio, bench.scene.waveform.rate_hz
    low, high = radio.limits.master_clock_hz
    clocks = [radio.master_clock_hz]
    if not bench.simulated:
        others = [k * rate_hz for k in (2, 4, 6, 8) if k * rate_hz != radio.master_clock_hz]
        clocks += [c for c in others if low <= c <= high and abs(radio.lo_offset_hz) <= 0.5 * (c - rate_hz)]
    for clock_hz in clocks:
        again = dataclasses.replace(radio, master_clock_hz=clock_hz)
        count = bench.starts if clock_hz == radio.master_clock_hz else min(bench.starts, 3)
        found = []
        for k in range(count):
            # on the air the seed changes nothing that is sent without interference
            scene = bench.programme(300.0, frames=1, radio=again, seed=bench.scene.seed + k)
            found.append(bench.fly(scene).latency)
        what = f"latency {np.mean(found):.2f} samples at {clock_hz / 1e6:g} MHz, spread of {count} starts"
        cause = "starts are not repeatable: calibrate anew after each, and report the driver's and firmware's versions"
        yield Check("starts", what, float(np.ptp(found)), "samples", 0, _SPREAD_SAMPLES, cause)


def _reference(bench: Bench, scene: Scene) -> Scene:
    """The scene in the simulated channel at the bench's SNR; other noise than that of a simulated bench."""
    snr_db = min(40.0, _db(bench.known["level"]) - _db(bench.known["noise"]))
    return dataclasses.replace(scene, channel=ChannelSettings(snr_db=snr_db), seed=scene.seed + 1)


def _altitudes(bench: Bench) -> Iterator[Check]:
    scene = bench.programme(*_ALTITUDES_M)
    flown = bench.fly(scene, capture="altitudes").result.results["none"]
    simulated = run_chain(_reference(bench, scene), ("none",)).results["none"]
    index = [frames["frame_index"] for frames in (flown, simulated)]
    for altitude_m in _ALTITUDES_M:
        medians = []
        for frames, at in zip((flown, simulated), index, strict=True):
            here = (scene.altitude.programme.altitude_m(at) == altitude_m) & frames["valid"]
            medians.append(float(np.median(frames["altitude_m"][here])) if here.any() else np.nan)
        what = f"{altitude_m:g} m: error {medians[0] - altitude_m:+.2f} m, beyond the simulation's"
        cause = "reflections between open ports, flatness, or lost samples; see the checks above"
        yield Check("altitudes", what, abs(medians[0] - medians[1]), "m", 0, _OFF_M, cause)


def _jammer(bench: Bench) -> Iterator[Check]:
    """The radar silent: the interference's power against the radar's alone, and its share of the time."""
    scene = bench.programme(300.0, jammer=True).at(overlap=0.5)
    flight = bench.fly(scene, capture="jammer", silent=(RADAR_GATE,))
    yield from _counters("jammer", flight)
    first = scene.altitude.preamble_frames
    played = flight.frames(first + 2, first + max(3, bench.frames - 1), bench.known["latency"])
    noise = bench.known["noise"]
    radar = _db(bench.known["level"] - noise) + bench.drive_db(scene) - bench.drive_db(bench.programme(300.0))
    power = _power(played) - noise
    off = radar - _db(power) - scene.sir_db
    cause = (
        "the paths' losses differ, a cable swapped, or a transmitter in compression; state equal attenuation"
    )
    if _db(_power(played)) - _db(noise) < _HEARD_DB:
        cause = "nothing arrives: the jammer's cable, port or attenuator"
    yield Check(
        "jammer", f"SIR off from {scene.sir_db:g} dB", off, "dB", -_LEVEL_ERROR_DB, _LEVEL_ERROR_DB, cause
    )
    kernel = np.ones(_SMOOTH) / _SMOOTH
    envelope = np.convolve(np.abs(np.nan_to_num(played.ravel())) ** 2, kernel, "same") - noise
    share = float(np.mean(envelope > 0.1 * np.percentile(envelope, 90)))
    cause = (
        "the jammer's clock or second differs from the radar's: 10 MHz and PPS to both, clock_source external"
    )
    yield Check("jammer", "overlap off from 0.5", share - 0.5, "", -_OVERLAP_ERROR, _OVERLAP_ERROR, cause)


def _both(bench: Bench) -> Iterator[Check]:
    flights: list[Flight] = []
    for overlap in _OVERLAPS:
        scene = bench.programme(300.0, 100.0, 30.0, jammer=True).at(overlap=overlap)
        flight = bench.fly(scene, _METHODS, capture=f"both_{overlap:g}")
        flights.append(flight)
        simulated = run_chain(_reference(bench, scene), _METHODS)
        for method in _METHODS:
            here, there = (
                score(r.results[method], scene.altitude.programme) for r in (flight.result, simulated)
            )
            what = f"overlap {overlap:g}, {method}: Pd; simulated {there.pd:.2f}"
            lowest = there.interval[0] - (here.interval[1] - here.pd)  # the intervals overlap
            cause = "SIR, overlap or level are not the simulation's; see the steps before"
            yield Check("both", what, here.pd, "of 1", lowest, cause=cause)
    yield from _counters("both", *flights)
    if np.isfinite(flight.latency):
        alone = flight.frames(2, scene.altitude.preamble_frames - 1)
        expected = _db(bench.known["level"]) + bench.drive_db(scene) - bench.drive_db(bench.programme(300.0))
        off = _db(_power(alone) - bench.known["noise"]) - expected
        cause = "the transmitter is in compression, or the stream argument fullscale has no effect"
        yield Check(
            "both",
            "radar's level off from its fullscale",
            off,
            "dB",
            -_LEVEL_ERROR_DB,
            _LEVEL_ERROR_DB,
            cause,
        )


def _endurance(bench: Bench) -> Iterator[Check]:
    count = max(40, round(bench.minutes * 60.0 / bench.scene.waveform.sweep_s))
    scene = bench.programme(300.0, frames=count)
    limit_s = 4 * count * scene.waveform.sweep_s + 30.0
    flight = bench.fly(scene, time_limit_s=limit_s)
    yield from _counters("endurance", flight)
    counted = flight.result.segmenter
    cause = "samples were lost without notice, or the path changed; see docs/hardware.md, counters"
    yield Check("endurance", "lock losses", counted["lock_losses"], "times", 0, 0, cause)
    frames = flight.result.results["none"]
    cause = "the host is too slow for the chain; close other programs"
    yield Check("endurance", "frames dropped", counted.get("dropped_slow", 0), "", 0, 0, cause)
    good = frames[frames["valid"] & scene.altitude.programme.is_trial(frames["frame_index"])]
    ends = (good["altitude_m"][: good.size // 4], good["altitude_m"][-(good.size // 4) :])
    drift = float(np.median(ends[1]) - np.median(ends[0])) if good.size >= 4 else np.nan
    cause = "temperature or reference: let the radios warm up for ten minutes"
    yield Check("endurance", "drift, last quarter against first", drift, "m", -_DRIFT_M, _DRIFT_M, cause)


_ALL = "every cable of the drawing"
_HEARD = ("noise", "level", "latency")


def _with_jammer(step: Step) -> Step:
    """Skipped where the scene has no interference."""

    def measure(bench: Bench) -> Iterator[Check]:
        if not bench.scene.has_jammer:
            yield skipped(step.name, step.title, "the scene has no interference")
            return
        yield from step.measure(bench)

    return dataclasses.replace(step, measure=measure)


STEPS = (
    Step("devices", "Radios and their links", "USB and power of both radios", _devices),
    Step("receiver", "Transmitters off: noise, DC, spurs", _ALL, _receiver),
    Step("radar", "Radar alone: level, image, flatness, timing", _ALL, _radar, ("noise",)),
    Step("muted", "Transmitter muted: what zeros leave", _ALL, _muted, _HEARD),
    Step("starts", "Latency over starts and master clocks", _ALL, _starts, _HEARD),
    Step("altitudes", "Altitudes against simulation", _ALL, _altitudes, _HEARD),
    _with_jammer(Step("jammer", "Jammer alone: SIR and overlap", _ALL, _jammer, _HEARD)),
    _with_jammer(Step("both", "Radar and jammer: Pd over overlap", _ALL, _both, _HEARD)),
    Step("endurance", "Endurance: lost samples, underflows, drift", _ALL, _endurance, _HEARD),
)
