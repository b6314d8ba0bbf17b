"""Ground reflectivity sigma0 (square metres per square metre) against incidence angle, near nadir.

Three models, by name and by land type; every coefficient can be set by hand, since published values disagree
and none was measured at 4.3 GHz and nadir over a town. ``level_db`` shifts a whole curve for sensitivity
studies.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.constants import speed_of_light


@dataclass(frozen=True)
class ConstantGamma:
    """``sigma0 = gamma sin(grazing) = gamma cos(incidence)``.

    The plateau model (M. W. Long, *Radar Reflectivity of Land and Sea*, 3rd ed., 2001); it has no nadir peak. Values
    by land type are the usual X-band figures (10 GHz), lowered by ``5 log10(10 GHz / f)`` dB after D. K. Barton,
    *Radar Equations for Modern Radar* (2013), ch. 9. They were not checked against the print.
    """

    gamma_db: float = -5.0
    level_db: float = 0.0

    def sigma0(self, incidence_rad: np.ndarray, carrier_hz: float) -> np.ndarray:
        """(...,) linear reflectivity at an incidence angle in radians; 0 beyond 90 degrees."""
        gamma_db = self.gamma_db + 5.0 * np.log10(carrier_hz / 10e9) + self.level_db
        return 10.0 ** (gamma_db / 10.0) * np.maximum(np.cos(incidence_rad), 0.0)


@dataclass(frozen=True)
class UlabyDobson:
    """``sigma0 = P1 + P2 exp(-P3 theta) + P4 cos(P5 theta + P6)`` in decibels, ``theta`` incidence in radians.

    F. T. Ulaby and M. C. Dobson, *Handbook of Radar Scattering Statistics for Terrain* (1989), fit to measured means;
    the land types below are its C-band (4-8 GHz) tables, horizontal polarisation. The coefficients were transcribed
    from a secondary source, not from the print; a test holds them to a physical check (at nadir both polarisations
    must agree, since there is no plane of incidence).
    """

    p: tuple[float, float, float, float, float, float] = (-24.855, 26.351, 1.146, 0.204, 0.0, 0.0)
    level_db: float = 0.0

    def sigma0(self, incidence_rad: np.ndarray, carrier_hz: float) -> np.ndarray:
        """See `ConstantGamma.sigma0`; the carrier is taken to be in C band."""
        theta = np.abs(incidence_rad)
        p1, p2, p3, p4, p5, p6 = self.p
        db = p1 + p2 * np.exp(-p3 * theta) + p4 * np.cos(p5 * theta + p6) + self.level_db
        return np.where(theta < np.pi / 2, 10.0 ** (db / 10.0), 0.0)


@dataclass(frozen=True)
class Morchin:
    """Diffuse plateau plus a specular term around normal incidence.

    ``sigma0 = a s sin(psi) / lambda + u cot^2(beta0) exp(-tan^2(b - psi) / tan^2(beta0))`` with grazing angle
    ``psi``, ``u = sqrt(f_GHz) / 4.7``, and ``s = (psi / psi_c)^4`` below the critical angle ``psi_c = asin(lambda /
    (4 pi 9.3 beta0^2.2))`` where the land type asks for it (desert), else 1 (W. C. Morchin, *Airborne Early Warning
    Radar*, 1990, ch. 2). ``lambda`` in metres. The coefficients of desert, farmland, wooded hills and mountains are
    those commonly quoted from the book, not checked against the print. ``urban_low_relief`` is **this project's
    assumption**: the plateau of built-up land (that of mountains) with the specular slope of farmland, +10.5 dB at
    nadir (4.3 GHz); no measured urban value at nadir was found, so sweep ``level_db``.
    """

    a: float = 0.04
    b_rad: float = np.pi / 2
    beta0_rad: float = 0.2
    critical: bool = False
    level_db: float = 0.0

    def sigma0(self, incidence_rad: np.ndarray, carrier_hz: float) -> np.ndarray:
        """See `ConstantGamma.sigma0`."""
        wavelength = speed_of_light / carrier_hz
        psi = np.pi / 2 - np.abs(incidence_rad)
        shadow = 1.0
        if self.critical:
            edge = np.arcsin(min(1.0, wavelength / (4.0 * np.pi * 9.3 * self.beta0_rad**2.2)))
            shadow = np.minimum(1.0, np.maximum(psi, 0.0) / edge) ** 4
        u = np.sqrt(carrier_hz / 1e9) / 4.7
        off = np.clip(np.abs(self.b_rad - psi), 0.0, 0.49 * np.pi)
        specular = u / np.tan(self.beta0_rad) ** 2 * np.exp(-((np.tan(off) / np.tan(self.beta0_rad)) ** 2))
        total = self.a * shadow * np.sin(np.maximum(psi, 0.0)) / wavelength + specular
        return np.where(psi > 0, total * 10.0 ** (self.level_db / 10.0), 0.0)


Reflectivity = ConstantGamma | UlabyDobson | Morchin

LAND_TYPES: dict[str, dict[str, Reflectivity]] = {
    "constant_gamma": {
        "urban_low_relief": ConstantGamma(-5.0),
        "metropolitan": ConstantGamma(0.0),
        "mountains": ConstantGamma(0.0),
        "wooded_hills": ConstantGamma(-10.0),
        "woods": ConstantGamma(-15.0),
        "farmland": ConstantGamma(-15.0),
        "flatland": ConstantGamma(-20.0),
    },
    "ulaby_dobson": {
        "soil": UlabyDobson((-24.855, 26.351, 1.146, 0.204, 0.0, 0.0)),
        "grass": UlabyDobson((-15.750, 17.931, 2.369, -1.502, 4.592, -3.142)),
        "shrubs": UlabyDobson((-91.950, 99.0, 0.270, 6.980, 1.922, -3.142)),
        "short_vegetation": UlabyDobson((-87.727, 99.0, 0.322, 10.188, -1.747, 3.142)),
        "dry_snow": UlabyDobson((-42.864, 20.762, 10.0, 30.0, 0.763, -0.147)),
        "wet_snow": UlabyDobson((-31.910, 17.749, 11.854, 30.0, 0.421, 0.740)),
    },
    "morchin": {
        "urban_low_relief": Morchin(),
        "desert": Morchin(0.00126, np.pi / 2, 0.14, True),
        "farmland": Morchin(0.004, np.pi / 2, 0.2),
        "wooded_hills": Morchin(0.0126, np.pi / 2, 0.4),
        "mountains": Morchin(0.04, 1.24, 0.5),
    },
}


def reflectivity(model: str = "morchin", land: str = "urban_low_relief", **settings: float) -> Reflectivity:
    """A reflectivity model by name and land type.

    ``model``: ``"constant_gamma"``, ``"ulaby_dobson"`` or ``"morchin"``; ``land``: a key of ``LAND_TYPES[model]``;
    ``**settings``: coefficients to override, named as the fields of the model (``level_db``, ``gamma_db``,
    ``beta0_rad``, ...). Raises `ValueError` if a name is unknown; lists what is allowed.

    Examples
    --------
    >>> float(round(10 * np.log10(reflectivity().sigma0(0.0, 4.3e9)), 1))
    10.5
    """
    if model not in LAND_TYPES:
        raise ValueError(f"reflectivity model is {model!r}; allowed: {', '.join(LAND_TYPES)}")
    if land not in LAND_TYPES[model]:
        raise ValueError(f"land type {land!r} is unknown to {model}; allowed: {', '.join(LAND_TYPES[model])}")
    chosen = LAND_TYPES[model][land]
    unknown = set(settings) - {f.name for f in fields(chosen)}
    if unknown:
        allowed = ", ".join(f.name for f in fields(chosen))
        raise ValueError(f"{model} has no setting {sorted(unknown)[0]!r}; allowed: {allowed}")
    return replace(chosen, **settings)
