#!/usr/bin/env python3
"""Sensitivity of `ofdm_cancel` to its settings: each number 0.7 and 1.3 times as large, a few frames per case.

.venv/bin/python tools/ofdm_settings.py --frames 8                      # all settings; minutes
.venv/bin/python tools/ofdm_settings.py --frames 8 --settings chance,blank_ratio
.venv/bin/python tools/ofdm_settings.py --prices                        # prices of the steps beside measured costs
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from scipy import fft

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))

from radalt.core.mitigation.ofdm.settings import SETTINGS, OfdmSettings
from radalt.core.mitigation.ofdm_cancel import OfdmCancel
from radalt.core.receiver.altimeter import AltimeterSettings, shared_altimeter
from radalt.studies.cancellation.cases import CASES, WAVEFORM, received

# SIR of each case, 3 dB above its break-point, where a setting has most effect
MEASURED = {
    "ideal": -55.0,
    "evm_3": -47.0,
    "evm_8": -39.0,
    "256qam": -45.0,
    "qpsk_users": -33.0,
    "mixed": -44.0,
    "layer_20": -32.0,
    "precoding": -35.0,
    "eva": -46.0,
    "ra4_moving": -35.0,
    "nr5": -38.0,
    "stream": -44.0,
}
FACTORS = (0.7, 1.3)


def changed(name: str, factor: float) -> OfdmSettings | None:
    """The settings with one of them multiplied, whole numbers changed by at least one; None if it is no number."""
    value = getattr(SETTINGS, name)
    if isinstance(value, tuple):
        if name == "spacings_hz":  # numerologies, no threshold
            return None
        return dataclasses.replace(SETTINGS, **{name: tuple(factor * v for v in value)})
    if isinstance(value, int):
        step = round(value * factor)
        return dataclasses.replace(
            SETTINGS, **{name: step if step != value else value + (1 if factor > 1 else -1)}
        )
    return dataclasses.replace(SETTINGS, **{name: value * factor})


@cache
def drawn(name: str, frames: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames of a case, which all settings share, and their altitudes."""
    rng = np.random.default_rng([seed, list(CASES).index(name)])
    return received(CASES[name], MEASURED[name], frames, rng)


def right(settings: OfdmSettings, frames: int, seed: int) -> dict[str, float]:
    """Pd of each case."""
    method = OfdmCancel(WAVEFORM, settings=settings)
    altimeter = shared_altimeter(WAVEFORM, AltimeterSettings())
    out = {}
    for name in MEASURED:
        case = CASES[name]
        given, altitude_m = drawn(name, frames, seed)
        cleaned = given.copy()
        method.reset()
        for row, frame in zip(cleaned, given, strict=True):
            if not case.stream:
                method.reset()
            row[:] = method.process(frame)
        result = altimeter.process(cleaned)
        out[name] = float(np.mean(result["valid"] & (np.abs(result["altitude_m"] - altitude_m) < 5.0)))
    return out


def prices(frames: int, seed: int) -> None:
    """Print price and measured cost per frame of each case, in FFTs of 7,500 points."""
    method = OfdmCancel(WAVEFORM)
    for name, sir_db in MEASURED.items():
        case = CASES[name]
        given, _ = received(case, sir_db, frames, np.random.default_rng(seed))
        method.reset()
        said, spent, unit = [], [], []
        for frame in given:
            if not case.stream:
                method.reset()
            begin = time.thread_time()
            method.process(frame)
            spent.append(time.thread_time() - begin)
            said.append(method.outcome.ffts)
            for _ in range(3):
                begin = time.thread_time()
                fft.fft(frame)
                unit.append(time.thread_time() - begin)
        measured = np.median(spent) / np.median(unit)
        print(f"{name:12s} price {np.median(said):4.0f}, measured {measured:4.0f}, most {max(said):4.0f}")


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line per setting and factor: mean Pd lost, and the case that loses most."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=8, help="per case (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--settings", default="", help="names with commas (default: all)")
    parser.add_argument("--prices", action="store_true", help="compare prices with measured costs instead")
    args = parser.parse_args(argv)
    if args.prices:
        prices(args.frames, args.seed)
        return 0
    known = [field.name for field in dataclasses.fields(OfdmSettings)]
    names = args.settings.split(",") if args.settings else known
    strange = next((name for name in names if name not in known), None)
    if strange is not None:
        parser.error(f"--settings holds {strange!r}; known: {', '.join(known)}")
    usual = right(SETTINGS, args.frames, args.seed)
    print("unchanged:", " ".join(f"{name} {pd:.2f}" for name, pd in usual.items()), flush=True)
    for name in names:
        for factor in FACTORS:
            settings = changed(name, factor)
            if settings is None:
                continue
            found = right(settings, args.frames, args.seed)
            lost = {case: usual[case] - pd for case, pd in found.items()}
            worst = max(lost, key=lost.get)
            mean = float(np.mean(list(lost.values())))
            print(f"{name} x {factor}: mean {-mean:+.3f}, {worst} {-lost[worst]:+.2f}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
