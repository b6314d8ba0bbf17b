"""How far `hybrid` comes in a mixture of which a genie takes parts away: what limits it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk import QpskEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.placement import Emitter, Interferer, interference_frames
from ..results.chain import Chain
from ..results.rows import Columns
from ..results.score import SCORE_COLUMNS, score_frames
from .cases import CASES, WAVEFORM, received

__all__ = ["GENIE_COLUMNS", "GENIE_METHOD", "GENIE_SIRS_DB", "MIXTURE", "REMOVED", "mixture_without"]

GENIE_METHOD = "hybrid"
GENIE_SIRS_DB = (-20.0, -25.0, -27.5, -30.0, -32.5, -35.0, -40.0, -45.0, -50.0)
_NR5 = NrEmitter(channel_bandwidth_hz=5e6, cell_id=402, frame_count=2, seed=43)
MIXTURE: Mapping[str, Emitter] = {"tones": ToneEmitter(3), "QPSK": QpskEmitter(), "NR": _NR5}
REMOVED = {
    "nothing": (),
    "tones": ("tones",),
    "NR": ("NR",),
    "QPSK": ("QPSK",),
    "tones and NR": ("tones", "NR"),
    "tones and QPSK": ("tones", "QPSK"),
}
GENIE_COLUMNS = Columns(
    ("removed", "sir_db", "method", *SCORE_COLUMNS),
    text=frozenset({"removed", "method"}),
    whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"}),
)


def mixture_without(removed: str, sir_db: float, count: int, seed: list[int]) -> dict[str, Any]:
    """A row: ``count`` frames of `MIXTURE`, at that SIR in all, of which the genie takes `REMOVED` away exactly.

    The frames of one seed are the same for all that may be removed; what stays keeps its level.
    """
    rng = np.random.default_rng([*seed, round(-10 * sir_db)])
    frames, altitude_m = received(CASES["nr10_64qam"], None, count, rng)  # None: without
    each_db = sir_db + 10.0 * np.log10(len(MIXTURE))
    for name, emitter in MIXTURE.items():
        heard = interference_frames(
            [Interferer(emitter, each_db)], count, WAVEFORM.samples_per_frame, WAVEFORM.rate_hz, rng
        )
        if name not in REMOVED[removed]:
            frames = frames + heard
    results, _ = Chain(GENIE_METHOD, GENIE_METHOD).results(frames.astype(np.complex64), WAVEFORM)
    score = score_frames(results, altitude_m)
    return {"removed": removed, "sir_db": sir_db, "method": GENIE_METHOD} | score.row()
