"""Geodesy against published numbers and an independent iterative inverse."""

import numpy as np
import pytest

from radalt.core.returns.terrain import geodesy


def _bowring_iterated(position: np.ndarray) -> tuple[float, float, float]:
    """Independent inverse: fixed-point iteration on the latitude, pure Python."""
    x, y, z = position
    a, e2 = 6378137.0, 0.00669437999014
    p = (x * x + y * y) ** 0.5
    lat = np.arctan2(z, p * (1 - e2))
    for _ in range(50):
        n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + e2 * n * np.sin(lat), p)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    height = p * np.cos(lat) + z * np.sin(lat) - a * a / n
    return np.degrees(lat), np.degrees(np.arctan2(y, x)), height


def test_axes_of_the_ellipsoid():
    assert geodesy.geodetic_to_ecef(0, 0, 0) == pytest.approx([6378137.0, 0, 0])
    assert geodesy.geodetic_to_ecef(90, 0, 0) == pytest.approx([0, 0, 6356752.314245], abs=1e-5)
    # EPSG guidance note 7-2 (2023), 4.1.1: WGS 84 53 48 33.820 N, 2 07 46.380 E, 73.0 m
    place = geodesy.geodetic_to_ecef(53 + 48 / 60 + 33.820 / 3600, 2 + 7 / 60 + 46.380 / 3600, 73.0)
    assert place == pytest.approx([3771793.968, 140253.342, 5124304.349], abs=1e-3)


def test_iteration_finds_the_place_again_to_a_micrometre():
    rng = np.random.default_rng(5)
    lat, lon, height = (
        rng.uniform(-89.9, 89.9, 200),
        rng.uniform(-180, 180, 200),
        rng.uniform(-500, 12e3, 200),
    )
    ecef = geodesy.geodetic_to_ecef(lat, lon, height)
    back = np.array([_bowring_iterated(p) for p in ecef]).T
    assert np.abs(back[2] - height).max() < 1e-6
    assert np.abs(back - [lat, lon, height])[:2].max() * 111e3 < 1e-6


def test_local_axes_follow_the_derivatives_of_position():
    lat, lon, step = 41.97, -87.93, 1e-4
    axes = geodesy.enu_axes(lat, lon)
    meridian, prime = geodesy.curvature_radii_m(lat)
    centre = geodesy.geodetic_to_ecef(lat, lon, 0.0)
    east = (
        geodesy.geodetic_to_ecef(lat, lon + np.degrees(step / prime / np.cos(np.radians(lat))), 0.0) - centre
    )
    north = geodesy.geodetic_to_ecef(lat + np.degrees(step / meridian), lon, 0.0) - centre
    up = geodesy.geodetic_to_ecef(lat, lon, step) - centre
    assert axes @ np.stack([east, north, up], axis=1) / step == pytest.approx(np.eye(3), abs=1e-3)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
