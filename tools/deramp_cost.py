#!/usr/bin/env python3
"""Error against run time of the deramping receiver: its IF computed directly, and by full-rate simulation.

    .venv/bin/python tools/deramp_cost.py

Prints, for each emitter, milliseconds per sweep both ways, the ratio of powers and the error vector of the same
realisation, and the altitude error of a return of 300 m next to it at an SIR of -10 dB.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))

from test_deramp import EMITTERS, FULL, SWEEP, agreement, full_rate, full_rate_if

from radalt.core.altimeter.altimeter import Altimeter, AltimeterSettings
from radalt.core.deramp.emitters import interference_if
from radalt.core.returns.point import point_return

_ALTITUDE_M, _SIR_DB, _SWEEPS = 300.0, -10.0, 5


def _timed(call: Callable[..., np.ndarray], *args: object) -> tuple[float, np.ndarray]:
    """Median milliseconds of CPU time, and what the last call returned."""
    times = []
    for _ in range(_SWEEPS):
        begin = time.process_time_ns()
        out = call(*args)
        times.append((time.process_time_ns() - begin) * 1e-6)
    return float(np.median(times)), out


def main() -> None:
    """Print the table."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    altimeter = Altimeter(SWEEP, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=0.0))
    ground = point_return(SWEEP, np.array([_ALTITUDE_M]))[0]

    def error_m(interference: np.ndarray) -> float:
        power = np.mean(np.abs(interference) ** 2) / np.mean(np.abs(ground) ** 2)
        frame = ground + interference * np.sqrt(10.0 ** (-_SIR_DB / 10.0) / power)
        return float(altimeter.process(frame[None].astype(np.complex64))["altitude_m"][0] - _ALTITUDE_M)

    print(f"full rate {FULL * SWEEP.simulation_hz / 1e6:g} MS/s, IF {SWEEP.rate_hz / 1e6:g} MS/s")
    print(
        "| emitter | full rate, ms | deramped, ms | ratio | power, dB | error vector, dB | altitude error, m |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name, emitter in EMITTERS.items():
        full_ms, full = _timed(full_rate_if, SWEEP, lambda t, e=emitter: full_rate(e, t))
        direct_ms, direct = _timed(lambda e=emitter: interference_if(SWEEP, e, 1, 0)[0])
        power_db, vector_db = agreement(direct, full)
        errors = " / ".join(f"{error_m(x):.3f}" for x in (full, direct))
        row = [name, f"{full_ms:.1f}", f"{direct_ms:.2f}", f"{full_ms / direct_ms:.0f}", f"{power_db:.3f}"]
        print("| " + " | ".join([*row, f"{vector_db:.0f}", errors]) + " |")


if __name__ == "__main__":
    main()
