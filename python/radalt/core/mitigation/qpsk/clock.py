"""Symbol rate and timing of a linear modulation, with nothing known of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from ...waveform import exp_cycles

__all__ = ["Clock", "clock_line", "find_clocks"]

_SLOWEST = 0.02  # symbols per sample
_FASTEST = 0.47
_BLOCK = 125  # bins with one floor
_HARMONIC = 0.3  # of the strongest line's power: the lowest line of so much is tried first
_MOST = 3  # lines tried
_WIDE = 4  # bins that a line takes
_PER_SYMBOL = 2.2  # taps of an equaliser at least


@dataclass(frozen=True)
class Clock:
    """The line that a symbol clock leaves in the product of neighbouring samples.

    Attributes
    ----------
    rate : float
        Symbols per sample.
    instant : float
        Sample at which the line peaks, near the middle of the frame; symbols lie at a fixed distance from it.
    """

    rate: float
    instant: float

    @property
    def tap_step(self) -> int:
        """Samples from tap to tap of an equaliser."""
        return max(1, int(1 / (_PER_SYMBOL * self.rate)))


@lru_cache(maxsize=4)
def _window(count: int) -> np.ndarray:
    """Periodic Hann window, (count,) float32, read-only."""
    window = (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count) / count)).astype(np.float32)
    window.setflags(write=False)
    return window


def find_clocks(frame: np.ndarray, least: float) -> list[Clock]:
    """Symbol clocks that an (n,) complex64 frame may have, at most three, the likeliest first.

    The mean of ``x[n] x*[n-1]`` changes with the period of the symbols (cyclostationarity; W. A. Gardner, IEEE Signal
    Process. Mag. 8(2), 1991). Of ``|x|^2`` rectangular pulses of constant modulus would show no line. Short transitions
    make harmonics nearly as strong as the clock itself, and echoes make them stronger; what comes after has to tell.
    ``least`` is the power of a line that counts, over the median of its surroundings.
    """
    count = frame.size
    spectrum = fft.rfft(_windowed(frame))
    power = spectrum.real**2 + spectrum.imag**2
    used = power[: power.size - power.size % _BLOCK].reshape(-1, _BLOCK)
    floor = np.sort(used, axis=1)[:, _BLOCK // 2]
    contrast = (used / np.maximum(floor, 1e-30)[:, None]).ravel()
    contrast[: int(_SLOWEST * count)] = 0
    contrast[int(_FASTEST * count) :] = 0
    start = int((contrast > max(least, _HARMONIC * contrast.max())).argmax())
    lines = [start + int(contrast[start : start + _WIDE].argmax())]
    while contrast[lines[-1]] >= least and len(lines) <= _MOST:
        contrast[max(0, lines[-1] - _WIDE) : lines[-1] + _WIDE + 1] = 0
        lines.append(int(contrast.argmax()))
    return [_clock(spectrum, line, count) for line in lines[:-1]]


def clock_line(frame: np.ndarray, rate: float) -> float:
    """Sample near the middle of an (n,) complex64 frame at which the line of a clock of known ``rate`` peaks."""
    count = frame.size
    # even about the frame's middle
    phase = float(np.angle(_windowed(frame) @ _turns(rate, count)))
    instant = count / 2 - 0.5 - phase / (2 * np.pi * rate)
    return instant + round((count / 2 - instant) * rate) / rate


def _windowed(frame: np.ndarray) -> np.ndarray:
    """(n,) float32, the windowed products of neighbouring samples without their mean."""
    count = frame.size
    product = frame[1:] * frame[:-1].conj()
    mean = complex(product.mean())
    turn = mean / max(abs(mean), 1e-30)  # a carrier turns every product alike
    real = np.zeros(count, dtype=np.float32)
    # the real part of what is turned back
    np.matmul(
        product.view(np.float32).reshape(-1, 2), np.array([turn.real, turn.imag], np.float32), out=real[1:]
    )
    real[1:] -= np.float32(abs(mean))
    real *= _window(count)
    return real


def _turns(rate: float, count: int) -> np.ndarray:
    """(count,) complex64 that a tone of ``rate`` cycles per sample is multiplied by for its phase in the middle."""
    short = int(np.sqrt(count)) + 1
    long, steps = exp_cycles(-rate * np.array([[short], [1]]) * np.arange(short))
    middle = np.complex64(np.exp(1j * np.pi * rate * count))
    return (long[:, None] * (steps * middle)).ravel()[:count]


def _clock(spectrum: np.ndarray, line: int, count: int) -> Clock:
    """Rate and phase of a line between two bins."""
    before, peak, after = np.abs(spectrum[line - 1 : line + 2])
    # the ratio of two bins beside a line tells where between them it is: exact for the Hann window
    side = 1 if after > before else -1
    ratio = float(max(before, after) / peak)
    rate = (line + side * (2 * ratio - 1) / (ratio + 1)) / count
    # the window is even about the frame's middle, where the phase of a bin does not depend on the line's place in it
    phase = float(np.angle(spectrum[line])) + np.pi * line
    # the product of two neighbours belongs to the point between them
    instant = count / 2 - 0.5 - phase / (2 * np.pi * rate)
    return Clock(rate, instant + round((count / 2 - instant) * rate) / rate)
