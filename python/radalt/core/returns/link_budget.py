"""Link budget: power of the ground return at the receiver's input, and power density of a field strength there.

All powers and densities hold at the receiver's input, behind the receive cable; a *loop loss* counts from the
transmitter's output to there, as altimeter test sets state it.
"""

import numpy as np
from scipy.constants import speed_of_light

from .terrain.antenna import Antenna
from .terrain.ground import Reflectivity

_STEPS = 2000  # steps of the midpoint rule over incidence: 0.001 dB for beams from 10 degrees on


def diffuse_loop_loss_db(
    height_m: float, *, antenna: Antenna, ground: Reflectivity, carrier_hz: float, losses_db: float
) -> float:
    """Loop loss over level, diffuse ground, in decibels, of one ``antenna`` pattern that points down, both ways.

    The radar equation over all incidence angles, ``dA = 2 pi R^2 tan(theta) dtheta`` at ``R = h / cos(theta)``:

        P_r / P_t = lambda^2 / ((4 pi)^3 L) 2 pi / h^2  integral of G^2 sigma0 sin(theta) cos(theta) dtheta
    """
    step = 0.5 * np.pi / _STEPS
    theta = (np.arange(_STEPS) + 0.5) * step
    gain = antenna.gain(theta, np.zeros(_STEPS))
    lit = np.sum(gain**2 * ground.sigma0(theta, carrier_hz) * np.sin(theta) * np.cos(theta)) * step
    wavelength = speed_of_light / carrier_hz
    share = wavelength**2 / (4 * np.pi) ** 3 * 2 * np.pi / height_m**2 * lit
    return float(losses_db - 10.0 * np.log10(share))


def port_density_dbm_per_mhz(
    flux_dbw_per_m2_mhz: float, *, frequency_hz: float, gain_dbi: float, cable_db: float
) -> float:
    """Power density at the port of a power flux density: plus ``G + 10 log10(lambda^2 / 4 pi)``, less the cable.

    ``frequency_hz``: frequency of the band: the aperture falls with its square; ``gain_dbi``: antenna gain in the
    emitter's direction; ``cable_db``: loss from antenna to port.
    """
    aperture_db = 10.0 * np.log10((speed_of_light / frequency_hz) ** 2 / (4 * np.pi))
    return float(flux_dbw_per_m2_mhz + 30.0 + gain_dbi + aperture_db - cable_db)
