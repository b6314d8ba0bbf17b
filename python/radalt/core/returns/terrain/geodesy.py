"""WGS84 geodesy in closed form: geodetic, earth-centred (ECEF) and local east-north-up (ENU) coordinates.

Formulae: NIMA TR8350.2, 3rd ed. (2000), chapter 3 (constants) and B. Hofmann-Wellenhof et al., *GNSS* (2008),
section 8.2. Angles are in degrees at every interface, lengths in metres, all arrays float64.
"""

import numpy as np

SEMI_MAJOR_M = 6378137.0  # TR8350.2, Table 3.1
FLATTENING = 1.0 / 298.257223563  # TR8350.2, Table 3.1
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)  # first eccentricity


def geodetic_to_ecef(
    latitude_deg: np.ndarray | float, longitude_deg: np.ndarray | float, height_m: np.ndarray | float
) -> np.ndarray:
    """ECEF position of geodetic points.

    ``latitude_deg``, ``longitude_deg``, ``height_m``: geodetic latitude (-90..90), longitude, and height above the
    ellipsoid. Returns (..., 3) float64.
    """
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    prime = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_lat**2)
    horizontal = (prime + height_m) * cos_lat
    vertical = (prime * (1.0 - ECCENTRICITY_SQUARED) + height_m) * sin_lat
    x, y, z = np.broadcast_arrays(horizontal * np.cos(lon), horizontal * np.sin(lon), vertical)
    return np.stack([x, y, z], axis=-1)


def enu_axes(latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """(3, 3) rotation whose rows are the east, north and up unit vectors of a place, in ECEF."""
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )


def curvature_radii_m(latitude_deg: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Meridian radius ``M`` and prime-vertical radius ``N`` in metres at a latitude.

    A step of ``dlat`` radians is ``(M + h) dlat`` metres north, of ``dlon`` radians ``(N + h) cos(lat) dlon`` east.
    """
    sin2 = np.sin(np.radians(latitude_deg)) ** 2
    root = np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin2)
    return SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / root**3, SEMI_MAJOR_M / root
