"""The planner: parts that a scene builds, imports and computes, and parts that it leaves out, each with its reason.

The flowgraph, the reports and ``ota_eval.py --plan`` use this list. The planner imports none of the parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.channel.settings import ChannelSettings
from ...core.receiver.altimeter import shared_altimeter
from ...core.receiver.altimeter_settings import AltimeterSettings
from ...core.scene import Scene

__all__ = ["Part", "Plan", "left_out", "make_plan"]


@dataclass(frozen=True)
class Part:
    """A part of a run.

    Attributes
    ----------
    name : str
    needed : bool
    why : str
        Reason in the scene.
    module : str
        Module that is not imported without the part; empty for none.
    """

    name: str
    needed: bool
    why: str
    module: str = ""


@dataclass(frozen=True)
class Plan:
    """Parts of a run, and dimensions of the altimeter's processing.

    Attributes
    ----------
    parts : tuple of Part
    radios : int
        B210s of a run with radios.
    span_m, band_hz : (low, high)
        Searched altitudes and their beat frequencies.
    decimation, fft_size, doppler_cells : int
        Decimation and FFT length of the beat spectrum; largest difference of the half sweeps' beats, in cells.
    full_decimation, full_fft_size : int
        Decimation and FFT length for the default span of 1500 m.
    """

    parts: tuple[Part, ...]
    radios: int
    span_m: tuple[float, float]
    band_hz: tuple[float, float]
    decimation: int
    fft_size: int
    doppler_cells: int
    full_decimation: int
    full_fft_size: int

    @property
    def left_out(self) -> list[str]:
        """One line for every part that is not built, imported or computed."""
        return [f"{part.name}: {part.why}" for part in self.parts if not part.needed]

    @property
    def absent_modules(self) -> list[str]:
        """Modules that a simulated run of this scene does not import."""
        return [part.module for part in self.parts if part.module and not part.needed]

    def text(self) -> str:
        """The plan for a terminal."""
        lines = ["built:"]
        lines += [f"  {p.name}: {p.why}" for p in self.parts if p.needed]
        lines += ["left out:"] + [f"  {line}" for line in self.left_out]
        lines += [
            "computed:",
            f"  altitudes {self.span_m[0]:g}..{self.span_m[1]:g} m: beats {self.band_hz[0] / 1e3:.1f}.."
            f"{self.band_hz[1] / 1e3:.1f} kHz, decimation {self.decimation}, FFT of {self.fft_size} "
            f"(1500 m: {self.full_decimation}, {self.full_fft_size}); half sweeps differ by at most "
            f"{self.doppler_cells} cells",
            "  once for all methods: reference sweep, segmenting, tables of altimeters that measure alike; each "
            "method: its frames and spectra",
            f"  radios on the air: {self.radios}",
        ]
        return "\n".join(lines)


def make_plan(scene: Scene, methods: Sequence[str], *, simulated: bool = True) -> Plan:
    """Plan of a run of a scene with these methods, with the simulated channel or with radios."""
    altimeter = shared_altimeter(scene.waveform, scene.altimeter_settings)
    full = shared_altimeter(scene.waveform, AltimeterSettings())
    settings = altimeter.settings
    return Plan(
        parts=(*_parts(scene, methods), *(_simulated(scene.channel) if simulated else _ON_AIR)),
        radios=2 if scene.has_jammer else 1,
        span_m=(settings.min_altitude_m, settings.max_altitude_m),
        band_hz=altimeter.search_hz,
        decimation=altimeter.decimation,
        fft_size=altimeter.fft_size,
        doppler_cells=altimeter.doppler_cells,
        full_decimation=full.decimation,
        full_fft_size=full.fft_size,
    )


def left_out(scene: Scene, methods: Sequence[str], *, simulated: bool = True) -> list[str]:
    """Parts that a scene does not need and that are not built or imported, each with its reason."""
    return make_plan(scene, methods, simulated=simulated).left_out


_ON_AIR = (Part("simulated channel", False, "the radios are real"),)


def _parts(scene: Scene, methods: Sequence[str]) -> list[Part]:
    from ...core.mitigation import METHODS

    jammer = scene.has_jammer
    terrain = scene.return_model == "terrain"
    delays = scene.altitude.mode == "true_delay"
    absent = [m for m in METHODS if m not in methods]
    network = any(METHODS[m].runs_network for m in methods if m in METHODS)
    parts = [
        Part(
            "jammer source and second B210",
            jammer,
            "the scene has interference" if jammer else "the scene has no interference (or overlap 0)",
        ),
        Part(f"methods {', '.join(methods)}", True, "asked for"),
        Part(
            "onnxruntime",
            network,
            "a network is among the methods" if network else "no network among the methods",
            "onnxruntime",
        ),
        Part(
            "terrain",
            terrain or scene.landing is not None,
            "the scene has a landing" if scene.landing is not None else "the scene has no landing",
            "radalt.core.returns.terrain",
        ),
        Part(
            "true delay and Doppler",
            delays or terrain,
            "the simulated channel delays the return"
            if delays or terrain
            else "altitudes are synthetic beat shifts",
        ),
        Part("windows", False, "headless; the live flowgraphs have them", "PyQt5"),
        Part("matplotlib", False, "figures are drawn by the report, after the run", "matplotlib"),
    ]
    if absent:
        parts.insert(2, Part(f"methods {', '.join(absent)}", False, "not asked for"))
    return parts


def _simulated(channel: ChannelSettings) -> list[Part]:
    """Parts of the simulated channel, and the radios that it replaces."""
    stated = {
        "noise": channel.snr_db is not None,
        "DC offset": bool(channel.dc_offset),
        "IQ imbalance": bool(channel.iq_gain_db or channel.iq_phase_deg),
        "converter": bool(channel.adc_bits),
        "jammer clock and LO": bool(channel.jammer_clock_ppm or channel.jammer_lo_offset_hz),
        "lost samples": bool(channel.drops.count),
        "leakage": channel.leakage_db is not None,
        "multipath": channel.return_multipath is not None,
    }
    on = [name for name, is_on in stated.items() if is_on]
    off = [name for name, is_on in stated.items() if not is_on]
    parts = [Part("UHD and radios", False, "the channel is simulated", "gnuradio.uhd")]
    parts += [Part(f"channel impairments {', '.join(on)}", True, "on in the scene")] if on else []
    return parts + ([Part(f"channel impairments {', '.join(off)}", False, "off in the scene")] if off else [])
