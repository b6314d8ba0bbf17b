"""Cases of the cancellation study: signals of base stations and QPSK transmitters, their channels and radios."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...core.channel.settings import ChannelSettings
from ...core.channel.simulated import SimulatedChannel
from ...core.interference.amplifier import Amplifier
from ...core.interference.effects import ImpairedEmitter, Impairments
from ...core.interference.emitters import NamedEmitter
from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk_received import QpskReceivedEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.multipath import FadingChannel
from ...core.interference.placement import Emitter, Interferer, interference_frames
from ...core.interference.stream import JammerStream
from ...core.returns.point import point_return
from ...core.waveform import Waveform

WAVEFORM = Waveform()
SNR_DB = 10.0  # as in the other studies of single frames
SPEED_M_PER_S = 10.0  # largest vertical speed, up and down
NR10 = {"channel_bandwidth_hz": 10e6, "cell_id": 211, "frame_count": 2, "seed": 41}
_NR5 = {"channel_bandwidth_hz": 5e6, "cell_id": 402, "frame_count": 2, "seed": 43}
_NR20 = {
    "channel_bandwidth_hz": 20e6,
    "subcarrier_spacing_hz": 30e3,
    "modulation": "256qam",
    "frame_count": 2,
    "seed": 45,
}
_NR100 = {"channel_bandwidth_hz": 100e6, "subcarrier_spacing_hz": 30e3, "seed": 47}
_LEAD = 4  # frames of a stream before the first that counts: the channel delays radar and jammer differently
_30_KM_PER_H_HZ, _5_KM_PER_H_HZ = 120.0, 20.0  # Doppler at 4.3 GHz


@dataclass(frozen=True, kw_only=True)
class Noisy(NamedEmitter):
    """An emitter with white noise of its own, ``noise_db`` below it: emitter protocol."""

    emitter: Emitter
    noise_db: float

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 at `rate_hz`, mean power of the signal 1."""
        sent = self.emitter.samples(count, rate_hz, rng)
        noise = rng.standard_normal((count, 2)).view(np.complex128)[:, 0]
        return sent + np.sqrt(0.5 * 10.0 ** (-self.noise_db / 10.0)) * noise


@dataclass(frozen=True)
class Case:
    """One kind of interference.

    Attributes
    ----------
    title : str
        Name in tables.
    emitter : Emitter
    method : str
        Canceller for this emitter.
    overlap : float
    tones : int
        Number of tones beside the emitter; together they have its power.
    stream : bool
        Whether the emitter continues from frame to frame; otherwise frames are independent.
    radio : mapping or None
        Keys of `ChannelSettings`: clocks, mixers and converters of a stream.
    """

    title: str
    emitter: Emitter
    method: str = "ofdm_cancel"
    overlap: float = 1.0
    tones: int = 0
    stream: bool = False
    radio: Mapping[str, object] | None = None


def _nr10(evm: float = 0.0, **changes: object) -> NrEmitter:
    return NrEmitter(**{**NR10, "evm": evm, **changes})


def _faded(profile: str, doppler_hz: float = 0.0) -> ImpairedEmitter:
    fading = FadingChannel(profile=profile, doppler_hz=doppler_hz)
    return ImpairedEmitter(emitter=_nr10(0.03), effects=Impairments(fading=fading))


_OFFSETS = {
    "jammer_clock_ppm": 2.0,
    "jammer_lo_offset_hz": 3_100.0,
    "dc_offset": 0.5,
    "iq_gain_db": 0.05,
    "iq_phase_deg": 0.3,
    "adc_bits": 12,
}
_QPSK = QpskReceivedEmitter(evm=TYPICAL)
CASES = {
    "ideal": Case("64QAM, ideal", _nr10()),
    "evm_3": Case("64QAM, EVM 3 %", _nr10(0.03)),
    "evm_5": Case("64QAM, EVM 5 %", _nr10(0.05)),
    "evm_8": Case("64QAM, EVM 8 %", _nr10(0.08)),
    "256qam": Case("256QAM, EVM 3.5 %", _nr10(0.035, modulation="256qam")),
    "16qam": Case("16QAM, EVM 12.5 %", _nr10(0.125, modulation="16qam")),
    "qpsk_users": Case("QPSK, EVM 17.5 %", _nr10(0.175, modulation="qpsk")),
    "mixed": Case("users of all four constellations, EVM 3 %", _nr10(0.03, modulation="mixed")),
    "powers": Case(
        "all four constellations, powers within 6 dB, EVM 3 %",
        _nr10(0.03, modulation="mixed", power_spread_db=6.0),
    ),
    "load_30": Case("64QAM, EVM 3 %, 30 % of the blocks in use", _nr10(0.03, load=0.3)),
    "amplifier": Case(
        "64QAM, amplifier 6 dB below saturation",
        ImpairedEmitter(emitter=_nr10(), effects=Impairments(amplifier=Amplifier(backoff_db=6.0))),
    ),
    "layer_20": Case("64QAM, second layer 20 dB down", _nr10(second_layer_db=-20.0)),
    "layer_0": Case("64QAM, second layer of equal power", _nr10(second_layer_db=0.0)),
    "precoding": Case("64QAM, EVM 3 %, precoding per group and slot", _nr10(0.03, precoding=True)),
    "eva": Case("64QAM, EVM 3 %, nine paths (EVA)", _faded("EVA")),
    "ra4": Case("64QAM, EVM 3 %, four paths (RA4)", _faded("RA4")),
    "pa": Case("64QAM, EVM 3 %, four paths (PA)", _faded("PA")),
    "etu": Case("64QAM, EVM 3 %, echoes beyond the prefix (ETU)", _faded("ETU")),
    "eva_moving": Case("EVA, 30 km/h, EVM 3 %", _faded("EVA", _30_KM_PER_H_HZ)),
    "ra4_moving": Case("RA4, 30 km/h, EVM 3 %", _faded("RA4", _30_KM_PER_H_HZ)),
    "pa_moving": Case("PA, 30 km/h, EVM 3 %", _faded("PA", _30_KM_PER_H_HZ)),
    "nr5": Case("5 MHz, 64QAM, EVM 8 %", NrEmitter(**_NR5, evm=0.08)),
    "nr20": Case("20 MHz, 30 kHz, 256QAM, EVM 3.5 %", NrEmitter(**_NR20, evm=0.035)),
    "nr100": Case("100 MHz, 30 kHz, 64QAM, EVM 3 %", NrEmitter(**_NR100, evm=0.03)),
    "part": Case("64QAM, EVM 3 %, 0.6 of the frame", _nr10(0.03), overlap=0.6),
    "burst": Case("64QAM, EVM 3 %, 0.3 of the frame", _nr10(0.03), overlap=0.3),
    "tones": Case("64QAM, EVM 3 %, and three tones as strong", _nr10(0.03), tones=3),
    "noise_10": Case("64QAM, noise 10 dB below it", Noisy(emitter=_nr10(), noise_db=10.0)),
    "noise_5": Case("64QAM, noise 5 dB below it", Noisy(emitter=_nr10(), noise_db=5.0)),
    "stream": Case("stream, 64QAM, EVM 3 %", _nr10(0.03), stream=True),
    "stream_mixed": Case(
        "stream, all four constellations, EVM 3 %", _nr10(0.03, modulation="mixed"), stream=True
    ),
    "stream_radios": Case(
        "stream, CFO, clock, IQ and DC offsets, EVM 3 %", _nr10(0.03), stream=True, radio=_OFFSETS
    ),
    "stream_ra4_5": Case("stream, RA4, 5 km/h, EVM 3 %", _faded("RA4", _5_KM_PER_H_HZ), stream=True),
    "stream_ra4_30": Case("stream, RA4, 30 km/h, EVM 3 %", _faded("RA4", _30_KM_PER_H_HZ), stream=True),
    "qpsk": Case("QPSK, 2 MHz, rectangular, typical EVM", _QPSK, "qpsk_cancel"),
    "qpsk_stream": Case("stream, QPSK, rectangular, typical EVM", _QPSK, "qpsk_cancel", stream=True),
}


def received(
    case: Case, sir_db: float | None, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(count, N) complex64 frames at the case's SIR (None: without interference) and their altitudes, 3..1500 m."""
    n, rate_hz = WAVEFORM.samples_per_frame, WAVEFORM.rate_hz
    altitude_m = rng.uniform(3.0, 1500.0, count)
    returns = point_return(
        WAVEFORM,
        altitude_m,
        vertical_speed_m_per_s=rng.uniform(-SPEED_M_PER_S, SPEED_M_PER_S, count),
        phase_cycles=rng.random(count),
        dtype=np.complex128,
    )
    interferers = [Interferer(case.emitter, 0.0 if sir_db is None else sir_db, case.overlap)]
    if case.tones:
        interferers.append(Interferer(ToneEmitter(case.tones), interferers[0].sir_db, case.overlap))
    if case.stream:
        stream = JammerStream(
            WAVEFORM, interferers, seed=int(rng.integers(2**31)), free_running=True, total_sir_db=None
        )
        stream.next_frame()  # the emitter starts within this frame
        jam = np.stack([stream.next_frame() for _ in range(count + _LEAD)])
        if sir_db is None:
            jam[:] = 0
        return _through(case, returns, jam, sir_db, rng), altitude_m
    noise = rng.standard_normal((count, n, 2)).view(np.complex128)[..., 0]
    frames = returns + np.sqrt(0.5 * 10.0 ** (-SNR_DB / 10.0)) * noise
    if sir_db is not None:
        frames += interference_frames(interferers, count, n, rate_hz, rng, total_sir_db=sir_db)
    return frames.astype(np.complex64), altitude_m


def _through(
    case: Case, returns: np.ndarray, jam: np.ndarray, sir_db: float | None, rng: np.random.Generator
) -> np.ndarray:
    """(count, N) complex64 frames of both streams behind the simulated front end."""
    n = WAVEFORM.samples_per_frame
    # the gain is set so that the converter clips at four times the RMS
    full_scale = 4.0 * np.sqrt(1.0 + 10.0 ** (-(sir_db or 0.0) / 10.0))
    settings = ChannelSettings(
        snr_db=SNR_DB, start_offset_samples=float(n), full_scale=full_scale, **(case.radio or {})
    )
    channel = SimulatedChannel(WAVEFORM, settings, seed=int(rng.integers(2**31)), frames=len(jam))
    radar = np.zeros_like(jam)
    radar[_LEAD - 1 : -1] = returns  # arrives a frame later, the jammer with a drifting clock two
    out = [
        np.concatenate([part for _, part in channel.process(*both)]) for both in zip(radar, jam, strict=True)
    ]
    return np.stack(out[_LEAD:]).astype(np.complex64)
