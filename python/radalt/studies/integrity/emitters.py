"""Interferers of the integrity campaign, which continue from frame to frame."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy import signal

from ...core.interference import Emitter, Interferer, QpskEmitter, ToneEmitter
from ...core.interference.effects import ImpairedEmitter, Impairments
from ...core.interference.effects import parts as parts_of
from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.multipath import FadingChannel
from ...core.interference.transmission import Signal, Transmission, in_blocks
from ...core.scene import load_scene
from .cases import WAVEFORM, Case

_ANEW = "fmcw"  # an emitter that is received now and then: each frame's window is drawn to contain a passage
_NR_FRAMES = 4  # NR frames of 10 ms after which a drawn transmitter starts again
_REPEATED = 20  # radar frames after which a repeating transmitter starts again (docs/tracker.md)
_TRANSMITTED_S = 0.3  # signal of GNU Radio's transmitters from which every 40 ms are drawn


@dataclass(frozen=True)
class _Samples:
    """An emitter known by windows of its samples only."""

    samples: Callable[[int, float, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class _Repeated:
    """The first ``period`` samples of an emitter, again and again."""

    emitter: Emitter
    period: int

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """See `Emitter`."""
        first = self.emitter.samples(self.period, rate_hz, rng)
        return in_blocks(lambda k: first, self.period)


def interferers_of(case: Case, rng: np.random.Generator) -> tuple[list[Interferer], float | None]:
    """Interferers of a case, and their SIR together if it is set for all of them.

    Bursts keep their place in the sweep, tones their frequencies.
    """
    if case.kind == "drawn":
        parts = [Interferer(_drawn(rng), 0.0, case.overlap) for _ in range(rng.integers(1, 4))]
        total_sir_db = case.sir_db
    elif case.kind == "gnuradio":
        parts = [Interferer(_transmitter(case.scene, int(rng.integers(1 << 31))), case.sir_db)]
        total_sir_db = None
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
        out.append(dataclasses.replace(interferer, emitter=_continued(case, emitter), start=start))
    return out, total_sir_db if len(out) > 1 or case.kind == "drawn" else None


def _continued(case: Case, emitter: object) -> object:
    """The emitter as it continues from frame to frame."""
    count = WAVEFORM.samples_per_frame
    if case.kind == "fading":
        fading = FadingChannel(profile="EVA", doppler_hz=case.value)
        through = ImpairedEmitter(emitter=emitter, effects=Impairments(fading=fading))
        return Transmission(through, count, steady=True)
    if getattr(parts_of(emitter)[0], "scene_name", "") == _ANEW:
        return emitter
    return Transmission(_Repeated(emitter, _REPEATED * count) if case.kind == "repeating" else emitter, count)


def _transmitter(name: str, seed: int) -> _Samples:
    """Random windows of the signal of one of GNU Radio's transmitters."""
    from ...evaluation.transmitters import TRANSMITTERS, transmit

    ratio = Fraction(WAVEFORM.rate_hz) / Fraction(TRANSMITTERS[name].rate_hz)
    sent = transmit(name, _TRANSMITTED_S, seed)
    sent = signal.resample_poly(sent, ratio.numerator, ratio.denominator).astype(np.complex64)

    def samples(count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        first = int(rng.integers(sent.size - count + 1))
        return sent[first : first + count]

    return _Samples(samples)


def _drawn(rng: np.random.Generator) -> object:
    """Tones, QPSK or NR of random width and place in the band."""
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
