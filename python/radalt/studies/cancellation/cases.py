"""What a base station or a QPSK transmitter may send, and what happens to it on the way.

Emitters have typical error vectors unless a case is called ideal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...core.channel.simulated import ChannelSettings, SimulatedChannel
from ...core.interference.emitters import NamedEmitter
from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk import QpskEmitter
from ...core.interference.emitters.qpsk_received import QpskReceivedEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.multipath import FadedEmitter, FadingChannel
from ...core.interference.placement import Interferer, interference_frames
from ...core.interference.stream import JammerStream
from ...core.returns.point import point_return
from ...core.waveform import Waveform

__all__ = ["CASES", "NR10", "SNR_DB", "WAVEFORM", "Case", "received"]

WAVEFORM = Waveform()
SNR_DB = 10.0
SPEED_M_PER_S = 10.0
_LEAD = 4  # frames of a stream before the first that counts
NR10 = {"channel_bandwidth_hz": 10e6, "cell_id": 211, "frame_count": 2, "seed": 41, "evm": TYPICAL}
_NR5 = {"channel_bandwidth_hz": 5e6, "cell_id": 402, "frame_count": 2, "seed": 43, "evm": TYPICAL}
_QPSK = QpskReceivedEmitter(evm=TYPICAL)


@dataclass(frozen=True)
class Case:
    """One kind of interference.

    Attributes
    ----------
    title : str
        As in tables.
    carrier : mapping
        Keys of `NrEmitter`.
    overlap : float
        Of each frame.
    fading : FadingChannel or None
        On the way, drawn anew for every frame.
    antennas : int
        That send streams of their own on the same elements.
    own_snr_db : float or None
        Of the emitter's signal over noise that comes with it; None is none.
    tones : int
        Carriers of equal power together beside it, with as much power as it has.
    stream : bool
        Goes on from frame to frame; otherwise it starts anew with each.
    radio : mapping
        Keys of `ChannelSettings`: what clocks, mixers and converters do to a stream.
    qpsk : QpskEmitter or None
        Sends in the place of an NR carrier.
    asked : bool
        Whether its limit was asked for beforehand; then it is measured with three times as many frames.
    """

    title: str
    carrier: Mapping[str, object] = field(default_factory=lambda: NR10)
    overlap: float = 1.0
    fading: FadingChannel | None = None
    antennas: int = 1
    own_snr_db: float | None = None
    tones: int = 0
    stream: bool = False
    radio: Mapping[str, object] | None = None
    qpsk: QpskEmitter | None = None
    asked: bool = False

    def frames(self, count: int) -> int:
        """How many frames per SIR a study of ``count`` gives it."""
        return 3 * count if self.asked else count


@dataclass(frozen=True, kw_only=True)
class Antennas(NamedEmitter):
    """A base station's antennas, each with a stream of its own on the same elements, and noise that comes along.

    Emitter protocol; the streams have equal power, one timing, and payloads and phases of their own.
    ``sent``, if given, gets what an ideal transmitter would have sent, (count,) complex64 per call: a genie knows all
    symbols, and neither error vectors nor noise.
    """

    carrier: NrEmitter
    antennas: int = 1
    own_snr_db: float | None = None
    sent: list[np.ndarray] | None = field(default=None, compare=False, repr=False)

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 at `rate_hz`, mean power of the signal 1."""
        window = int(rng.integers(2**62))
        phase = np.exp(2j * np.pi * rng.random(self.antennas))

        def streams(**changes: float) -> np.ndarray:
            """(count,) the antennas' sum."""
            each = (
                turn
                * replace(self.carrier, seed=self.carrier.seed + number, **changes).samples(
                    count, rate_hz, np.random.default_rng(window)
                )
                for number, turn in enumerate(phase)
            )
            return sum(each) / np.sqrt(self.antennas)

        sent = streams()
        if self.sent is not None:
            self.sent.append((streams(evm=0.0) if self.carrier.evm else sent).astype(np.complex64))
        if self.own_snr_db is None:
            return sent
        noise = rng.standard_normal((count, 2)).view(np.complex128)[:, 0]
        return sent + np.sqrt(0.5 * 10.0 ** (-self.own_snr_db / 10.0)) * noise


def _nr10(**changes: object) -> dict[str, object]:
    return {**NR10, **changes}


_TWO_RADIOS = {
    "jammer_clock_ppm": 2.0,
    "jammer_lo_offset_hz": 3_100.0,
    "dc_offset": 0.5,
    "iq_gain_db": 0.05,
    "iq_phase_deg": 0.3,
    "adc_bits": 12,
}
_30_KM_PER_H_HZ = 120.0  # at 4.3 GHz
CASES = {
    "nr10_qpsk": Case("10 MHz, QPSK", _nr10(modulation="qpsk")),
    "nr10_16qam": Case("10 MHz, 16QAM", _nr10(modulation="16qam")),
    "nr10_64qam": Case("10 MHz, 64QAM", asked=True),
    "nr10_256qam": Case("10 MHz, 256QAM", _nr10(modulation="256qam"), asked=True),
    "nr10_mixed": Case("10 MHz, users of all four alphabets", _nr10(modulation="mixed"), asked=True),
    "nr10_mixed_stream": Case(
        "10 MHz, users of all four alphabets, goes on from frame to frame",
        _nr10(modulation="mixed"),
        stream=True,
        asked=True,
    ),
    "nr10_stream": Case("10 MHz, 64QAM, goes on from frame to frame", stream=True),
    "nr10_stream_256qam": Case(
        "10 MHz, 256QAM, goes on from frame to frame", _nr10(modulation="256qam"), stream=True
    ),
    "nr10_part": Case("10 MHz, 64QAM, 0.6 of the frame", overlap=0.6, asked=True),
    "nr10_burst": Case("10 MHz, 64QAM, 0.3 of the frame", overlap=0.3),
    "nr10_load70": Case("10 MHz, 64QAM, 70 % of the blocks in use", _nr10(load=0.7)),
    "nr10_load30": Case("10 MHz, 64QAM, 30 % of the blocks in use", _nr10(load=0.3)),
    "nr10_offset": Case("10 MHz, 64QAM, carrier 1.234 567 MHz off", _nr10(carrier_hz=1_234_567.0)),
    "nr10_offset_stream": Case(
        "10 MHz, 64QAM of 3.7 GHz, carrier 1.234 567 MHz off, goes on from frame to frame",
        _nr10(carrier_hz=1_234_567.0, upconversion_frequency_hz=3_699.99e6),
        stream=True,
    ),
    "nr5": Case("5 MHz, 64QAM", _NR5, asked=True),
    "nr5_part": Case("5 MHz, 64QAM, 0.6 of the frame", _NR5, overlap=0.6),
    "nr10_eva": Case("10 MHz, 64QAM, nine paths (EVA)", fading=FadingChannel(profile="EVA")),
    "nr10_eva_moving": Case(
        "10 MHz, 64QAM, nine paths (EVA), 30 km/h",
        fading=FadingChannel(profile="EVA", doppler_hz=_30_KM_PER_H_HZ),
    ),
    "nr10_paths_moving": Case(
        "10 MHz, 64QAM, four paths (RA4), 30 km/h",
        fading=FadingChannel(profile="RA4", doppler_hz=_30_KM_PER_H_HZ),
        asked=True,
    ),
    "nr10_walk_moving": Case(
        "10 MHz, 64QAM, four paths (PA), 30 km/h",
        fading=FadingChannel(profile="PA", doppler_hz=_30_KM_PER_H_HZ),
        asked=True,
    ),
    "nr10_etu": Case("10 MHz, 64QAM, nine paths over 5 us (ETU)", fading=FadingChannel(profile="ETU")),
    "nr10_radios": Case("10 MHz, 64QAM, two radios", stream=True, radio=_TWO_RADIOS, asked=True),
    "nr10_tones": Case("10 MHz, 64QAM, and three tones as strong", tones=3),
    "nr10_powers": Case(
        "10 MHz, mixed users of powers within 6 dB", _nr10(modulation="mixed", power_spread_db=6.0)
    ),
    "nr10_idle": Case("10 MHz, 64QAM, half of the slots idle", _nr10(slot_load=0.5)),
    "nr10_noise10": Case("10 MHz, 64QAM, heard with noise 10 dB below it", own_snr_db=10.0),
    "nr10_noise5": Case("10 MHz, 64QAM, heard with noise 5 dB below it", own_snr_db=5.0),
    "nr10_antennas": Case("10 MHz, 64QAM, two antennas' streams on the same elements", antennas=2),
    "qpsk": Case("QPSK, 2 MHz, rectangular pulses, as received", qpsk=_QPSK, asked=True),
    "qpsk_stream": Case("QPSK, rectangular, goes on from frame to frame", stream=True, qpsk=_QPSK),
    "qpsk_rrc": Case("QPSK, 2 MHz, root-raised-cosine, as received", qpsk=replace(_QPSK, pulse="rrc")),
    "qpsk_part": Case("QPSK, rectangular, 0.6 of the frame", overlap=0.6, qpsk=_QPSK),
    "qpsk_burst": Case("QPSK, rectangular, 0.3 of the frame", overlap=0.3, qpsk=_QPSK),
    "qpsk_eva": Case("QPSK, rectangular, nine paths (EVA)", fading=FadingChannel(profile="EVA"), qpsk=_QPSK),
    "qpsk_radios": Case("QPSK, rectangular, two radios", stream=True, radio=_TWO_RADIOS, qpsk=_QPSK),
    "nr10_ideal": Case("10 MHz, 64QAM, ideal emitter", _nr10(evm=0.0)),
    "nr10_256qam_ideal": Case("10 MHz, 256QAM, ideal emitter", _nr10(modulation="256qam", evm=0.0)),
    "qpsk_ideal": Case("QPSK, rectangular, as received, ideal emitter", qpsk=QpskReceivedEmitter()),
    "qpsk_paper": Case("QPSK as in the paper, switched on the sample grid, ideal", qpsk=QpskEmitter()),
}


def received(
    case: Case,
    sir_db: float | None,
    count: int,
    rng: np.random.Generator,
    sent: list[np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """(count, N) complex64 frames at the case's SIR (None: without interference) and their altitudes, 3..1500 m.

    ``sent``, if given, gets what NR antennas sent in each frame, (N,) complex64.
    """
    n, rate_hz = WAVEFORM.samples_per_frame, WAVEFORM.rate_hz
    altitude_m = rng.uniform(3.0, 1500.0, count)
    speed = rng.uniform(-SPEED_M_PER_S, SPEED_M_PER_S, count)
    returns = point_return(
        WAVEFORM,
        altitude_m,
        vertical_speed_m_per_s=speed,
        phase_cycles=rng.random(count),
        dtype=np.complex128,
    )
    emitter = case.qpsk or NrEmitter(**case.carrier)
    if case.antennas > 1 or case.own_snr_db is not None or sent is not None:
        emitter = Antennas(carrier=emitter, antennas=case.antennas, own_snr_db=case.own_snr_db, sent=sent)
    if case.fading is not None:
        emitter = FadedEmitter(emitter=emitter, channel=case.fading)
    interferers = [Interferer(emitter, 0.0 if sir_db is None else sir_db, case.overlap)]
    if case.tones:
        interferers.append(Interferer(ToneEmitter(case.tones), interferers[0].sir_db, case.overlap))
    if case.stream:
        stream = JammerStream(
            WAVEFORM, interferers, seed=int(rng.integers(2**31)), free_running=True, total_sir_db=None
        )
        stream.next_frame()  # it begins within this one
        jam = np.stack([stream.next_frame() for _ in range(count + _LEAD)])
        if sir_db is None:
            jam[:] = 0
        # gain is set so that the converter clips at four times the rms
        full_scale = 4.0 * np.sqrt(1.0 + 10.0 ** (-(sir_db or 0.0) / 10.0))
        return _through(case, returns, jam, full_scale, rng), altitude_m
    noise = rng.standard_normal((count, n, 2)).view(np.complex128)[..., 0]
    frames = returns + np.sqrt(0.5 * 10.0 ** (-SNR_DB / 10.0)) * noise
    if sir_db is not None:
        frames += interference_frames(interferers, count, n, rate_hz, rng, total_sir_db=sir_db)
    return frames.astype(np.complex64), altitude_m


def _through(
    case: Case, returns: np.ndarray, jam: np.ndarray, full_scale: float, rng: np.random.Generator
) -> np.ndarray:
    """(count, N) complex64: both streams through the simulated front end, whole frames again."""
    n = WAVEFORM.samples_per_frame
    settings = ChannelSettings(
        snr_db=SNR_DB, start_offset_samples=float(n), full_scale=full_scale, **(case.radio or {})
    )
    channel = SimulatedChannel(WAVEFORM, settings, seed=int(rng.integers(2**31)), frames=len(jam))
    radar = np.zeros_like(jam)
    radar[_LEAD - 1 : -1] = returns  # comes a frame later; the jammer, where its clock drifts, two
    out = [
        np.concatenate([part for _, part in channel.process(*both)]) for both in zip(radar, jam, strict=True)
    ]
    return np.stack(out[_LEAD:]).astype(np.complex64)
