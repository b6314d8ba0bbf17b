"""Antenna patterns and ground reflectivity: what the numbers mean, and what is refused."""

import numpy as np
import pytest

from radalt.core.returns import terrain

# vertical polarisation of the same C-band tables (Ulaby and Dobson 1989)
VERTICAL = {
    "soil": (-24.951, 28.742, 1.043, -1.681, 0.0, 0.0),
    "grass": (-93.606, 99.0, 0.220, -5.509, -2.964, 1.287),
    "shrubs": (-91.133, 99.0, 0.294, 8.107, 2.112, -3.142),
    "short_vegetation": (-88.593, 99.0, 0.326, 9.574, 1.969, -3.142),
    "dry_snow": (-19.765, 19.830, 10.0, 7.089, 1.540, -0.012),
    "wet_snow": (4.288, 15.642, 15.0, 30.0, 0.535, 1.994),
}


def _db(x):
    return 10.0 * np.log10(x)


@pytest.mark.parametrize(("two_way", "drop_db"), [(False, 6.02), (True, 3.01)])
def test_gaussian_beamwidth_is_one_way_or_two_way(two_way, drop_db):
    antenna = terrain.GaussianAntenna(40.0, 10.0, two_way)
    angle = np.radians([0.0, 20.0])
    gain = antenna.gain(angle, 0.0)
    assert _db(gain[0]) == pytest.approx(10.0)
    assert 2 * _db(gain[0] / gain[1]) == pytest.approx(drop_db, abs=0.01)
    edge = antenna.footprint_rad(30.0)
    assert 2 * _db(gain[0] / antenna.gain(edge, 0.0)) == pytest.approx(30.0)


def test_pattern_file_reproduces_a_gaussian(tmp_path):
    exact = terrain.GaussianAntenna(40.0, 11.0)
    angle = np.arange(0.0, 91.0, 1.0)
    path = tmp_path / "beam.csv"
    rows = "".join(f"{a},{_db(exact.gain(np.radians(a), 0.0))}\n" for a in angle)
    path.write_text("# measured\nangle_deg,gain_dbi\n" + rows)
    table = terrain.TabulatedAntenna.load(path)
    query = np.radians(np.linspace(0.0, 60.0, 77))
    assert _db(table.gain(query, 0.3)) == pytest.approx(_db(exact.gain(query, 0.0)), abs=0.01)
    assert table.footprint_rad(30.0) == pytest.approx(exact.footprint_rad(30.0), abs=np.radians(1.1))


def test_pattern_file_with_azimuth_wraps_around(tmp_path):
    path = tmp_path / "fan.csv"
    grid = [(a, z, 10 - a * (0.1 if z in (0, 180) else 0.3)) for a in (0, 30, 60) for z in (0, 90, 180, 270)]
    path.write_text("angle_deg,azimuth_deg,gain_dbi\n" + "".join(f"{a},{z},{g}\n" for a, z, g in grid))
    table = terrain.TabulatedAntenna.load(path)
    at = np.radians([0.0, 90.0, 45.0, -45.0, 315.0, 359.999])
    assert _db(table.gain(np.radians(30.0), at)) == pytest.approx([7, 1, 4, 4, 4, 7], abs=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("angle_deg,gain_dbi\n0,1\n", "at least two angles"),
        ("angle_deg,gain_dbi\n5,1\n10,0\n", "angles start at 0"),
        ("angle_deg,azimuth_deg,gain_dbi\n0,0,1\n0,90,1\n9,0,1\n", "angle 9 azimuth 90 deg is missing"),
        ("angle_deg,gain_dbi\n0,1\n9,nan\n", "row 2 is 9 degrees, nan dBi; within"),
        ("angle_deg,gain_dbi\n0,1\n9,0\n9,-3\n", "row 3 gives angle 9 again"),
    ],
)
def test_pattern_files_that_do_not_fit(tmp_path, text, message):
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        terrain.TabulatedAntenna.load(path)


def test_a_pattern_of_a_spreadsheet_is_read(tmp_path):
    (tmp_path / "p.csv").write_text("\ufeffangle_deg,gain_dbi\n0,1\n9,0\n")
    assert terrain.TabulatedAntenna.load(tmp_path / "p.csv").angle_deg.size == 2


def test_polarisations_agree_at_nadir():
    """At normal incidence there is no plane of incidence: a mistyped coefficient would break the tie."""
    for land, vertical in VERTICAL.items():
        h = terrain.LAND_TYPES["ulaby_dobson"][land].sigma0(0.0, 4.3e9)
        v = terrain.UlabyDobson(vertical).sigma0(0.0, 4.3e9)
        assert abs(_db(h / v)) < 0.6, land


def test_ulaby_dobson_soil_by_hand():
    # 30 degrees: -24.855 + 26.351 exp(-1.146 * 0.5236) + 0.204 = -10.19 dB
    sigma0 = terrain.reflectivity("ulaby_dobson", "soil").sigma0(np.radians(30.0), 4.3e9)
    assert _db(sigma0) == pytest.approx(-10.19, abs=0.01)


def test_morchin_is_plateau_plus_specular():
    ground = terrain.reflectivity("morchin", "farmland")
    # nadir: 0.004 / 0.06972 + sqrt(4.3) / 4.7 * cot(0.2)^2 = 0.0574 + 10.74
    assert ground.sigma0(0.0, 4.3e9) == pytest.approx(10.80, abs=0.02)
    # 60 degrees incidence: tan^2 / tan^2(beta0) = 73, the specular part is gone
    assert ground.sigma0(np.radians(60.0), 4.3e9) == pytest.approx(0.5 * 0.004 / 0.06972, rel=1e-3)


def test_constant_gamma_follows_the_cosine():
    ground = terrain.reflectivity("constant_gamma", "woods", level_db=3.0)
    assert ground.sigma0(np.radians(60.0), 10e9) == pytest.approx(0.5 * 10 ** (-1.2), rel=1e-6)


def test_every_model_is_positive_and_dark_behind():
    angle = np.radians(np.linspace(0.0, 85.0, 50))
    for model, lands in terrain.LAND_TYPES.items():
        for land, ground in lands.items():
            assert np.all(ground.sigma0(angle, 4.3e9) > 0), (model, land)
            assert ground.sigma0(np.radians(95.0), 4.3e9) == 0.0, (model, land)
