"""The first hour on two radios: the bench, its steps in order, and a verdict with a number and a likely cause for each.

A step flies short programmes with `run_hardware`, whose interlock and gates stand before every transmitter, or through
the simulated channel. It yields `Check` after `Check`; a refusal of the set-up is a failed one.
"""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.channel.simulated import ChannelSettings
from ...core.radio.interlock import require_enclosure
from ...core.radio.levels import drive
from ...core.radio.recording import Stretch, open_capture, write_metadata
from ...core.scene import Scene
from ...core.scene.build import channel_of, jammer_of, segmenter_of, sweeps_of
from ..engine.options import expected_errors
from ..flowgraph.rewrite import JAMMER_GATE, RADAR_GATE
from ..simulation import TAIL_FRAMES, PointResult, run_chain, segmented

__all__ = ["CABLING", "Bench", "Check", "Flight", "Step", "perform", "skipped"]

CABLING = r"""
   radar radio                                        jammer radio
  +------------+                                     +------------+
  |      TX/RX |--[ A dB ]--+           +--[ A dB ]--| TX/RX      |
  |            |            |           |            |            |
  |            |        +---+-----------+---+        |            |
  |            |        |     combiner      |        | RX2: 50 ohm|
  |            |        +---------+---------+        |            |
  |        RX2 |------------------+                  |            |
  +------------+                                     +------------+
     A = radio.attenuation_db of the scene, less the combiner's loss (3 to 6 dB), rated for the transmit power.
     With clock_source external: 10 MHz and PPS to both. Without jammer: TX/RX --[ A dB ]-- RX2.
     Measure A with every cable in place before the first start. Damage begins at -15 dBm at RX2.
"""
_SIMULATED_LATENCY = 150.3  # samples, fraction included as on a bench
_RECORDER = "radalt first-light"
_SETTLE_S = 0.02  # time before a receiver's samples are used, s: UHD's DC correction settles
_LISTEN_LIMIT_S = 30.0  # longest reception with the transmitters off, s


@dataclass(frozen=True)
class Check:
    """One measured value and its limits; without a value it was skipped, and ``cause`` says why.

    ``cause`` is the most likely cause of a value beyond the limits.
    """

    step: str
    what: str
    value: float | None
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    cause: str = ""

    @property
    def verdict(self) -> str:
        """``pass``, ``fail`` or ``skipped``; a value that is not a number fails."""
        if self.value is None:
            return "skipped"
        return "pass" if self.low <= self.value <= self.high else "fail"

    @property
    def limit(self) -> str:
        """The limits in words."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{self.low:g} to {self.high:g}" if self.low < self.high else f"{self.low:g}"
        if math.isfinite(self.low):
            return f"at least {self.low:.3g}"
        return f"at most {self.high:.3g}" if math.isfinite(self.high) else "none"

    @property
    def shown(self) -> str:
        """The value with its unit; a dash without one."""
        return "-" if self.value is None else f"{self.value:.4g} {self.unit}".strip()


def skipped(step: str, what: str, why: str) -> Check:
    """A skipped check."""
    return Check(step, what, None, cause=why)


@dataclass(frozen=True)
class Flight:
    """One run of a programme.

    Attributes
    ----------
    result : PointResult
    samples : (n,) complex64
        By the sample counter since the transmitters' start; NaN where none was recorded or kept.
    latency : float
        In samples; NaN where the sweep was not found.
    """

    scene: Scene
    result: PointResult
    samples: np.ndarray
    latency: float

    def frames(self, first: int, last: int, latency: float | None = None) -> np.ndarray:
        """(last - first, N) samples of the sweeps ``first..last-1``, on the whole sample before each begins."""
        n = self.scene.waveform.samples_per_frame
        start = first * n + math.floor(self.latency if latency is None else latency)
        return self.samples[start : start + (last - first) * n].reshape(-1, n)


@dataclass
class Bench:
    """Two radios with the cabling between them, or their simulation.

    Attributes
    ----------
    scene : Scene
        Waveform, interference and ``radio``.
    folder : Path
        Folder of the captures.
    frames, starts, minutes : number
        Trials at each altitude, starts whose latencies are compared, length of the last step.
    known : dict
        Results of earlier steps: ``noise`` and ``level`` (powers, 1 is full scale), ``latency``.
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
        if self.simulated:
            # the rail that clears the scene's shortest burst by 12 dB, but leaves the return well above a 12-bit step
            rail = min(50.0, 4.0 * 10.0 ** (max(0.0, 6.0 - self.scene.sir_db) / 20.0))
            channel = ChannelSettings(
                snr_db=30.0,
                start_offset_samples=_SIMULATED_LATENCY,
                adc_bits=12,
                full_scale=rail,
                dc_offset=1e-3,
                iq_gain_db=0.05,
            )
            self.scene = dataclasses.replace(self.scene, channel=channel)
        else:
            require_enclosure(self.scene, self.transmit)

    @property
    def full_scale(self) -> float:
        """Rail of the receiver."""
        return self.scene.channel.full_scale if self.simulated else 1.0

    def programme(self, *altitudes_m: float, jammer: bool = False, **changes: Any) -> Scene:
        """The scene with these altitudes (metres), `frames` at each; without interference unless ``jammer``."""
        spec = dataclasses.replace(
            self.scene.altitude,
            programme_m=altitudes_m,
            frames=changes.pop("frames", self.frames),
            mode="synthetic",
        )
        if not jammer:
            changes |= {"interference": (), "total_sir_db": None}
        return dataclasses.replace(self.scene, altitude=spec, **changes)

    def drive_db(self, scene: Scene) -> float:
        """Level of the radar by its digital drive (``fullscale``) in a scene, relative to a full-scale sample."""
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
        """Run a programme once. ``capture`` names the recording to keep; ``silent`` gates pass zeros."""
        data = self.folder / "captures" / f"{capture}.sigmf-data"
        data.parent.mkdir(parents=True, exist_ok=True)
        if self.simulated:
            result = run_chain(scene, methods if RADAR_GATE not in silent else ())
            latency = math.nan if RADAR_GATE in silent else _simulated_latency(scene)
            if capture:
                pieces = np.concatenate([s for _, s in _simulated(scene, silent)])
                pieces.tofile(data)
                write_metadata(
                    data,
                    scene,
                    [Stretch(0, 0, pieces.size)],
                    latency_samples=_SIMULATED_LATENCY,
                    recorder=_RECORDER,
                )
        else:
            from .hardware import run_hardware

            result = run_hardware(
                scene,
                methods,
                transmit=self.transmit,
                use_calibration=False,
                capture=data.with_suffix("") if capture else None,
                silent=tuple(silent),
                time_limit_s=time_limit_s,
                log=self.log,
                sleep=self.sleep,
            )
            latency = float(result.segmenter["latency_samples"])
        samples = self._kept(data, scene, latency) if capture else np.empty(0, np.complex64)
        return Flight(scene, result, samples / np.float32(self.full_scale), latency)

    def _kept(self, data: Path, scene: Scene, latency: float) -> np.ndarray:
        """Samples of a recording up to its programme's end; the rest is removed from the file."""
        n = scene.waveform.samples_per_frame
        end = (scene.altitude.programme.total_frames + TAIL_FRAMES) * n
        held = open_capture(data)
        kept = [dataclasses.replace(s, count=min(s.count, end - s.global_index)) for s in held.stretches]
        kept = [s for s in kept if s.count > 0]
        samples = np.full(end, np.nan, np.complex64)
        for counter, block in held.blocks(scene.waveform.rate_hz):
            block = block[: max(0, end - counter)]
            samples[counter : counter + block.size] = block
        if kept:
            os.truncate(data, 8 * (kept[-1].file_start + kept[-1].count))
            write_metadata(
                data,
                scene,
                kept,
                latency_samples=0.0 if math.isnan(latency) else latency,
                recorder=_RECORDER,
                radio=held.radio,
            )
        return samples

    def listen(self, frames: int) -> np.ndarray:
        """(frames, N) samples with every transmitter off: none is opened."""
        scene = self.programme(0.0, frames=frames)
        n = scene.waveform.samples_per_frame
        if self.simulated:
            silent = (RADAR_GATE, JAMMER_GATE)
            heard = np.concatenate([s for _, s in _simulated(scene, silent)])[: frames * n]
        else:
            heard = _received_alone(scene, frames * n, self.sleep, self.log)
        data = self.folder / "captures" / "receiver.sigmf-data"
        data.parent.mkdir(parents=True, exist_ok=True)
        heard.tofile(data)
        write_metadata(data, scene, [Stretch(0, 0, heard.size)], latency_samples=0.0, recorder=_RECORDER)
        return (heard / np.float32(self.full_scale)).reshape(frames, n)


def _simulated_latency(scene: Scene) -> float:
    """Latency of the sweep by the segmenter; NaN without a lock."""
    frame = next((frames[0] for frames in segmented(scene, segmenter_of(scene)) if frames), None)
    if frame is None:
        return math.nan
    w = scene.waveform
    return frame.start_sample - frame.index * w.samples_per_frame + frame.offset_s * w.rate_hz


def _simulated(scene: Scene, silent: Collection[str]) -> Iterator[tuple[int, np.ndarray]]:
    """(sample counter, samples) of the simulated channel, a frame at a time, its transmitters silent or not."""
    sweeps, channel = sweeps_of(scene), channel_of(scene)
    jammer = jammer_of(scene) if scene.has_jammer and JAMMER_GATE not in silent else None
    for k in range(scene.altitude.programme.total_frames + TAIL_FRAMES):
        radar = sweeps.sweep(k)
        yield from channel.process(
            np.zeros_like(radar) if RADAR_GATE in silent else radar,
            None if jammer is None else jammer.next_frame(),
        )


def _received_alone(
    scene: Scene, count: int, sleep: Callable[[float], None], log: Callable[[str], None]
) -> np.ndarray:
    """(count,) samples of the radar's receiver, whose radio is opened for that alone."""
    from gnuradio import blocks, gr, uhd

    from ..flowgraph.watch import run_to_end
    from .setup import bring_up, start_together

    radio, skip = scene.radio, round(_SETTLE_S * scene.waveform.rate_hz)
    address = f"serial={radio.radar_serial}," if radio.radar_serial else ""
    top = gr.top_block()
    stream = uhd.stream_args(cpu_format="fc32", args="", channels=[0])
    top.radar_usrp_source = uhd.usrp_source(f"{address}master_clock_rate={radio.master_clock_hz:.0f}", stream)
    for entry in bring_up(top, scene, uhd, sleep):
        log(str(entry))
    start_together(top, scene, uhd)
    head, sink = blocks.head(gr.sizeof_gr_complex, skip + count), blocks.vector_sink_c(1, skip + count)
    top.connect(top.radar_usrp_source, head, sink)
    run_to_end(top, time_limit_s=_LISTEN_LIMIT_S)
    return np.array(sink.data()[skip:], np.complex64)


@dataclass(frozen=True)
class Step:
    """One step of the hour.

    Attributes
    ----------
    name, title : str
    connect : str
        Cabling for the step.
    measure : callable
        ``(bench) -> iterator of Check``.
    needs : tuple of str
        Entries of ``bench.known`` without which it is skipped.
    """

    name: str
    title: str
    connect: str
    measure: Callable[[Bench], Iterator[Check]]
    needs: tuple[str, ...] = ()


def perform(bench: Bench, steps: Sequence[Step], show: Callable[[Check], None]) -> list[Check]:
    """Perform every step in order, also after a failure; each check is passed to ``show``."""
    checks: list[Check] = []

    def add(check: Check) -> None:
        checks.append(check)
        show(check)

    for step in steps:
        missing = [name for name in step.needs if name not in bench.known]
        if missing:
            add(
                skipped(
                    step.name, step.title, f"needs the {missing[0]} of an earlier step, which did not find it"
                )
            )
            continue
        try:
            for check in step.measure(bench):
                add(check)
        except expected_errors() as error:
            add(Check(step.name, "run", math.nan, cause=str(error)))
        except RuntimeError as error:  # UHD's, of a device that is missing or was pulled out
            add(Check(step.name, "run", math.nan, cause=" ".join(str(error).split())[:300]))
    return checks
