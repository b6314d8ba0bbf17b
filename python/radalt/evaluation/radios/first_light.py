"""The first hour on two radios: a checklist over the set-up, the flowgraph and the altimeter, each check with a limit.

Limits are from data sheets and from what the altimeter needs. Powers in dBFS count a complex sample of magnitude 1 as
0 dB. `Bench.fly` flies a short programme by `run_hardware`, with its interlock and gates, or in simulation.
"""

import dataclasses
import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.channel.settings import ChannelSettings
from ...core.radio.interlock import require_enclosure
from ...core.radio.levels import drive
from ...core.radio.path_measures import clipped_percent, db, mean_power, ripple_db, strongest_lines
from ...core.radio.recording import open_capture
from ...core.scene import Scene, scene_to_mapping
from ...core.text import said
from ..engine.options import EXPECTED
from ..flowgraph.rewrite import RADAR_GATE
from ..results.folder import FolderError, RunFolder, versions
from ..results.page import render, write_page
from ..results.rows import TEXT, Columns
from ..results.score import score
from ..results.table import table
from ..simulation import TAIL_FRAMES, PointResult, found_latency, received, run_chain

CABLING = """
     radar radio                                        jammer radio
    +------------+                                     +-------------+
    |      TX/RX |--[ A dB ]--+           +--[ A dB ]--| TX/RX       |
    |            |        +---+-----------+---+        |             |
    |            |        |     combiner      |        |             |
    |            |        +---------+---------+        |             |
    |        RX2 |------------------+                  | RX2: 50 ohm |
    +------------+                                     +-------------+
    A: radio.attenuation_db of the scene less the combiner's loss, rated for the transmit power; measure it first.
    clock_source external: 10 MHz and PPS to both. Without jammer: TX/RX --[ A dB ]-- RX2. Above -15 dBm RX2 is damaged.
"""
_LATENCY = 150.3  # samples, of the simulated bench: with a fraction, as on a real one
_LISTENED = 40  # frames with every transmitter off
_ALTITUDES_M = (10.0, 30.0, 100.0, 300.0, 1000.0, 1500.0)
_OVERLAPS, _METHODS = (0.25, 0.5, 1.0), ("none", "whitening", "tcae")
_SLOW_HOST = "USB or host too slow: another port, no hub, CPU governor performance"
_WEAK = "more attenuation than stated, or too little gain"
_ROLL_OFF = "filter roll-off (odd divider of the clock?), reflections on an open port, clipping"


class Check(NamedTuple):
    """One measured value with its unit, its limits and the likely cause of one beyond them; None: skipped."""

    what: str
    value: float | None
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    cause: str = ""
    step: str = ""

    @property
    def verdict(self) -> str:
        """``pass``, ``fail`` or ``skipped``; a value that is not a number fails."""
        if self.value is None:
            return "skipped"
        return "pass" if self.low <= self.value <= self.high else "fail"

    @property
    def limit(self) -> str:
        """The limits in words."""
        parts = (("at least", self.low), ("at most", self.high))
        return ", ".join(f"{word} {value:.4g}" for word, value in parts if math.isfinite(value)) or "none"

    @property
    def shown(self) -> str:
        """The value with its unit; a dash without one."""
        return "-" if self.value is None else f"{self.value:.4g} {self.unit}".strip()


@dataclass(frozen=True)
class Flight:
    """A programme that was flown: (n,) complex64 ``samples`` by the sample counter, full scale 1, NaN where lost."""

    scene: Scene
    result: PointResult
    samples: np.ndarray
    latency: float  # samples; NaN where the sweep was not found

    def frames(self, first: int, last: int, latency: float | None = None) -> np.ndarray:
        """(last - first, N) samples of sweeps ``first..last-1``, from the whole sample before each begins."""
        n = self.scene.waveform.samples_per_frame
        start = first * n + math.floor(self.latency if latency is None else latency)
        return self.samples[start : start + (last - first) * n].reshape(-1, n)


@dataclass
class Bench:
    """Two radios and what is between them, or their simulation; radios' recordings go to ``folder``/captures.

    ``frames`` at each altitude, ``starts`` whose latencies are compared, ``minutes`` of the last step. Found by
    steps: ``known``, powers ``noise`` and ``level`` (full scale 1) and ``latency`` in samples.
    """

    scene: Scene
    folder: Path
    simulated: bool = False
    transmit: bool = False
    frames: int = 15
    starts: int = 10
    minutes: float = 10.0
    log: Callable[[str], None] = print
    sleep: Callable[[float], None] = time.sleep
    known: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_enclosure(self.scene, self.transmit, radios=not self.simulated)
        if self.simulated:
            # 18 dB above the shortest burst of the steps, but the return stays well above a 12-bit step
            rail = min(90.0, 8.0 * 10.0 ** (max(0.0, 6.0 - self.scene.sir_db) / 20.0))
            path = {"snr_db": 30.0, "start_offset_samples": _LATENCY, "dc_offset": 1e-3, "iq_gain_db": 0.05}
            channel = ChannelSettings(adc_bits=12, full_scale=rail, **path)
            self.scene = dataclasses.replace(self.scene, channel=channel)

    def programme(self, *altitudes_m: float, jammer: bool = False, frames: int = 0, **changes: Any) -> Scene:
        """The scene with these altitudes, `frames` at each, and without interference unless ``jammer``."""
        flown = {"programme_m": altitudes_m, "frames": frames or self.frames, "mode": "synthetic"}
        if not jammer:
            changes |= {"interference": (), "total_sir_db": None}
        altitude = dataclasses.replace(self.scene.altitude, **flown)
        return dataclasses.replace(self.scene, altitude=altitude, **changes)

    def drive_db(self, scene: Scene) -> float:
        """Level of the radar by its digital drive (``fullscale``) in a scene."""
        return 0.0 if self.simulated else -20.0 * math.log10(drive(scene).radar_full_scale)

    def fly(
        self,
        scene: Scene,
        methods: Sequence[str] = ("none",),
        *,
        capture: str = "",
        silent: Collection[str] = (),
        time_limit_s: float = 300.0,
    ) -> Flight:
        """Fly a programme once; with ``capture`` the flight has its samples. ``silent`` gates send zeros."""
        samples = np.empty(0, np.complex64)
        if self.simulated:
            sends = RADAR_GATE not in silent
            result = run_chain(scene, methods if sends else ())
            samples = self._simulated(scene, sends) if capture else samples
            return Flight(scene, result, samples, found_latency(scene) if sends else math.nan)
        from .hardware import run_hardware

        own = {"transmit": self.transmit, "log": self.log, "sleep": self.sleep, "use_calibration": False}
        own |= {"capture": None, "silent": tuple(silent), "time_limit_s": time_limit_s}
        if capture:
            own["capture"] = self.folder / "captures" / capture
            own["capture"].parent.mkdir(parents=True, exist_ok=True)
        result = run_hardware(scene, methods, **own)
        if capture:
            samples = _recorded(own["capture"], scene)
        return Flight(scene, result, samples, float(result.segmenter["latency_samples"]))

    def listen(self, frames: int) -> np.ndarray:
        """(frames, N) samples with every transmitter off: none is opened; the LO is in the middle of the band."""
        middle = {"radio": dataclasses.replace(self.scene.radio, lo_offset_hz=0.0)}
        scene = self.programme(0.0, frames=frames, **middle)
        count = frames * scene.waveform.samples_per_frame
        if self.simulated:
            return self._simulated(scene, sends=False)[:count].reshape(frames, -1)
        from .hardware import receive_alone

        return receive_alone(scene, count, sleep=self.sleep, log=self.log).reshape(frames, -1)

    def _simulated(self, scene: Scene, sends: bool) -> np.ndarray:
        """What the simulated channel gives over a programme, full scale 1."""
        frames = scene.altitude.programme.total_frames + TAIL_FRAMES
        samples = [samples for _, samples in received(scene, frames, radar_sends=sends)]
        return np.concatenate(samples) / np.float32(scene.channel.full_scale)


def _recorded(file: Path, scene: Scene) -> np.ndarray:
    """A radio's recording by the sample counter, up to the programme's end; NaN where samples are missing."""
    w, frames = scene.waveform, scene.altitude.programme.total_frames + TAIL_FRAMES
    samples = np.full(frames * w.samples_per_frame, np.nan, np.complex64)
    recording = open_capture(file.with_name(f"{file.name}.sigmf-meta"))
    for counter, block in recording.blocks(w.rate_hz):
        end = min(samples.size, counter + block.size)
        samples[counter:end] = block[: max(0, end - counter)]
    return samples


# -- the checklist: name, unit, limits, likely cause of a value beyond them -------------------------------------------


_ANY = math.inf
CHECKS = {
    # the noise of a 12-bit converter lies near -74
    "noise": ("dBFS", -110, -40, "zeros: a frozen receiver; above: something transmits, or too much gain"),
    "DC, LO in the middle of the band": ("dBFS", -_ANY, -40, "DC correction did not run (UHD issue 892)"),
    "strongest line": ("dBFS", -_ANY, -60, "a spur or a signal from outside"),
    "transmitter late": ("times", -_ANY, 0, "started after the common start time: a busy host; start again"),
    "transmitter underflows": ("times", -_ANY, 0, _SLOW_HOST),
    "samples lost": ("", -_ANY, 0, _SLOW_HOST),
    "samples clipped": ("%", -_ANY, 0, "too much arrives: lower radar_rx_gain_db, or more attenuation"),
    # enough for timing to a hundredth of a sample
    "above the noise": ("dB", 20, _ANY, _WEAK + ", a dead port or cable, or radios or serials exchanged"),
    "level": ("dBFS", -40, -3, f"below: {_WEAK}; above: too much of it"),
    "timing lock": ("", 1, _ANY, "the sweep is not found in what is received; see the checks above"),
    "flatness, inner 80 % of the band": ("dB", -_ANY, 3, _ROLL_OFF),
    "altitudes right at 300 m": ("of 1", 0.9, _ANY, "timing or level; see the checks above"),
    # a twentieth of a sample is 1 m of altitude
    "latency": ("samples spread", -_ANY, 0.05, "calibrate after each start; report the driver's version"),
    "altitude": ("m", -_ANY, 1, "reflections on open ports, flatness, or lost samples; see above"),
    "SIR": ("dB", -1, 1, "unequal path losses, a cable swapped, compression; or no jammer arrives"),
    "Pd": ("", -_ANY, _ANY, "SIR, overlap or level are not the simulation's; see the steps before"),
    "lock losses": ("times", -_ANY, 0, "samples were lost without notice, or the path changed"),
    "frames dropped": ("", -_ANY, 0, "the host is too slow for the chain; close other programs"),
    "drift": ("m", -0.5, 0.5, "temperature or reference: let the radios warm up"),
}


def _check(name: str, value: float, what: str = "", **limits: float) -> Check:
    """A value of the checklist, under its name or a longer one."""
    return Check(what or name, value, *CHECKS[name])._replace(**limits)


# -- the steps: docstrings are their titles ----------------------------------------------------------------------------


def _receiver(bench: Bench) -> Iterator[Check]:
    """Transmitters off: noise, DC, spurs"""
    frames = bench.listen(_LISTENED)
    noise = mean_power(frames)
    dc, line, at_hz = strongest_lines(frames, bench.scene.waveform.rate_hz)
    yield _check("noise", db(noise))
    yield _check("DC, LO in the middle of the band", dc)
    yield _check("strongest line", line, f"strongest line, at {at_hz / 1e3:+.0f} kHz")
    if noise > 0:
        bench.known["noise"] = noise


def _counters(*flights: Flight) -> Iterator[Check]:
    """What the transmitters reported, what was lost on the way, and how much of what was recorded is clipped."""
    counted = {"transmitter late": "tx_late", "transmitter underflows": "tx_underflows"}
    for name, key in (counted | {"samples lost": "lost_samples"}).items():
        yield _check(name, sum(int(f.result.segmenter.get(key, 0)) for f in flights))
    recorded = [clipped_percent(f.samples) for f in flights if f.samples.size]
    if recorded:
        yield _check("samples clipped", max(recorded))


def _radar(bench: Bench) -> Iterator[Check]:
    """Radar alone: level, flatness, timing"""
    scene = bench.programme(300.0)
    flight = bench.fly(scene, capture="radar")
    known = bool(np.isfinite(flight.latency))
    signal = flight.frames(2, scene.altitude.preamble_frames + bench.frames) if known else flight.samples
    level = mean_power(signal)
    yield from _counters(flight)
    yield _check("above the noise", db(level) - db(bench.known["noise"]))
    yield _check("level", db(level))
    yield _check("timing lock", float(known))
    if not known:
        return
    bench.known |= {"level": level, "latency": flight.latency}
    sweeps = flight.frames(1, scene.altitude.preamble_frames - 1)
    ripple = ripple_db(scene.waveform, sweeps, flight.latency % 1.0, first=1)
    yield _check("flatness, inner 80 % of the band", ripple)
    right = score(flight.result.results["none"], scene.altitude.programme).pd
    yield _check("altitudes right at 300 m", right)


def _starts(bench: Bench) -> Iterator[Check]:
    """Latency over starts"""
    # another seed is other noise in simulation; on the air it changes nothing that is sent
    seeds = range(bench.scene.seed, bench.scene.seed + bench.starts)
    found = [bench.fly(bench.programme(300.0, frames=1, seed=seed)).latency for seed in seeds]
    yield _check("latency", float(np.ptp(found)), f"latency {np.mean(found):.2f}, {bench.starts} starts")


def _reference(bench: Bench, scene: Scene) -> Scene:
    """The scene in the simulated channel at the bench's SNR, with another seed than a simulated bench."""
    snr_db = min(40.0, db(bench.known["level"]) - db(bench.known["noise"]))
    return dataclasses.replace(scene, channel=ChannelSettings(snr_db=snr_db), seed=scene.seed + 1)


def _altitudes(bench: Bench) -> Iterator[Check]:
    """Altitudes against simulation of the same scene"""
    scene = bench.programme(*_ALTITUDES_M)
    flown = bench.fly(scene, capture="altitudes").result
    simulated = run_chain(_reference(bench, scene), ("none",))
    for altitude_m in _ALTITUDES_M:
        found = []
        for result in (flown, simulated):
            frames = result.results["none"]
            sent = scene.altitude.programme.altitude_m(frames["frame_index"])
            here = frames["altitude_m"][(sent == altitude_m) & frames["valid"]]
            found.append(float(np.median(here)) if here.size else math.nan)
        what = f"{altitude_m:g} m: {found[0]:.2f} m, off the simulation's"
        yield _check("altitude", abs(found[0] - found[1]), what)


def _jammer(bench: Bench) -> Iterator[Check]:
    """Jammer alone: SIR against the radar's level alone"""
    scene = bench.programme(300.0, jammer=True).at(overlap=0.5)
    flight = bench.fly(scene, capture="jammer", silent=(RADAR_GATE,))
    yield from _counters(flight)
    first, noise = scene.altitude.preamble_frames, bench.known["noise"]
    played = flight.frames(first + 1, first + bench.frames - 1, bench.known["latency"])
    # the radar arrives by its level alone and both drives
    louder_db = bench.drive_db(scene) - bench.drive_db(bench.programme(300.0))
    sir_db = db(bench.known["level"] - noise) + louder_db - db(mean_power(played) - noise)
    yield _check("SIR", sir_db - scene.sir_db, f"SIR off from {scene.sir_db:g} dB")


def _both(bench: Bench) -> Iterator[Check]:
    """Radar and jammer: Pd over overlap"""
    flights: list[Flight] = []
    for overlap in _OVERLAPS:
        scene = bench.programme(300.0, 100.0, 30.0, jammer=True).at(overlap=overlap)
        flights.append(bench.fly(scene, _METHODS, capture=f"both_{overlap:g}"))
        simulated = run_chain(_reference(bench, scene), _METHODS)
        for method in _METHODS:
            results = (flights[-1].result.results[method], simulated.results[method])
            here, there = (score(r, scene.altitude.programme) for r in results)
            lowest = there.interval[0] - (here.interval[1] - here.pd)  # both intervals overlap
            what = f"Pd, overlap {overlap:g}, {method}; simulated {there.pd:.2f}"
            yield _check("Pd", here.pd, what, low=lowest)
    yield from _counters(*flights)


def _endurance(bench: Bench) -> Iterator[Check]:
    """Endurance: lost samples, underflows, drift"""
    count = max(40, round(bench.minutes * 60.0 / bench.scene.waveform.sweep_s))
    scene = bench.programme(300.0, frames=count, jammer=bench.scene.has_jammer)
    if bench.scene.has_jammer:  # both radios stream throughout; most frames stay clear for the drift
        scene = scene.at(overlap=_OVERLAPS[0])
    flight = bench.fly(scene, time_limit_s=4 * count * scene.waveform.sweep_s + 30.0)
    yield from _counters(flight)
    counted, frames = flight.result.segmenter, flight.result.results["none"]
    yield _check("lock losses", counted["lock_losses"])
    yield _check("frames dropped", counted.get("dropped_slow", 0))
    good = frames["altitude_m"][frames["valid"] & scene.altitude.programme.is_trial(frames["frame_index"])]
    quarter = good.size // 4
    drift_m = float(np.median(good[-quarter:]) - np.median(good[:quarter])) if quarter else math.nan
    yield _check("drift", drift_m, "drift, last quarter against first")


class Step(NamedTuple):
    """A step with what it needs: a key of `Bench.known`, and whether a jammer."""

    checks: Callable[[Bench], Iterable[Check]]
    needs: str = ""
    jammer: bool = False

    @property
    def title(self) -> str:
        """Title for people."""
        return str(self.checks.__doc__)


STEPS = {
    "receiver": Step(_receiver),
    "radar": Step(_radar, "noise"),
    "starts": Step(_starts, "latency"),
    "altitudes": Step(_altitudes, "latency"),
    "jammer": Step(_jammer, "latency", jammer=True),
    "both": Step(_both, "latency", jammer=True),
    "endurance": Step(_endurance, "latency"),
}


def perform(bench: Bench, names: Iterable[str] = tuple(STEPS)) -> Iterator[Check]:
    """The checks of these steps in order, to the end whatever fails.

    What the set-up or UHD refuses is a failed check: a device that is not there, a value that a step cannot use.
    """
    for name in names:
        step = STEPS[name]
        why = "the scene has no interference" if step.jammer and not bench.scene.has_jammer else ""
        if step.needs not in ("", *bench.known):
            why = why or f"needs the {step.needs} that an earlier step did not find"
        if why:
            yield Check(step.title, None, cause=why, step=name)
            continue
        try:
            for check in step.checks(bench):
                yield check._replace(step=name)
        except EXPECTED as error:
            yield Check("run", math.nan, cause=" ".join(said(error).split())[:300], step=name)


def open_folder(bench: Bench) -> RunFolder:
    """The result folder of a bench; raises FolderError where something else is in its place."""
    if (bench.folder / "run.json").exists():
        raise FolderError(f"{bench.folder} holds another hour; name another --out")
    source = "simulated" if bench.simulated else "air"
    head = {"study": "first_light", "source": source, "scene": scene_to_mapping(bench.scene)}
    head |= {name: getattr(bench, name) for name in ("frames", "starts", "minutes")}
    return RunFolder(bench.folder, head | {"versions": versions(with_network=bench.scene.has_jammer)})


def report(folder: RunFolder, checks: Sequence[Check]) -> str:
    """Write rows.csv and the report into the folder; returns the verdicts' counts and the report's path."""
    columns = Columns((*Check._fields, "verdict"), TEXT | {"what", "step"})
    rows = [columns.row(check._asdict() | {"verdict": check.verdict}) for check in checks]
    folder.write_text("rows.csv", columns.csv(rows))
    count = Counter(check.verdict for check in checks)
    verdict = f"{count['pass']} passed, {count['fail']} failed, {count['skipped']} skipped"
    parts = {}
    for name in dict.fromkeys(check.step for check in checks):
        mine = [c for c in checks if c.step == name]
        cells = ((c.what, c.shown, c.limit, c.verdict, c.cause * (c.verdict != "pass")) for c in mine)
        cells = [[cell.replace("|", "/") for cell in row] for row in cells]
        parts[STEPS[name].title] = table("measured | value | limit | verdict | likely cause", cells)
    text = render(
        Path(__file__).with_suffix(".md.j2"), title=folder.head["source"], verdict=verdict, parts=parts
    )
    return f"{verdict}\n{write_page(folder, text, {'command': 'radalt first-light'})}"
