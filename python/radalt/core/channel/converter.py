"""Analogue-to-digital conversion of complex samples."""

import numpy as np


def convert(out: np.ndarray, bits: int, full_scale: float) -> None:
    """Quantise and clip both rails of complex64 samples in place; ``full_scale`` is the amplitude of a rail."""
    rails = out.view(np.float32)
    step = np.float32(full_scale / 2 ** (bits - 1))
    top = 2 ** (bits - 1) - 1
    # one bit is mid-rise, since a mid-tread converter has a level at zero; from two bits on mid-tread
    levels = np.sign(rails) * 0.5 if bits == 1 else np.clip(np.rint(rails / step), -top - 1, top)
    rails[:] = levels * step
