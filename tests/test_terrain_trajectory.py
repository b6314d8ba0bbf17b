"""Trajectories: shipped approach, derived velocity and attitude, ADS-B vectors, files that do not fit."""

import numpy as np
import pytest
from _landing_scenario import OHARE_10C, Approach
from hostile import refused

from radalt.core.returns.terrain import Trajectory, TrajectoryError

HEADER = "time,icao24,lat,lon,velocity,heading,vertrate,onground,baroaltitude,geoaltitude\n"


def _state_vectors(tmp_path, rows):
    path = tmp_path / "states.csv"
    path.write_text(HEADER + "".join(f"{row}\n" for row in rows))
    return path


def track(names, cells, *, start=0, step=1, east=1e-3, rows=5):
    """A CSV file along 42 degrees north."""
    lines = [f"{start + step * k},42,{-88 + east * k},{cells.format(k=k)}" for k in range(rows)]
    return "\n".join([f"time,lat (deg),lon,{names}", *lines])


def test_shipped_approach_is_a_three_degree_path_with_flare(root):
    track = Trajectory.load(root / "flowgraphs" / "landing" / "approach_kord_10c.csv")
    states = track.states(np.array([track.start_s + 5.0, 60.0, 120.0]))
    for state in states:
        east, north, up = state.velocity_m_per_s
        assert np.degrees(np.arctan2(-up, np.hypot(east, north))) == pytest.approx(3.0, abs=0.02)
        assert np.hypot(east, north) == pytest.approx(72.0 * np.cos(np.radians(3.0)), rel=1e-3)
        assert state.heading_deg == pytest.approx(OHARE_10C.bearing_deg, abs=0.2)
        assert state.pitch_deg == pytest.approx(2.0, abs=0.05)
        assert state.roll_deg == pytest.approx(0.0, abs=0.2)
    touchdown = track.state(track.end_s)
    assert touchdown.altitude_m == pytest.approx(OHARE_10C.elevation_m + 2.0, abs=0.01)
    assert touchdown.velocity_m_per_s[2] == pytest.approx(-0.6, abs=0.15)
    heights = np.array([s.altitude_m for s in track.states(np.linspace(track.start_s, track.end_s, 4000))])
    assert np.all(np.diff(heights) < 0)


def test_path_crosses_the_threshold_at_fifty_feet():
    points = Approach().points(0.05)
    over = np.argmin(np.abs(points[:, 2] - OHARE_10C.longitude_deg))
    # the flare begins above 15 m, so the aircraft is a little above the straight glide path there
    assert 15.0 < points[over, 3] - OHARE_10C.elevation_m < 18.0


def test_coordinated_turn_sets_the_bank(tmp_path):
    speed, rate = 80.0, np.radians(3.0)  # a rate-one turn: atan(80 * 0.05236 / 9.80665) = 23.13 degrees
    t = np.arange(0.0, 40.0, 1.0)
    north, east = speed / rate * np.sin(rate * t), speed / rate * (1 - np.cos(rate * t))
    track = Trajectory(t, 42 + np.degrees(north / 6.36e6), -88 + np.degrees(east / 4.75e6), np.full(40, 9e2))
    state = track.state(20.3)
    assert state.roll_deg == pytest.approx(23.1, abs=0.6)
    assert state.heading_deg == pytest.approx(60.9, abs=0.7)
    nose, wing, belly = state.body_axes()
    assert wing[2] < -0.3 and belly[2] < -0.9  # right wing down in a right turn
    axes = np.stack([nose, wing, belly])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)


def test_adsb_state_vectors_load_as_they_come(tmp_path):
    rows = []
    for k in range(40):  # 5 s apart, descending 3.8 m/s, quantised to 25 ft as in ADS-B
        altitude = round((800 - 19.0 * k) / 7.62) * 7.62
        lon = -88.10 + 0.0043 * (k - k % 2 * (k > 30))
        rows.append(
            f"{1600000000 + 5 * k},a0b1c2,41.96,{lon:.5f},71.2,90.1,-3.8,false,"
            f"{altitude:.2f},{altitude + 60:.2f}"
        )
    rows[7] = "1600000035,a0b1c2,,,,,,false,,"
    rows += ["1600000200,a0b1c2,41.96,-87.93,60,90,0,true,,"]
    path = _state_vectors(tmp_path, rows)
    track = Trajectory.load(path, altitude_offset_m=34.0)
    assert track.time_s.size == 41 - 7  # one without position, one on ground, five with the position before
    assert track.altitude_m[0] == pytest.approx(round(800 / 7.62) * 7.62 + 94.0)
    assert Trajectory.load(path, altitude="baro").altitude_m[0] == pytest.approx(round(800 / 7.62) * 7.62)
    state = track.state(1600000080.0)
    assert state.velocity_m_per_s[0] == pytest.approx(71.3, rel=0.02)
    assert state.velocity_m_per_s[2] == pytest.approx(-3.8, abs=1.6)


def test_several_aircraft_need_a_choice(tmp_path):
    rows = [f"{k},{n},41.9,{-88 + 0.001 * k},70,90,0,false,500,500" for k in range(8) for n in ("aaa", "bbb")]
    path = _state_vectors(tmp_path, rows)
    with pytest.raises(TrajectoryError, match=r"2 aircraft.*aaa.*aircraft="):
        Trajectory.load(path)
    assert Trajectory.load(path, aircraft="BBB").time_s.size == 8
    with pytest.raises(TrajectoryError, match="no aircraft 'ccc'"):
        Trajectory.load(path, aircraft="ccc")


def test_a_gap_is_named_unless_allowed(tmp_path):
    t = np.r_[0.0, 1.0, 2.0, 40.0, 41.0]
    points = (t, np.full(5, 42.0), -88 + 1e-3 * t, 500 - t)
    with pytest.raises(TrajectoryError, match=r"no points for 38 s after t = 2 s.*max_gap_s"):
        Trajectory(*points)
    assert Trajectory(*points, max_gap_s=60.0).state(20.0).altitude_m == pytest.approx(480.0, abs=0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,lat,lon\n0,1,2\n", "no column for altitude"),
        ("time,lat,lon,alt\n0,42,-88,5\n1,42,-88,5\n1,42,-88,5\n2,42,-88,5\n", "s at point 3; leave one"),
        ("time,lat,lon,alt\n0,92,-88,5\n1,92,-88,5\n2,92,-88,5\n3,92,-88,5\n", "latitude_deg has"),
        (track("alt", "1e300"), r"altitude_m has to be within \+/-100000"),
        (track("alt,vertical_rate", "1000,1200"), "alt may .* vertical_rate; give .*altitude_unit: ft"),
        (track("geoaltitude,gs", "1000,140"), "geoaltitude may be in feet .* has gs; give .*altitude_unit"),
        (track("altitude", "{k}125"), r"1000 m/s from t = 0 s to point 2.*max_vertical_speed_m_per_s = 60"),
        (track("altitude", "500", east=0.1), r"828. m/s .*max_speed_m_per_s = 700"),
        (track("altitude", "500", step=1000), "milliseconds; give seconds"),
        (track("alt,Speed (kts)", "500,90"), "alt may be in feet or metres, as the file has speed_kts"),
        (track("altitude_m,Altitude [m]", "1,2"), "two columns are called 'altitude_m'; leave one"),
        (track("altitude_m,alt_ft", "1000,1400"), "row 1: altitude_m 1000 and alt_ft 1400 are two altitudes"),
        (track("alt", "{k}00", step=3, east=1e-5), "over 0.8.* m of ground .* point 2, steeper than 45 deg"),
    ],
    ids=lambda value: value[:40],
)
def test_files_that_do_not_fit_get_one_line(tmp_path, text, message):
    path = tmp_path / "track.csv"
    path.write_text(text)
    with refused(TrajectoryError, message):
        Trajectory.load(path)


def test_queries_outside_and_missing_files_are_refused(tmp_path):
    track = Trajectory(np.arange(5.0), np.full(5, 42.0), np.linspace(-88, -87.99, 5), np.full(5, 400.0))
    with pytest.raises(TrajectoryError, match=r"t = 9 s is outside 0\.\.4 s"):
        track.state(9.0)
    with pytest.raises(TrajectoryError, match="name a CSV file"):
        Trajectory.load(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("names", "cells", "settings", "altitude_m"),
    [
        ("altitude_ft", "1000", {}, 304.8),
        ("altitude_m,altitude_ft", "310,1000", {}, 310.0),
        ("alt_baro,gs", "1000,140", {}, 304.8),
        ("altitude,track", "1000,90", {"altitude_unit": "ft"}, 304.8),
        ("altitude,track", "1000,90", {"altitude_unit": "m"}, 1000.0),
        ("altitude,geoaltitude,baroaltitude", "1,2,3", {"altitude": "baro"}, 3.0),
        ("altitude,geoaltitude,baroaltitude", "1,2,3", {}, 1.0),
    ],
)
def test_the_column_and_its_unit_are_those_meant(tmp_path, names, cells, settings, altitude_m):
    path = tmp_path / "t.csv"
    path.write_text("# a comment\n" + track(names, cells))
    assert Trajectory.load(path, **settings).altitude_m == pytest.approx(altitude_m)


def test_what_rises_on_the_spot_stays_level(tmp_path):
    hover = Trajectory(np.arange(5.0), np.full(5, 42.0), np.full(5, -88.0), 5 * np.arange(5.0))
    assert hover.state(2.0).pitch_deg < 17.0
