"""How far `ofdm_cancel` would come if a genie told it every symbol: what decisions cost, and what noise leaves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import erfc

from ...core.mitigation.ofdm.acquisition import acquire, find_prefix, transforms
from ...core.mitigation.ofdm.channel_fit import fit, sums
from ...core.mitigation.ofdm.lattice import middle, power
from ...core.mitigation.ofdm.modulator import BLANKED
from ...core.mitigation.ofdm_cancel import OfdmCancel
from ..results.chain import Chain
from ..results.rows import Columns
from ..results.score import CORRECT_LIMIT_M, SCORE_COLUMNS, score_frames
from .cases import CASES, NR10, WAVEFORM, Case, received

__all__ = [
    "KNOWN",
    "KNOWN_COLUMNS",
    "KNOWN_METHODS",
    "KNOWN_SIRS_DB",
    "KnownSymbols",
    "misread_share",
    "rmse_correct_m",
    "weak_return_gain_db",
    "with_known_symbols",
]

KNOWN_SIRS_DB = (-20.0, -22.5, -25.0, -27.5, -30.0, -32.5, -35.0, -40.0, -45.0, -50.0)
KNOWN: Mapping[str, Case] = {
    "64qam": Case("64QAM"),
    "mixed": CASES["nr10_mixed"],
    "64qam_10": CASES["nr10_noise10"],
    "64qam_8": Case("64QAM, noise 8 dB below it", own_snr_db=8.0),
    "64qam_5": CASES["nr10_noise5"],
    "qpsk_8": Case("QPSK, noise 8 dB below it", NR10 | {"modulation": "qpsk"}, own_snr_db=8.0),
    "antennas": CASES["nr10_antennas"],
}
KNOWN_METHODS = ("none", "ofdm_cancel", "known symbols")
KNOWN_COLUMNS = Columns(
    ("kind", "sir_db", "method", *SCORE_COLUMNS, "rmse_correct_m"),
    text=frozenset({"kind", "method"}),
    whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"}),
)


class KnownSymbols(OfdmCancel):
    """`OfdmCancel` that is told what was sent. The channel is still to be estimated, and the return to be kept."""

    def given(self, frame: np.ndarray, sent: np.ndarray) -> np.ndarray:
        """(N,) complex64 frame less what was ``sent`` (N,) by a channel that stands still, without a carrier offset."""
        numerology, ridge = self._kinds[0]
        prefix = find_prefix(sent, numerology)
        starts = acquire(sent, prefix, numerology, lambda starts: ridge.clear(starts, 0.0)).starts
        clear = ridge.clear(starts, 0.0)
        symbols, points = (transforms(signal, starts, numerology) for signal in (frame, sent))
        times = np.zeros(len(starts), dtype=np.float32)
        agreement, weight = symbols * points.conj() * clear, power(points) * clear
        channel = fit(*sums(agreement, weight, times, 0), 0, 1)[0]
        rest = (symbols - channel * points) * ~clear
        every = np.ones(len(starts), dtype=bool)
        out = frame - self._modulator.samples(symbols - rest, every, starts, numerology)
        level = power(out)
        return out * (level <= np.float32(BLANKED) * middle(level))


def with_known_symbols(kind: str, sir_db: float, count: int, seed: list[int]) -> list[dict[str, Any]]:
    """A row per method, of ``count`` frames of one of `KNOWN`."""
    sent: list[np.ndarray] = []
    rng = np.random.default_rng([*seed, list(KNOWN).index(kind), round(-10 * sir_db)])
    frames, altitude_m = received(KNOWN[kind], sir_db, count, rng, sent)
    genie = KnownSymbols(WAVEFORM)
    rows = []
    for method in KNOWN_METHODS:
        heard, chain = frames, method
        if method == "known symbols":
            heard, chain = np.stack([genie.given(*pair) for pair in zip(frames, sent, strict=True)]), "none"
        results, _ = Chain(chain, chain).results(heard, WAVEFORM)
        score = score_frames(results, altitude_m)
        rows.append(
            {"kind": kind, "sir_db": sir_db, "method": method}
            | score.row()
            | {"rmse_correct_m": rmse_correct_m(results, altitude_m)}
        )
    return rows


def rmse_correct_m(results: np.ndarray, altitude_m: np.ndarray) -> float:
    """Root mean square error of the altitudes that are right; NaN without any."""
    error = (results["altitude_m"] - altitude_m)[results["valid"]]
    right = error[np.abs(error) < CORRECT_LIMIT_M]
    return float(np.sqrt(np.mean(right**2))) if right.size else float("nan")


def misread_share(points: int, snr_db: float) -> float:
    """Share of wrong nearest points of square QAM in white noise (Proakis, Digital Communications, eq. 4.3-30)."""
    rail = (1 - 1 / np.sqrt(points)) * erfc(np.sqrt(1.5 * 10.0 ** (snr_db / 10.0) / (points - 1)))
    return float(1 - (1 - rail) ** 2)


def weak_return_gain_db(points: int, snr_db: float) -> float:
    """Most that a weak return's signal to noise ratio can rise under square QAM with white noise ``snr_db`` below it.

    It is the received power times the Fisher information of its density (Kassam, Signal Detection in Non-Gaussian
    Noise, 1988), rail by rail; nothing else of the carrier is known than its channel and alphabet.
    """
    side = round(np.sqrt(points))
    levels = np.sqrt(1.5 / (points - 1)) * (2 * np.arange(side) - side + 1)
    variance = 0.5 * 10.0 ** (-snr_db / 10.0)
    value = np.linspace(-4.0, 4.0, 20_001)
    away = value[:, None] - levels
    parts = np.exp(-(away**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance) / side
    slope = (away * parts).sum(axis=1) / variance
    information = np.sum(slope**2 / np.maximum(parts.sum(axis=1), 1e-300)) * (value[1] - value[0])
    return float(10 * np.log10(information * (0.5 + variance)))
