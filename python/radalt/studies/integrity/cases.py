"""Cases of the integrity campaign: what flies, what disturbs it, what fails, and the truth.

Everything is a function of (case, seed, batch).
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from ...core.interference.effects import parts as parts_of
from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.stream import Continued
from ...core.receiver.segmenter import FrameSegmenter
from ...core.returns.landing import LandingSpec
from ...core.returns.point import point_return
from ...core.scene import load_scene
from ...core.waveform import Waveform

__all__ = ["BLOCK", "KINDS", "SCENES", "WAVEFORM", "Case", "Flight", "case_of", "cases", "fly", "received"]

WAVEFORM = Waveform()
BLOCK = 40  # frames of one output: flights last a whole number of them
SCENES = ("paper_qpsk", "qpsk_shaped", "nr5", "nr10", "tones", "mixture", "faa_mask", "fmcw")
_ANEW = "fmcw"  # heard now and then: each frame's window is drawn to meet a passage
_PERIODIC = "pulsed_radar"  # of 4 kHz: every frame the same
_LOWEST_M, _HIGHEST_M, _FASTEST = 5.0, 1400.0, 10.0  # m, m, m/s
_NR_FRAMES = BLOCK // 10  # of 10 ms in a window of an emitter
_DRAWN = 60  # cases that have nothing in common
_PREAMBLE = 8  # frames at altitude zero, on which the segmenter takes its timing
_DRIFT = 150.0  # m/s of range for each ppm between the clocks of two altimeters, c / 2 * 1e-6

KINDS = {
    "noise": "noise alone",
    "interference": "interference alone",
    "jammed": "return and interference",
    "drawn": "return, echo, one to three emitters and all levels drawn at random",
    "switched_on": "jammer switched on in mid-track",
    "landing": "landing over steps of the terrain, point return",
    "terrain": "landing over terrain, extended return",
    "step": "step of the ground",
    "missing": "frames lost and tagged",
    "slip": "samples lost without a tag",
    "nan": "frames that are not finite",
    "clipped": "converter clips",
    "altimeter": "another altimeter slides through, ground in sight",
    "altimeter_alone": "another altimeter slides through, no ground",
    "spoofed": "second return switched on in mid-track",
    "spoofed_first": "second return there before the ground",
}


@dataclass(frozen=True)
class Case:
    """What a flight meets.

    Attributes
    ----------
    kind, name : str
        ``kind`` is one of `KINDS`; ``name`` is unique and all that seeds it.
    scene : str
        Shipped scene whose interferers play; empty for none.
    overlap, sir_db, snr_db : float
        Levels are against a return of unit power, whether there is one or not.
    ground : bool
        Whether there is a return of the ground.
    value : float
        Size of the fault: metres, share of frames, parts per million, rail over RMS.
    known : str
        What of it docs/tracker.md names among what the tracker cannot tell; empty where the tracker has to stand it.
    """

    kind: str
    name: str
    scene: str = ""
    overlap: float = 1.0
    sir_db: float | None = None
    snr_db: float = 10.0
    ground: bool = True
    value: float = 0.0
    known: str = ""


@dataclass(frozen=True)
class Flight:
    """Altitudes by frame, NaN without a return; the first frame of a fault (None: no fault); frames of steps."""

    middle_m: np.ndarray
    end_m: np.ndarray
    speed_m_per_s: np.ndarray
    fault_frame: int | None = None
    steps: tuple[int, ...] = ()
    landing: object | None = None


def _scenes(kind: str, sirs: tuple[float, ...], snrs: tuple[float, ...], ground: bool) -> Iterator[Case]:
    for scene in SCENES:
        sparse = scene == "fmcw"  # 27 ms per frame
        for overlap in (1.0,) if sparse else (0.3, 1.0):
            for sir in sirs[::3] if sparse else sirs:
                for snr in snrs[-1:] if sparse else snrs:
                    name = f"{kind}/{scene}/{overlap:g}/{sir:g}dB/snr{snr:g}"
                    yield Case(kind, name, scene, overlap, sir, snr, ground)


def _all() -> Iterator[Case]:
    yield Case("noise", "noise", ground=False)
    yield from _scenes("interference", (-60.0, -30.0, 0.0), (10.0,), False)
    for number in range(_DRAWN):
        yield Case("drawn", f"drawn/{number}", overlap=np.nan, sir_db=np.nan, snr_db=np.nan)
    yield from _scenes("jammed", (-60.0, -50.0, -40.0, -30.0, -20.0, -10.0, 0.0), (-10.0, 10.0), True)
    for scene, sir in (("paper_qpsk", -10), ("paper_qpsk", -28), ("nr5", -30), ("nr10", -20), ("tones", -40)):
        yield Case("switched_on", f"switched_on/{scene}/{sir}dB", scene, sir_db=sir)
        yield Case("landing", f"landing/{scene}/{sir}dB", scene, sir_db=sir)
    yield Case("landing", "landing/clear")
    yield Case("terrain", "terrain/clear")
    yield Case("terrain", "terrain/nr5/-20dB", "nr5", sir_db=-20.0)
    for value in (-300.0, -100.0, -30.0, -12.0, 12.0, 30.0, 100.0, 300.0):
        yield Case("step", f"step/{value:+g}m", value=value)
        yield Case("step", f"step/{value:+g}m/nr5/-20dB", "nr5", sir_db=-20.0, value=value)
    for kind, values in (("missing", (0.1, 0.4)), ("nan", (0.1, 0.4)), ("clipped", (0.1, 0.5, 1.5))):
        for value in values:
            yield Case(kind, f"{kind}/{value:g}", value=value)
            yield Case(kind, f"{kind}/{value:g}/qpsk/-20dB", "paper_qpsk", sir_db=-20.0, value=value)
    for scene, sir in (("", None), ("paper_qpsk", -10.0), ("nr5", -20.0)):
        yield Case("slip", f"slip/{scene or 'clear'}", scene, sir_db=sir)
    for ppm in (0.05, 0.3, 3.0, 20.0):
        for sir in (10.0, 0.0, -20.0):
            slow, what = _DRIFT * ppm <= 20.0, f"{ppm:g}ppm/{sir:g}dB"
            hides = "stronger from the start, drifts as an aircraft" if slow and sir < -6.0 else ""
            yield Case("altimeter", f"altimeter/{what}", sir_db=sir, value=ppm, known=hides)
            yield Case(
                "altimeter_alone",
                f"altimeter_alone/{what}",
                sir_db=sir,
                value=ppm,
                ground=False,
                known="drifts as an aircraft, no ground" if slow else "",
            )
    for side, way in ((1.0, "beyond"), (-1.0, "nearer")):
        for level in (-8.0, -3.0, 3.0, 10.0, 20.0):
            for kind, hides_db in (("spoofed", 20.0), ("spoofed_first", 10.0 if side > 0 else 6.0)):
                name = f"{kind}/{way}/{level:+g}dB"
                known = f"stronger by {level:g} dB" if level >= hides_db else ""
                yield Case(kind, name, sir_db=-level, value=side, known=known)


@lru_cache(maxsize=1)
def _named() -> dict[str, Case]:
    return {case.name: case for case in _all()}


def cases(kinds: tuple[str, ...] = tuple(KINDS)) -> list[Case]:
    """Cases of these kinds."""
    return [case for case in _named().values() if case.kind in kinds]


def case_of(name: str) -> Case:
    """A case by its name; raises ValueError."""
    if name not in _named():
        raise ValueError(f"no case is called {name[:60]!r}; names are in cases.csv of a run")
    return _named()[name]


def _rng(case: Case, seed: int, batch: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(case.name.encode()), batch, purpose])


def fly(case: Case, seed: int, batch: int, frames: int) -> Flight:
    """Draw the flight: a start from 5 to 1400 m, even in the logarithm, and a speed up to 10 m/s."""
    rng, sweep_s = _rng(case, seed, batch, 0), WAVEFORM.sweep_s
    index = np.arange(frames)
    whole = ("noise", "interference", "jammed", "drawn", "landing", "terrain", "spoofed_first")
    faulty = case.kind not in whole
    fault = int(rng.integers(2 * frames // 5, frames // 2)) if faulty else None
    if not case.ground:
        nothing = np.full(frames, np.nan)
        return Flight(nothing, nothing, np.zeros(frames))
    if case.kind == "terrain":
        return _landing(rng, frames)
    start = float(np.exp(rng.uniform(np.log(_LOWEST_M), np.log(_HIGHEST_M))))
    speed = float(rng.uniform(-_FASTEST, _FASTEST))
    steps: list[tuple[int, float]] = []
    if case.kind == "landing":
        start, speed = rng.uniform(40.0, 250.0), -abs(speed)
        at = np.sort(rng.integers(BLOCK, frames, max(1, frames // 400)))
        steps = [(int(k), float(rng.uniform(-15.0, 15.0))) for k in at]
    elif case.kind == "step":
        start = float(rng.uniform(max(50.0, 30.0 - case.value), 1000.0))
        steps = [(fault, case.value)]
    elif case.kind.startswith("spoofed"):
        start = float(rng.uniform(450.0, 900.0))
    if start + speed * frames * sweep_s < _LOWEST_M:
        speed = abs(speed)

    def at(time_s: np.ndarray) -> np.ndarray:
        # a step belongs to what comes after its frame begins: the output that ends there is still of the old ground
        jumps = sum(((time_s > k * sweep_s) * height for k, height in steps), np.zeros(frames))
        return np.maximum(start + speed * time_s + jumps, _LOWEST_M)

    middle, end = at((index + 0.5) * sweep_s), at((index + 1) * sweep_s)
    return Flight(middle, end, np.full(frames, speed), fault, tuple(k for k, _ in steps))


def _landing(rng: np.random.Generator, frames: int) -> Flight:
    """A stretch of the shipped approach at its own pace, and who makes its echoes."""
    from ...core.returns.terrain import LandingProfile

    spec, sweep_s = LandingSpec(), WAVEFORM.sweep_s
    flight = spec.flight()
    first, last = spec.window_s(flight, sweep_s)
    start = float(rng.uniform(first, last - frames * sweep_s))
    radar = spec.radar(WAVEFORM, int(rng.integers(1, 1 << 30)))
    profile = LandingProfile(radar, flight, frames, start, start + (frames - 1) * sweep_s)
    climb = profile.vertical_speed_m_per_s
    middle = profile.altitude_m
    return Flight(middle, middle + 0.5 * sweep_s * climb, climb, landing=profile)


def received(case: Case, flight: Flight, seed: int, batch: int) -> Iterator[tuple[np.ndarray, ...]]:
    """(frame index, (n, N) complex64 frames, timing offset in s) of up to 40 frames, as the receiver hands them on."""
    rng = _rng(case, seed, batch, 1)
    if case.kind == "slip":
        return _segmented(case, flight, rng)
    return ((index, frames, 0.0) for index, frames in _frames(case, flight, rng) if index.size)


def _frames(case: Case, flight: Flight, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    n, total = WAVEFORM.samples_per_frame, flight.middle_m.size
    if case.kind == "drawn":
        overlap, levels = float(rng.choice((0.3, 0.6, 1.0))), rng.uniform((-62.0, -10.0), (-20.0, 15.0))
        case = dataclasses.replace(case, overlap=overlap, sir_db=float(levels[0]), snr_db=float(levels[1]))
    sources = _sources(case, flight, rng)
    out = _spoilt(case, flight, rng) if case.kind in ("missing", "nan") else np.zeros(total, dtype=bool)
    level, rail = np.float32(10.0 ** (-case.snr_db / 20.0) / np.sqrt(2.0)), None
    for first in range(0, total, BLOCK):
        index = np.arange(first, min(first + BLOCK, total))
        frames = rng.standard_normal((index.size, n, 2), dtype=np.float32).view(np.complex64)[..., 0] * level
        for source, begin in sources:
            on = index >= begin
            if on.any():
                frames[on] += source(index[on])
        rails = frames.view(np.float32)
        if case.kind == "clipped":
            rail = case.value * float(np.std(rails)) if rail is None else rail  # a gain that is set once
            np.clip(rails, -rail, rail, out=rails)
        bad = out[index]
        if case.kind == "nan":
            rails[bad] = np.nan
        elif case.kind == "missing":
            index, frames = index[~bad], frames[~bad]
        yield index, frames


Source = Callable[[np.ndarray], np.ndarray]


def _sources(case: Case, flight: Flight, rng: np.random.Generator) -> list[tuple[Source, int]]:
    """What is received besides noise: frames by their index, and the frame from which on."""
    w, sources = WAVEFORM, []
    fault = flight.fault_frame or 0
    phase = rng.random(2)
    if flight.landing is not None:
        sources.append((lambda k: np.stack([flight.landing.frame(int(i)) for i in k]), 0))
    elif case.ground:
        sources.append((_point(flight.middle_m, flight.speed_m_per_s, phase[0]), 0))
    if case.kind == "drawn" and rng.random() < 0.5:
        echo = _point(flight.middle_m + rng.uniform(5.0, 120.0), flight.speed_m_per_s, phase[1])
        share = np.float32(10.0 ** (rng.uniform(-25.0, -6.0) / 20.0))
        sources.append((lambda k: echo(k) * share, 0))
    if case.scene or case.kind == "drawn":
        interferers, total = _interferers(case, rng)

        def interference(index: np.ndarray) -> np.ndarray:
            return interference_frames(
                interferers,
                index.size,
                w.samples_per_frame,
                w.rate_hz,
                rng,
                total_sir_db=total,
                dtype=np.complex64,
            )

        sources.append((interference, fault if case.kind == "switched_on" else 0))
        return sources
    if case.kind.startswith("altimeter"):
        drift = _DRIFT * case.value * float(rng.choice((-1.0, 1.0)))
        time_s = (np.arange(flight.middle_m.size) - 0.4 * flight.middle_m.size + 0.5) * w.sweep_s
        where, speed, begin = rng.uniform(0.0, 1500.0) + drift * time_s, np.full(time_s.size, drift), 0
    elif case.kind.startswith("spoofed"):
        apart = case.value * float(rng.uniform(60.0, 400.0))
        where, speed = flight.middle_m + apart, flight.speed_m_per_s
        begin = fault if case.kind == "spoofed" else 0
    else:
        return sources
    second, strength = _point(where, speed, phase[1]), np.float32(10.0 ** (-case.sir_db / 20.0))
    return [*sources, (lambda k: second(k) * strength, begin)]


def _point(altitude_m: np.ndarray, speed: np.ndarray, phase: float) -> Source:
    return lambda k: point_return(
        WAVEFORM, altitude_m[k], vertical_speed_m_per_s=speed[k], phase_cycles=phase
    )


def _interferers(case: Case, rng: np.random.Generator) -> tuple[list[Interferer], float | None]:
    """The scene's interferers, which go on from frame to frame: bursts keep their place, tones their frequencies."""
    if case.kind == "drawn":
        parts = [Interferer(_emitter(rng), 0.0, case.overlap) for _ in range(rng.integers(1, 4))]
        total_sir_db = case.sir_db
    else:
        scene = load_scene(case.scene).at(overlap=case.overlap, sir_db=case.sir_db)
        parts, total_sir_db = scene.interference, scene.total_sir_db
    out = []
    for interferer in parts:
        emitter, start = interferer.emitter, float(rng.random())
        if isinstance(emitter, ToneEmitter) and not emitter.frequencies_hz:
            span = emitter.span_hz or WAVEFORM.rate_hz
            tones = rng.uniform(-0.5, 0.5, emitter.count) * span
            emitter = dataclasses.replace(emitter, frequencies_hz=tuple(tones))
        name = parts_of(emitter)[0].scene_name
        if name != _ANEW:
            periodic = name == _PERIODIC
            length = 1 if periodic else BLOCK
            emitter = Continued(emitter, WAVEFORM.samples_per_frame, length, repeats=periodic)
        out.append(dataclasses.replace(interferer, emitter=emitter, start=start))
    return out, total_sir_db if len(out) > 1 or case.kind == "drawn" else None


def _emitter(rng: np.random.Generator) -> object:
    """Tones, QPSK or NR of a width and a place of their own."""
    kind, seed = int(rng.integers(3)), int(rng.integers(1 << 31))
    if kind == 0:
        return ToneEmitter(int(rng.integers(1, 6)))
    if kind == 1:
        return QpskEmitter(
            bandwidth_hz=float(np.exp(rng.uniform(np.log(3e5), np.log(5e6)))),
            carrier_hz=float(rng.uniform(-1e6, 1e6)),
            pulse=str(rng.choice(("rrc", "rectangular"))),
            evm=TYPICAL,
        )
    return NrEmitter(
        channel_bandwidth_hz=float(rng.choice((5e6, 10e6))),
        carrier_hz=float(rng.choice((0.0, rng.uniform(-2e6, 2e6)))),
        load=float(rng.choice((0.3, 0.7, 1.0))),
        cell_id=int(rng.integers(1000)),
        seed=seed,
        frame_count=_NR_FRAMES,
        evm=TYPICAL,
    )


def _spoilt(case: Case, flight: Flight, rng: np.random.Generator) -> np.ndarray:
    """(frames,) bool: a share of all frames at random, and a hundred in a row from the fault on."""
    index = np.arange(flight.middle_m.size)
    burst = (index >= flight.fault_frame) & (index < flight.fault_frame + 100)
    return burst | (rng.random(index.size) < case.value)


def _segmented(case: Case, flight: Flight, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, ...]]:
    """Samples lost once without a tag, and what the segmenter makes of the stream."""
    w, n = WAVEFORM, WAVEFORM.samples_per_frame
    segmenter = FrameSegmenter(w, None, true_delay=True)
    total = flight.middle_m.size

    def sent(index: int) -> tuple[float, float]:
        at = index - _PREAMBLE
        if at < 0:
            return 0.0, 0.0
        at = min(at, total - 1)
        return float(flight.middle_m[at]), float(flight.speed_m_per_s[at])

    segmenter.follow(sent)
    lost = int(rng.choice([rng.integers(1, 10), rng.integers(1, n), n * int(rng.integers(1, 4))]))
    cut = flight.fault_frame * n + int(rng.integers(0, n))
    noise = rng.standard_normal((_PREAMBLE, n, 2), dtype=np.float32).view(np.complex64)[..., 0]
    segmenter.push((point_return(w, np.zeros(_PREAMBLE)) + np.float32(0.1) * noise).ravel())
    for index, frames in _frames(case, flight, rng):
        first = int(index[0]) * n
        position = first + np.arange(frames.size)
        found = segmenter.push(frames.ravel()[(position < cut) | (position >= cut + lost)])
        found = [f for f in found if 0 <= f.index - _PREAMBLE < total]
        if found:
            numbers = np.array([f.index - _PREAMBLE for f in found])
            yield numbers, np.stack([f.samples for f in found]), np.array([f.offset_s for f in found])
