"""The planner: parts that a scene builds, imports and computes, and parts that it leaves out, each with its reason.

The flowgraph, the reports and ``ota_eval.py --plan`` use this list. The planner imports none of the parts.
"""

from collections.abc import Sequence
from typing import NamedTuple

from ...core.altimeter.altimeter import Altimeter, shared_altimeter
from ...core.altimeter.altimeter_settings import AltimeterSettings
from ...core.channel.settings import ChannelSettings
from ...core.scene import Scene


class Part(NamedTuple):
    """A part of a run, and the reason in the scene."""

    name: str
    needed: bool
    why: str


class Plan(NamedTuple):
    """Parts of a run, B210s of a run with radios, and the altimeter of all methods."""

    parts: tuple[Part, ...]
    radios: int
    altimeter: Altimeter

    @property
    def left_out(self) -> list[str]:
        """One line for every part that is not built, imported or computed."""
        return [f"{part.name}: {part.why}" for part in self.parts if not part.needed]

    def text(self) -> str:
        """The plan for a terminal."""
        a = self.altimeter
        full = shared_altimeter(a.waveform, AltimeterSettings())
        low_khz, high_khz = (1e-3 * f for f in a.search_hz)
        lines = [
            "built:",
            *(f"  {part.name}: {part.why}" for part in self.parts if part.needed),
            "left out:",
            *(f"  {line}" for line in self.left_out),
            "computed:",
            f"  altitudes {a.settings.min_altitude_m:g}..{a.settings.max_altitude_m:g} m: beats {low_khz:.1f}.."
            f"{high_khz:.1f} kHz, decimation {a.decimation}, FFT of {a.fft_size} "
            f"(1500 m: {full.decimation}, {full.fft_size}); half sweeps differ by at most {a.doppler_cells} cells",
            "  once for all methods: reference sweep, segmenting, tables of altimeters that measure alike; each "
            "method: its frames and spectra",
            f"  radios on the air: {self.radios}",
        ]
        return "\n".join(lines)


def make_plan(scene: Scene, methods: Sequence[str], *, simulated: bool = True) -> Plan:
    """Plan of a run of a scene with these methods, with the simulated channel or with radios."""
    radios = [Part("simulated channel", False, "the radios are real")]
    around = _simulated(scene.channel) if simulated else radios
    altimeter = shared_altimeter(scene.waveform, scene.altimeter_settings)
    return Plan((*_parts(scene, methods), *around), 2 if scene.has_jammer else 1, altimeter)


def _parts(scene: Scene, methods: Sequence[str]) -> list[Part]:
    from ...core.mitigation import METHODS

    landing = scene.landing is not None
    delayed = scene.altitude.mode == "true_delay" or scene.return_model == "terrain"
    network = any(METHODS[m].runs_network for m in methods if m in METHODS)
    jammer = f"the scene has {'interference' if scene.has_jammer else 'no interference (or overlap 0)'}"
    delays = "the simulated channel delays the return" if delayed else "altitudes are synthetic beat shifts"
    networks = "a network is among the methods" if network else "no network among the methods"
    terrain = f"the scene has {'a' if landing else 'no'} landing"
    two = scene.auxiliary is not None
    parts = [
        Part("jammer source and second B210", scene.has_jammer, jammer),
        Part("second receive channel", two, f"the scene has {'a' if two else 'no'} section auxiliary"),
        Part(f"methods {', '.join(methods)}", True, "asked for"),
        Part("onnxruntime", network, networks),
        Part("terrain", landing, terrain),
        Part("true delay and Doppler", delayed, delays),
        Part("windows", False, "headless; the live flowgraphs have them"),
        Part("matplotlib", False, "figures are drawn by the report, after the run"),
    ]
    absent = [m for m in METHODS if m not in methods]
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
    parts = [Part("UHD and radios", False, "the channel is simulated")]
    for needed, why in ((True, "on in the scene"), (False, "off in the scene")):
        names = [name for name, on in stated.items() if on == needed]
        parts += [Part(f"channel impairments {', '.join(names)}", needed, why)] if names else []
    return parts
