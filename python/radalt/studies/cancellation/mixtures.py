"""How far `hybrid` comes in a mixture of tones, QPSK and NR, and how far with the help of a genie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.interference.emitters.nr import NrEmitter
from ...core.interference.emitters.qpsk import QpskEmitter
from ...core.interference.emitters.qpsk_received import QpskReceivedEmitter
from ...core.interference.emitters.tones import ToneEmitter
from ...core.interference.evm import TYPICAL
from ...core.interference.placement import Emitter, Interferer, interference_frames
from ...evaluation.results.chain import Chain
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import SCORE_COLUMNS, score_frames
from .cases import CASES, WAVEFORM, received
from .known_symbols import rmse_correct_m

__all__ = ["MIXTURES", "MIXTURE_COLUMNS", "MIXTURE_SIRS_DB", "Mixture", "measure_mixture"]

MIXTURE_SIRS_DB = (-20.0, -25.0, -30.0, -35.0, -40.0, -45.0, -50.0)
_NR5 = NrEmitter(channel_bandwidth_hz=5e6, cell_id=402, frame_count=2, seed=43, evm=TYPICAL)
MIXTURE_COLUMNS = Columns(
    ("mixture", "sir_db", "method", *SCORE_COLUMNS, "rmse_correct_m"),
    text=frozenset({"mixture", "method"}),
    whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"}),
)


@dataclass(frozen=True)
class Mixture:
    """Three tones, QPSK and NR of equal power.

    Attributes
    ----------
    title : str
    qpsk : Emitter
    removed : tuple of str
        What a genie takes away exactly: ``tones``, ``QPSK``, ``NR``.
    """

    title: str
    qpsk: Emitter
    removed: tuple[str, ...] = ()

    @property
    def chain(self) -> Chain:
        """`hybrid`."""
        return Chain("hybrid", "hybrid", independent=True)

    @property
    def emitters(self) -> Mapping[str, Emitter]:
        """All three, whatever is removed."""
        return {"tones": ToneEmitter(3), "QPSK": self.qpsk, "NR": _NR5}


_PAPER, _RECEIVED = QpskEmitter(), QpskReceivedEmitter(evm=TYPICAL)
MIXTURES = {
    "paper": Mixture("nothing removed", _PAPER),
    "paper_tones": Mixture("tones removed", _PAPER, removed=("tones",)),
    "paper_nr": Mixture("NR removed", _PAPER, removed=("NR",)),
    "paper_qpsk": Mixture("QPSK removed", _PAPER, removed=("QPSK",)),
    "received": Mixture("QPSK as received", _RECEIVED),
}


def measure_mixture(name: str, sir_db: float, count: int, seed: list[int]) -> dict[str, Any]:
    """A row: ``count`` frames of ``MIXTURES[name]``, at that SIR in all.

    The frames of one seed are the same for all that may be removed; what stays keeps its level.
    """
    mixture = MIXTURES[name]
    rng = np.random.default_rng([*seed, round(-10 * sir_db)])
    frames, altitude_m = received(CASES["nr10_64qam"], None, count, rng)  # None: without
    each_db = sir_db + 10.0 * np.log10(len(mixture.emitters))
    for kind, emitter in mixture.emitters.items():
        heard = interference_frames(
            [Interferer(emitter, each_db)], count, WAVEFORM.samples_per_frame, WAVEFORM.rate_hz, rng
        )
        if kind not in mixture.removed:
            frames = frames + heard
    results, _ = mixture.chain.results(frames.astype(np.complex64), WAVEFORM)
    row = score_frames(results, altitude_m).row()
    where = {"mixture": name, "sir_db": sir_db, "method": "hybrid"}
    return where | row | {"rmse_correct_m": rmse_correct_m(results, altitude_m)}
