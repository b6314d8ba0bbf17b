"""Channel filter and rate conversion of the radar's receiver, shared by all wideband emitters.

An emitter wider than the radar's band must be filtered before it is sampled at the radar's rate; otherwise it aliases
into the band. The filter is a linear-phase Kaiser FIR: flat up to half the receiver bandwidth, stop band from half the
output rate on.
"""

from fractions import Fraction
from functools import lru_cache

import numpy as np

from ..fir import kaiser_lowpass
from ..waveform import read_only
from .transmission import Signal

PASSBAND_FRACTION = 0.9  # flat bandwidth over the output rate: usual for an SDR's decimator
MAX_OVERSAMPLING = 64  # largest oversampling of an emitter: a window of 1 ms then takes 8 MB
MAX_RATIO = 4096  # largest term of a resampling ratio: beyond it the polyphase filter has millions of taps


def around(signal: np.ndarray, start: int, count: int) -> np.ndarray:
    """``count`` samples from number ``start`` (0..n-1) on of an (n,) signal that repeats; a view of one piece."""
    if start + count <= signal.size:
        return signal[start : start + count]
    rest = count - (signal.size - start)
    whole, last = divmod(rest, signal.size)
    return np.concatenate([signal[start:], *[signal] * whole, signal[:last]])


def repeated(signal: np.ndarray, residual: float, rng: np.random.Generator) -> Signal:
    """An (n,) signal without end: random start and phase, shifted by ``residual`` cycles per sample."""
    start = int(rng.integers(0, signal.size))
    phase = rng.random()

    def cut(first: int, count: int) -> np.ndarray:
        window = around(signal, (start + first) % signal.size, count)
        turned = phase + np.mod(first * residual, 1.0)
        return window * np.exp(2j * np.pi * (turned + np.arange(count) * residual if residual else phase))

    return cut


@lru_cache(maxsize=32)
def receiver_taps(design_rate_hz: float, stop_hz: float, bandwidth_hz: float) -> np.ndarray:
    """Odd-length Kaiser low-pass at `design_rate_hz`: flat to bandwidth_hz/2, 80 dB down from `stop_hz`.

    Unit gain at 0 Hz. Read-only (cached).
    """
    return read_only(kaiser_lowpass(bandwidth_hz / 2, stop_hz, design_rate_hz))


def rate_ratio(rate_hz: float, source_rate_hz: float) -> Fraction:
    """Exact rate_hz / source_rate_hz as a reduced fraction p/q.

    Raises ValueError if p or q exceeds 4096 (the polyphase filter would have millions of taps).
    """
    ratio = Fraction(rate_hz) / Fraction(source_rate_hz)
    if max(ratio.numerator, ratio.denominator) > MAX_RATIO:
        raise ValueError(
            f"rate_hz {rate_hz:g} is not a ratio p/q of {source_rate_hz:g} with p, q <= {MAX_RATIO}; "
            "choose a rate such as 7.5e6 or 10e6"
        )
    return ratio


def resample_periodic(samples: np.ndarray, source_rate_hz: float, rate_hz: float) -> np.ndarray:
    """Receiver filter and polyphase resampling of one period of a periodic signal, without a seam and without delay.

    (N,) at ``source_rate_hz`` become (N rate/source_rate,) complex128. Raises ValueError if that is no whole number.
    """
    ratio = rate_ratio(rate_hz, source_rate_hz)
    if (samples.size * ratio.numerator) % ratio.denominator:
        raise ValueError(
            f"{samples.size} samples at {source_rate_hz:g} are no whole number at rate_hz {rate_hz:g}; "
            "choose a rate that is a multiple of 100 Hz"
        )
    design_rate_hz = source_rate_hz * ratio.numerator
    stop_hz = min(rate_hz, source_rate_hz) / 2
    bandwidth_hz = min(PASSBAND_FRACTION * rate_hz, 0.98 * 2 * stop_hz)
    taps = receiver_taps(design_rate_hz, stop_hz, bandwidth_hz)
    # Guard of whole input:output periods, so that cropping is exact, and no shorter than half the filter.
    blocks = -(-(taps.size // 2 // ratio.numerator + 1) // ratio.denominator)
    guard = blocks * ratio.denominator
    extended = np.take(samples, np.arange(-guard, samples.size + guard), mode="wrap")
    from scipy import signal  # see core/fir.py

    resampled = signal.resample_poly(extended, ratio.numerator, ratio.denominator, window=taps)
    lead = blocks * ratio.numerator
    return resampled[lead : lead + samples.size * ratio.numerator // ratio.denominator]


def oversampling(rate_hz: float, highest_hz: float) -> int:
    """Smallest integer M such that a signal within +-highest_hz, sampled at M rate, does not alias into the band.

    Raises ValueError if M exceeds 64.
    """
    factor = max(1.0, float(np.ceil((highest_hz + rate_hz / 2) / rate_hz)))
    if factor > MAX_OVERSAMPLING:  # infinite for a rise time near the smallest number
        raise ValueError(
            f"frequencies up to {highest_hz:g} Hz from the radar need {factor:g} times its rate; "
            f"the limit is {MAX_OVERSAMPLING} times, reduce the offset or the bandwidth, or lengthen the rise time"
        )
    return int(factor)


def window_taps(rate_hz: float, factor: int) -> np.ndarray:
    """Receiver filter at ``factor`` times the rate."""
    return receiver_taps(rate_hz * factor, rate_hz / 2, PASSBAND_FRACTION * rate_hz)


def window_guard(rate_hz: float, factor: int) -> int:
    """Output samples that `decimate_window` needs on either side of the window."""
    return window_taps(rate_hz, factor).size // 2 // factor + 1


def decimate_window(samples: np.ndarray, rate_hz: float, factor: int) -> np.ndarray:
    """Filter and decimate by `factor` a window with `window_guard` extra output samples on either side.

    `samples` (factor (count + 2 guard),) at factor * rate_hz gives (count,) at rate_hz, without delay.
    """
    taps, guard = window_taps(rate_hz, factor), window_guard(rate_hz, factor)
    # The filter's delay must be a whole number of output samples: pad the taps in front.
    pad = -(taps.size // 2) % factor
    # by FFTs: a tenth of upfirdn's time for a sweep of 150 MHz, a third for a long window
    from scipy import signal  # see core/fir.py

    received = signal.oaconvolve(samples, np.concatenate([np.zeros(pad), taps]))[::factor]
    delay = (taps.size // 2 + pad) // factor
    count = samples.size // factor - 2 * guard
    return received[guard + delay : guard + delay + count]
