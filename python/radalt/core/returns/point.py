"""Point returns: delayed, Doppler-shifted copies of the sweep (docs/design.md), evaluated without a filter."""

import numpy as np

from ..waveform import Waveform, altitude_to_delay_s, exp_cycles


def point_return(
    waveform: Waveform,
    altitude_m: np.ndarray | float,
    *,
    vertical_speed_m_per_s: np.ndarray | float = 0.0,
    phase_cycles: np.ndarray | float = 0.0,
    frame_index: np.ndarray | int = 0,
    dtype: type = np.complex64,
) -> np.ndarray:
    """Unit-amplitude return ``s(t - tau(t)) exp(-j 2 pi f_c tau(t))`` with ``tau(t) = 2 R(t) / c``: (n, N).

    Of (n,) values or scalars, (N,) if all are scalar. The sweep is periodic, so the first ``tau`` seconds hold the
    previous one's tail. Of a deramping altimeter (`core.deramp.IfWaveform`) the return comes mixed with the sweep,
    without that tail.

    - ``altitude_m``: range ``R`` at the middle of the frame (the instant the up/down mean refers to), >= 0
    - ``vertical_speed_m_per_s``: range rate, positive climbing; range walk inside the frame and Doppler both follow
    - ``phase_cycles``: extra carrier phase (scatterer, LO)
    - ``frame_index``: sweep number; matters only where ``B T_h`` is not whole and the sweep is not centred
    """
    parts = np.broadcast_arrays(altitude_m, vertical_speed_m_per_s, phase_cycles, frame_index)
    columns = [np.atleast_1d(part).astype(float) for part in parts]
    out = np.empty((columns[0].size, waveform.samples_per_frame), dtype)
    t = waveform.sample_times_s
    # one by one: temporary arrays of hundreds of frames leave the cache, which takes half as long again
    for frame, altitude, speed, phase, index in zip(out, *columns, strict=True):
        delay_s = altitude_to_delay_s(altitude + speed * (t - waveform.half_sweep_s) if speed else altitude)
        total = waveform.phase_cycles(t - delay_s, index) - np.mod(waveform.carrier_hz * delay_s, 1.0) + phase
        if waveform.deramped:
            total -= waveform.phase_cycles(t)
        frame[:] = exp_cycles(total, dtype)
        if waveform.deramped:
            # what is still on the ramp before passes the IF filter for an instant only: left out
            frame[np.mod(t, waveform.half_sweep_s) < delay_s + 2.0 / waveform.rate_hz] = 0
    return out[0] if np.ndim(parts[0]) == 0 else out
