"""An approach past base stations: power by hand, and a run through the command."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from hostile import refused
from waiting import ROOT

from radalt.core.deramp.profile import load_profile
from radalt.core.parsing import InputError
from radalt.studies.tolerance.approach import Station, load_approach
from radalt.studies.tolerance.command import main

SHIPPED = ROOT / "flowgraphs/approaches/glide_path.yaml"
C = 299_792_458.0


def test_power_is_that_of_friis_of_two_rays_and_of_none_beyond_the_horizon():
    approach, pattern = load_approach(SHIPPED)
    profile, width_db = load_profile("typical"), 10 * np.log10(98)
    mast = Station(0.0, 0.0, 30.0, 0.0, 0.0, 65.0)
    alone = replace(approach, stations=(mast,), ground_reflection=0.0, antenna_floor_dbi=-10.0)
    height_m = alone.altitude_ft(5000.0) * 0.3048
    loss_db = 20 * np.log10(4 * np.pi * np.hypot(5000.0, height_m - 30.0) * 4.1e9 / C)
    rise_deg = np.degrees(np.arctan2(height_m - 30.0, 5000.0))
    lobe_db = 12 * (rise_deg / 10) ** 2  # the pattern's parabola, in its file from degree to degree
    friis = 65.0 + width_db - loss_db - lobe_db - 10.0 - 3.0
    assert alone.power_dbm(profile, pattern, 5000.0) == pytest.approx(friis, abs=0.1)
    tilted = replace(alone, stations=(replace(mast, tilt_deg=-rise_deg),))
    assert tilted.power_dbm(profile, pattern, 5000.0) == pytest.approx(friis + lobe_db, abs=0.1)
    # a perfect mirror, isotropic antennas: between nothing and 6 dB over free space, 3 dB in the mean over a band
    flat = replace(pattern, gain_dbi=0 * pattern.gain_dbi)
    both = replace(alone, ground_reflection=1.0)
    far = np.arange(500, 1500, 2)
    more = [both.power_dbm(profile, flat, x) - alone.power_dbm(profile, flat, x) for x in far]
    assert np.mean(10 ** (np.array(more) / 10)) == pytest.approx(2.0, abs=0.15)
    assert max(more) < 6.03
    beyond = replace(alone, glide_path_deg=0.5, stations=(replace(mast, along_m=-200e3),))
    assert beyond.power_dbm(profile, pattern, 0.0) < -200.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("nr100_4100", "nr10", "interferer is 'nr10'; allowed: nr100_3750"),
        ("glide_path_deg: 3.0", "glide_path_deg: 30.0", "approach.glide_path_deg is 30; .* within 0.5..10"),
        ("base_station.csv", "nobody.csv", "nobody.csv"),
    ],
)
def test_a_wrong_value_gets_one_line(tmp_path, old, new, message):
    (tmp_path / "base_station.csv").write_text((SHIPPED.parent / "base_station.csv").read_text())
    (tmp_path / "mine.yaml").write_text(SHIPPED.read_text().replace(old, new, 1))
    with refused(InputError, message):
        load_approach(tmp_path / "mine.yaml")


def test_an_approach_says_what_broke_where(tmp_path, measured_here, undrawn):
    """Stations of 70 dB more than allowed take the altitude; those allowed do not."""
    (tmp_path / "base_station.csv").write_text((SHIPPED.parent / "base_station.csv").read_text())
    text = SHIPPED.read_text().replace("step_m: 400.0", "step_m: 3000.0")
    for name, eirp in (("allowed", "65.0"), ("loud", "135.0")):
        stations = text.replace("eirp_dbm_per_mhz: 65.0", f"eirp_dbm_per_mhz: {eirp}")
        (tmp_path / f"{name}.yaml").write_text(stations)
        options = f"--profile poor --approach {tmp_path / name}.yaml --outputs 20 --jobs 1".split()
        assert main([*options, "--out", str(tmp_path / name)]) == 0
        rows = list(csv.DictReader((tmp_path / name / "rows.csv").open()))
        assert [float(r["along_m"]) for r in rows] == [6000.0, 3000.0, 0.0]
        assert {r["failed"] == "none" for r in rows} == {name == "allowed"}
        assert {float(r["power_dbm"]) > float(r["break_dbm"]) for r in rows} == {name == "loud"}
        assert "Glide path of 3 degrees" in (tmp_path / name / "report.md").read_text()
