"""Point returns: delayed, Doppler-shifted copies of the sweep (docs/design.md), evaluated without a filter."""

from __future__ import annotations

import numpy as np

from ..waveform import Waveform, altitude_to_delay_s, exp_cycles

__all__ = ["point_return"]


def point_return(
    waveform: Waveform,
    altitude_m: np.ndarray | float,
    *,
    vertical_speed_m_per_s: np.ndarray | float = 0.0,
    phase_cycles: np.ndarray | float = 0.0,
    frame_index: np.ndarray | int = 0,
    dtype: type = np.complex64,
) -> np.ndarray:
    """Unit-amplitude return ``s(t - tau(t)) exp(-j 2 pi f_c tau(t))`` with ``tau(t) = 2 R(t) / c``.

    Parameters
    ----------
    waveform : Waveform
        The sweep; it is periodic, so the first ``tau`` seconds hold the previous sweep's tail. Of a deramping altimeter
        (`core.deramp.IfWaveform`) the return comes mixed with the sweep, without that tail.
    altitude_m : (n,) or scalar
        Range ``R`` in metres at the middle of the frame (the instant the up/down mean refers to), >= 0.
    vertical_speed_m_per_s : (n,) or scalar
        Range rate, positive climbing; range walk inside the frame and Doppler both follow from it.
    phase_cycles : (n,) or scalar
        Extra carrier phase in cycles (scatterer, LO).
    frame_index : (n,) or scalar
        Sweep number; matters only where ``B T_h`` is not whole and the sweep is not centred.

    Returns
    -------
    (n, N) complex array, or (N,) if every argument is scalar.
    """
    parts = np.broadcast_arrays(altitude_m, vertical_speed_m_per_s, phase_cycles, frame_index)
    altitude, speed, phase, index = (np.atleast_1d(p).astype(float)[:, None] for p in parts)
    t = waveform.sample_times_s[None, :]
    if np.any(speed):
        delay_s = altitude_to_delay_s(altitude + speed * (t - waveform.half_sweep_s))
    else:
        delay_s = altitude_to_delay_s(altitude)
    total = waveform.phase_cycles(t - delay_s, index) - np.mod(waveform.carrier_hz * delay_s, 1.0) + phase
    if waveform.deramped:
        total = total - waveform.phase_cycles(t)
    out = exp_cycles(total, dtype)
    if waveform.deramped:  # the return of the ramp before passes the IF filter for an instant only: left out
        out[np.mod(t, waveform.half_sweep_s) < delay_s + 2.0 / waveform.rate_hz] = 0
    return out[0] if np.ndim(parts[0]) == 0 else out
