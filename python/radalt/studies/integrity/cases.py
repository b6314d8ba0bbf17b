"""Cases of the integrity campaign: every kind, and the list of all cases with the limits that they meet."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...core.waveform import Waveform

WAVEFORM = Waveform()
BLOCK = 40  # frames of an output: flights last a whole number of outputs
DRIFT = 150.0  # drift of a return in m/s per ppm between two clocks: c / 2 * 1e-6
SPAN_M = 1500.0  # the altimeter's highest altitude
SCENES = ("paper_qpsk", "qpsk_shaped", "nr5", "nr10", "tones", "mixture", "faa_mask", "fmcw")
_DRAWN, _NOISE = 60, 4  # cases with random settings, cases of noise alone
LONG = ("land", "point")  # kinds that fly without mitigation, and `LONGER` times as long as the others
LONGER = 120
_PHASES = 4  # flights of two grounds whose phases are drawn
_PEAK_M = 20.0  # distance below which two returns are one peak: a resolution cell of 7.5 MHz

LANDS = {  # kinds of land whose reflectivity falls off differently with the angle, or (woods) hardly
    "woods": ("constant_gamma", "woods"),
    "urban": ("morchin", "urban_low_relief"),
    "desert": ("morchin", "desert"),
    "farmland": ("morchin", "farmland"),
    "wooded hills": ("morchin", "wooded_hills"),
    "mountains": ("morchin", "mountains"),
    "soil": ("ulaby_dobson", "soil"),
    "grass": ("ulaby_dobson", "grass"),
    "dry snow": ("ulaby_dobson", "dry_snow"),
    "wet snow": ("ulaby_dobson", "wet_snow"),
}
ATTITUDES = {  # beam, pitch and mean bank in degrees
    "level": (40.0, 0.0, 0.0),
    "beam 60": (60.0, 0.0, 0.0),
    "pitch 15": (40.0, 15.0, 0.0),
    "bank 15": (40.0, 0.0, 15.0),
    "bank 20": (40.0, 0.0, 20.0),
    "bank 30": (40.0, 0.0, 30.0),
    "bank 40": (40.0, 0.0, 40.0),
}
# Attitude over each of them under interference.
_JAMMED = "level,bank 30,beam 60,pitch 15,bank 15,bank 40,bank 20,level,beam 60,pitch 15".split(",")

KINDS = {
    "noise": "noise alone",
    "interference": "interference alone",
    "jammed": "return and interference",
    "drawn": "return, echo, one to three emitters and all levels drawn at random",
    "switched_on": "jammer switched on in mid-track",
    "landing": "landing over steps of the terrain, point return",
    "land": "minutes over land, level to banks of 40 degrees",
    "point": "minutes over a point, alone or with a weaker echo",
    "land_jammed": "land and interference",
    "step": "step of the ground",
    "missing": "frames lost and tagged",
    "slip": "samples lost without a tag",
    "nan": "frames that are not finite",
    "clipped": "converter clips",
    "altimeter": "another altimeter slides through, ground in sight",
    "altimeter_alone": "another altimeter slides through, no ground",
    "sawtooth": "altimeter with a saw-tooth of our slope, ground in sight",
    "spoofed": "second return switched on in mid-track",
    "spoofed_first": "second return there before the ground",
    "pull_off": "copy switched on over the ground walks off",
    "two_grounds": "two grounds 5 to 30 m apart",
    "bounce": "double and triple bounce",
    "beyond": "ground beyond the span, to the unambiguous limit",
    "frozen": "receiver repeats a frame or a block",
    "leakage": "leakage with its calibration, cables of 0 to 15 m",
    "gear": "landing gear next to leakage of 30 dB",
    "nonlinear": "sweep not linear, by a share of its bandwidth",
    "clock": "sample clocks of transmitter and receiver differ",
    "rotor": "rotor blades take a share of the return",
    "gnuradio": "GNU Radio's own transmitters",
    "fading": "NR and QPSK through continuous fading",
    "repeating": "interference that repeats itself exactly",
}


STRATA = {  # strata of the rates per flight hour: their share of the time in the air, an assumption, and their kinds
    "land, level": (0.80, ("land",)),
    "land, banked": (0.12, ("land",)),
    "a point": (0.01, ("point",)),
    "second returns, steps": (
        0.02,
        ("step", "altimeter", "altimeter_alone", "sawtooth", "spoofed", "spoofed_first", "pull_off")
        + ("two_grounds", "bounce", "beyond"),
    ),
    "faults": (
        0.001,
        ("missing", "slip", "nan", "clipped", "frozen", "leakage", "gear", "nonlinear", "clock", "rotor"),
    ),
    "emitters": (
        0.049,
        ("noise", "interference", "jammed", "drawn", "switched_on", "landing", "land_jammed")
        + ("gnuradio", "fading", "repeating"),
    ),
}


@dataclass(frozen=True)
class Case:
    """Conditions of a flight.

    - ``kind``, ``name``: ``kind`` is one of `KINDS`; ``name`` is unique and seeds the flights
    - ``overlap``, ``sir_db``, ``snr_db``: levels are against a return of unit power, whether there is one or not
    """

    kind: str
    name: str
    scene: str = ""
    """Shipped scene whose interferers transmit (for the kind ``gnuradio`` the transmitter); empty for none."""
    overlap: float = 1.0
    sir_db: float | None = None
    snr_db: float = 10.0
    ground: bool = True  # whether there is a return of the ground
    value: float = 0.0  # size of the fault: metres, dB, share of frames, ppm, rail over RMS; m/s over land
    known: str = ""
    """The limit of docs/tracker.md or docs/leakage.md, in that page's words, that puts the case outside the claim;
    empty inside it."""

    @property
    def known_limit(self) -> int:
        """1 outside the claim, 0 inside: a property of the case, never of the results."""
        return int(bool(self.known))


def stratum_of(case: Case) -> str:
    """The stratum of a case."""
    if case.kind == "land":
        return "land, banked" if "bank" in case.name else "land, level"
    return next(name for name, (_, kinds) in STRATA.items() if case.kind in kinds)


def cases(kinds: tuple[str, ...] = tuple(KINDS)) -> list[Case]:
    """Cases of these kinds."""
    return [case for case in _named().values() if case.kind in kinds]


def case_of(name: str) -> Case:
    """A case by its name; raises ValueError."""
    if name not in _named():
        raise ValueError(f"no case is called {name[:60]!r}; names are in cases.csv of a run")
    return _named()[name]


@lru_cache(maxsize=1)
def _named() -> dict[str, Case]:
    parts = _interference, _landings, _long, _faults, _deceptions, _returns, _installation, _transmitters
    return {case.name: case for part in parts for case in part()}


def _scenes(kind: str, sirs: tuple[float, ...], snrs: tuple[float, ...], ground: bool) -> Iterator[Case]:
    for scene in SCENES:
        sparse = scene == "fmcw"  # 27 ms per frame: fewer levels
        for overlap in (1.0,) if sparse else (0.3, 1.0):
            for sir in sirs[::3] if sparse else sirs:
                for snr in snrs[-1:] if sparse else snrs:
                    name = f"{kind}/{scene}/{overlap:g}/{sir:g}dB/snr{snr:g}"
                    yield Case(kind, name, scene, overlap, sir, snr, ground)


def _alone_and_jammed(kind: str, name: str, value: float, scene: str) -> Iterator[Case]:
    """A fault without interference and at an SIR of -20 dB."""
    label = "qpsk" if scene == "paper_qpsk" else scene
    yield Case(kind, f"{kind}/{name}", value=value)
    yield Case(kind, f"{kind}/{name}/{label}/-20dB", scene, sir_db=-20.0, value=value)


def _interference() -> Iterator[Case]:
    for number in range(_NOISE):
        yield Case("noise", f"noise/{number}", ground=False)
    yield from _scenes("interference", (-60.0, -30.0, 0.0), (10.0,), False)
    for number in range(_DRAWN):
        yield Case("drawn", f"drawn/{number}", overlap=np.nan, sir_db=np.nan, snr_db=np.nan)
    yield from _scenes("jammed", (-60.0, -50.0, -40.0, -30.0, -20.0, -10.0, 0.0), (-10.0, 10.0), True)


def _landings() -> Iterator[Case]:
    for scene, sir in (("paper_qpsk", -10), ("paper_qpsk", -28), ("nr5", -30), ("nr10", -20), ("tones", -40)):
        yield Case("switched_on", f"switched_on/{scene}/{sir}dB", scene, sir_db=sir)
        yield Case("landing", f"landing/{scene}/{sir}dB", scene, sir_db=sir)
    yield Case("landing", "landing/clear")


def _long() -> Iterator[Case]:
    for attitude in ATTITUDES:
        for land in LANDS:
            yield Case("land", f"land/{land}/{attitude}")
    for snr in (-10.0, 10.0):
        yield Case("point", f"point/snr{snr:g}", snr_db=snr)
        for apart in (30.0, 120.0):
            yield Case("point", f"point/snr{snr:g}/{apart:g}m/-12dB", sir_db=12.0, snr_db=snr, value=apart)
    for land, attitude in zip(LANDS, _JAMMED, strict=True):
        for scene, sir in (("nr10", -40.0), ("qpsk_shaped", -30.0), ("tones", -40.0)):
            name = f"land_jammed/{land}/{attitude}/{scene}/{sir:g}dB"
            yield Case("land_jammed", name, scene, sir_db=sir)


def _faults() -> Iterator[Case]:
    """Steps of the ground, and faults of converter and transport."""
    for value in (-300.0, -100.0, -30.0, -12.0, 12.0, 30.0, 100.0, 300.0):
        yield from _alone_and_jammed("step", f"{value:+g}m", value, "nr5")
        yield Case("step", f"step/{value:+g}m/late", value=value, known="in the last quarter of a block")
    for kind, values in (("missing", (0.1, 0.4)), ("nan", (0.1, 0.4)), ("clipped", (0.1, 0.5, 1.5))):
        for value in values:
            yield from _alone_and_jammed(kind, f"{value:g}", value, "paper_qpsk")
    for scene, sir in (("", None), ("paper_qpsk", -10.0), ("nr5", -20.0)):
        yield Case("slip", f"slip/{scene or 'clear'}", scene, sir_db=sir)


def _deceptions() -> Iterator[Case]:
    """Other altimeters, and returns that are not the ground."""
    for ppm in (0.05, 0.3, 3.0, 20.0):
        for sir in (10.0, 0.0, -20.0):
            slow, what = DRIFT * ppm <= 20.0, f"{ppm:g}ppm/{sir:g}dB"
            limit = "radar of the same sweep"
            hidden = limit if slow and sir < -6.0 else ""
            yield Case("altimeter", f"altimeter/{what}", sir_db=sir, value=ppm, known=hidden)
            alone, known = f"altimeter_alone/{what}", limit if slow else ""
            yield Case("altimeter_alone", alone, sir_db=sir, value=ppm, ground=False, known=known)
            hidden = "saw-tooth of our slope" if sir < -6.0 else ""
            yield Case("sawtooth", f"sawtooth/{what}", sir_db=sir, value=ppm, known=hidden)
    for side, way in ((1.0, "beyond"), (-1.0, "nearer")):
        for level in (-8.0, -3.0, 3.0, 10.0, 20.0):
            for kind, hides_db in (("spoofed", 20.0), ("spoofed_first", 10.0 if side > 0 else 6.0)):
                name = f"{kind}/{way}/{level:+g}dB"
                limit = "side lobes hide the ground" if kind == "spoofed" else "before the ground was seen"
                yield Case(kind, name, sir_db=-level, value=side, known=limit if level >= hides_db else "")


def _returns() -> Iterator[Case]:
    """More than one return, or ground where none is expected."""
    for side, way in ((1.0, "up"), (-1.0, "down")):
        for level in (6.0, 10.0, 15.0, 20.0):
            yield Case("pull_off", f"pull_off/{way}/{level:+g}dB", sir_db=-level, value=side)
    for apart in (5.0, 10.0, 15.0, 20.0, 30.0):
        one_peak = apart <= _PEAK_M
        for level in (-6.0, 0.0, 6.0):
            # the bound holds up to equal levels, or 6 dB within a resolution cell; docs/tracker.md has the rest
            known = "6 dB stronger" if level >= 6.0 else ""
            for phase in range(_PHASES):
                name = f"two_grounds/{apart:g}m/{level:+g}dB/{phase}"
                yield Case("two_grounds", name, sir_db=-level, value=apart, known=known)
        name, known = f"two_grounds/{apart:g}m/nr5", "echo within the peak" if one_peak else ""
        yield Case("two_grounds", name, "nr5", sir_db=-20.0, value=apart, known=known)
    for level in (-20.0, -10.0, -3.0):
        yield from _alone_and_jammed("bounce", f"{level:g}dB", level, "nr5")
    for snr in (-10.0, 10.0, 30.0):
        for number in range(4):
            yield Case("beyond", f"beyond/{number}/snr{snr:g}", snr_db=snr)
    for scene in ("nr5", "paper_qpsk"):
        known = "Ground beyond the span where interference hides it"
        yield Case("beyond", f"beyond/{scene}/-30dB", scene, sir_db=-30.0, known=known)


def _installation() -> Iterator[Case]:
    """Frozen receivers, leakage, landing gear, and sweeps and clocks that are not ideal."""
    for frames in (1.0, float(BLOCK)):
        yield from _alone_and_jammed("frozen", f"{frames:g}", frames, "paper_qpsk")
    for level in (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0):
        yield Case("leakage", f"leakage/{level:+g}dB", value=level)
    for left in (-15.0, 0.0, 6.0):  # residual of 40 dB whose phase has changed since the calibration
        known = "+6 dB and more" if left >= 6.0 else ""
        yield Case("leakage", f"leakage/left{left:+g}dB", sir_db=-left, value=40.0, known=known)
    for level in (-10.0, 0.0, 10.0, 20.0):
        yield Case("gear", f"gear/{level:+g}dB", value=level)
    for level in (-15.0, 0.0, 10.0):  # lowered in flight, so not in the calibration
        known = "+6 dB and more" if level >= 6.0 else ""
        yield Case("gear", f"gear/lowered/{level:+g}dB", sir_db=-level, value=level, known=known)
    for share in (0.001, 0.003, 0.01):
        yield Case("nonlinear", f"nonlinear/{100 * share:g}%", value=share)
    for share in (0.3, 1.0):
        yield Case("rotor", f"rotor/{share:g}", value=share)
    for ppm in (-20.0, 0.05, 0.1, 20.0):
        known = "0.05 to 0.1 ppm apart" if abs(ppm) < 1.0 else ""
        yield Case("clock", f"clock/{ppm:+g}ppm", value=ppm, known=known)


def _transmitters() -> Iterator[Case]:
    """Interference from other transmitters, through fading channels, and repeated exactly."""
    for sir in (-20.0, -40.0):
        for name in ("dvbt", "dvbt2", "atsc", "dvbs2", "ofdm"):
            yield Case("gnuradio", f"gnuradio/{name}/{sir:g}dB", name, sir_db=sir)
        for scene in ("nr5", "nr10", "qpsk_shaped"):
            for doppler_hz in (10.0, 300.0):
                name = f"fading/{scene}/{doppler_hz:g}Hz/{sir:g}dB"
                yield Case("fading", name, scene, sir_db=sir, value=doppler_hz)
    for scene, sir in (("nr10", -40.0), ("paper_qpsk", -28.0)):
        yield Case("repeating", f"repeating/{scene}", scene, sir_db=sir, known="repeats itself exactly")
