"""From scatterers to a complex frame: the sum of delayed, Doppler-shifted sweeps.

Relative to the reference, each scatterer is a tone in either half sweep, except during the first ``tau``
seconds of a half, when its echo belongs to the half before. All tones of an extended ground lie within
a few tens of kilohertz, so their sum is summed at a few dozen instants and interpolated, and the two short
transitions are summed over range bins. The tests hold it against the sum of every sweep at every sample.
"""

from functools import lru_cache

import numpy as np

from ...waveform import C_M_PER_S, Waveform, exp_cycles, read_only

TAPS = 14  # interpolator length; its error is near -100 dB at twofold oversampling
KAISER_BETA = 11.0  # Kaiser window of the interpolator: side lobes near -100 dB
NODE_STEP = 16  # node counts are multiples of this, so that few interpolators are built
BIN_M = 4.0  # width of a range bin in the transitions, metres: a fifth of the range resolution at 7.5 MHz


def synthesise(
    waveform: Waveform,
    amplitude: np.ndarray,
    range_m: np.ndarray,
    range_rate_m_per_s: np.ndarray,
    *,
    frame_index: int = 0,
) -> np.ndarray:
    """(N,) complex128 frame of n point scatterers.

    Neglected: range walk within a half sweep beyond its effect on the beat frequency (a phase of ``pi k rate T_h^2 /
    2c``, 2e-3 rad at 70 m/s) and, in the transitions, range differences inside a bin and Doppler over ``tau``. Against
    the sum of whole sweeps the error is below -45 dB for an airliner's approach.

    ``amplitude`` (n,) is without the carrier phase ``-2 pi f_c tau``, which is added here; ``range_m`` (n,), at the
    middle of the frame, within a quarter of the sweep's range; ``range_rate_m_per_s`` (n,) positive receding;
    ``frame_index`` matters only where ``B T_h`` is not whole and the sweep is not centred.
    """
    amplitude, range_m = np.asarray(amplitude, dtype=complex), np.asarray(range_m, dtype=float)
    tau = 2.0 * range_m / C_M_PER_S
    rate = 2.0 * np.asarray(range_rate_m_per_s, dtype=float) / C_M_PER_S
    if tau.size == 0:
        return np.zeros(waveform.samples_per_frame, dtype=complex)
    if tau.min() < 0 or tau.max() >= 0.5 * waveform.half_sweep_s:
        raise ValueError(
            f"ranges of {range_m.min():.1f}..{range_m.max():.1f} m do not fit; they have to be within 0.."
            f"{0.25 * waveform.half_sweep_s * C_M_PER_S:.0f} m, half a half sweep"
        )
    half = waveform.samples_per_half
    relative = np.empty(waveform.samples_per_frame, dtype=complex)
    for down in (False, True):
        start = half if down else 0
        relative[start : start + half] = _half_sweep(waveform, amplitude, tau, rate, down)
        first = np.flatnonzero(waveform.sample_times_s[:half] < tau.max())
        relative[start + first] = _transition(waveform, amplitude, tau, rate, down, first)
    reference = exp_cycles(waveform.phase_cycles(waveform.sample_times_s, frame_index), np.complex128)
    return reference * relative


def _half_sweep(
    waveform: Waveform, amplitude: np.ndarray, tau: np.ndarray, rate: np.ndarray, down: bool
) -> np.ndarray:
    """Echo relative to the reference over one half sweep, every scatterer taken as already in that half."""
    k, middle = waveform.slope_hz_per_s, 0.5 * waveform.half_sweep_s
    f0 = -0.5 * waveform.bandwidth_hz if waveform.centered else 0.0
    sign = -1.0 if down else 1.0
    centre = tau - sign * rate * middle  # delay at the middle of this half
    constant = -(f0 + waveform.carrier_hz) * centre - k * centre * middle + sign * 0.5 * k * centre**2
    tone_hz = -(f0 + waveform.carrier_hz) * rate - sign * k * centre - k * rate * (middle - sign * centre)
    mid_hz = 0.5 * (tone_hz.min() + tone_hz.max())
    spread_hz = max(tone_hz.max() - tone_hz.min(), 1.0)
    count = NODE_STEP * int(np.ceil(2.0 * spread_hz * waveform.half_sweep_s / NODE_STEP))
    matrix, first_s, step_s = interpolator(waveform.samples_per_half, waveform.rate_hz, count)
    nodes = matrix.shape[1]
    inner = int(np.ceil(np.sqrt(nodes)))
    outer = -(-nodes // inner)
    # the node phases are linear in time, so node p * inner + q is the product of two short geometric series
    base = amplitude * exp_cycles(constant + (tone_hz - mid_hz) * first_s, np.complex128)
    fine = _powers(exp_cycles((tone_hz - mid_hz) * step_s, np.complex128), inner)
    coarse = _powers(exp_cycles((tone_hz - mid_hz) * step_s * inner, np.complex128), outer) * base
    sums = (coarse @ fine.T).ravel()[:nodes]
    time = waveform.sample_times_s[: waveform.samples_per_half] - middle
    smooth = matrix @ np.stack([sums.real, sums.imag], axis=1)
    return (smooth[:, 0] + 1j * smooth[:, 1]) * exp_cycles(mid_hz * time, np.complex128)


def _powers(z: np.ndarray, count: int) -> np.ndarray:
    """(count, n) powers 0..count-1 of unit phasors."""
    return np.cumprod(np.concatenate([np.ones((1, z.size)), np.broadcast_to(z, (count - 1, z.size))]), axis=0)


@lru_cache(maxsize=32)
def interpolator(samples: int, rate_hz: float, count: int) -> tuple[np.ndarray, float, float]:
    """Kaiser-windowed sinc from uniform nodes to the samples of a half sweep.

    Returns the (samples, nodes) matrix, and the first node's time and the node step in seconds, from the middle of
    the half. ``count`` intervals span the half; ``TAPS / 2`` more nodes on either side.
    """
    step = samples / count
    # sample n of the half lies at n - samples / 2 from its middle
    position = (np.arange(samples)) / step + TAPS // 2
    nodes = np.arange(count + TAPS + 1)
    distance = position[:, None] - nodes[None, :]
    inside = np.abs(distance) <= TAPS / 2
    taper = np.i0(KAISER_BETA * np.sqrt(np.clip(1.0 - (2.0 * distance / TAPS) ** 2, 0.0, None)))
    taper /= np.i0(KAISER_BETA)
    matrix = read_only(np.where(inside, np.sinc(distance) * taper, 0.0))
    first = -(0.5 * samples + (TAPS // 2) * step) / rate_hz
    return matrix, first, step / rate_hz


def _transition(
    waveform: Waveform,
    amplitude: np.ndarray,
    tau: np.ndarray,
    rate: np.ndarray,
    down: bool,
    first: np.ndarray,
) -> np.ndarray:
    """Echo relative to the reference at samples ``first`` of a half, where some echoes belong to the half before."""
    half_s = waveform.half_sweep_s
    f0 = -0.5 * waveform.bandwidth_hz if waveform.centered else 0.0
    edge_hz = f0 + waveform.bandwidth_hz if down else f0
    start_s = half_s if down else 0.0
    time = waveform.sample_times_s[first] + start_s
    here = tau + rate * (time.mean() - half_s)  # the frame's middle is at T_h
    step = 2.0 * BIN_M / C_M_PER_S
    index = np.floor((here - here.min()) / step).astype(np.intp)
    bins = here.min() + (np.arange(index.max() + 1) + 0.5) * step
    turned = amplitude * exp_cycles(-(waveform.carrier_hz + edge_hz) * here, np.complex128)
    weight = np.bincount(index, turned.real) + 1j * np.bincount(index, turned.imag)
    lag = waveform.phase_cycles(time[:, None] - bins[None, :]) + edge_hz * bins[None, :]
    return exp_cycles(lag - waveform.phase_cycles(time)[:, None], np.complex128) @ weight
