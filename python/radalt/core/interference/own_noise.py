"""Noise of a recording, estimated from the coherence of the cyclic prefix of its OFDM."""

import numpy as np
from scipy import ndimage

_CYCLE_S = 0.5e-3  # period of the long cyclic prefix, s: LTE, and NR of any spacing
_SPACINGS_HZ = (15e3, 30e3)  # subcarrier spacings of LTE and of NR in FR1 below 60 kHz
_LONGEST_S = 40e-3  # longest recording in use, s: clocks 10 ppm apart slip by 0.4 us, less than a prefix
_WINDOW = 0.25  # part of the prefix in use: multipath and the receiver's filter disturb its ends
_CONTRAST = 6.0  # least peak of the correlation over its scatter: noise, tones and QPSK stay below 5
MOST_DB = 20.0  # largest SNR that is estimated, dB: above it the scatter of the data hides the noise


def prefix_snr_db(samples: np.ndarray, rate_hz: float) -> float | None:
    """Ratio of the OFDM's power to all other power, in decibels; None where no OFDM is found.

    In the prefix ``x[n] = s[n] + v[n]`` and ``x[n + N] = s[n] exp(j phi) + v[n + N]``. N samples are the inverse of the
    subcarrier spacing. The coherence ``gamma = |<x[n] x*[n+N]>| / <(|x[n]|^2 + |x[n+N]|^2) / 2>`` is then S / (S + V),
    and the ratio is gamma / (1 - gamma) (J.-J. van de Beek et al., "ML estimation of time and frequency offset in OFDM
    systems", IEEE Trans. Signal Process. 45(7), 1997).

    Needs 3 ms and uses the first 40 ms; 20 dB stands for 20 dB or more. Finds 15 and 30 kHz spacing with the normal
    prefix (LTE and 5G NR). Changes within a symbol (fading, phase noise) count as noise, as for a demodulator.
    """
    step_hz = _SPACINGS_HZ[-1]
    even_hz = max(step_hz, round(rate_hz / step_hz) * step_hz)  # whole samples in a symbol and in a cycle
    samples = samples[: round(_LONGEST_S * rate_hz)]
    if even_hz != rate_hz:
        from scipy import signal  # see core/fir.py

        samples = signal.resample(samples, round(samples.size * even_hz / rate_hz))
    cycle = round(_CYCLE_S * even_hz)
    found = (_contrast_and_coherence(samples, even_hz, cycle, spacing_hz) for spacing_hz in _SPACINGS_HZ)
    contrast, coherence = max(found)
    if contrast < _CONTRAST:
        return None
    return float(min(10 * np.log10(coherence / max(1 - coherence, 1e-9)), MOST_DB))


def _contrast_and_coherence(
    samples: np.ndarray, rate_hz: float, cycle: int, spacing_hz: float
) -> tuple[float, float]:
    """Peak of the folded correlation over its scatter, and the coherence there; zeros where samples are too few."""
    useful = round(rate_hz / spacing_hz)
    cycles = (samples.size - useful) // cycle
    if cycles < 4:
        return 0.0, 0.0
    prefix, tail = samples[: cycles * cycle], samples[useful : useful + cycles * cycle]
    product = (prefix * tail.conj()).reshape(cycles, cycle).sum(axis=0)
    power = (0.5 * (np.abs(prefix) ** 2 + np.abs(tail) ** 2)).reshape(cycles, cycle).sum(axis=0)
    prefix_s = 144 / 2048 / spacing_hz
    width = max(1, round(_WINDOW * prefix_s * rate_hz))
    # a cycle begins with the long prefix; its symbols are evenly spaced
    even = (1 / spacing_hz + prefix_s) * rate_hz
    starts = np.rint(np.arange(cycle // int(even)) * even).astype(int)
    summed, energy = (
        ndimage.uniform_filter1d(sum(np.roll(row, -start) for start in starts), width, mode="wrap")
        for row in (product, power)
    )
    peak = int(np.abs(summed - summed.mean()).argmax())
    symbol = int(even)
    # shifts by whole symbols also correlate: exclude their neighbourhood from the scatter
    distance = np.abs((np.arange(cycle) - peak + symbol // 2) % symbol - symbol // 2)
    elsewhere = summed[distance > 1.5 * prefix_s * rate_hz]
    # subtract the mean elsewhere: a tone correlates at every shift
    size = abs(summed[peak] - elsewhere.mean())
    scatter = elsewhere.std()
    if not (scatter > 0 and energy[peak] > 0):
        return 0.0, 0.0
    return float(size / scatter), float(min(size / energy[peak], 1.0))
