#!/usr/bin/env python3
"""Frames, a method, an altimeter and a report from Python alone: no GNU Radio, no radios.

PYTHONPATH=python .venv/bin/python examples/ten_lines.py

The last part measures three methods at 12 SIRs and 4 overlaps, some ten minutes on one core.
"""

import numpy as np

import radalt


def my_function(frames, waveform):
    """Spectral lines limited to three times each frame's median."""
    spectrum = np.fft.fft(frames)
    level = np.abs(spectrum)
    limit = 3 * np.median(level, axis=-1, keepdims=True)
    return np.fft.ifft(spectrum * np.minimum(1, limit / level))


w = radalt.Waveform()
frames, truth_m = radalt.simulate("nr10", sir_db=-40, overlap=1, frames=200, seed=1)
result = radalt.Altimeter(w).process(radalt.method("ofdm_cancel", w).process(frames))
print("within 5 m:", np.mean(np.abs(result["altitude_m"] - truth_m) < 5))

methods = ["none", "tcae", my_function]
report = radalt.evaluate("nr10", methods, sir_db=range(-60, 0, 5), out="results/ten_lines", resume=True)
print(report.break_points())
print(report.html)
report.plot()
