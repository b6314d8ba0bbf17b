"""Geodesy against published numbers and derivatives of position."""

import numpy as np
import pytest

from radalt.core.returns.terrain import geodesy


def test_axes_of_the_ellipsoid():
    assert geodesy.geodetic_to_ecef(0, 0, 0) == pytest.approx([6378137.0, 0, 0])
    assert geodesy.geodetic_to_ecef(90, 0, 0) == pytest.approx([0, 0, 6356752.314245], abs=1e-5)
    # EPSG guidance note 7-2 (2023), 4.1.1: WGS 84 53 48 33.820 N, 2 07 46.380 E, 73.0 m
    place = geodesy.geodetic_to_ecef(53 + 48 / 60 + 33.820 / 3600, 2 + 7 / 60 + 46.380 / 3600, 73.0)
    assert place == pytest.approx([3771793.968, 140253.342, 5124304.349], abs=1e-3)


def test_local_axes_follow_the_derivatives_of_position():
    lat, lon, step = 41.97, -87.93, 1e-4
    axes = geodesy.enu_axes(lat, lon)
    meridian, prime = geodesy.curvature_radii_m(lat)
    centre = geodesy.geodetic_to_ecef(lat, lon, 0.0)
    moved = lon + np.degrees(step / prime / np.cos(np.radians(lat)))
    east = geodesy.geodetic_to_ecef(lat, moved, 0.0) - centre
    north = geodesy.geodetic_to_ecef(lat + np.degrees(step / meridian), lon, 0.0) - centre
    up = geodesy.geodetic_to_ecef(lat, lon, step) - centre
    assert axes @ np.stack([east, north, up], axis=1) / step == pytest.approx(np.eye(3), abs=1e-3)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
