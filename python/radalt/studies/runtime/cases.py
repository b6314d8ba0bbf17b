"""Interferers and frames of the error-against-run-time study."""

from typing import Any

import numpy as np

from ...core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk_received import QpskReceivedEmitter
from ...core.interference.evm import TYPICAL
from ...core.returns.point import point_return
from ...core.waveform import Waveform

WAVEFORM = Waveform()
SNR_DB = 10.0  # as in the other studies of single frames
TRANSFORM = "transform"  # "chain" of the rows that time one complex64 FFT of a frame
CLEAN = "clean"  # "interferer" of frames without interference
# name -> (emitter, overlap)
INTERFERERS: dict[str, tuple[Any, float]] = {
    "QPSK shaped, all": (QpskEmitter(pulse="rrc", evm=TYPICAL), 1.0),
    "QPSK rectangular, all": (QpskEmitter(evm=TYPICAL), 1.0),
    "QPSK rectangular, 30 %": (QpskEmitter(evm=TYPICAL), 0.3),
    "QPSK as received, all": (QpskReceivedEmitter(evm=TYPICAL), 1.0),
    "5 tones, all": (ToneEmitter(5), 1.0),
    "NR 5 MHz, all": (NrEmitter(channel_bandwidth_hz=5e6, evm=TYPICAL), 1.0),
    "NR 10 MHz, all": (NrEmitter(channel_bandwidth_hz=10e6, evm=TYPICAL), 1.0),
    "NR 10 MHz ideal, all": (NrEmitter(channel_bandwidth_hz=10e6), 1.0),
}


def frames_of(name: str | None, sir_db: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(count, N) complex64 frames with one interferer (None: without), and their altitudes, 10 to 1450 m."""
    number = 0 if name is None else 1 + list(INTERFERERS).index(name)
    rng = np.random.default_rng([seed, number, round(-sir_db)])
    truth = rng.uniform(10.0, 1450.0, count)
    noise = rng.standard_normal((count, WAVEFORM.samples_per_frame, 2)) @ np.array([1.0, 1.0j]) / np.sqrt(2.0)
    frames = point_return(WAVEFORM, truth) + noise * 10.0 ** (-SNR_DB / 20.0)
    if name is not None:
        emitter, overlap = INTERFERERS[name]
        jam = Interferer(emitter, sir_db, overlap)
        frames = frames + interference_frames([jam], count, WAVEFORM.samples_per_frame, WAVEFORM.rate_hz, rng)
    return frames.astype(np.complex64), truth
