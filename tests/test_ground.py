"""Ground as a pilot meets it: the nearest point of a return that is wider than a point's."""

import numpy as np
import pytest
from frames import ALTIMETER, W, noise

from radalt import Altimeter, AltitudeTracker, TrackerSettings
from radalt.core.returns import terrain
from radalt.core.returns.point import point_return
from radalt.core.tracker.tracker import Status
from radalt.core.waveform import C_M_PER_S

DEGREE_M = 82_700.0  # of longitude at 42 degrees north


def over_ground(seed: int, land, altitude_m: float, *, beam=40.0, roll=0.0, pitch=0.0, count=160):
    """Frames over flat land at 70 m/s."""
    antenna, grid = terrain.GaussianAntenna(beamwidth_deg=beam), terrain.GroundGrid(seed=seed)
    flat, ground = terrain.FlatTerrain(0.0), terrain.reflectivity(*land)
    radar = terrain.TerrainReturn(flat, W, antenna=antenna, ground=ground, grid=grid)
    frames = np.empty((count, W.samples_per_frame), dtype=np.complex64)
    for k in range(count):
        east, velocity = -88.0 + 70.0 * k * W.sweep_s / DEGREE_M, (70.0, 0.0, 0.0)
        state = terrain.AircraftState(k * W.sweep_s, 42.0, east, altitude_m, velocity, 90.0, pitch, roll)
        frames[k] = radar(state, frame_index=k).frame
    frames /= np.sqrt(np.mean(np.abs(frames) ** 2))
    return frames + noise(np.random.default_rng(seed), count, 10.0)


def tracked(frames: np.ndarray, **also) -> np.ndarray:
    """Outputs after the two that a track takes to begin."""
    tracker = AltitudeTracker(ALTIMETER, TrackerSettings(leakage_m=0.0))
    return tracker.process(ALTIMETER.spectra(frames), **also)[2:]


@pytest.mark.parametrize(
    ("land", "altitude_m", "attitude"),
    [
        (("constant_gamma", "woods"), 150.0, {}),
        (("constant_gamma", "mountains"), 30.0, {}),
        (("constant_gamma", "mountains"), 150.0, {}),
        (("morchin", "urban_low_relief"), 300.0, {}),
        (("morchin", "mountains"), 1380.0, {"beam": 60.0}),
        (("morchin", "desert"), 40.0, {"beam": 60.0}),
        (("ulaby_dobson", "grass"), 300.0, {"pitch": 15.0}),
        (("constant_gamma", "woods"), 200.0, {"roll": 30.0}),
        (("morchin", "wooded_hills"), 500.0, {"roll": 40.0}),
    ],
)
def test_the_altitude_is_that_of_the_nearest_ground_in_level_flight_and_in_a_bank(land, altitude_m, attitude):
    """Ground off nadir pulls the peak up by several metres."""
    out = tracked(over_ground(4_711, land, altitude_m, **attitude))
    assert np.all(out["status"] == Status.NORMAL)
    error = np.abs(out["altitude_m"] - altitude_m)
    most_m = max(5.0, 0.03 * altitude_m) if attitude else 3.0
    assert np.all(error < out["protection_level_m"]) and np.all(error <= most_m)
    assert np.all(out["protection_level_m"] < max(10.5, 8.0 + 0.021 * altitude_m))


@pytest.mark.parametrize(("kept", "most_m"), [(1.0, 10.0), (0.6, 30.0)])
def test_ground_that_only_a_method_shows_and_widens_errs_by_no_more_than_its_protection_level(kept, most_m):
    """Of a sweep's middle the rise is wider: an edge 13 m nearer had a level of 12 m. Unwidened it costs nothing."""
    frames = over_ground(4_711, ("constant_gamma", "woods"), 150.0)
    off = np.abs(W.sample_times_s % W.half_sweep_s / W.half_sweep_s - 0.5)
    hidden = frames + 100.0 * noise(np.random.default_rng(5), len(frames), 0.0)
    out = tracked(frames * (off < 0.5 * kept), received=ALTIMETER.spectra(hidden))
    assert np.all(out["status"] == Status.NORMAL)
    assert np.all(np.abs(out["altitude_m"] - 150.0) <= out["protection_level_m"])
    assert np.all(out["protection_level_m"] < most_m)


@pytest.mark.parametrize(("speed", "snr_db"), [(0.0, -10.0), (20.0, 20.0), (150.0, -10.0)])
def test_a_point_is_no_spread_ground(speed, snr_db):
    """It fluctuates by noise alone, and moves: none of thirty blocks is weighted (95 %: fewer than one in ten)."""
    altimeter = Altimeter(W)
    rng, tracker = np.random.default_rng([1, int(speed), int(snr_db + 100)]), AltitudeTracker(altimeter)
    for _ in range(30):
        path = rng.uniform(30.0, 1400.0) + speed * W.sweep_s * np.arange(40)
        sent = point_return(W, path, vertical_speed_m_per_s=speed)
        spectra = altimeter.spectra(sent + noise(rng, 40, snr_db))
        assert tracker.spread.find(tracker.integrator.normalise(spectra)) is None


def test_power_down_to_the_lowest_beat_has_no_nearest_point():
    """Another altimeter that slides through, behind a method: its rise begins before the spectrum does."""
    tracker = AltitudeTracker(ALTIMETER)
    cell, peak = np.arange(tracker.integrator.beat_hz.size), tracker.integrator.first + 25
    power = np.where(cell <= peak, 0.2 + 0.8 * (cell / peak) ** 7, np.exp((peak - cell) / 8.0).clip(0.005))
    ratio = np.random.default_rng(3).exponential(power, (40, 2, cell.size)).astype(np.float32)
    assert tracker.spread.find(ratio) is None


def two_levels(rng: np.random.Generator, altitude_m: float, apart_m: float, level_db: float, count: int):
    """(count, N) of two returns at rest, the farther one of a level against the nearer, their phases drawn."""
    amplitudes = np.array([1.0, 10.0 ** (level_db / 20.0)])
    turns = rng.random(2)
    parts = [
        a * point_return(W, altitude_m + apart, phase_cycles=turn)
        for a, apart, turn in zip(amplitudes, (0.0, apart_m), turns, strict=True)
    ]
    return np.tile(sum(parts) / np.hypot(*amplitudes), (count, 1))


@pytest.mark.parametrize("level_db", [-6.0, 0.0, 3.0])
def test_two_levels_at_rest_within_the_peak_err_by_no_more_than_the_protection_level(level_db):
    """Of any phase; without the moment of their delays 3 of 11 altitudes were beyond it at 0 dB, 6 of 10 at 3 dB."""
    rng, given = np.random.default_rng(75), 0
    for apart_m in np.linspace(4.0, 14.0, 16):
        altitude_m = float(np.exp(rng.uniform(np.log(20.0), np.log(1300.0))))
        tracker = AltitudeTracker(ALTIMETER, TrackerSettings(leakage_m=0.0))
        frames = two_levels(rng, altitude_m, apart_m, level_db, 160) + noise(rng, 160, 10.0)
        out = tracker.process(ALTIMETER.spectra(frames))[-1]
        if out["status"] == Status.NORMAL:
            given += 1
            assert abs(out["altitude_m"] - altitude_m) <= out["protection_level_m"]
    assert given >= 5


def test_three_levels_whose_phases_turn_err_by_no_more_than_the_protection_level():
    """The middle one 5 dB stronger: the peak is 9 m too high, and their moment averages out."""
    at, frames = np.arange(240) * W.sweep_s, noise(np.random.default_rng(18), 240, 15.0)
    for behind_m, speed, level_db in ((0.0, 0.0, 0.0), (9.4, 0.9, 5.2), (20.3, -0.65, 0.8)):
        sent = point_return(W, 413.0 + behind_m + speed * at, vertical_speed_m_per_s=speed)
        frames += 10.0 ** (level_db / 20.0) * sent
    out = tracked(frames)
    assert np.all(out["status"] == Status.NORMAL)
    assert np.all(np.abs(out["altitude_m"] - 413.0) <= out["protection_level_m"])


@pytest.mark.parametrize("altitude_m", [20.0, 300.0, 1300.0])
def test_the_moment_of_two_delays_is_that_of_their_complex_amplitudes_and_a_points_is_zero(altitude_m):
    point = ALTIMETER.moments(ALTIMETER.spectra(point_return(W, np.array([altitude_m]))))[0, :, 0]
    assert np.sqrt(np.abs(point)).max() < 0.05  # resolution cells: 1 m
    delay_s = 2.0 * np.array([altitude_m, altitude_m + 6.0]) / C_M_PER_S
    near, far = np.exp(2j * np.pi * (0.1 - W.carrier_hz * delay_s))
    share = 0.5 * far / (near + 0.5 * far)
    first, second = (point_return(W, altitude_m + m, phase_cycles=0.1) for m in (0.0, 6.0))
    frame = first + 0.5 * second
    moments = ALTIMETER.moments(ALTIMETER.spectra(frame[None]))[0, :, 0]
    expected = np.abs(share * (1.0 - share)) * (6.0 / W.range_resolution_m) ** 2
    assert np.abs(moments) == pytest.approx(expected, rel=0.15)
