"""How far `ofdm_cancel` would come if a genie told it every symbol: what decisions cost, and what noise leaves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import erfc

from ...core.mitigation.ofdm.acquisition import acquire, find_prefix, transforms
from ...core.mitigation.ofdm.channel_fit import fit, sums
from ...core.mitigation.ofdm.lattice import power
from ...core.mitigation.ofdm_cancel import OfdmCancel
from ...evaluation.results.chain import Chain
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import CORRECT_LIMIT_M, SCORE_COLUMNS, score_frames
from .cases import CASES, NR10, WAVEFORM, Case, received

__all__ = [
    "BLANKED_BURST",
    "KNOWN",
    "KNOWN_COLUMNS",
    "KNOWN_METHODS",
    "KNOWN_SIRS_DB",
    "KnownSymbols",
    "misread_share",
    "placed",
    "rmse_correct_m",
    "weak_return_gain_db",
    "with_known_symbols",
]

KNOWN_SIRS_DB = (-20.0, -22.5, -25.0, -27.5, -30.0, -32.5, -35.0, -40.0, -45.0, -50.0)
KNOWN: Mapping[str, Case] = {
    "64qam": CASES["nr10_64qam"],
    "mixed": CASES["nr10_mixed"],
    "64qam_10": CASES["nr10_noise10"],
    "64qam_8": Case("10 MHz, 64QAM, heard with noise 8 dB below it", own_snr_db=8.0),
    "64qam_5": CASES["nr10_noise5"],
    "qpsk_8": Case(
        "10 MHz, QPSK, heard with noise 8 dB below it", NR10 | {"modulation": "qpsk"}, own_snr_db=8.0
    ),
    "antennas": CASES["nr10_antennas"],
    "part": CASES["nr10_part"],
    "burst": CASES["nr10_burst"],
    "5mhz_part": CASES["nr5_part"],
    "load30": CASES["nr10_load30"],
    "powers": CASES["nr10_powers"],
    "eva_moving": CASES["nr10_eva_moving"],
    "ra4_moving": CASES["nr10_paths_moving"],
    "pa_moving": CASES["nr10_walk_moving"],
    "etu": CASES["nr10_etu"],
}
KNOWN_METHODS = ("none", "ofdm_cancel", "known symbols")
BLANKED_BURST = "burst blanked"  # a reference without interference: that part of a clean frame is zero
_STILL_ROUNDS = 4
KNOWN_COLUMNS = Columns(
    ("kind", "sir_db", "method", *SCORE_COLUMNS, "rmse_correct_m"),
    text=frozenset({"kind", "method"}),
    whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"}),
)


class KnownSymbols(OfdmCancel):
    """`OfdmCancel` that is told what was sent. The channel is still to be estimated, and the return to be kept."""

    def given(self, frame: np.ndarray, sent: np.ndarray, *, moving: bool = False) -> np.ndarray:
        """(N,) complex64 frame less what was ``sent`` (M,), without a carrier offset.

        Its place in the frame is that of the greatest correlation. Symbols that the frame or the burst cuts stay, as
        in any demodulation. The channel of a subcarrier stands still, or is quadratic in time where it is ``moving``.
        """
        numerology, ridge = self._kinds[0]
        sent, first, last = placed(frame, sent)
        starts = acquire(
            sent, find_prefix(frame, numerology), numerology, lambda starts: ridge.clear(starts, 0.0)
        ).starts
        whole = (starts >= first) & (starts + numerology.useful <= last)
        clear, points = ridge.clear(starts, 0.0), transforms(sent, starts, numerology)
        told = clear & whole[:, None]
        times = ((np.arange(len(starts)) - (len(starts) - 1) / 2) / (len(starts) / 2)).astype(np.float32)
        samples = frame
        for _ in range(_STILL_ROUNDS if moving else 1):
            symbols = transforms(samples, starts, numerology)
            agreement, weight, order = symbols * points.conj() * told, power(points) * told, 2 * moving
            courses = fit(*sums(agreement, weight, times, order), order, 1)
            channel = sum(times[:, None] ** n * course for n, course in enumerate(courses))
            if moving:  # the change within a symbol spreads subcarriers over their neighbours
                change = (np.gradient(channel, axis=0) * points).astype(np.complex64)
                spread = self._modulator.samples(change, whole, starts, numerology)
                samples = frame - spread * self._modulator.offsets(starts, numerology)
        symbols = transforms(samples, starts, numerology) if moving else symbols
        rest = (symbols - channel * points) * ~clear
        return self._modulator.subtract(samples, None, symbols - rest, whole, starts, numerology)


def placed(frame: np.ndarray, sent: np.ndarray) -> tuple[np.ndarray, int, int]:
    """What was ``sent`` (M,), where it is in the ``frame`` (N,): (N,) complex64, its first sample and the one after
    its last."""
    length = frame.size + sent.size
    met = np.fft.ifft(np.fft.fft(frame, length) * np.fft.fft(sent, length).conj())
    first = int(np.abs(met).argmax())
    first -= length if first >= frame.size else 0
    at = np.arange(max(0, first), min(frame.size, first + sent.size))
    out = np.zeros(frame.size, dtype=np.complex64)
    out[at] = sent[at - first]
    return out, int(at[0]), int(at[-1]) + 1


def with_known_symbols(kind: str, sir_db: float, count: int, seed: list[int]) -> list[dict[str, Any]]:
    """A row per method, of ``count`` frames of one of `KNOWN`; of bursts also `BLANKED_BURST`."""
    case, sent = KNOWN[kind], []
    seed = [*seed, list(KNOWN).index(kind), round(-10 * sir_db)]
    frames, altitude_m = received(case, sir_db, count, np.random.default_rng(seed), sent)
    heard = {method: frames for method in KNOWN_METHODS}
    genie, moving = KnownSymbols(WAVEFORM), case.fading is not None and case.fading.doppler_hz > 0
    heard["known symbols"] = np.stack(
        [genie.given(*pair, moving=moving) for pair in zip(frames, sent, strict=True)]
    )
    if case.overlap < 1:
        alone, _ = received(case, None, count, np.random.default_rng(seed))
        heard[BLANKED_BURST] = alone
        for clean, frame, burst in zip(alone, frames, sent, strict=True):
            _, first, last = placed(frame, burst)
            clean[first:last] = 0
    rows = []
    for method, given in heard.items():
        chain = method if method == "ofdm_cancel" else "none"
        results, _ = Chain(chain, chain).results(given, WAVEFORM)
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
