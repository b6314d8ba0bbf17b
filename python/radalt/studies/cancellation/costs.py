"""CPU time of the cancelling methods, and of their arithmetic alone, in transforms of a frame."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy import fft

from ...core.interference.emitters.qpsk_received import QpskReceivedEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.placement import Emitter, Interferer
from ...core.interference.stream import JammerStream
from ...core.mitigation import Mitigation, create
from ...core.mitigation.ofdm.lattice import nearest, power
from ...core.returns.point import point_return
from ...evaluation.results.table import number, table
from .cases import CASES, SNR_DB, WAVEFORM, received
from .tracked import FLIGHTS

__all__ = ["costs"]

_ROUNDS = 5  # the median of which is given
_LEAD = 20  # frames in which a method settles
# the same where searches are frames apart, and frames that hold some
_LONG_LEAD, _LONG = 512, 512
_FRAMES = 64  # one of them is judged anew in any case
_FEW, _PER_FRAME = 32, 10  # frames that fit a cache, and times their transforms are measured
_KINDS = (
    ("ofdm_cancel", "no OFDM", "nr10_stream", None, False),
    ("ofdm_cancel", "following, SIR -45 dB", "nr10_stream", -45.0, False),
    ("ofdm_cancel", "following, users of all four alphabets", "nr10_mixed_stream", -45.0, False),
    ("ofdm_cancel", "following, two radios", "nr10_radios", -45.0, False),
    ("ofdm_cancel", "following, carrier 1.234 567 MHz off", "nr10_offset_stream", -45.0, False),
    (
        "ofdm_cancel",
        "following, SIR -28 dB: the return is wider than a cell of 64QAM",
        "nr10_stream",
        -28.0,
        False,
    ),
    ("ofdm_cancel", "the same with users of all four alphabets", "nr10_mixed_stream", -28.0, False),
    ("ofdm_cancel", "looking for an emitter, SIR -45 dB", "nr10_stream", -45.0, True),
    ("qpsk_cancel", "no QPSK", "qpsk", None, False),
    ("qpsk_cancel", "following, SIR -45 dB", "qpsk_stream", -45.0, False),
    ("qpsk_cancel", "following one that begins anew in every frame", "qpsk", -45.0, False),
    ("qpsk_cancel", "looking for an emitter, SIR -45 dB", "qpsk", -45.0, True),
    ("hybrid", "no interference", "nr10_stream", None, False),
    ("hybrid", "following OFDM, SIR -45 dB", "nr10_stream", -45.0, False),
    ("hybrid", "following QPSK, SIR -45 dB", "qpsk_stream", -45.0, False),
    ("hybrid", "OFDM that cannot be read (noise 10 dB below it), SIR -45 dB", "nr10_noise10", -45.0, False),
)
_ON_THE_AIR = (
    ("three tones", (ToneEmitter(3),), 1.0),
    ("QPSK in 0.3 of the frame", (QpskReceivedEmitter(evm=TYPICAL),), 0.3),
    ("three tones, QPSK and 5 MHz NR", FLIGHTS["mixture"].emitters, 1.0),
)
_SYMBOLS = np.arange(13)[:, None] * 535 + np.arange(500)  # 13 whole symbols of 15 kHz
_ROW = np.exp(2j * np.pi * np.arange(500) / 500).astype(np.complex64)
_PLACES = np.arange(WAVEFORM.samples_per_frame) % _SYMBOLS.size


def costs(seed: int) -> str:
    """CPU time per frame of `ofdm_cancel`, `qpsk_cancel` and `hybrid` over that of a transform of the frame."""
    lines = []
    for method, title, case, sir_db, anew in _KINDS:
        frames, _ = received(CASES[case], sir_db, _LEAD + _FRAMES, np.random.default_rng([seed, 8]))
        lines.append([f"`{method}`: {title}", number(_of_method(create(method, WAVEFORM), frames, anew), 0)])
    for title, emitters, overlap in _ON_THE_AIR:
        cost = _of_method(create("hybrid", WAVEFORM), _heard(emitters, overlap, seed), lead=_LONG_LEAD)
        lines.append([f"`hybrid`: {title}, goes on, SIR -45 dB", number(cost, 0)])
    alone = _transforms(_kernels, frames[_LEAD:])
    return table(
        ["frame", "transforms"], [*lines, ["the arithmetic of following OFDM alone", number(alone, 0)]]
    )


def _heard(emitters: tuple[Emitter, ...], overlap: float, seed: int) -> np.ndarray:
    """(n, N) complex64 frames: a return, and 45 dB above it emitters of equal power that go on."""
    parts = [Interferer(emitter, -45.0, overlap) for emitter in emitters]
    stream = JammerStream(WAVEFORM, parts, seed=seed, total_sir_db=-45.0, free_running=overlap == 1.0)
    rng, count = np.random.default_rng([seed, 9]), _LONG_LEAD + _LONG
    frames = point_return(WAVEFORM, np.linspace(500.0, 505.0, count), dtype=np.complex128)
    frames += np.stack([stream.next_frame() for _ in range(count)])
    frames += (
        np.sqrt(0.5 * 10.0 ** (-SNR_DB / 10.0))
        * rng.standard_normal((*frames.shape, 2)).view(np.complex128)[..., 0]
    )
    return frames.astype(np.complex64)


def _of_method(method: Mitigation, frames: np.ndarray, anew: bool = False, lead: int = _LEAD) -> float:
    """One method, which has heard nothing before each frame if ``anew``."""

    def settle() -> None:
        method.reset()
        method.process(frames[:lead])

    def clean(frame: np.ndarray) -> None:
        if anew:
            method.reset()
        method.process(frame)

    return _transforms(clean, frames[lead:], settle)


def _transforms(
    work: Callable[[np.ndarray], None], frames: np.ndarray, settle: Callable[[], None] = lambda: None
) -> float:
    """CPU time of ``work`` per frame over that of a transform of a frame, whose samples are in the cache."""
    ratios, few = [], frames[:_FEW]
    for _ in range(_ROUNDS):
        settle()
        start = time.process_time_ns()
        for frame in frames:
            work(frame)
        middle = time.process_time_ns()
        for _ in range(_PER_FRAME):
            for frame in few:
                fft.fft(frame)
        transform = (time.process_time_ns() - middle) / (_PER_FRAME * len(few))
        ratios.append((middle - start) / len(frames) / max(1, transform))
    return float(np.median(ratios))


def _kernels(frame: np.ndarray) -> None:
    """What has to be computed to follow an emitter: symbols there and back, one decision, its error, the channel."""
    symbols = fft.fft(frame[_SYMBOLS], axis=1, overwrite_x=True)
    symbols *= _ROW  # timing
    points = nearest(symbols * _ROW, 64)  # channel
    sure = power(symbols - points) < 1
    model = points * _ROW
    energy = (power(model) * sure).sum(axis=0)
    channel = (symbols * model.conj() * sure).sum(axis=0) / np.maximum(energy, np.float32(1e-30))
    model *= channel
    frame - fft.ifft(model, axis=1, overwrite_x=True).ravel()[_PLACES]
