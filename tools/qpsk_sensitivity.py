#!/usr/bin/env python3
"""Sensitivity of the QPSK receiver to its settings: Pd of the QPSK cases with each 30 % lower and 30 % higher.

    .venv/bin/python tools/qpsk_sensitivity.py            # a line per setting, then those that lose more than 0.02
    .venv/bin/python tools/qpsk_sensitivity.py --costs    # costs of the receiver's steps in FFTs of 7,500 points

All settings share their frames. Integers are rounded, and change by at least one.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy import fft

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))
from radalt.core.interference import QpskEmitter
from radalt.core.mitigation.qpsk.cma_equaliser import CmaEqualiser
from radalt.core.mitigation.qpsk.pulse_estimation import estimate_pulse
from radalt.core.mitigation.qpsk.settings import DEFAULTS, QpskSettings
from radalt.core.mitigation.qpsk.symbol_timing import find_symbol_timings
from radalt.core.mitigation.qpsk.zero_order_hold import cancel_zero_order_hold
from radalt.core.mitigation.qpsk_cancel import QpskCancel, without_tones
from radalt.core.receiver.altimeter import Altimeter
from radalt.studies.cancellation.cases import CASES, WAVEFORM, received

SEED = 161_803
NAMES = tuple(name for name, case in CASES.items() if case.method == "qpsk_cancel")
SIRS_DB = (-20.0, -45.0)
MOST_LOST = 0.02  # loss of Pd that counts as sensitive: one frame of 50
_TRIES = 35  # timed calls of a step, fewer than the 40 frames of an emitter's window in a stream


def pd(settings: QpskSettings, frames: np.ndarray, altitude_m: np.ndarray) -> float:
    """Share of (n, N) frames with a correct altitude behind a receiver with these settings."""
    result = Altimeter(WAVEFORM).process(QpskCancel(WAVEFORM, settings=settings).process(frames))
    return float(np.mean(result["valid"] & (np.abs(result["altitude_m"] - altitude_m) < 5.0)))


def changed(name: str, factor: float) -> QpskSettings:
    """The settings with one of them ``factor`` times as large; lengths that have to be even stay even."""
    value = getattr(DEFAULTS, name)
    if isinstance(value, int):
        step = 2 if name in ("pulse_samples", "taps") else 1
        moved = max(1, step * round(factor * value / step))
        value = moved if moved != value else value + step * (1 if factor > 1 else -1)
    else:
        value *= factor
    return dataclasses.replace(DEFAULTS, **{name: value})


def costs(frames: np.ndarray) -> list[str]:
    """A line per step: median CPU time in FFTs of a frame."""
    frame = frames[0] / np.sqrt(np.mean(np.abs(frames[0]) ** 2))
    timing = find_symbol_timings(frame, DEFAULTS)[0]
    symbols = CmaEqualiser(frame, timing, DEFAULTS).symbols()
    method = QpskCancel(WAVEFORM)
    method.process(frames[:2])
    later = iter(frames[2:])
    rng = np.random.default_rng(1)
    held = QpskEmitter().samples(frame.size, WAVEFORM.rate_hz, rng)
    held = (held + 0.02 * rng.standard_normal((frame.size, 2)).view(complex)[:, 0]).astype(np.complex64)

    def detect() -> None:
        without_tones(frame)
        cancel_zero_order_hold(frame, DEFAULTS)
        find_symbol_timings(frame, DEFAULTS)

    steps: dict[str, Callable[[], object]] = {
        "detect": detect,
        "hold": lambda: cancel_zero_order_hold(held, DEFAULTS),
        "demodulation": lambda: CmaEqualiser(frame, timing, DEFAULTS).symbols(),
        "pulse": lambda: estimate_pulse(frame, symbols, DEFAULTS),
        "tracking": lambda: method.cancel(next(later), search=False),
    }
    one = _seconds(lambda: fft.fft(frame))
    return [f"{name:14s} {_seconds(step) / one:5.1f} FFTs" for name, step in steps.items()]


def _seconds(work: Callable[[], object]) -> float:
    took = []
    for _ in range(_TRIES):
        begin = time.thread_time()
        work()
        took.append(time.thread_time() - begin)
    return float(np.median(took))


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; returns 1 if a setting loses more than `MOST_LOST` in a case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=50, help="per case and SIR (default: 50)")
    parser.add_argument("--costs", action="store_true", help="measure the steps' costs instead")
    args = parser.parse_args(argv)
    if args.frames < 3:
        parser.error(f"--frames is {args.frames}; at least 3")
    if args.costs:
        print(
            *costs(received(CASES["qpsk_stream"], -45.0, _TRIES + 2, np.random.default_rng(SEED))[0]),
            sep="\n",
        )
        return 0
    cases = {
        (name, sir_db): received(
            CASES[name], sir_db, args.frames, np.random.default_rng([SEED, k, round(-sir_db)])
        )
        for k, name in enumerate(NAMES)
        for sir_db in SIRS_DB
    }
    usual, sensitive = {case: pd(DEFAULTS, *both) for case, both in cases.items()}, []
    for field in dataclasses.fields(QpskSettings):
        for factor in (0.7, 1.3):
            lost = {
                case: usual[case] - pd(changed(field.name, factor), *both) for case, both in cases.items()
            }
            (name, sir_db), most = max(lost.items(), key=lambda item: item[1])
            print(
                f"{field.name:18s} x {factor}: loses {most:.3f} at most ({name}, {sir_db:g} dB)", flush=True
            )
            if most > MOST_LOST:
                sensitive.append(f"{field.name} x {factor}")
    print(f"more than {MOST_LOST}: {', '.join(sensitive) or 'none'}")
    return int(bool(sensitive))


if __name__ == "__main__":
    raise SystemExit(main())
