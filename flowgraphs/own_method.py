"""A mitigation method of your own, in ten lines.

    .venv/bin/python flowgraphs/ota_eval.py --sim --method-file flowgraphs/own_method.py

`mitigate` gets (n, N) complex frames aligned with the sweep, and returns cleaned ones of the same shape. What it
raises, or gives instead, is reported in one line. A subclass of `radalt.core.mitigation.Mitigation` may stand
here as well.
"""

import numpy as np


def mitigate(frames, waveform):  # noqa: ANN001, ANN201 - as short as a method of your own may be
    """Limit every spectral line of a frame to three times the frame's median."""
    spectrum = np.fft.fft(frames)
    level = np.abs(spectrum)
    limit = 3 * np.median(level, axis=-1, keepdims=True)
    return np.fft.ifft(spectrum * np.minimum(1, limit / np.maximum(level, 1e-30)))
